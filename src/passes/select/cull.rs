//! Which entries, chunks of instances, meet the frustum.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Listed, Recorder};

/// Entries that a workgroup looks at; as in the shader.
pub const ENTRIES: u32 = 32 * 32;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let groups = recorder.entries().div_ceil(ENTRIES);
    let mut constants = vec![recorder.hides()];
    if recorder.task.composites() {
        constants.push(("COMPOSITES", 1));
    }
    if recorder.scene.has_trees() {
        constants.extend(recorder.tree_constants());
    }
    recorder.over_lists(groups, Listed::Cull, constants)
}
