// Keeps the translucent fragments nearest to the eye, of those before what is opaque.
//!include shared/window
@group(0) @binding(1) var<storage, read> visibility: array<vec2<u32>>;
@group(0) @binding(5) var<storage, read_write> fragments: array<atomic<u64>>;

// Leaves the greater of two words in a layer, and returns the other one.
fn sink(layer: u32, pixel: u32, word: u64) -> u64 {
    if word == 0lu {
        return word;
    }
    return min(word, atomicMax(&fragments[place_in(layer, pixel)], word));
}

fn visibility_write(pixel: u32, inverse_depth: f32, id: u32) {
    let word = (u64(bitcast<u32>(inverse_depth)) << 32u) | u64(~id);
    let shown = visibility[pixel];
    if is_in_window(pixel) && word > ((u64(shown.y) << 32u) | u64(shown.x)) {
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
