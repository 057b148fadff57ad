//! A surface from the samples that were projected: weighted sums of splats in integers, whose order does not matter, splats that are sorted
//! and painted over each other, or a pyramid of the image.

pub mod blend_splats;
pub mod blend_walked;
pub mod count_keys;
pub mod count_splats;
pub mod count_tiles;
pub mod fuzzy_splats;
pub mod fuzzy_walked;
pub mod list_splats;
pub mod move_keys;
pub mod move_tiles;
pub mod number_splats;
pub mod paint_splats;
pub mod pull;
pub mod push;
pub mod record_samples;
pub mod sum_counts;

use super::fog;
use super::frame::output_number;
use super::pipelines::Constants;
use super::project::{band_constant, walk};
use super::recorder::{Call, Launch, Recorder};
use super::samples::{
    is_clipped, is_tree, node_constants, paint_constants, sort_constants, splat_constants,
};
use super::shaders::Choices;
use super::spread::sort_workers;
use crate::gpu::shader::ShaderError;
use crate::plan::{Output, Pass, Reconstruction};
use crate::scene::recolor::Recolor;
use crate::scene::{PullPushWeights, Shading};

/// Samples that the sums of a pixel have room for.
const SUMS_ROOM: u64 = 1 << 17;

/// Whether splats are lit one by one.
pub fn is_lit(recorder: &Recorder) -> bool {
    let alone = recorder.task.reconstruction.shades(Shading::Splat);
    alone && recorder.task.output == Output::Color && recorder.scene.light_count > 0
}

/// Records a pass in which a thread walks a splat.
pub fn scatter(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let mut constants = constants(recorder, false);
    constants.push(recorder.lanes());
    constants.extend(sort_constants(recorder, recorder.segment));
    // Blended are all that the visible surface was looked for among.
    let choices = Choices { portion: recorder.portion(), ..choices(recorder) };
    let (segments, launch) = (&[recorder.segment], recorder.launch());
    recorder.compute(Call { choices, constants, segments, launch })
}

/// Records a pass over the list of large splats.
pub fn walk_listed(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let mut constants = constants(recorder, true);
    constants.push(band_constant(recorder));
    let (choices, segments, launch) = (choices(recorder), &[recorder.segment], walk(recorder));
    recorder.compute(Call { choices, constants, segments, launch })
}

/// Records a pass over the list of painted splats, a share a thread.
pub fn over_shares(recorder: &mut Recorder) -> Result<(), ShaderError> {
    let (workers, lanes) = (sort_workers(recorder.context.gpu.is_cpu), recorder.lanes());
    let clipped = ("CLIPPED", u32::from(recorder.scene.has_clip_lines()));
    recorder.rows(workers / lanes.1, 1, vec![("WORKERS", workers), clipped, lanes])
}

/// Overrides of `shared/patches`.
pub fn pulled_constants(recorder: &Recorder) -> Constants {
    let task = recorder.task;
    let is_color = task.output == Output::Color;
    let normals = task.output == Output::Normal
        || (is_color && (task.plan.lights_pixels || matches!(task.recolor, Some(Recolor::Normal))));
    let pull_push = task.reconstruction.pull_push();
    let is_box = pull_push.is_some_and(|found| found.weights == PullPushWeights::Box);
    vec![
        ("BOX", u32::from(is_box)),
        ("COLORS", u32::from(is_color)),
        ("NORMALS", u32::from(normals)),
    ]
}

/// A launch of a thread for each pixel of a level, in every view.
pub fn over_level(recorder: &Recorder, width: u32, height: u32) -> Launch {
    Launch::Direct([width.div_ceil(64), height, recorder.task.count()])
}

/// A launch of a thread for each corner of the pixels of the level above the recorder's, in every view.
pub fn over_corners(recorder: &Recorder) -> Launch {
    let (width, height) = recorder.levels().size(recorder.level + 1);
    over_level(recorder, width + 1, height + 1)
}

fn choices(recorder: &Recorder) -> Choices {
    let segment = recorder.segment;
    Choices {
        clipped: is_clipped(recorder, segment),
        wide_sums: recorder.context.gpu.atomic_sums_64,
        normal_sums: recorder.task.is_deferred(),
        lit: is_lit(recorder),
        environment: is_lit(recorder) && recorder.task.environment,
        shadows: is_lit(recorder) && recorder.task.shadows.is_some(),
        nodes: is_tree(recorder, segment),
        fields: recorder.task.shows_field(),
        ..Choices::default()
    }
}

fn constants(recorder: &Recorder, walked: bool) -> Constants {
    let segment = recorder.segment;
    let mut constants = vec![
        ("OUTPUT", output_number(recorder.task.output)),
        ("OVERRIDES", u32::from(recorder.scene.looks.overrides)),
        ("DEFERRED", u32::from(recorder.task.is_deferred())),
    ];
    // Splats that leave no depths are seen through fog one by one.
    if recorder.task.reconstruction.without_depths().is_some() {
        constants.extend(fog::constants(recorder));
    }
    match recorder.task.reconstruction {
        Reconstruction::Fuzzy(_) => {
            constants.push(("HIDES", u32::from(recorder.task.plan.runs(Pass::ProjectTriangles))));
        }
        Reconstruction::Painted(_) => constants.push(("PAINTED", 1)),
        _ => constants.push(("CROWDED", u32::from(recorder.scene.sample_count >= SUMS_ROOM))),
    }
    if is_lit(recorder) {
        constants.extend(super::resolve::light_constants(recorder));
        constants.push(("MAPS", 0));
    }
    constants.extend(splat_constants(&recorder.task.reconstruction, walked));
    constants.extend(node_constants(recorder, segment));
    constants.extend(paint_constants(recorder, segment));
    constants
}
