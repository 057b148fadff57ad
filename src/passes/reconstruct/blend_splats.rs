//! Sums of splats that one thread walks.

use super::scatter;
use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Recorder, Segment};
use crate::plan::Pass;

pub fn record(recorder: &mut Recorder, segment: Segment) -> Result<(), ShaderError> {
    scatter(recorder, segment, Pass::BlendSplats, "reconstruct/blend_splats")
}
