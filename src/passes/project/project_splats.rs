//! Visibility of splats; large ones are listed.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Recorder};
use crate::passes::samples::{is_clipped, is_tree, node_constants, splat_constants};
use crate::passes::shaders::Choices;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let segment = recorder.segment;
    let mut constants = splat_constants(&recorder.task.reconstruction, false);
    constants.extend(node_constants(recorder, segment));
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
