// Reconstruction kernels as samples store them.

// Unit vectors across a unit vector (Duff et al. 2017).
struct Tangents {
    u: vec3<f32>,
    v: vec3<f32>,
}

fn tangent_frame(n: vec3<f32>) -> Tangents {
    let s = select(-1.0, 1.0, n.z >= 0.0);
    let a = -1.0 / (s + n.z);
    let b = n.x * n.y * a;
    return Tangents(vec3<f32>(1.0 + s * n.x * n.x * a, s * b, -s * n.x), vec3<f32>(b, s + n.y * n.y * a, -n.y));
}

fn axis_length(code: u32, base: f32) -> f32 {
    return select(base * exp2((1.0 - f32(code)) * 0.0078125), 0.0, code == 0u);
}

// Lengths of both axes of a kernel, in the units of `base`, the chunk's longest.
fn axis_lengths(word: u32, base: f32) -> vec2<f32> {
    return vec2<f32>(axis_length(word & 0x7ffu, base), axis_length((word >> 11u) & 0x7ffu, base));
}

// Both axes of a kernel, in the chunk's steps.
fn kernel_axes(word: u32, base: f32, normal: vec3<f32>) -> Tangents {
    let lengths = axis_lengths(word, base) * frame.splat_width;
    let p = (f32(word >> 22u) - 511.0) / 511.0;
    let inverse = 1.0 / fma(p, p, 1.0);
    let cos = (1.0 - p * p) * inverse;
    let sin = 2.0 * p * inverse;
    let own = tangent_frame(normal);
    return Tangents((cos * own.u + sin * own.v) * lengths.x, (cos * own.v - sin * own.u) * lengths.y);
}

// Larger disks are thinned as if they had this radius, in pixels. Objects that large are therefore always drawn.
const MOST_THINNED_PX: f32 = 2.0;
