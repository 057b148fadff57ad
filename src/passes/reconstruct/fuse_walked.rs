//! Listed splats, blended and depth-tested at once.

use super::{choices, constants};
use crate::gpu::shader::ShaderError;
use crate::passes::project::{band_constant, walk};
use crate::passes::recorder::{Call, Recorder, Segment};
use crate::plan::Pass;

pub fn record(recorder: &mut Recorder, segment: Segment) -> Result<(), ShaderError> {
    let mut constants = constants(recorder, segment, true);
    constants.push(band_constant(recorder));
    recorder.compute(Call {
        pass: Pass::FuseWalked,
        root: "reconstruct/fuse_walked",
        choices: choices(recorder, segment),
        constants,
        segments: &[segment],
        launch: walk(recorder),
    })
}
