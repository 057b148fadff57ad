// Rules on which the compute walk and the rasteriser must agree: where a corner falls on the 1/256-pixel grid, which way a
// triangle faces, and its depth at a pixel.
//!include shared/clipping
//!include shared/plane

// A coordinate this large in pixels goes to the rasteriser's clipper.
const GUARD_PX: f32 = 1048576.0;

// Fixed point with eight fractional bits, as rasterisers snap.
fn snap(pixel: vec2<f32>) -> vec2<i32> {
    return vec2<i32>(round(pixel * 256.0));
}

// Writes a covered pixel. Of a triangle that meets the plane through the eye, parallel rays also cover what lies behind it.
fn triangle_write(plane: Plane, ray: vec3<f32>, pixel: u32, id: u32) {
    let inverse = plane_inverse_depth(plane, ray);
    let is_before = !ORTHOGRAPHIC || (inverse > 0.0 && inverse < 1.0 / NEAREST);
    if is_before && place_is_shown(on_ray(ray, 1.0 / inverse)) {
        visibility_write(pixel, inverse, id);
    }
}

// Where a triangle is in the image.
struct ImageBounds {
    least: vec2<f32>,
    most: vec2<f32>,
    // All corners have an image within the guard: they can be snapped.
    snaps: bool,
}

// Extends bounds by an edge's points before the eye. Where the edge meets the camera plane its image runs off to infinity.
fn extend(bounds: ptr<function, ImageBounds>, p: vec3<f32>, q: vec3<f32>) {
    if ORTHOGRAPHIC || p.z > NEAREST {
        let image = clamp(image_position(p), vec2<f32>(-2.0 * GUARD_PX), vec2<f32>(2.0 * GUARD_PX));
        (*bounds).least = min((*bounds).least, image);
        (*bounds).most = max((*bounds).most, image);
    }
    if !ORTHOGRAPHIC && (p.z > NEAREST) != (q.z > NEAREST) {
        let t = p.z / (p.z - q.z);
        let meets = p.xy + t * (q.xy - p.xy);
        let slack = 1e-5 * max(abs(p.xy), abs(q.xy));
        let far = vec2<f32>(2.0 * GUARD_PX);
        (*bounds).least = min((*bounds).least, select(far, -far, meets <= slack));
        (*bounds).most = max((*bounds).most, select(-far, far, meets >= -slack));
    }
}

fn image_bounds(a: vec3<f32>, b: vec3<f32>, c: vec3<f32>) -> ImageBounds {
    var bounds = ImageBounds(vec2<f32>(3.0 * GUARD_PX), vec2<f32>(-3.0 * GUARD_PX), false);
    extend(&bounds, a, b);
    extend(&bounds, b, c);
    extend(&bounds, c, a);
    let within = all(abs(bounds.least) < vec2<f32>(GUARD_PX)) && all(abs(bounds.most) < vec2<f32>(GUARD_PX));
    bounds.snaps = within && (ORTHOGRAPHIC || min(a.z, min(b.z, c.z)) > NEAREST);
    return bounds;
}
