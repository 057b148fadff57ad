//! The groups that `cull_groups` has left, in order.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::Recorder;
use crate::plan::Pass;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    recorder.rows(Pass::ListGroups, "select/list_groups", 1, 1, Vec::new())
}
