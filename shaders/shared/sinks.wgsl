// How a translucent fragment finds its layer. The file that includes this says in `sink` what a layer keeps and what it hands on, of words
// of the type `Word`.
//!include shared/window
@group(0) @binding(1) var<storage, read> visibility: array<vec2<u32>>;

// Whether a fragment lies before what is opaque.
fn is_before(pixel: u32, depth: u32, id: u32) -> bool {
    let shown = visibility[pixel];
    return depth > shown.y || (depth == shown.y && ~id > shown.x);
}

// Lets a word sink. Written out: on lavapipe all loops of a thread share 65535 rounds.
fn sink_through(pixel: u32, depth: u32, word: Word) {
    var rest = sink(0u, pixel, depth, word);
    rest = sink(1u, pixel, depth, rest);
    rest = sink(2u, pixel, depth, rest);
    rest = sink(3u, pixel, depth, rest);
    rest = sink(4u, pixel, depth, rest);
    rest = sink(5u, pixel, depth, rest);
    rest = sink(6u, pixel, depth, rest);
    rest = sink(7u, pixel, depth, rest);
}

fn draws_pixel(pixel: u32) -> bool {
    return is_in_window(pixel);
}

// First row that the pass draws, and the one behind the last: those of the window.
fn drawn_rows() -> vec2<u32> {
    let pixels = frame.size_px.x * frame.size_px.y;
    let begin = max(window.first_pixel, frame.first_pixel) - frame.first_pixel;
    let end = max(window.first_pixel + window.pixels, frame.first_pixel) - frame.first_pixel;
    let width = frame.size_px.x;
    return vec2<u32>(min(begin, pixels) / width, (min(end, pixels) + width - 1u) / width);
}
