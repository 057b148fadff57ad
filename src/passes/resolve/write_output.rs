//! The output of kept surfaces, after effects that depend on neighbouring pixels.

use super::{output_constants, tiles};
use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Recorder};
use crate::passes::shaders::Choices;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    recorder.compute(Call {
        choices: Choices::default(),
        constants: output_constants(recorder),
        segments: &[None],
        launch: tiles(recorder),
    })
}
