//! The output of kept surfaces, after effects that depend on neighbouring pixels.

use super::{output_constants, recolor_constants, surrounded, tiles};
use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Recorder};
use crate::passes::shaders::Choices;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let mut constants = output_constants(recorder);
    constants.extend(recolor_constants(recorder));
    constants.push(("MAPS", u32::from(recorder.scene.looks.maps)));
    let occlusion = recorder.task.occlusion.is_some();
    if occlusion {
        constants.push(("OCCLUSION", 1));
    }
    if recorder.task.edl.is_none() {
        constants.push(("EDL", 0));
    }
    recorder.compute(Call {
        choices: Choices {
            shadows: recorder.task.shadows.is_some(),
            environment: surrounded(recorder),
            occlusion,
            maps: recorder.scene.looks.maps,
            ..Choices::default()
        },
        constants,
        segments: &[None],
        launch: tiles(recorder),
    })
}
