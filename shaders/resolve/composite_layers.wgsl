// Lays the translucent surfaces over the image (Porter & Duff 1984). A thread takes a pixel.
//!include shared/frame
//!include shared/scene
//!include shared/colour
//!include shared/over
//!include shared/window
//!include shared/transmits

@group(0) @binding(1) var<storage, read> fragments: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read_write> pixels: array<u32>;
@group(0) @binding(3) var<storage, read> covered: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> stats: array<Stats>;

// The word of a pixel that shows `over` before what it showed, of each channel of which a part is hidden. Highlights on glass are brighter
// than the little that it hides. Over a transparent background alpha is therefore as large as the brightest channel.
fn word_through(over: vec4<f32>, hidden: vec3<f32>, word: u32) -> u32 {
    let below = unpack4x8unorm(word).a;
    let sum = over.rgb + below * (vec3<f32>(1.0) - hidden) * linear_color(word);
    let most = max(sum.r, max(sum.g, sum.b));
    let alpha = min(max(over.a + below * (1.0 - over.a), most), 1.0);
    return pack4x8unorm(vec4<f32>(srgb_from_linear(sum / alpha), alpha));
}

@compute @workgroup_size(64)
fn composite_layers(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    begin_view(0u);
    let pixel = window.first_pixel + (group.y * DISPATCH_ROW + group.x) * 64u + lane;
    if !is_in_window(pixel) {
        return;
    }
    let over = covered[place_in(0u, pixel)];
    var hidden = vec3<f32>(over.a);
    if TRANSMITS {
        hidden = covered[place_in(1u, pixel)].rgb;
    }
    let passing = 1.0 - min(hidden.r, min(hidden.g, hidden.b));
    // Behind surfaces that hide all but half a step of a byte in every channel, nothing is missed.
    if passing > 1.0 / 512.0 && fragments[place_in(LAYERS - 1u, pixel)].y != 0u {
        let view = pixel / (frame.size_px.x * frame.size_px.y);
        atomicAdd(&stats[view].pixels_of_all_layers, 1u);
        atomicMax(&stats[view].passing_most, bitcast<u32>(min(passing, 1.0)));
    }
    // What hides nothing may still give off light.
    if over.a <= 0.0 && all(over.rgb <= vec3<f32>(0.0)) {
        return;
    }
    if TRANSMITS {
        pixels[pixel] = word_through(over, hidden, pixels[pixel]);
    } else {
        pixels[pixel] = word_over(over, pixels[pixel]);
    }
}
