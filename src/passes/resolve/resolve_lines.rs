//! Pixels that show a line, or the layers of translucent lines before them.

use super::{choices, constants, light_constants, tiles};
use crate::bake::pack::GeometryKind;
use crate::gpu::shader::ShaderError;
use crate::passes::lines::line_constants;
use crate::passes::recorder::{Call, Recorder};
use crate::passes::shaders::Choices;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let segments = recorder.segments(&[GeometryKind::Lines]);
    let mut constants = constants(recorder);
    // Thin lines are lit here even where a later pass lights everything else.
    if choices(recorder).kept && recorder.task.plan.lights_pixels {
        constants.extend(light_constants(recorder));
    }
    for segment in segments {
        recorder.compute(Call {
            choices: Choices { fields: recorder.task.shows_field(), ..choices(recorder) },
            constants: [constants.clone(), line_constants(recorder, segment)].concat(),
            segments: &[segment],
            launch: tiles(recorder),
        })?;
    }
    Ok(())
}
