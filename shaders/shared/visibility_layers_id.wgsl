// Second of two passes: the ids of the fragments whose depths the first pass kept. Of equal depths the lowest id is the nearest.
//!include shared/sinks
@group(0) @binding(5) var<storage, read_write> fragments: array<atomic<u32>>;

alias Word = u32;

fn sink(layer: u32, pixel: u32, depth: u32, word: u32) -> u32 {
    let place = 2u * place_in(layer, pixel);
    if word == 0u || atomicLoad(&fragments[place + 1u]) != depth {
        return word;
    }
    return min(word, atomicMax(&fragments[place], word));
}

fn visibility_write(pixel: u32, inverse_depth: f32, id: u32) {
    let depth = bitcast<u32>(inverse_depth);
    if is_in_window(pixel) && is_before(pixel, depth, id) {
        sink_through(pixel, depth, ~id);
    }
}

// Counters advance in the first pass over the scene alone.
const FIRST_HALF: bool = false;
