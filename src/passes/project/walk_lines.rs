//! Listed segments.

use super::{band_constant, walk};
use crate::gpu::shader::ShaderError;
use crate::passes::lines::line_constants;
use crate::passes::recorder::{Call, Recorder};
use crate::passes::shaders::Choices;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    recorder.compute(Call {
        choices: Choices { visibility: recorder.visibility(), ..Choices::default() },
        constants: [
            vec![band_constant(recorder)],
            line_constants(recorder, recorder.segment).to_vec(),
        ]
        .concat(),
        segments: &[recorder.segment],
        launch: walk(recorder),
    })
}
