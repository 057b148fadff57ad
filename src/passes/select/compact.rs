//! Visible entries become slots, each with the map that takes its samples to the image.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Listed, Recorder};

/// Entries that a workgroup takes; as in the shader.
pub const ENTRIES: u32 = 64;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let groups = recorder.entries().div_ceil(ENTRIES);
    let unasked = ("UNASKED", u32::from(recorder.task.reconstruction.without_depths().is_some()));
    let mut constants = vec![recorder.hides(), unasked];
    if recorder.scene.has_trees() {
        constants.extend(recorder.tree_constants());
    }
    recorder.over_lists(groups, Listed::Compact, constants)
}
