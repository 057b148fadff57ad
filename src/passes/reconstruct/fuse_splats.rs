//! Splats that one thread walks, blended and depth-tested at once.

use super::scatter;
use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Recorder, Segment};
use crate::plan::Pass;

pub fn record(recorder: &mut Recorder, segment: Segment) -> Result<(), ShaderError> {
    scatter(recorder, segment, Pass::FuseSplats, "reconstruct/fuse_splats")
}
