//! Pixels that show blended splats.

use super::{choices, constants, tiles};
use crate::gpu::shader::ShaderError;
use crate::passes::reconstruct::is_lit;
use crate::passes::recorder::{Call, Recorder};
use crate::scene::recolor::Recolor;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let mut constants = constants(recorder);
    constants.push(("DEFERRED", u32::from(recorder.task.is_deferred())));
    constants.push(("BALLS", u32::from(recorder.task.model.trees)));
    // A colour that replaces that of the splats is lit as any other surface.
    let is_replaced = matches!(
        recorder.task.recolor,
        Some(Recolor::Height { .. } | Recolor::Normal | Recolor::Instance)
    );
    if recorder.task.plan.lights_pixels && is_lit(recorder) && !is_replaced {
        constants.push(("LIT_SINGLY", 1));
    }
    recorder.compute(Call {
        choices: choices(recorder),
        constants,
        // One for all: sums belong to no page.
        segments: &[Some(0)],
        launch: tiles(recorder),
    })
}
