// Antialiasing: averages the parts of each pixel in linear light. A thread takes a pixel. The result takes the place of the visibility buffer,
// which no later pass of a frame reads.
//!include shared/frame
//!include shared/colour

@group(0) @binding(1) var<storage, read_write> visibility: array<u32>;
@group(0) @binding(2) var<storage, read> pixels: array<u32>;

// Parts along each side of a pixel.
override PARTS: u32 = 2u;

@compute @workgroup_size(64)
fn average(@builtin(global_invocation_id) invocation: vec3<u32>) {
    begin_view(invocation.z);
    let size = frame.size_px / PARTS;
    let at = invocation.xy;
    if any(at >= size) {
        return;
    }
    let first = frame.first_pixel + PARTS * (at.y * frame.size_px.x + at.x);
    // Colour times alpha, and alpha.
    var sum = vec4<f32>(0.0);
    for (var y = 0u; y < PARTS; y++) {
        for (var x = 0u; x < PARTS; x++) {
            let word = pixels[first + y * frame.size_px.x + x];
            let alpha = unpack4x8unorm(word).a;
            sum += vec4<f32>(linear_color(word) * alpha, alpha);
        }
    }
    // Without alpha, all parts show the same background.
    var mean = pixels[first];
    if sum.a > 0.0 {
        mean = pack4x8unorm(vec4<f32>(srgb_from_linear(sum.rgb / sum.a), sum.a / f32(PARTS * PARTS)));
    }
    visibility[frame.view * size.x * size.y + at.y * size.x + at.x] = mean;
}
