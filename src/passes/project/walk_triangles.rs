//! Listed triangles, for adapters whose rasteriser is slower than a walk in compute.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Launch, Recorder, Segment};
use crate::passes::shaders::Visibility;
use crate::plan::Pass;

/// Triangles side by side; as in the shader.
pub const STRIDE: u32 = 64;
/// Rows of a band of the image; as in the shader.
pub const BAND: u32 = 128;

pub fn pass(half: Visibility) -> Pass {
    if half == Visibility::Id { Pass::WalkTrianglesId } else { Pass::WalkTriangles }
}

pub fn record(
    recorder: &mut Recorder,
    half: Visibility,
    segment: Segment,
) -> Result<(), ShaderError> {
    // The list is that of all views together.
    let bands = recorder.task.size().1.div_ceil(BAND);
    recorder.compute(Call {
        pass: pass(half),
        root: "project/walk_triangles",
        visibility: Some(half),
        constants: Vec::new(),
        segments: &[segment],
        launch: Launch::Direct([STRIDE, bands, 1]),
    })
}
