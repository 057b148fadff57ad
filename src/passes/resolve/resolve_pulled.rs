//! The surface that pull-push reconstructs.

use super::{choices, constants};
use crate::gpu::shader::ShaderError;
use crate::passes::reconstruct::{over_corners, pulled_constants};
use crate::passes::recorder::{Call, Recorder};

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let mut constants = constants(recorder);
    constants.extend(pulled_constants(recorder));
    recorder.compute(Call {
        choices: choices(recorder),
        constants,
        // One for all: patches belong to no page.
        segments: &[Some(0)],
        launch: over_corners(recorder),
    })
}
