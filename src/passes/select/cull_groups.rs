//! Which groups of instances may show anything of their own.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{DISPATCH_ROW, Launch, Recorder};

/// Groups of instances that a workgroup looks at; as in the shader.
const GROUPS: u32 = 64;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let groups = recorder.scene.instance_groups().div_ceil(GROUPS);
    let size = [groups.min(DISPATCH_ROW), groups.div_ceil(DISPATCH_ROW), 1];
    recorder.compute_once(vec![("MEASURE", recorder.task.measure())], Launch::Direct(size))
}
