//! How many painted splats reach into each tile.

use super::over_shares;
use crate::gpu::shader::ShaderError;
use crate::passes::recorder::Recorder;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    over_shares(recorder, true)
}
