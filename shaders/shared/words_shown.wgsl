// The words that passes over the image look at: those of the visibility buffer.

fn low_word(pixel: u32) -> u32 {
    return visibility[pixel].x;
}

fn high_word(pixel: u32) -> u32 {
    return visibility[pixel].y;
}

fn words_are_left() -> bool {
    return true;
}

fn note_layer() {
}
