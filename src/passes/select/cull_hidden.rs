//! Which far slots lie wholly behind what has been drawn.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Launch, Recorder};
use crate::passes::shaders::Choices;
use crate::plan::{Pass, Stage};
use crate::residency::{PageKind, SAMPLE_PAGES};

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    // Samples that have been drawn are asked once more before they are blended, now that all that may hide them is drawn.
    let again = recorder.stage == Stage::Blend;
    // Splats that are blended in a single pass are drawn wherever they are.
    let samples = if recorder.task.plan.runs(Pass::FuzzySplats) { &[][..] } else { SAMPLE_PAGES };
    let triangles = if again { &[][..] } else { &[PageKind::Triangles] };
    let segments = recorder.segments(&[samples, triangles].concat());
    let splats = ("SPLATS", u32::from(recorder.task.kernels().is_some()));
    let counts = ("COUNTS_SAMPLES", u32::from(!recorder.scene.has_trees()));
    let mut constants = vec![counts, splats, ("AGAIN", u32::from(again))];
    constants.extend(recorder.task.discs.map(|_| ("DISCS", 1)));
    recorder.compute(Call {
        choices: Choices::default(),
        constants,
        segments: &segments,
        launch: Launch::Asked,
    })
}
