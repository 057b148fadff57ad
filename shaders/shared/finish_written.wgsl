// Surfaces are coloured by a value where that is asked for, lit, and written at once.
//!include shared/light
//!include shared/recolor
//!include shared/fog
@group(0) @binding(1) var<storage, read_write> visibility: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read_write> pixels: array<u32>;

fn finish(pixel: u32, at: vec2<u32>, surface: Surface) {
    var shown = surface;
    shown.color = recoloured(surface, at);
    if SHADED {
        shown.color = lit_color(shown, material_of(shown), at);
    }
    finish_lit(pixel, at, shown);
}

// For a surface whose colour is the one under all lights.
fn finish_lit(pixel: u32, at: vec2<u32>, surface: Surface) {
    var shown = surface;
    shown.color = fogged_at(surface.color, at, surface.depth_scale / surface.inverse_depth);
    pixels[pixel] = output_word(shown);
}
