// Antialiasing: averages the parts of each pixel in linear light. A thread takes a pixel. The result takes the place of the visibility buffer,
// which no later pass of a frame reads.
//!include shared/frame
//!include shared/mean

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
    var sum = vec4<f32>(0.0);
    for (var y = 0u; y < PARTS; y++) {
        for (var x = 0u; x < PARTS; x++) {
            sum += light_of(pixels[first + y * frame.size_px.x + x]);
        }
    }
    let mean = word_of_mean(sum, f32(PARTS * PARTS), pixels[first]);
    visibility[frame.view * size.x * size.y + at.y * size.x + at.x] = mean;
}
