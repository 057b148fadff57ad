// The words that passes over the image look at: those of the visibility buffer.

fn low_word(pixel: u32) -> u32 {
    return visibility[pixel].x;
}

fn high_word(pixel: u32) -> u32 {
    return visibility[pixel].y;
}

// There are no layers.
const MOST_BEFORE: u32 = 0u;

fn word_before(layer: u32, pixel: u32) -> vec2<u32> {
    return vec2<u32>(0u);
}

// Whether any of these pixels may have a word: the pixel behind the last one is not among them.
fn may_have_words(first: u32, behind: u32) -> bool {
    return true;
}

// Counts a thread's pixels that show a sample.
fn note_samples(count: u32) {
    atomicAdd(&stats[frame.view].pixels_of_samples, count);
}

// Counts a thread's pixels that show a segment of a line.
fn note_segments(count: u32) {
    atomicAdd(&stats[frame.view].pixels_of_segments, count);
}

// Counts a thread's pixels that show a triangle.
fn note_triangles(count: u32) {
    atomicAdd(&stats[frame.view].pixels_of_triangles, count);
}
