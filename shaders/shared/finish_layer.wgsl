// Translucent surfaces are lit and laid under what is nearer, from front to back (Porter & Duff 1984).
//!include shared/light
//!include shared/recolor
//!include shared/fog
//!include shared/window
//!include shared/transmits

// A pixel's colour, multiplied by what is hidden, and how much is hidden. Where surfaces let light pass, a second layer says how much of each
// channel is hidden, and the first the mean of that.
@group(0) @binding(2) var<storage, read_write> covered: array<vec4<f32>>;

// The colour of a surface, and the share of the light from behind that passes it.
struct Layer {
    color: vec3<f32>,
    alpha: f32,
    passing: vec3<f32>,
}

fn layer_of(surface: Surface, at: vec2<u32>) -> Layer {
    var layer: Layer;
    layer.color = surface.color;
    layer.alpha = surface.alpha;
    if !SHADED && !TRANSMITS {
        return layer;
    }
    let material = material_of(surface);
    if TRANSMITS && (material.flags & MATERIAL_UNLIT) == 0u {
        let normal = select(vec3<f32>(0.0), surface.normal, SHADED);
        layer.passing = passing_light(surface.color, material, normal, eye_from(place_of(surface, at)));
        layer.color *= 1.0 - material.transmission * (1.0 - material.metallic);
    }
    if SHADED {
        layer.color = lit_color(surface, material, at);
    }
    return layer;
}

fn finish(pixel: u32, at: vec2<u32>, surface: Surface) {
    var shown = surface;
    shown.color = recoloured(surface, at);
    lay_under(pixel, at, layer_of(shown, at), surface.depth_scale / surface.inverse_depth);
}

// For a surface whose colour is the one under all lights.
fn finish_lit(pixel: u32, at: vec2<u32>, surface: Surface) {
    let layer = Layer(surface.color, surface.alpha, vec3<f32>(0.0));
    lay_under(pixel, at, layer, surface.depth_scale / surface.inverse_depth);
}

// Lays the surface at a distance along the viewing axis under what is nearer.
fn lay_under(pixel: u32, at: vec2<u32>, layer: Layer, distance: f32) {
    let color = fogged_at(layer.color, at, distance);
    let place = place_in(0u, pixel);
    let before = covered[place];
    if TRANSMITS {
        let passing = layer.alpha * layer.passing;
        // Of the fog before the surface, what lies behind has its own part.
        let own = layer.alpha * color - passing * fogged_at(vec3<f32>(0.0), at, distance);
        let hidden_place = place_in(1u, pixel);
        let hidden = covered[hidden_place].rgb;
        let left = vec3<f32>(1.0) - hidden;
        let sum = hidden + left * (vec3<f32>(layer.alpha) - passing);
        covered[place] = vec4<f32>(before.rgb + left * own, dot(sum, vec3<f32>(1.0 / 3.0)));
        covered[hidden_place] = vec4<f32>(sum, 0.0);
        return;
    }
    covered[place] = before + vec4<f32>(color, 1.0) * (layer.alpha * (1.0 - before.a));
}
