//! Listed segments.

use super::{band_constant, walk};
use crate::gpu::shader::ShaderError;
use crate::passes::lines::line_constant;
use crate::passes::recorder::{Call, Recorder};
use crate::passes::shaders::Choices;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let ribbons = line_constant(recorder, recorder.segment);
    recorder.compute(Call {
        choices: Choices { visibility: recorder.visibility(), ..Choices::default() },
        constants: vec![band_constant(recorder), ribbons],
        segments: &[recorder.segment],
        launch: walk(recorder),
    })
}
