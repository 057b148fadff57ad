// The canvas holds what splats have painted of each pixel, from front to back.

// Splats at the same depth are averaged before they are blended; else each splat is blended by itself.
override SURFACES: bool = true;

// Colours multiplied by alpha, and alpha.
@group(0) @binding(2) var<storage, read_write> painted: array<vec4<f32>>;
// The surface that is being painted: weighted colours and the weight, which is negative once nothing shines through the pixel.
@group(0) @binding(9) var<storage, read_write> paint_sums: array<vec4<f32>>;
// Two numbers of that surface. Its end is one over a depth, whose lowest bits say which side is seen. The other is how much shines through.
@group(0) @binding(10) var<storage, read_write> paint_ends: array<vec2<f32>>;

// From where on a surface hides more, and how much more; see docs/painted.md.
const CLOSED_FROM: f32 = 2.0;
const CLOSING: f32 = 1.8;
// Behind this alpha, even white changes no byte of a pixel.
const OPAQUE: f32 = 0.9998;

// Lays a colour under what is there.
fn under(over: vec4<f32>, color: vec3<f32>, alpha: f32) -> vec4<f32> {
    return over + vec4<f32>(color, 1.0) * (alpha * (1.0 - over.a));
}

// Returns how much shines through a surface, given what would shine through its splats one after the other: less where they lie over each other,
// because there the surface goes on. What is thin, or at the surface's border, hides as much as its splats do.
fn through_surface(through: f32) -> f32 {
    let layers = -log(max(through, 1e-30));
    let more = max(layers - CLOSED_FROM, 0.0);
    return exp(-fma(CLOSING * more, more, layers));
}

// Returns the canvas of a pixel with the surface that was being painted.
fn with_surface(over: vec4<f32>, sums: vec4<f32>, through: f32) -> vec4<f32> {
    return select(over, under(over, sums.rgb / sums.a, 1.0 - through_surface(through)), sums.a > 0.0);
}
