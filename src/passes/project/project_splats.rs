//! Visibility of splats; large ones are listed.

use crate::gpu::shader::ShaderError;
use crate::passes::reconstruct::{is_clipped, is_tree, node_constants, splat_constants};
use crate::passes::recorder::{Call, Recorder, Segment};
use crate::passes::shaders::{Choices, Portion, Visibility};
use crate::plan::Pass;

pub fn pass(half: Visibility) -> Pass {
    if half == Visibility::Id { Pass::ProjectSplatsId } else { Pass::ProjectSplats }
}

pub fn record(
    recorder: &mut Recorder,
    half: Visibility,
    portion: Portion,
    segment: Segment,
) -> Result<(), ShaderError> {
    let splats = recorder.task.splats.unwrap_or_default();
    let mut constants = splat_constants(&splats, false);
    constants.extend(node_constants(recorder, segment));
    constants.push(recorder.lanes());
    recorder.compute(Call {
        pass: pass(half),
        root: "project/project_splats",
        choices: Choices {
            visibility: half,
            clipped: is_clipped(recorder, segment),
            nodes: is_tree(recorder, segment),
            portion,
            ..Choices::default()
        },
        constants,
        segments: &[segment],
        launch: Recorder::launch(portion),
    })
}
