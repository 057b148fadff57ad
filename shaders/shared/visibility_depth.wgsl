// First of two passes where 64-bit atomics are absent: the greatest 1/z of each pixel.
@group(0) @binding(1) var<storage, read_write> visibility: array<atomic<u32>>;

fn visibility_write(pixel: u32, inverse_depth: f32, id: u32) {
    atomicMax(&visibility[2u * pixel + 1u], bitcast<u32>(inverse_depth));
}

// Counters advance in the first pass over the scene alone.
const FIRST_HALF: bool = true;

fn draws_pixel(pixel: u32) -> bool {
    return true;
}

// First row that the pass draws, and the one behind the last.
fn drawn_rows() -> vec2<u32> {
    return vec2<u32>(0u, frame.size_px.y);
}
