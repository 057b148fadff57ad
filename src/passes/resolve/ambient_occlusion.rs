//! How much of the surroundings of each pixel is open to ambient light.

use super::tiles;
use crate::gpu::shader::ShaderError;
use crate::passes::recorder::Recorder;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    recorder.compute_once(Vec::new(), tiles(recorder))
}
