// A slot, and which of the sixteen parts of its chunk are drawn; none where there is no slot.
struct Turn {
    slot: u32,
    parts: u32,
}

const ALL_PARTS: u32 = 0xffffu;
// Elements of a part.
const PART: u32 = 64u;

// Returns the next drawn element, at or after `index`, that belongs to this thread. The chunk has `count` elements; the thread starts at `lane` and
// advances by a fixed stride.
fn next_element(index: u32, parts: u32, lane: u32, count: u32) -> u32 {
    var at = index;
    while at < count && ((parts >> (at / PART)) & 1u) == 0u {
        at = (at / PART + 1u) * PART + lane;
    }
    return at;
}
