//! The hierarchical depth buffer of what has been drawn.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Launch, Recorder};
use crate::passes::shaders::Choices;

/// Side of a block, and the words of its record; as in the shader.
pub const BLOCK_PX: u32 = 16;
pub const BLOCK_WORDS: u32 = 17;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    recorder.compute(Call {
        choices: Choices::default(),
        constants: Vec::new(),
        segments: &[None],
        launch: Launch::Pyramid,
    })
}
