//! Listed segments.

use super::{band_constant, walk};
use crate::gpu::shader::ShaderError;
use crate::passes::lines::line_constants;
use crate::passes::recorder::{Call, Recorder};
use crate::passes::shaders::Choices;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let [tubes, ribbons] = line_constants(recorder, recorder.segment);
    recorder.compute(Call {
        choices: Choices { visibility: recorder.visibility(), ..Choices::default() },
        constants: vec![band_constant(recorder), tubes, ribbons],
        segments: &[recorder.segment],
        launch: walk(recorder),
    })
}
