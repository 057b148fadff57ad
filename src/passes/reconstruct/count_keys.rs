//! How many keys of painted splats have each value of a digit.

use super::over_shares;
use crate::gpu::shader::ShaderError;
use crate::passes::recorder::Recorder;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    over_shares(recorder, false)
}
