//! Sums of listed splats.

use super::{choices, constants};
use crate::gpu::shader::ShaderError;
use crate::passes::project::walk;
use crate::passes::recorder::{Call, Recorder, Segment};
use crate::plan::Pass;

pub fn record(recorder: &mut Recorder, segment: Segment) -> Result<(), ShaderError> {
    recorder.compute(Call {
        pass: Pass::BlendWalked,
        root: "reconstruct/blend_walked",
        choices: choices(recorder, segment),
        constants: constants(recorder, segment, true),
        segments: &[segment],
        launch: walk(recorder),
    })
}
