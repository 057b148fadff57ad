//! Pixels that show blended splats.

use super::{choices, constants, tiles};
use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Recorder};

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let mut constants = constants(recorder);
    constants.push(("DEFERRED", u32::from(recorder.task.is_deferred())));
    constants.push(("BALLS", u32::from(recorder.task.model.trees)));
    recorder.compute(Call {
        choices: choices(recorder),
        constants,
        // One for all: sums belong to no page.
        segments: &[Some(0)],
        launch: tiles(recorder),
    })
}
