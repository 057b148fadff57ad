//! One pixel a sample.

use crate::gpu::shader::ShaderError;
use crate::passes::reconstruct::{is_tree, node_constants};
use crate::passes::recorder::{Call, Recorder};
use crate::passes::shaders::{Choices, Portion, Visibility};
use crate::plan::Pass;
use crate::residency::SAMPLE_PAGES;

pub fn pass(half: Visibility) -> Pass {
    if half == Visibility::Id { Pass::ProjectSamplesId } else { Pass::ProjectSamples }
}

pub fn record(
    recorder: &mut Recorder,
    half: Visibility,
    portion: Portion,
) -> Result<(), ShaderError> {
    // A scene's samples are either all nodes of trees or none.
    let segments = recorder.segments(SAMPLE_PAGES);
    let first = segments.first().copied().flatten();
    let mut constants = node_constants(recorder, first);
    constants.push(recorder.lanes());
    recorder.compute(Call {
        pass: pass(half),
        root: "project/project_samples",
        choices: Choices {
            visibility: half,
            nodes: is_tree(recorder, first),
            portion,
            ..Choices::default()
        },
        constants,
        segments: &segments,
        launch: Recorder::launch(portion),
    })
}
