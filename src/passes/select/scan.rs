//! Where the visible entries of each segment will lie, and how its passes are launched.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::Recorder;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let (groups, views) = (1, recorder.task.count());
    recorder.rows(groups, views, vec![recorder.hides()])
}
