//! Pixels that show a triangle, or the layers of translucent triangles before them.

use super::{choices, constants, tiles};
use crate::bake::pack::GeometryKind;
use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Recorder};

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let segments = recorder.segments(&[GeometryKind::Triangles]);
    recorder.compute(Call {
        choices: choices(recorder),
        constants: constants(recorder),
        segments: &segments,
        launch: tiles(recorder),
    })
}
