//! The output of kept surfaces, after effects that depend on neighbouring pixels.

use super::{output_constants, recolor_constants, surrounded, switch, tiles};
use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Recorder};
use crate::passes::shaders::Choices;
use crate::plan::Specialisation;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let mut constants = output_constants(recorder);
    constants.extend(recolor_constants(recorder));
    constants.push(switch(recorder, Specialisation::Maps));
    let occlusion = recorder.task.occlusion.is_some();
    if occlusion {
        constants.push(("OCCLUSION", 1));
    }
    if !recorder.task.plan.draws(Specialisation::Edl) {
        constants.push(switch(recorder, Specialisation::Edl));
    }
    recorder.compute(Call {
        choices: Choices {
            shadows: recorder.task.shadows.is_some(),
            environment: surrounded(recorder),
            occlusion,
            maps: recorder.task.plan.draws(Specialisation::Maps),
            ..Choices::default()
        },
        constants,
        segments: &[None],
        launch: tiles(recorder),
    })
}
