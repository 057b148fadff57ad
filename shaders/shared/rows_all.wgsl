// The rows and pixels of passes that draw all of the image at once; shared/sinks has those of passes over a window of it.
fn draws_pixel(pixel: u32) -> bool {
    return true;
}

// First row that the pass draws, and the one behind the last.
fn drawn_rows() -> vec2<u32> {
    return vec2<u32>(0u, frame.size_px.y);
}
