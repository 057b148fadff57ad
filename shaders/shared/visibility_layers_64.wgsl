// Keeps the translucent fragments nearest to the eye, of those before what is opaque.
//!include shared/sinks
@group(0) @binding(5) var<storage, read_write> fragments: array<atomic<u64>>;

alias Word = u64;

fn sink(layer: u32, pixel: u32, depth: u32, word: u64) -> u64 {
    if word == 0lu {
        return word;
    }
    return min(word, atomicMax(&fragments[place_in(layer, pixel)], word));
}

fn visibility_write(pixel: u32, inverse_depth: f32, id: u32) {
    let depth = bitcast<u32>(inverse_depth);
    if is_in_window(pixel) && is_before(pixel, depth, id) {
        sink_through(pixel, depth, (u64(depth) << 32u) | u64(~id));
    }
}

// Counters advance in the first pass over the scene alone.
const FIRST_HALF: bool = true;
