//! Listed segments, or their layers.

use super::{band_constant, walk};
use crate::gpu::shader::ShaderError;
use crate::passes::lines::line_constants;
use crate::passes::recorder::{Call, Recorder};
use crate::passes::shaders::Choices;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let mut constants = line_constants(recorder, recorder.segment);
    constants.push(band_constant(recorder));
    recorder.compute(Call {
        choices: Choices { visibility: recorder.visibility(), ..Choices::default() },
        constants,
        segments: &[recorder.segment],
        launch: walk(recorder),
    })
}
