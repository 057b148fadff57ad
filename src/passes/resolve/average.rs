//! Antialiasing: the mean of the parts of each pixel.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Launch, Recorder};

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let (width, height) = recorder.task.image_size();
    recorder.compute_once(
        vec![("PARTS", recorder.task.parts)],
        Launch::Direct([width.div_ceil(64), height, recorder.task.count()]),
    )
}
