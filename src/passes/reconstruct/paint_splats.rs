//! The splats of each tile, painted over each other.

use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Launch, Recorder};
use crate::passes::scratch::DIGIT_VALUES;
use crate::passes::shaders::Choices;
use crate::passes::spread::{PAINT_BAND, painters};
use crate::plan::Pass;
use crate::scene::{PAINT_LAYERS, PAINT_WIDTH_PERCENT, Painting};

/// Override of `shared/canvas`: splats of one surface are averaged.
pub fn surfaces(recorder: &Recorder) -> u32 {
    let painted = recorder.task.reconstruction.painted();
    u32::from(painted.is_some_and(|painted| painted.each == Painting::Surfaces))
}

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let (task, is_cpu) = (recorder.task, recorder.context.gpu.is_cpu);
    let hides = task.plan.runs(Pass::ProjectTriangles) || task.plan.runs(Pass::ProjectLines);
    // A workgroup of a GPU has a thread for each pixel of a square.
    let lanes = if is_cpu { recorder.lanes() } else { ("LANES", 256) };
    let constants = vec![
        ("HIDES", u32::from(hides)),
        ("CLIPPED", u32::from(recorder.scene.has_clip_lines())),
        ("LAYERS", PAINT_LAYERS),
        ("WIDTH_PERCENT", PAINT_WIDTH_PERCENT),
        ("SURFACES", surfaces(recorder)),
        ("BAND", PAINT_BAND),
        ("PIXELWISE", u32::from(!is_cpu)),
        lanes,
    ];
    recorder.compute(Call {
        choices: Choices::default(),
        constants,
        // Each launch goes on where the one before it stopped.
        segments: &vec![None; task.paint_launches as usize],
        launch: Launch::Direct([DIGIT_VALUES, painters(task.size(), is_cpu), 1]),
    })
}
