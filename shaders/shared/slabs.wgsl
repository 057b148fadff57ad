// The word of a pixel that is blended and depth-tested at once. Depths are cut into slabs, equally thick up to some
// depth, each a given share thicker than the one before it from there; a pixel has a word for even slabs and one for odd ones, each of the nearest slab of its kind:
//
//   13 bits  8191 − (2 · number among its kind, + 1 for the back of a surface); so that a greater word is nearer, 0 is none
//   13 bits  sum of weights, each of 8 bits at most; all ones: there were too many for the bits
//   13 bits  red,   13 bits  green, in a weight's unit
//   12 bits  blue, in two units
//
// To keep the nearest slab and add up what lies in it depends on no order. Two slabs side by side reach at least one slab behind the
// nearest fragment, wherever in its slab that is.
const SLABS: f32 = 8188.0;
const SLAB_NEAREST: u32 = 8191u;
const WEIGHTS_MOST: u32 = 8190u;
const WEIGHTS_FULL: u32 = 8191u;
const BLUE_STEPS: f32 = 0.5;

// `inverse`: 1/z.
fn slab_of(inverse: f32) -> u32 {
    let z = 1.0 / inverse;
    let first = (min(z, frame.slab_meet) - frame.slab_near) * frame.slab_per_unit;
    let rest = max(log2(z) - frame.slab_meet_log2, 0.0) * frame.slab_per_octave;
    return u32(clamp(first + rest, 0.0, SLABS));
}

fn slab_tag(slab: u32, facing: u32) -> u32 {
    return SLAB_NEAREST - ((slab & ~1u) | u32(facing == FACING_BACK));
}

// Upper halves of words.
fn tag_of(high: u32) -> u32 {
    return high >> 19u;
}

fn weights_of(high: u32) -> u32 {
    return (high >> 6u) & 0x1fffu;
}
