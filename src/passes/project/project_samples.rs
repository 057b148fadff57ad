//! One pixel a sample.

use crate::bake::pack::GeometryKind;
use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Recorder, Segment};
use crate::passes::samples::{is_mixed, is_tree, node_constants, sort_constants};
use crate::passes::shaders::Choices;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let segments = recorder.segments(&[GeometryKind::Samples]);
    let (mixed, plain): (Vec<Segment>, Vec<Segment>) =
        segments.into_iter().partition(|&segment| is_mixed(recorder, segment));
    [plain, mixed]
        .iter()
        .filter(|segments| !segments.is_empty())
        .try_for_each(|segments| record_segments(recorder, segments))
}

/// Records the pass over segments that have translucent samples, or over others.
fn record_segments(recorder: &mut Recorder, segments: &[Segment]) -> Result<(), ShaderError> {
    // A scene's samples are either all nodes of trees or none.
    let first = segments.first().copied().flatten();
    let mut constants = node_constants(recorder, first);
    constants.push(recorder.lanes());
    constants.extend(recorder.task.reconstruction.pull_push().map(|_| ("EXPANDED", 1)));
    constants.extend(sort_constants(recorder, first));
    recorder.compute(Call {
        choices: Choices {
            visibility: recorder.visibility(),
            nodes: is_tree(recorder, first),
            portion: recorder.portion(),
            ..Choices::default()
        },
        constants,
        segments,
        launch: recorder.launch(),
    })
}
