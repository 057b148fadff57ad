//! Where the entries of each value of a digit, or of each tile, go.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::Recorder;
use crate::passes::scratch::{DIGIT_VALUES, sort_workers};

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let (workers, lanes) = (sort_workers(recorder.context.gpu.is_cpu), recorder.lanes());
    recorder.rows(DIGIT_VALUES, 1, vec![("WORKERS", workers), lanes])
}
