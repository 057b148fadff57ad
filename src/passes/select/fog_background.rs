//! The background behind fog that becomes thinner with height.

use crate::gpu::shader::ShaderError;
use crate::passes::fog;
use crate::passes::recorder::{Call, Launch, Recorder};
use crate::passes::shaders::Choices;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let (width, height) = recorder.task.size();
    recorder.compute(Call {
        choices: Choices::default(),
        constants: fog::constants(recorder),
        segments: &[None],
        launch: Launch::Direct([width.div_ceil(64), height, recorder.task.count()]),
    })
}
