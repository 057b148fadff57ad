//! The hierarchical depth buffer of what has been drawn.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Launch, Recorder};
use crate::passes::shaders::Choices;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    recorder.compute(Call {
        choices: Choices::default(),
        constants: Vec::new(),
        segments: &[None],
        launch: Launch::Pyramid,
    })
}
