// Agreements of passes over splats and over pixels: the bits of a pixel's depth that say which side of a surface is seen, and what a
// depth is counted in.
const FACING_FRONT: u32 = 1u;
const FACING_BACK: u32 = 2u;
const FACING_BITS: u32 = 3u;
// Whether a splat shows the other side than a kept depth; a surface's back lies within the offset near its silhouette.
fn shows_other_side(kept: u32, facing: u32) -> bool {
    return ((kept | facing) & FACING_BITS) == FACING_BITS;
}

const DEPTH_ONE: f32 = 1073741824.0;
