// Surfaces are kept for the pass that writes the output: colours in `pixels`, normals in `normals`, depths and slots in `visibility`.
@group(0) @binding(3) var<storage, read_write> normals: array<u32>;

fn finish(pixel: u32, at: vec2<u32>, surface: Surface) {
    pixels[pixel] = surface.color;
    normals[pixel] = select(octahedral_encode(surface.normal), BALL, surface.is_ball);
    visibility[pixel].y = bitcast<u32>(surface.inverse_depth / surface.depth_scale);
}

// For a surface whose colour is the one under all lights.
fn finish_lit(pixel: u32, surface: Surface) {
    pixels[pixel] = surface.color;
    normals[pixel] = LIT_ALREADY;
    visibility[pixel].y = bitcast<u32>(surface.inverse_depth / surface.depth_scale);
}
