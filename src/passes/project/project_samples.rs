//! One pixel a sample.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Launch, Recorder};
use crate::passes::shaders::{Choices, Visibility};
use crate::plan::Pass;
use crate::residency::SAMPLE_PAGES;

pub fn pass(half: Visibility) -> Pass {
    if half == Visibility::Id { Pass::ProjectSamplesId } else { Pass::ProjectSamples }
}

pub fn record(recorder: &mut Recorder, half: Visibility) -> Result<(), ShaderError> {
    let segments = recorder.segments(SAMPLE_PAGES);
    recorder.compute(Call {
        pass: pass(half),
        root: "project/project_samples",
        choices: Choices { visibility: half, ..Choices::default() },
        constants: Vec::new(),
        segments: &segments,
        launch: Launch::Indirect,
    })
}
