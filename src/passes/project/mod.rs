//! Everything into one visibility buffer. Without 64-bit atomics each pass runs twice, for depths and for ids.

pub mod project_lines;
pub mod project_samples;
pub mod project_splats;
pub mod project_triangles;
pub mod rasterise_triangles;
pub mod walk_lines;
pub mod walk_splats;
pub mod walk_triangles;

use super::recorder::{Launch, Recorder};

/// Most rows of a band of the image.
const BAND: u32 = 128;
/// Threads that walk an entry together; as in the shader.
pub const LANES: u32 = 8;
/// Rounds that an entry may take: with as many before it, half of what lavapipe lets a thread have.
const ROUNDS: u32 = 30_000;

/// Rows of a band of the image, such that a box of its width takes no more rounds than it may.
fn band(width: u32) -> u32 {
    let mut rows = BAND;
    while rows > 1 && (width / LANES + 1) * (rows + 2) > ROUNDS {
        rows /= 2;
    }
    rows
}

/// The override of `shared/walk`.
pub fn band_constant(recorder: &Recorder) -> (&'static str, u32) {
    ("BAND", band(recorder.task.size().0))
}

/// A launch over the list of large triangles or splats, which is that of all views together.
pub fn walk(recorder: &Recorder) -> Launch {
    let (width, height) = recorder.task.size();
    Launch::Direct([recorder.task.walk_stride, height.div_ceil(band(width)), 1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_entry_takes_too_many_rounds() {
        for width in [1, 1024, 1920, 4096, 16384, 65535] {
            assert!((width / LANES + 1) * (band(width) + 2) <= ROUNDS, "{width}");
        }
        assert_eq!([band(1024), band(1920), band(4096)], [128, 64, 32]);
    }
}
