// Translucent surfaces are lit and laid under what is nearer, from front to back (Porter & Duff 1984).
//!include shared/light
//!include shared/recolor
//!include shared/fog
//!include shared/window
@group(0) @binding(2) var<storage, read_write> covered: array<vec4<f32>>;

fn finish(pixel: u32, at: vec2<u32>, surface: Surface) {
    var shown = surface;
    shown.color = recoloured(surface, at);
    if SHADED {
        shown.color = lit_color(shown, at);
    }
    shown.color = fogged_at(shown.color, at, surface.depth_scale / surface.inverse_depth);
    let place = place_in(0u, pixel);
    let before = covered[place];
    covered[place] = before + vec4<f32>(shown.color, 1.0) * (surface.alpha * (1.0 - before.a));
}
