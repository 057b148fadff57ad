// The visibility buffer in one 64-bit word a pixel: bits of 1/z above, the complement of the id below. The
// nearest sample has the greatest word; of equal depths the lowest id wins; 0 is an empty pixel.
//!include shared/rows_all
@group(0) @binding(1) var<storage, read_write> visibility: array<atomic<u64>>;

fn visibility_write(pixel: u32, inverse_depth: f32, id: u32) {
    let word = (u64(bitcast<u32>(inverse_depth)) << 32u) | u64(~id);
    atomicMax(&visibility[pixel], word);
}

// Counters advance in the first pass over the scene alone.
const FIRST_HALF: bool = true;
