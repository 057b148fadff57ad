//! Visibility of listed splats, or their layers.

use super::{band_constant, walk};
use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Recorder};
use crate::passes::samples::{is_clipped, is_tree, visible_constants};
use crate::passes::shaders::Choices;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let segment = recorder.segment;
    let mut constants = visible_constants(recorder, true);
    constants.push(band_constant(recorder));
    recorder.compute(Call {
        choices: Choices {
            visibility: recorder.visibility(),
            clipped: is_clipped(recorder, segment),
            nodes: is_tree(recorder, segment),
            ..Choices::default()
        },
        constants,
        segments: &[segment],
        launch: walk(recorder),
    })
}
