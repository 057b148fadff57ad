// Occlusion culling (after Greene, Kass & Miller 1993): what is near is drawn first, then, turn by turn from near to far, what does not
// lie as a whole behind all that. The order changes no pixel: the visibility buffer keeps the nearest, whoever came first.

// Counts of a segment's visible slots: how many are asked whether they are hidden, and how many are listed as drawn: those that are near,
// and those that turned out not to be hidden.
struct Portion {
    far: atomic<u32>,
    listed: atomic<u32>,
    // The one among them whose turn it is.
    begin: u32,
    end: u32,
}

// A view's record of depths: what begins in each eighth of an octave of depth covers, in parts of the image; and where
// near and each turn of what is far end.
const DEPTH_BINS: u32 = 512u;
// Where its ends begin, and the first and last row of pixels that what begins in each part covers.
const DEPTH_ENDS: u32 = 512u;
const DEPTH_TOPS: u32 = 520u;
const DEPTH_BOTTOMS: u32 = 1032u;
// Which turn it is, from 1 on once near is drawn; and how many slots each asks.
const DEPTH_TURN: u32 = 1544u;
const DEPTH_ASKED: u32 = 1545u;
const DEPTHS_WORDS: u32 = 1560u;
// A far slot in the list: the slot, and from this bit on where its depth is among the bins.
const TURN_SHIFT: u32 = 22u;
const TURN_SLOT: u32 = 0x3fffffu;
const NO_TURN: u32 = 0xffffffffu;
// Far slots that a workgroup of 64 threads goes through.
override ASKED: u32 = 512u;
// Far slots are asked in at most so many turns, each after nearer slots have been drawn.
const TURNS: u32 = 7u;
// Parts of the image, of which a slot covers so many at most.
const COVER_ONE: u32 = 1000u;

// The part of an octave of depth in which something begins; 0 where it surrounds the eye.
fn depth_bin(near: f32) -> u32 {
    // Exponent and the first bits of the mantissa, from 2^-32 on.
    let octaves = bitcast<u32>(max(near, 0.0)) >> 20u;
    return min(max(octaves, 760u) - 760u, DEPTH_BINS - 1u);
}
