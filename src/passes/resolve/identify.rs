//! Which chunk and which of its elements each pixel shows.

use super::tiles;
use crate::gpu::shader::ShaderError;
use crate::passes::recorder::Recorder;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    recorder.compute_once(Vec::new(), tiles(recorder))
}
