//! Visibility of listed splats.

use super::{band_constant, walk};
use crate::gpu::shader::ShaderError;
use crate::passes::reconstruct::{is_clipped, is_tree, node_constants, splat_constants};
use crate::passes::recorder::{Call, Recorder, Segment};
use crate::passes::shaders::{Choices, Visibility};
use crate::plan::Pass;

pub fn pass(half: Visibility) -> Pass {
    if half == Visibility::Id { Pass::WalkSplatsId } else { Pass::WalkSplats }
}

pub fn record(
    recorder: &mut Recorder,
    half: Visibility,
    segment: Segment,
) -> Result<(), ShaderError> {
    let splats = recorder.task.splats.unwrap_or_default();
    let mut constants = splat_constants(&splats, true);
    constants.extend(node_constants(recorder, segment));
    constants.push(band_constant(recorder));
    recorder.compute(Call {
        pass: pass(half),
        root: "project/walk_splats",
        choices: Choices {
            visibility: half,
            clipped: is_clipped(recorder, segment),
            nodes: is_tree(recorder, segment),
            ..Choices::default()
        },
        constants,
        segments: &[segment],
        launch: walk(recorder),
    })
}
