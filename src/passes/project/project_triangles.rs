//! Triangles of a few pixels; larger ones are listed.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Recorder, Segment};
use crate::passes::shaders::{Choices, Portion, Visibility};
use crate::plan::Pass;

pub fn pass(half: Visibility) -> Pass {
    if half == Visibility::Id { Pass::ProjectTrianglesId } else { Pass::ProjectTriangles }
}

pub fn record(
    recorder: &mut Recorder,
    half: Visibility,
    portion: Portion,
    segment: Segment,
) -> Result<(), ShaderError> {
    // Threads that cannot vote would keep account of more rounds than they take.
    let lanes = if recorder.context.gpu.subgroups { recorder.lanes() } else { ("LANES", 64) };
    recorder.compute(Call {
        pass: pass(half),
        root: "project/project_triangles",
        choices: Choices {
            visibility: half,
            alpha_cut: recorder.scene.alpha_cut,
            portion,
            ..Choices::default()
        },
        constants: vec![lanes],
        segments: &[segment],
        launch: Recorder::launch(portion),
    })
}
