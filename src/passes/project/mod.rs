//! Everything into one visibility buffer. Without 64-bit atomics each pass runs twice, for depths and for ids.

pub mod project_samples;
pub mod project_splats;
pub mod project_triangles;
pub mod rasterise_triangles;
pub mod walk_splats;
pub mod walk_triangles;

use super::recorder::{Launch, Recorder};

/// Entries of a list that are walked side by side; as in the shader.
pub const STRIDE: u32 = 64;
/// Rows of a band of the image; as in the shader.
pub const BAND: u32 = 128;

/// A launch over the list of large triangles or splats, which is that of all views together.
pub fn walk(recorder: &Recorder) -> Launch {
    Launch::Direct([STRIDE, recorder.task.size().1.div_ceil(BAND), 1])
}
