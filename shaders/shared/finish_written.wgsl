// Surfaces are coloured by a value where that is asked for, lit, and written at once.
//!include shared/light
//!include shared/recolor

fn finish(pixel: u32, at: vec2<u32>, surface: Surface) {
    var shown = surface;
    shown.color = recoloured(surface, at);
    if SHADED {
        shown.color = lit_color(shown, at);
    }
    pixels[pixel] = output_word(shown);
}

// For a surface whose colour is the one under all lights.
fn finish_lit(pixel: u32, surface: Surface) {
    pixels[pixel] = output_word(surface);
}
