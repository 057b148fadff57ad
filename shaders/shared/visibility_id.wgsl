// Second of two passes: of the samples at the depth that won, the lowest id (stored as its complement).
//!include shared/rows_all
@group(0) @binding(1) var<storage, read_write> visibility: array<atomic<u32>>;

fn visibility_write(pixel: u32, inverse_depth: f32, id: u32) {
    if atomicLoad(&visibility[2u * pixel + 1u]) == bitcast<u32>(inverse_depth) {
        atomicMax(&visibility[2u * pixel], ~id);
    }
}

// Counters advance in the first pass over the scene alone.
const FIRST_HALF: bool = false;
