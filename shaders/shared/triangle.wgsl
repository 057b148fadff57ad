// What the compute walk and the rasteriser must agree on: where a corner falls on the 1/256-pixel grid, which way a
// triangle faces, and its depth at a pixel.

// A coordinate this large in pixels goes to the rasteriser's clipper.
const GUARD_PX: f32 = 1048576.0;

// The plane of a triangle as 1/z over the image: 1/z = dot(plane, ray).
struct Plane {
    inverse: vec3<f32>,
    // Bounds on 1/z over the triangle.
    least: f32,
    most: f32,
}

fn image_position(camera: vec3<f32>) -> vec2<f32> {
    return fma(frame.focal_px, camera.xy / camera.z, frame.principal_px);
}

// Fixed point with eight fractional bits, as rasterisers snap.
fn snap(pixel: vec2<f32>) -> vec2<i32> {
    return vec2<i32>(round(pixel * 256.0));
}

// Normal · corner, computed so that it keeps its sign when the three are seen edge-on.
fn facing(a: vec3<f32>, b: vec3<f32>, c: vec3<f32>) -> f32 {
    return dot(cross(b - a, c - a), a);
}

fn triangle_plane(a: vec3<f32>, b: vec3<f32>, c: vec3<f32>) -> Plane {
    let n = cross(b - a, c - a);
    let d = dot(n, a);
    var plane: Plane;
    let near = min(a.z, min(b.z, c.z));
    plane.least = 1.0 / max(a.z, max(b.z, c.z));
    plane.most = select(3.0e38, 1.0 / near, near > NEAREST);
    // Edge-on: no pixel's depth depends on the slope within the clamp.
    plane.inverse = select(n / d, vec3<f32>(0.0, 0.0, plane.most), abs(d) < 1e-37);
    return plane;
}

fn plane_inverse_depth(plane: Plane, ray: vec3<f32>) -> f32 {
    return clamp(dot(plane.inverse, ray), plane.least, plane.most);
}
