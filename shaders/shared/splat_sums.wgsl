// Sums of splats at the pixels of the visible surface.
//   color:               weight, red, green, blue; for deferred shading also the normal and the depth
//   normal:              weight, normal
//   depth:               weight; depth in 64 bits
// Depth counts as a share of the offset surface's, which is never nearer.

//!include shared/splat_paint
//!include shared/rows_all
// The scene has more samples than the sums have room for, should all fall on one pixel.
override CROWDED: bool = true;

@group(0) @binding(1) var<storage, read> visibility: array<vec2<u32>>;

fn fixed(v: vec3<f32>, weight: f32, carry: f32) -> vec3<u32> {
    return vec3<u32>(floor(fma(v, vec3<f32>(weight), vec3<f32>(carry))));
}

// The weight, and what shares its word. That it does not fit is the same in every order of splats.
fn weigh(pixel: u32, other: u32, weight: u32) {
    let wrapped = add_0(pixel, other, weight);
    if CROWDED && wrapped {
        mark_full();
    }
}

fn emit(splat: Splat, paint: Paint, pixel: u32, d: vec2<f32>, q: f32) -> bool {
    let inverse = splat_inverse(splat, d);
    let kept = visibility[pixel].y;
    let visible = bitcast<f32>(kept & ~FACING_BITS);
    // Hidden, or the other side of what is seen: near its silhouette a surface's back lies within the offset.
    if inverse < visible || shows_other_side(kept, splat.facing) {
        return true;
    }
    let weight = splat_weight(splat, q);
    let carry = carry_of(weight, pixel, paint.key);
    if needs_depth() {
        weigh(pixel, 0u, u32(weight));
        // Much nearer to the eye than the splat is wide, it is still before the eye.
        add_wide(pixel, u32(weight), max(u32(min(visible / inverse, 1.0) * DEPTH_ONE), 1u));
        return true;
    }
    if !needs_color() {
        let n = fixed(paint.normal, weight, carry);
        weigh(pixel, n.x, u32(weight));
        add_1(pixel, n.y, n.z);
        return true;
    }
    let c = fixed(paint.color, weight, carry);
    weigh(pixel, c.r, u32(weight));
    add_1(pixel, c.g, c.b);
    if DEFERRED {
        add_normal(pixel, fixed(paint.normal, weight, carry), u32(round(visible / inverse * weight)));
    }
    return true;
}
