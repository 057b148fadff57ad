// The surroundings, which pixels show where nothing covers them. A thread takes a pixel.
//!include shared/frame
//!include shared/colour
//!include shared/octahedral
//!include shared/tone
//!include shared/environment_map

@group(0) @binding(2) var<storage, read_write> pixels: array<u32>;

@compute @workgroup_size(64)
fn environment_background(@builtin(global_invocation_id) invocation: vec3<u32>) {
    begin_view(invocation.z);
    let at = invocation.xy;
    if any(at >= frame.size_px) {
        return;
    }
    let way = world_from_camera(towards(ray_through(vec2<f32>(at) + vec2<f32>(0.5))));
    let color = toned(environment_at(way, 0u));
    pixels[frame.first_pixel + at.y * frame.size_px.x + at.x] = pack4x8unorm(vec4<f32>(srgb_from_linear(color), 1.0));
}
