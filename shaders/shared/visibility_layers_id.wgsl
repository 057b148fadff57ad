// Second of two passes: the ids of the fragments whose depths the first pass kept. Of equal depths the lowest id is the nearest.
//!include shared/window
@group(0) @binding(1) var<storage, read> visibility: array<vec2<u32>>;
@group(0) @binding(5) var<storage, read_write> fragments: array<atomic<u32>>;

// Leaves the greater of two words in a layer of this depth, and returns the other one.
fn sink(layer: u32, pixel: u32, depth: u32, word: u32) -> u32 {
    let place = 2u * place_in(layer, pixel);
    if word == 0u || atomicLoad(&fragments[place + 1u]) != depth {
        return word;
    }
    return min(word, atomicMax(&fragments[place], word));
}

fn visibility_write(pixel: u32, inverse_depth: f32, id: u32) {
    let depth = bitcast<u32>(inverse_depth);
    let shown = visibility[pixel];
    if is_in_window(pixel) && (depth > shown.y || (depth == shown.y && ~id > shown.x)) {
        // Written out: on lavapipe all loops of a thread share 65535 rounds.
        var rest = sink(0u, pixel, depth, ~id);
        rest = sink(1u, pixel, depth, rest);
        rest = sink(2u, pixel, depth, rest);
        rest = sink(3u, pixel, depth, rest);
        rest = sink(4u, pixel, depth, rest);
        rest = sink(5u, pixel, depth, rest);
        rest = sink(6u, pixel, depth, rest);
        rest = sink(7u, pixel, depth, rest);
    }
}

// Counters advance in the first pass over the scene alone.
const FIRST_HALF: bool = false;
