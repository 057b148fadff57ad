// Which elements are drawn of pages that have translucent ones and others.
override SORT: u32 = 0u;

const SORT_OPAQUE: u32 = 1u;
const SORT_TRANSLUCENT: u32 = 2u;
// Elements without any alpha are not there, whatever the output.
const SORT_THERE: u32 = 3u;

// Whether an element is drawn whose alpha, of 255, is this, in an instance with these flags. Of pages without translucent elements, all are.
fn is_drawn_with(alpha: u32, instance_flags: u32) -> bool {
    let is_translucent = alpha < 255u || (instance_flags & INSTANCE_TRANSLUCENT) != 0u;
    let is_there = alpha > 0u && (instance_flags & INSTANCE_CLEAR) == 0u;
    let is_sought = SORT == SORT_THERE || is_translucent == (SORT == SORT_TRANSLUCENT);
    return SORT == 0u || (is_there && is_sought);
}
