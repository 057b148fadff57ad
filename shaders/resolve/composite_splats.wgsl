// Lays painted splats over the image (Porter & Duff 1984). A thread takes EACH pixels.
//!include shared/frame
//!include shared/scene
//!include shared/colour
//!include shared/over
//!include shared/canvas

@group(0) @binding(1) var<storage, read_write> pixels: array<u32>;
@group(0) @binding(4) var<storage, read_write> stats: array<Stats>;

// As in src/passes/resolve/composite_splats.rs.
const EACH: u32 = 16u;

@compute @workgroup_size(64)
fn composite_splats(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    begin_view(0u);
    let first = (group.y * DISPATCH_ROW + group.x) * 64u * EACH + lane;
    var shown = 0u;
    for (var i = 0u; i < EACH; i++) {
        let pixel = first + i * 64u;
        if pixel < frame.size_px.x * frame.size_px.y {
            var over = painted[pixel];
            if SURFACES {
                over = with_surface(over, paint_sums[pixel], paint_ends[pixel].y);
            }
            if over.a > 0.0 {
                pixels[pixel] = word_over(over, pixels[pixel]);
                shown++;
            }
        }
    }
    if shown != 0u {
        atomicAdd(&stats[0].pixels_of_samples, shown);
    }
}
