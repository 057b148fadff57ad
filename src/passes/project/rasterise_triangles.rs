//! Listed triangles, through the adapter's rasteriser.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Recorder, Segment};
use crate::passes::shaders::Visibility;
use crate::plan::Pass;

pub fn pass(half: Visibility) -> Pass {
    if half == Visibility::Id { Pass::RasteriseTrianglesId } else { Pass::RasteriseTriangles }
}

pub fn record(
    recorder: &mut Recorder,
    half: Visibility,
    segment: Segment,
) -> Result<(), ShaderError> {
    recorder.raster(pass(half), half, segment)
}
