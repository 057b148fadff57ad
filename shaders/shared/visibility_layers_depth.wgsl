// First of two passes where 64-bit atomics are absent: the depths of the translucent fragments nearest to the eye, of those before what
// is opaque. Equal depths take a layer each.
//!include shared/window
@group(0) @binding(1) var<storage, read> visibility: array<vec2<u32>>;
@group(0) @binding(5) var<storage, read_write> fragments: array<atomic<u32>>;

// Leaves the greater of two words in a layer, and returns the other one.
fn sink(layer: u32, pixel: u32, word: u32) -> u32 {
    if word == 0u {
        return word;
    }
    return min(word, atomicMax(&fragments[2u * place_in(layer, pixel) + 1u], word));
}

fn visibility_write(pixel: u32, inverse_depth: f32, id: u32) {
    let word = bitcast<u32>(inverse_depth);
    let shown = visibility[pixel];
    if is_in_window(pixel) && (word > shown.y || (word == shown.y && ~id > shown.x)) {
        // Written out: on lavapipe all loops of a thread share 65535 rounds.
        var rest = sink(0u, pixel, word);
        rest = sink(1u, pixel, rest);
        rest = sink(2u, pixel, rest);
        rest = sink(3u, pixel, rest);
        rest = sink(4u, pixel, rest);
        rest = sink(5u, pixel, rest);
        rest = sink(6u, pixel, rest);
        rest = sink(7u, pixel, rest);
    }
}

// Counters advance in the first pass over the scene alone.
const FIRST_HALF: bool = true;
