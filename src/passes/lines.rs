//! The constants that all passes over lines have.

use super::pipelines::Constants;
use super::recorder::{Recorder, Segment};
use super::samples::sort_constants;

/// Overrides of `shared/line`: whether the lines of a segment's page are ribbons, and which of them are drawn. Lavapipe would compute what a pixel shows of a
/// tube and of a ribbon alike, if no constant said which of them lines are.
pub fn line_constants(recorder: &Recorder, segment: Segment) -> Constants {
    let are_ribbons = segment.is_some_and(|segment| recorder.scene.pages[segment].kind.ribbons);
    let mut constants = vec![("RIBBONS", u32::from(are_ribbons))];
    constants.extend(sort_constants(recorder, segment));
    constants
}
