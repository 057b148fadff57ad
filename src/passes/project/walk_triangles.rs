//! Listed triangles, for adapters whose rasteriser is slower than a walk in compute.

use super::{band_constant, walk};
use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Recorder, Segment};
use crate::passes::shaders::{Choices, Visibility};
use crate::plan::Pass;

pub fn pass(half: Visibility) -> Pass {
    if half == Visibility::Id { Pass::WalkTrianglesId } else { Pass::WalkTriangles }
}

pub fn record(
    recorder: &mut Recorder,
    half: Visibility,
    segment: Segment,
) -> Result<(), ShaderError> {
    recorder.compute(Call {
        pass: pass(half),
        root: "project/walk_triangles",
        choices: Choices {
            visibility: half,
            alpha_cut: recorder.scene.alpha_cut,
            ..Choices::default()
        },
        constants: vec![band_constant(recorder)],
        segments: &[segment],
        launch: walk(recorder),
    })
}
