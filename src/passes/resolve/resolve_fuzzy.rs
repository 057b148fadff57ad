//! Pixels that show splats blended in a single pass.

use super::{choices, constants, tiles};
use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Recorder};

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    recorder.compute(Call {
        choices: choices(recorder),
        constants: constants(recorder),
        // One for all: sums belong to no page.
        segments: &[Some(0)],
        launch: tiles(recorder),
    })
}
