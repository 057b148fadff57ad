//! Translucent surfaces over the image.

use super::layer_constants;
use crate::gpu::shader::ShaderError;
use crate::passes::recorder::Recorder;

/// Pixels of a workgroup; as in the shader.
const GROUP: u32 = 64;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let pixels = recorder.window_pixels();
    let constants = layer_constants(recorder);
    recorder.rows(pixels.div_ceil(GROUP), 1, constants)
}
