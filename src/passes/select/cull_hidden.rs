//! Which far slots lie wholly behind what has been drawn.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Launch, Recorder, Segment};
use crate::passes::shaders::Choices;
use crate::plan::Pass;
use crate::residency::{PageKind, SAMPLE_PAGES};

/// Turns in which what is far is asked; as in the shader.
pub const TURNS: u32 = 7;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    // Splats that are blended in a single pass are drawn wherever they are.
    let samples = if recorder.task.plan.runs(Pass::FuseSplats) { &[][..] } else { SAMPLE_PAGES };
    let segments = recorder.segments(&[samples, &[PageKind::Triangles]].concat());
    asked(recorder, &segments, false)
}

/// Asks samples that have been drawn once more, now that all that may hide them has been drawn, too.
pub fn record_again(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let segments = recorder.segments(SAMPLE_PAGES);
    asked(recorder, &segments, true)
}

fn asked(recorder: &mut Recorder, segments: &[Segment], again: bool) -> Result<(), ShaderError> {
    let splats = ("SPLATS", u32::from(recorder.task.splats.is_some()));
    let counts = ("COUNTS_SAMPLES", u32::from(!recorder.scene.has_trees()));
    recorder.compute(Call {
        pass: Pass::CullHidden,
        root: "select/cull_hidden",
        choices: Choices::default(),
        constants: vec![counts, splats, ("AGAIN", u32::from(again))],
        segments,
        launch: Launch::Asked,
    })
}
