// The words that passes over the image look at: those of a layer of translucent fragments.
//!include shared/window
@group(0) @binding(1) var<storage, read> fragments: array<vec2<u32>>;

fn low_word(pixel: u32) -> u32 {
    return fragments[place_in(window.layer, pixel)].x;
}

fn high_word(pixel: u32) -> u32 {
    if !is_in_window(pixel) {
        return 0u;
    }
    return fragments[place_in(window.layer, pixel)].y;
}

// Most layers before another one.
const MOST_BEFORE: u32 = LAYERS - 1u;

// The word of a pixel of the window in a layer, if that is before this one.
fn word_before(layer: u32, pixel: u32) -> vec2<u32> {
    return select(vec2<u32>(0u), fragments[place_in(layer, pixel)], layer < window.layer);
}

// Whether any of these pixels may have a word: the pixel behind the last one is not among them. No pixel has a fragment in this layer if none
// has one in the layer before.
fn may_have_words(first: u32, behind: u32) -> bool {
    let is_here = behind > window.first_pixel && first < window.first_pixel + window.pixels;
    return is_here && atomicLoad(&stats[frame.view].deepest) >= window.layer;
}

// Notes that some pixel has a fragment in this layer.
fn note_triangles(count: u32) {
    atomicMax(&stats[frame.view].deepest, window.layer + 1u);
}

// Counts a thread's pixels whose fragment in this layer is a sample's.
fn note_samples(count: u32) {
    note_triangles(count);
    atomicAdd(&stats[frame.view].pixels_of_samples, count);
}

// Counts a thread's pixels whose fragment in this layer is a segment's.
fn note_segments(count: u32) {
    note_triangles(count);
    atomicAdd(&stats[frame.view].pixels_of_segments, count);
}
