//! Triangles of a few pixels; larger ones are listed.

use crate::bake::pack::GeometryKind;
use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Recorder};
use crate::passes::shaders::Choices;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    // Threads that cannot vote would keep account of more rounds than they take.
    let lanes = if recorder.context.gpu.subgroups { recorder.lanes() } else { ("LANES", 64) };
    let mut constants = vec![lanes];
    if recorder.task.draws_opaque_first() && recorder.overrides_alpha(GeometryKind::Triangles) {
        constants.push(("SORT", if recorder.stage.is_windowed() { 2 } else { 1 }));
    }
    recorder.compute(Call {
        choices: Choices {
            visibility: recorder.visibility(),
            alpha_cut: recorder.alpha_cut(),
            portion: recorder.portion(),
            ..Choices::default()
        },
        constants,
        segments: &[recorder.segment],
        launch: recorder.launch(),
    })
}
