//! Where the entries of each value of a digit, or of each tile, go.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::Recorder;
use crate::passes::scratch::DIGIT_VALUES;
use crate::passes::spread::{sort_workers, summers};

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let is_cpu = recorder.context.gpu.is_cpu;
    let (workers, summers) = (sort_workers(is_cpu), summers(is_cpu));
    let constants = vec![("WORKERS", workers), recorder.lanes(), ("SUMMERS", summers)];
    recorder.rows(DIGIT_VALUES, 1, constants)
}
