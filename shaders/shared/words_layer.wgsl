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

// The word of a pixel of the window in the layer before, if there is one.
fn word_before(pixel: u32) -> vec2<u32> {
    let word = fragments[place_in(max(window.layer, 1u) - 1u, pixel)];
    return select(vec2<u32>(0u), word, window.layer > 0u);
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

// The same of segments of lines.
fn note_segments(count: u32) {
    note_triangles(count);
    atomicAdd(&stats[frame.view].pixels_of_segments, count);
}
