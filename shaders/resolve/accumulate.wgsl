// Depth of field and motion blur: adds exposures to the sums of a frame's pixels, in linear light (Haeberli & Akeley 1990). A frame takes several rounds, each of
// which draws some of its exposures as views; the last round writes the means in place of the visibility buffer. A thread takes a pixel. Sums are of whole
// numbers, so that they do not depend on how many exposures a round has.
//!include shared/frame
//!include shared/mean

@group(0) @binding(1) var<storage, read_write> visibility: array<u32>;
@group(0) @binding(2) var<storage, read> pixels: array<u32>;
@group(0) @binding(3) var<storage, read_write> exposed: array<vec4<u32>>;

// Parts along each side of a pixel.
override PARTS: u32 = 1u;
// Exposures of the round.
override EXPOSURES: u32 = 2u;
// No round came before.
override FIRST: bool = true;
// In the last round, the number of parts of a pixel in all exposures of the frame; else 0.
override TOTAL: u32 = 0u;

// The number that stands for 1: sums of 256 exposures of 16 parts fit 32 bits.
const ONE: f32 = 1048575.0;

@compute @workgroup_size(64)
fn accumulate(@builtin(global_invocation_id) invocation: vec3<u32>) {
    begin_view(0u);
    let size = frame.size_px / PARTS;
    let at = invocation.xy;
    if any(at >= size) {
        return;
    }
    let place = at.y * size.x + at.x;
    let first = PARTS * (at.y * frame.size_px.x + at.x);
    let view_pixels = frame.size_px.x * frame.size_px.y;
    var sum = vec4<u32>(0u);
    if !FIRST {
        sum = exposed[place];
    }
    for (var exposure = 0u; exposure < EXPOSURES; exposure++) {
        for (var y = 0u; y < PARTS; y++) {
            for (var x = 0u; x < PARTS; x++) {
                let light = light_of(pixels[first + exposure * view_pixels + y * frame.size_px.x + x]);
                sum += vec4<u32>(round(min(light, vec4<f32>(1.0)) * ONE));
            }
        }
    }
    if TOTAL == 0u {
        exposed[place] = sum;
        return;
    }
    visibility[place] = word_of_mean(vec4<f32>(sum) / ONE, f32(TOTAL), pixels[first]);
}
