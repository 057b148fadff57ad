//! Visible entries become slots, each with the map that takes its samples to the image.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::Recorder;
use crate::plan::Pass;

/// Entries that a workgroup takes; as in the shader.
pub const ENTRIES: u32 = 64;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let groups = recorder.scene.entry_count.div_ceil(ENTRIES);
    let views = recorder.task.count();
    recorder.rows(Pass::Compact, "select/compact", groups, views)
}
