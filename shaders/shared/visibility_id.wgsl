// Second of two passes: of the samples at the depth that won, the lowest id (stored as its complement).
@group(0) @binding(1) var<storage, read_write> visibility: array<atomic<u32>>;

fn visibility_write(pixel: u32, inverse_depth: f32, id: u32) {
    if atomicLoad(&visibility[2u * pixel + 1u]) == bitcast<u32>(inverse_depth) {
        atomicMax(&visibility[2u * pixel], ~id);
    }
}

// Counters advance in the first pass over the scene alone.
const FIRST_HALF: bool = false;

fn draws_pixel(pixel: u32) -> bool {
    return true;
}

// First row that the pass draws, and the one behind the last.
fn drawn_rows() -> vec2<u32> {
    return vec2<u32>(0u, frame.size_px.y);
}
