// Surfaces are kept for the pass that writes the output: colours in `colors`, normals in `normals`, depths and slots in `visibility`.
//!include shared/kept_color
//!include KEPT_MAPS
@group(0) @binding(1) var<storage, read_write> visibility: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read_write> pixels: array<u32>;
@group(0) @binding(3) var<storage, read_write> normals: array<u32>;
@group(0) @binding(9) var<storage, read_write> colors: array<vec2<u32>>;

fn keep(pixel: u32, surface: Surface, normal: u32) {
    colors[pixel] = kept_color(surface.color);
    normals[pixel] = normal;
    visibility[pixel].y = bitcast<u32>(surface.inverse_depth / surface.depth_scale);
    keep_maps(pixel, surface);
}

fn finish(pixel: u32, at: vec2<u32>, surface: Surface) {
    keep(pixel, surface, select(octahedral_encode(surface.normal), BALL, surface.is_ball));
}

// For a surface whose colour is the one under all lights.
fn finish_lit(pixel: u32, at: vec2<u32>, surface: Surface) {
    keep(pixel, surface, LIT_ALREADY);
}
