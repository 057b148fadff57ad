//! Segments of a few pixels, or the layers of translucent ones; longer and wider ones are listed.

use crate::gpu::shader::ShaderError;
use crate::passes::lines::line_constants;
use crate::passes::recorder::{Call, Recorder};
use crate::passes::shaders::Choices;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    // Threads that cannot vote would keep account of more rounds than they take.
    let lanes = if recorder.context.gpu.subgroups { recorder.lanes() } else { ("LANES", 64) };
    let mut constants = line_constants(recorder, recorder.segment);
    constants.push(lanes);
    recorder.compute(Call {
        choices: Choices {
            visibility: recorder.visibility(),
            portion: recorder.portion(),
            ..Choices::default()
        },
        constants,
        segments: &[recorder.segment],
        launch: recorder.launch(),
    })
}
