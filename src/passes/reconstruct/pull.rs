//! Pull phase: a level of the pyramid from the finer one.

use super::{over_level, pulled_constants};
use crate::gpu::shader::ShaderError;
use crate::passes::recorder::Recorder;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let (width, height) = recorder.levels().size(recorder.level + 1);
    // The rim included.
    recorder.compute_once(pulled_constants(recorder), over_level(recorder, width + 2, height + 2))
}
