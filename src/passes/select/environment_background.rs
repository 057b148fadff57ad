//! The surroundings behind the scene.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Launch, Recorder};
use crate::passes::resolve::tone_constants;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let (width, height) = recorder.task.size();
    recorder.compute_once(
        tone_constants(recorder),
        Launch::Direct([width.div_ceil(64), height, recorder.task.count()]),
    )
}
