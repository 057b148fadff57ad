//! Pixels that show a sample.

use super::{constants, tiles};
use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Recorder};
use crate::plan::Pass;
use crate::residency::PageKind;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let segments = recorder.segments(PageKind::Samples);
    recorder.compute(Call {
        pass: Pass::ResolveSamples,
        root: "resolve/resolve_samples",
        visibility: None,
        constants: constants(recorder),
        segments: &segments,
        launch: tiles(recorder),
    })
}
