//! How many chunks of each instance may have nodes that are drawn.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Launch, Listed, Recorder};
use crate::passes::shaders::Choices;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    recorder.compute(Call {
        choices: Choices::default(),
        constants: vec![("MEASURE", recorder.task.measure())],
        segments: &[None],
        launch: Launch::Listed(Listed::Select),
    })
}
