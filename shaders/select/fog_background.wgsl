// Colours of the background behind fog that becomes thinner with height: of what is infinitely far away. A thread takes a pixel.
//!include shared/frame
//!include shared/colour
//!include shared/fog

@group(0) @binding(2) var<storage, read_write> pixels: array<u32>;

@compute @workgroup_size(64)
fn fog_background(@builtin(global_invocation_id) invocation: vec3<u32>) {
    begin_view(invocation.z);
    let at = invocation.xy;
    if any(at >= frame.size_px) {
        return;
    }
    let pixel = frame.first_pixel + at.y * frame.size_px.x + at.x;
    let own = pixels[pixel];
    let alpha = unpack4x8unorm(own).a;
    // What is transparent shows no fog.
    if alpha > 0.0 {
        let color = fogged(linear_color(own), at_depth(vec2<f32>(at) + vec2<f32>(0.5), FOG_FARTHEST));
        pixels[pixel] = pack4x8unorm(vec4<f32>(srgb_from_linear(color), alpha));
    }
}
