// Surfaces are lit and written at once.
//!include shared/light

fn finish(pixel: u32, at: vec2<u32>, surface: Surface) {
    var shown = surface;
    if SHADED {
        shown.color = lit_color(surface, at);
    }
    pixels[pixel] = output_word(shown);
}
