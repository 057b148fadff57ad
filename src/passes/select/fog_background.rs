//! The background behind fog that becomes thinner with height.

use crate::gpu::shader::ShaderError;
use crate::passes::fog;
use crate::passes::recorder::{Launch, Recorder};

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let (width, height) = recorder.task.size();
    recorder.compute_once(
        fog::constants(recorder),
        Launch::Direct([width.div_ceil(64), height, recorder.task.count()]),
    )
}
