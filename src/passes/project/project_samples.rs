//! One pixel a sample.

use crate::bake::pack::GeometryKind;
use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Recorder};
use crate::passes::samples::{is_tree, node_constants};
use crate::passes::shaders::Choices;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    // A scene's samples are either all nodes of trees or none.
    let segments = recorder.segments(&[GeometryKind::Samples]);
    let first = segments.first().copied().flatten();
    let mut constants = node_constants(recorder, first);
    constants.push(recorder.lanes());
    constants.extend(recorder.task.reconstruction.pull_push().map(|_| ("EXPANDED", 1)));
    recorder.compute(Call {
        choices: Choices {
            visibility: recorder.visibility(),
            nodes: is_tree(recorder, first),
            portion: recorder.portion(),
            ..Choices::default()
        },
        constants,
        segments: &segments,
        launch: recorder.launch(),
    })
}
