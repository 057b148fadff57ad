//! Listed splats, blended and depth-tested at once.

use super::walk_listed;
use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Recorder, Segment};
use crate::plan::Pass;

pub fn record(recorder: &mut Recorder, segment: Segment) -> Result<(), ShaderError> {
    walk_listed(recorder, segment, Pass::FuseWalked, "reconstruct/fuse_walked")
}
