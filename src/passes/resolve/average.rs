//! Antialiasing: the mean of the parts of each pixel.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Launch, Recorder};
use crate::passes::shaders::Choices;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let (width, height) = recorder.task.image_size();
    recorder.compute(Call {
        choices: Choices::default(),
        constants: vec![("PARTS", recorder.task.parts)],
        segments: &[None],
        launch: Launch::Direct([width.div_ceil(64), height, recorder.task.count()]),
    })
}
