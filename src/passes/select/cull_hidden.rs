//! Which far slots lie wholly behind what has been drawn.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Launch, Recorder};
use crate::passes::shaders::Choices;
use crate::plan::Pass;
use crate::residency::{PageKind, SAMPLE_PAGES};

/// Turns in which what is far is asked; as in the shader.
pub const TURNS: u32 = 7;

pub fn record(recorder: &mut Recorder, turn: u32) -> Result<(), ShaderError> {
    // Splats are drawn wherever they are.
    let samples = if recorder.task.splats.is_some() { &[][..] } else { SAMPLE_PAGES };
    let segments = recorder.segments(&[samples, &[PageKind::Triangles]].concat());
    let counts = ("COUNTS_SAMPLES", u32::from(!recorder.scene.has_trees()));
    recorder.compute(Call {
        pass: Pass::CullHidden,
        root: "select/cull_hidden",
        choices: Choices::default(),
        constants: vec![counts, ("TURN", turn)],
        segments: &segments,
        launch: Launch::Asked,
    })
}
