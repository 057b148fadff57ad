//! Splats that one thread walks, blended and depth-tested at once.

use super::{choices, constants};
use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Launch, Recorder, Segment};
use crate::plan::Pass;

pub fn record(recorder: &mut Recorder, segment: Segment) -> Result<(), ShaderError> {
    let mut constants = constants(recorder, segment, false);
    constants.push(recorder.lanes());
    recorder.compute(Call {
        pass: Pass::FuseSplats,
        root: "reconstruct/fuse_splats",
        choices: choices(recorder, segment),
        constants,
        segments: &[segment],
        launch: Launch::Indirect,
    })
}
