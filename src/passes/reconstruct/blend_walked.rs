//! Sums of listed splats.

use super::{choices, constants};
use crate::gpu::shader::ShaderError;
use crate::passes::project::{band_constant, walk};
use crate::passes::recorder::{Call, Recorder, Segment};
use crate::plan::Pass;

pub fn record(recorder: &mut Recorder, segment: Segment) -> Result<(), ShaderError> {
    let mut constants = constants(recorder, segment, true);
    constants.push(band_constant(recorder));
    recorder.compute(Call {
        pass: Pass::BlendWalked,
        root: "reconstruct/blend_walked",
        choices: choices(recorder, segment),
        constants,
        segments: &[segment],
        launch: walk(recorder),
    })
}
