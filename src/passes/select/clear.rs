//! Empties what the passes of all views gather in.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::Recorder;
use crate::passes::scratch::LAYERS_BYTES;
use crate::plan::Pass;

/// Pixels that a workgroup clears; as in the shader.
pub const PIXELS: u32 = 2 * 16 * 64;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let (width, height) = recorder.task.size();
    let pixels = recorder.task.count() * width * height;
    let (sums, layers) = (&recorder.context.scratch.sums, &recorder.context.scratch.layers);
    for sums in &sums[..recorder.task.sums()] {
        recorder.encoder.clear_buffer(sums.buffer().raw(), 0, Some(u64::from(pixels) * 8));
    }
    if recorder.task.plan.runs(Pass::FuseSplats) {
        let bytes = u64::from(pixels) * LAYERS_BYTES;
        recorder.encoder.clear_buffer(layers.buffer().raw(), 0, Some(bytes));
    }
    recorder.rows(pixels.div_ceil(PIXELS), 1, Vec::new())
}
