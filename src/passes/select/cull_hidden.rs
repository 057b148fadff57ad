//! Which far slots lie wholly behind what has been drawn.

use crate::bake::pack::GeometryKind;
use crate::gpu::shader::ShaderError;
use crate::passes::recorder::{Call, Launch, Recorder};
use crate::passes::shaders::Choices;
use crate::passes::spread;
use crate::plan::Stage;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    // Samples that have been drawn are asked once more before they are blended, now that all that may hide them is drawn.
    let again = recorder.stage == Stage::Blend;
    let is_asked = |kind: &GeometryKind| match kind {
        // Splats that are blended in a single pass are drawn wherever they are.
        GeometryKind::Samples => recorder.task.reconstruction.without_depths().is_none(),
        GeometryKind::Triangles | GeometryKind::Lines => !again,
    };
    let kinds: Vec<GeometryKind> = GeometryKind::ALL.iter().copied().filter(is_asked).collect();
    let segments = recorder.segments(&kinds);
    let splats = ("SPLATS", u32::from(!recorder.task.reconstruction.is_points()));
    let counts = ("COUNTS_SAMPLES", u32::from(!recorder.scene.has_trees()));
    let mut constants = vec![counts, splats, ("AGAIN", u32::from(again))];
    let [_, asked, testers] = spread::overrides(recorder.context.gpu.is_cpu);
    constants.extend([asked, testers]);
    constants.extend(recorder.task.reconstruction.discs().map(|_| ("DISCS", 1)));
    constants.extend(recorder.task.reconstruction.pull_push().map(|_| ("EXPANDED", 1)));
    recorder.compute(Call {
        choices: Choices::default(),
        constants,
        segments: &segments,
        launch: Launch::Asked,
    })
}
