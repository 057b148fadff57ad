//! The hierarchical depth buffer of what has been drawn.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Launch, Recorder};

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    recorder.compute_once(Vec::new(), Launch::Pyramid)
}
