//! Empties what the passes of all views gather in.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::Recorder;
use crate::plan::Pass;

/// Pixels that a workgroup clears; as in the shader.
pub const PIXELS: u32 = 2 * 16 * 64;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let (width, height) = recorder.task.size();
    let (groups, views) = ((recorder.task.count() * width * height).div_ceil(PIXELS), 1);
    recorder.rows(Pass::Clear, "select/clear", groups, views, Vec::new())
}
