//! Constants that all passes over lines have.

use super::recorder::{Recorder, Segment};

/// The overrides of `shared/line` for a segment's page: lavapipe computes what a pixel shows of a tube and of a ribbon alike, unless a constant says
/// that there is none.
pub fn line_constants(recorder: &Recorder, segment: Segment) -> [(&'static str, u32); 2] {
    let page = segment.map(|segment| recorder.scene.pages[segment].kind);
    let [tubes, ribbons] = page.map_or([true; 2], |page| [page.tubes, page.ribbons]);
    [("TUBES", u32::from(tubes)), ("RIBBONS", u32::from(ribbons))]
}
