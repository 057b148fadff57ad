// Planes of triangles in camera space, and their depth at a pixel.

// The plane of a triangle as a linear form of the image: dot(form, ray) is 1/z, and z where rays are parallel.
struct Plane {
    form: vec3<f32>,
    // Bounds on that over the triangle.
    least: f32,
    most: f32,
}

fn image_position(camera: vec3<f32>) -> vec2<f32> {
    return fma(frame.focal_px, camera.xy / divisor(camera.z), frame.principal_px);
}

// Normal · corner, computed so that it keeps its sign when the three are seen edge-on.
fn facing(a: vec3<f32>, b: vec3<f32>, c: vec3<f32>) -> f32 {
    return dot(cross(b - a, c - a), towards(a));
}

fn triangle_plane(a: vec3<f32>, b: vec3<f32>, c: vec3<f32>) -> Plane {
    let n = cross(b - a, c - a);
    let d = dot(n, a);
    var plane: Plane;
    let near = min(a.z, min(b.z, c.z));
    if ORTHOGRAPHIC {
        plane.least = near;
        plane.most = max(a.z, max(b.z, c.z));
        plane.form = select(vec3<f32>(-n.xy, d) / n.z, vec3<f32>(0.0, 0.0, near), abs(n.z) < 1e-37);
        return plane;
    }
    plane.least = 1.0 / max(a.z, max(b.z, c.z));
    plane.most = select(3.0e38, 1.0 / near, near > NEAREST);
    // Edge-on: no pixel's depth depends on the slope within the clamp.
    plane.form = select(n / d, vec3<f32>(0.0, 0.0, plane.most), abs(d) < 1e-37);
    return plane;
}

fn plane_inverse_depth(plane: Plane, ray: vec3<f32>) -> f32 {
    let value = clamp(dot(plane.form, ray), plane.least, plane.most);
    if ORTHOGRAPHIC {
        return 1.0 / value;
    }
    return value;
}
