//! Places in the list of painted splats.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::Recorder;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let lanes = recorder.lanes();
    recorder.rows(1, 1, vec![lanes])
}
