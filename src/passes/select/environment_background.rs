//! The surroundings behind the scene.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Launch, Recorder};
use crate::passes::resolve::tone_constants;
use crate::passes::shaders::Choices;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let (width, height) = recorder.task.size();
    recorder.compute(Call {
        choices: Choices::default(),
        constants: tone_constants(recorder),
        segments: &[None],
        launch: Launch::Direct([width.div_ceil(64), height, recorder.task.count()]),
    })
}
