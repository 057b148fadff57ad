// First of two passes where 64-bit atomics return no values: the depths of the translucent fragments nearest to the eye, of those before
// what is opaque. Equal depths take a layer each.
//!include shared/sinks
@group(0) @binding(5) var<storage, read_write> fragments: array<atomic<u32>>;

alias Word = u32;

fn sink(layer: u32, pixel: u32, depth: u32, word: u32) -> u32 {
    if word == 0u {
        return word;
    }
    return min(word, atomicMax(&fragments[2u * place_in(layer, pixel) + 1u], word));
}

fn visibility_write(pixel: u32, inverse_depth: f32, id: u32) {
    let depth = bitcast<u32>(inverse_depth);
    if is_in_window(pixel) && is_before(pixel, depth, id) {
        sink_through(pixel, depth, depth);
    }
}

// Counters advance in the first pass over the scene alone.
const FIRST_HALF: bool = true;
