//! Attributes of the visible pixels only, and their light.

pub mod identify;
pub mod resolve_fused;
pub mod resolve_samples;
pub mod resolve_splats;
pub mod resolve_triangles;
pub mod shade;

use super::frame::output_number;
use super::pipelines::Constants;
use super::recorder::{Launch, Recorder};
use crate::plan::Pass;

/// Pixels that a workgroup resolves or shades; as in the shaders.
pub const TILE: (u32, u32) = (64, 16);

/// A launch of a workgroup for every tile of every view.
pub fn tiles(recorder: &Recorder) -> Launch {
    let (width, height) = recorder.task.size();
    Launch::Direct([width.div_ceil(TILE.0), height.div_ceil(TILE.1), recorder.task.count()])
}

fn constants(recorder: &Recorder) -> Constants {
    let looks = recorder.scene.looks;
    vec![
        ("OUTPUT", output_number(recorder.task.output)),
        ("SHADED", u32::from(recorder.task.plan.runs(Pass::Shade))),
        ("OVERRIDES", u32::from(looks.overrides)),
        ("TEXTURES", u32::from(looks.textures)),
    ]
}
