//! Each instance as each view's eye sees it.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Listed, Recorder};

/// Instances that a workgroup places; as in the shader.
pub const INSTANCES: u32 = 64;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let groups = recorder.scene.instance_end.div_ceil(INSTANCES);
    recorder.over_lists(groups, Listed::Place, Vec::new())
}
