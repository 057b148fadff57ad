//! Painted splats over the image.

use crate::gpu::shader::ShaderError;
use crate::passes::reconstruct::paint_splats::surfaces;
use crate::passes::recorder::Recorder;

/// Pixels of a workgroup; as in the shader.
const GROUP: u64 = 64 * 16;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let groups = recorder.task.pixels().div_ceil(GROUP);
    recorder.rows(groups as u32, 1, vec![("SURFACES", surfaces(recorder))])
}
