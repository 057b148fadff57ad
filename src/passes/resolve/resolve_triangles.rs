//! Pixels that show a triangle.

use super::{constants, tiles};
use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Recorder};
use crate::passes::shaders::Choices;
use crate::residency::PageKind;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let segments = recorder.segments(&[PageKind::Triangles]);
    recorder.compute(Call {
        choices: Choices::default(),
        constants: constants(recorder),
        segments: &segments,
        launch: tiles(recorder),
    })
}
