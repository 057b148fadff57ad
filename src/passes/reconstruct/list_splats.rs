//! Records and keys of painted splats.

use super::{choices, constants};
use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Recorder};

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    // Some splats may reach the camera plane.
    let mut constants = constants(recorder, true);
    constants.push(("CLIPPED", u32::from(recorder.scene.has_clip_lines())));
    constants.push(recorder.lanes());
    let (choices, segments, launch) = (choices(recorder), &[recorder.segment], recorder.launch());
    recorder.compute(Call { choices, constants, segments, launch })
}
