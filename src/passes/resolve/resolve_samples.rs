//! Pixels that show a sample.

use super::{constants, tiles};
use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Recorder};
use crate::passes::shaders::Choices;
use crate::plan::Pass;
use crate::residency::SAMPLE_PAGES;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let segments = recorder.segments(SAMPLE_PAGES);
    recorder.compute(Call {
        pass: Pass::ResolveSamples,
        root: "resolve/resolve_samples",
        choices: Choices::default(),
        constants: constants(recorder),
        segments: &segments,
        launch: tiles(recorder),
    })
}
