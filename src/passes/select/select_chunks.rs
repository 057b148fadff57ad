//! How many chunks of each instance may have nodes that are drawn.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Launch, Listed, Recorder};

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    recorder
        .compute_once(vec![("MEASURE", recorder.task.measure())], Launch::Listed(Listed::Select))
}
