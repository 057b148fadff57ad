//! Where the visible entries of each segment will lie, how its passes are launched, and in how many turns hidden ones are looked for.

use crate::bake::pack::CHUNK;
use crate::gpu::shader::ShaderError;
use crate::passes::recorder::Recorder;
use crate::plan::Pass;

/// Times of drawing a sample as a point, a sample as a splat, and a triangle or segment, in units of what a turn of occlusion culling takes for each
/// pixel of the image. Measured on lavapipe: 20, 330 and 60 ns, and 1.6 ns.
const POINT_COST: u32 = 12;
const SPLAT_COST: u32 = 200;
const TRIANGLE_COST: u32 = 40;

pub fn record(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let (groups, views) = (1, recorder.task.count());
    let task = recorder.task;
    let is_drawn = |pass| task.plan.runs(pass);
    let mut constants = vec![recorder.hides()];
    if task.hides() {
        let has_others = is_drawn(Pass::ProjectTriangles) || is_drawn(Pass::ProjectLines);
        let points_alone = is_drawn(Pass::ProjectSamples) && !has_others;
        let cost = match is_drawn(Pass::ProjectSplats) {
            true => SPLAT_COST,
            false if points_alone => POINT_COST,
            false => TRIANGLE_COST,
        };
        constants.extend([
            ("POINTS", u32::from(points_alone)),
            ("ELEMENT_COST", cost),
            ("ELEMENTS_EACH", CHUNK as u32),
        ]);
    }
    recorder.rows(groups, views, constants)
}
