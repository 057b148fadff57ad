// Perspective-correct interpolation over a triangle in camera space: each weight is a ratio of two forms that are linear
// in the ray, so its derivatives over the image are exact as well (Olano & Greer 1997, homogeneous rasterization).
struct Barycentric {
    // Linear forms: weight of b, weight of c, their common denominator.
    b: vec3<f32>,
    c: vec3<f32>,
    all: vec3<f32>,
}

struct Weights {
    b: f32,
    c: f32,
    // Derivatives per pixel in x and in y: (b, c).
    dx: vec2<f32>,
    dy: vec2<f32>,
}

fn barycentric_forms(a: vec3<f32>, b: vec3<f32>, c: vec3<f32>) -> Barycentric {
    let at = image_vector(a);
    let e1 = image_vector(b) - at;
    let e2 = image_vector(c) - at;
    return Barycentric(cross(e2, at), cross(at, e1), cross(e1, e2));
}

fn barycentric_weights(form: Barycentric, ray: vec3<f32>) -> Weights {
    let all = dot(form.all, ray);
    // Edge-on: any point of the triangle will do.
    let inverse = select(1.0 / all, 0.0, abs(all) < 1e-37);
    let raw = vec2<f32>(dot(form.b, ray), dot(form.c, ray)) * inverse;
    let per_x = vec2<f32>(form.b.x, form.c.x) - raw * form.all.x;
    let per_y = vec2<f32>(form.b.y, form.c.y) - raw * form.all.y;
    // Snapping may have moved the corners so that the pixel's centre lies outside.
    var w = clamp(raw, vec2<f32>(0.0), vec2<f32>(1.0));
    w /= max(w.x + w.y, 1.0);
    return Weights(w.x, w.y, per_x * inverse / frame.focal_px.x, per_y * inverse / frame.focal_px.y);
}
