//! The constant that all passes over lines have.

use super::recorder::{Recorder, Segment};

/// Whether the lines of a segment's page are ribbons, for `shared/line`. Lavapipe would compute what a pixel shows of a tube and of a ribbon alike, if
/// no constant said which of them lines are.
pub fn line_constant(recorder: &Recorder, segment: Segment) -> (&'static str, u32) {
    let are_ribbons = segment.is_some_and(|segment| recorder.scene.pages[segment].kind.ribbons);
    ("RIBBONS", u32::from(are_ribbons))
}
