//! Visibility of splats, or the layers of translucent ones; large ones are listed.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Recorder};
use crate::passes::samples::{is_clipped, is_tree, sort_constants, visible_constants};
use crate::passes::shaders::Choices;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let segment = recorder.segment;
    let mut constants = visible_constants(recorder, false);
    constants.extend(sort_constants(recorder, segment));
    constants.push(recorder.lanes());
    recorder.compute(Call {
        choices: Choices {
            visibility: recorder.visibility(),
            clipped: is_clipped(recorder, segment),
            nodes: is_tree(recorder, segment),
            portion: recorder.portion(),
            ..Choices::default()
        },
        constants,
        segments: &[segment],
        launch: recorder.launch(),
    })
}
