//! Pixels that show splats blended in a single pass.

use super::{constants, tiles};
use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Recorder};
use crate::passes::shaders::Choices;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    recorder.compute(Call {
        choices: Choices::default(),
        constants: constants(recorder),
        // One for all: sums belong to no page. The first segment's resolve writes the background.
        segments: &[Some(0)],
        launch: tiles(recorder),
    })
}
