//! Listed triangles, for adapters whose rasteriser is slower than a walk in compute.

use super::{band_constant, walk};
use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Recorder};
use crate::passes::shaders::Choices;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    recorder.compute(Call {
        choices: Choices {
            visibility: recorder.visibility(),
            alpha_cut: recorder.alpha_cut(),
            ..Choices::default()
        },
        constants: vec![band_constant(recorder)],
        segments: &[recorder.segment],
        launch: walk(recorder),
    })
}
