//! Pull phase: a level of the pyramid from the finer one.

use super::{over_level, pulled_constants};
use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Recorder};
use crate::passes::shaders::Choices;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let (width, height) = recorder.levels().size(recorder.level + 1);
    recorder.compute(Call {
        choices: Choices::default(),
        constants: pulled_constants(recorder),
        segments: &[None],
        // The rim included.
        launch: over_level(recorder, width + 2, height + 2),
    })
}
