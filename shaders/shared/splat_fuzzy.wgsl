// A splat at a pixel that is blended and depth-tested at once (Dachsbacher et al. 2003, §5): it takes the place of what
// lies a slab behind, is added to what lies beside it, or is hidden.
//!include shared/splat_paint
//!include shared/rows_all
//!include shared/slabs
// Triangles may hide splats; they are drawn before.
override HIDES: bool = true;

@group(0) @binding(1) var<storage, read> visibility: array<vec2<u32>>;
@group(0) @binding(5) var<storage, read_write> layers: array<atomic<u64>>;

const WEIGHTS_BITS: u64 = 0x7ffc000000000lu;

// False where another thread came between: to be tried once more.
fn emit(splat: Splat, paint: Paint, pixel: u32, d: vec2<f32>, q: f32) -> bool {
    let inverse = splat_inverse(splat, d);
    if HIDES && inverse < bitcast<f32>(visibility[pixel].y) {
        return true;
    }
    let weight = splat_weight(splat, q);
    let slab = slab_of(inverse);
    let tag = slab_tag(slab, splat.facing);
    let shares = paint.color * weight * vec3<f32>(1.0, 1.0, BLUE_STEPS);
    // Rounded to the nearest, what is dark would be black.
    let carry = select(vec3<f32>(0.5), vec3<f32>(carry_of(weight, pixel, paint.key)), shares < vec3<f32>(1.5));
    let c = vec3<u32>(floor(shares + carry));
    let low = c.b | (c.g << 12u) | (c.r << 25u);
    let high = (c.r >> 7u) | (u32(weight) << 6u);
    let share = (u64(high) << 32u) | u64(low);
    let word = 2u * pixel + (slab & 1u);
    let old = atomicLoad(&layers[word]);
    let old_high = u32(old >> 32u);
    if tag_of(old_high) > tag {
        return true;
    }
    var next = share | (u64(tag) << 51u);
    if tag_of(old_high) == tag {
        next = select(old + share, old | WEIGHTS_BITS, weights_of(old_high) + u32(weight) > WEIGHTS_MOST);
    }
    return atomicCompareExchangeWeak(&layers[word], old, next).exchanged;
}
