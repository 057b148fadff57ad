// First of two passes where 64-bit atomics are absent: the greatest 1/z of each pixel.
//!include shared/rows_all
@group(0) @binding(1) var<storage, read_write> visibility: array<atomic<u32>>;

fn visibility_write(pixel: u32, inverse_depth: f32, id: u32) {
    atomicMax(&visibility[2u * pixel + 1u], bitcast<u32>(inverse_depth));
}

// Counters advance in the first pass over the scene alone.
const FIRST_HALF: bool = true;
