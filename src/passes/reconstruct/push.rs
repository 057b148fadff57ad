//! Push phase: a level of the pyramid, completed from the coarser one.

use super::{over_corners, pulled_constants};
use crate::gpu::shader::ShaderError;
use crate::passes::recorder::Recorder;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    recorder.compute_once(pulled_constants(recorder), over_corners(recorder))
}
