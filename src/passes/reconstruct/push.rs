//! Push phase: a level of the pyramid, completed from the coarser one.

use super::{over_corners, pulled_constants};
use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Recorder};
use crate::passes::shaders::Choices;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    recorder.compute(Call {
        choices: Choices::default(),
        constants: pulled_constants(recorder),
        segments: &[None],
        launch: over_corners(recorder),
    })
}
