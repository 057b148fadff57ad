//! Which entries, chunks of instances, meet the frustum.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::Recorder;
use crate::plan::Pass;

/// Entries that a workgroup looks at; as in the shader.
pub const ENTRIES: u32 = 32 * 32;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let groups = recorder.scene.entry_count.div_ceil(ENTRIES);
    let views = recorder.task.count();
    recorder.rows(Pass::Cull, "select/cull", groups, views)
}
