//! How much of the surroundings of each pixel is open to ambient light.

use super::tiles;
use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Recorder};
use crate::passes::shaders::Choices;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    recorder.compute(Call {
        choices: Choices::default(),
        constants: Vec::new(),
        segments: &[None],
        launch: tiles(recorder),
    })
}
