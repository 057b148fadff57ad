// What a splat adds to the pixels of the visible surface.
//   color:               weight, red, green, blue; for deferred shading also the normal and the depth
//   normal:              weight, normal
//   depth:               weight; depth in 64 bits
// Depth counts as a share of the offset surface's, which is never nearer.

//!include shared/outputs
override OVERRIDES: bool = true;
// Colour frames that a shade pass follows: normals are blended too.
override DEFERRED: bool = true;
// The scene has more samples than the sums have room for, should all fall on one pixel.
override CROWDED: bool = true;

@group(0) @binding(1) var<storage, read> visibility: array<vec2<u32>>;
@group(1) @binding(3) var<storage, read> instances: array<Instance>;
@group(1) @binding(4) var<storage, read> materials: array<Material>;

// What the samples of a slot have in common.
struct PaintSlot {
    normals: NormalMap,
    // Overriding material plus one, or 0.
    material: u32,
}

struct Paint {
    // Linear light.
    color: vec3<f32>,
    // n · ½ + ½ in world space, towards the eye.
    normal: vec3<f32>,
}

fn albedo(own: u32, over_plus_one: u32) -> vec3<f32> {
    let c = linear_from_srgb(unpack4x8unorm(own).rgb);
    if !OVERRIDES || over_plus_one == 0u {
        return c;
    }
    let over = materials[over_plus_one - 1u];
    if (over.overrides & OVERRIDE_BASE_COLOR) == 0u {
        return c;
    }
    return clamp(c * over.base_color.rgb, vec3<f32>(0.0), vec3<f32>(1.0));
}

fn paint_slot(slot: SplatSlot) -> PaintSlot {
    var shared_paint: PaintSlot;
    if OUTPUT == OUTPUT_NORMAL || DEFERRED || LIT {
        shared_paint.normals = normal_map(slot.instance);
    }
    if OVERRIDES {
        shared_paint.material = instances[slot.instance].material;
    }
    return shared_paint;
}

fn paint_of(slot: SplatSlot, shared_paint: PaintSlot, sample: u32) -> Paint {
    var paint: Paint;
    if OUTPUT == OUTPUT_DEPTH {
        return paint;
    }
    let packed = attributes[slot.first + sample];
    var normal = vec3<f32>(0.0);
    if OUTPUT == OUTPUT_NORMAL || DEFERRED || LIT {
        // Unit, turned towards the eye; zero where the sample has none.
        let towards = world_from_camera(camera_vector(splat_centre(slot, sample)));
        normal = facing_normal(turned(shared_paint.normals, octahedral_decode(packed.y)), towards);
        paint.normal = fma(normal, vec3<f32>(0.5), vec3<f32>(0.5));
    }
    if OUTPUT == OUTPUT_COLOR {
        paint.color = lit(albedo(painted(slot.first + sample, packed.x), shared_paint.material), normal, shared_paint.material, slot, sample);
    }
    return paint;
}

fn fixed(v: vec3<f32>, weight: f32) -> vec3<u32> {
    return vec3<u32>(round(v * weight));
}

// The weight, and what shares its word. That it does not fit is the same in every order of splats.
fn weigh(pixel: u32, other: u32, weight: u32) {
    let wrapped = add_0(pixel, other, weight);
    if CROWDED && wrapped {
        mark_full();
    }
}

fn emit(splat: Splat, paint: Paint, pixel: u32, d: vec2<f32>, q: f32) {
    let inverse = splat_inverse(splat, d);
    let kept = visibility[pixel].y;
    let visible = bitcast<f32>(kept & ~FACING_BITS);
    // Hidden, or the other side of what is seen: near its silhouette a surface's back lies within the offset.
    if inverse < visible || ((kept | splat.facing) & FACING_BITS) == FACING_BITS {
        return;
    }
    let weight = max(round(splat.amplitude * exp(-0.5 * q) * frame.weight_one), 1.0);
    if OUTPUT == OUTPUT_DEPTH {
        weigh(pixel, 0u, u32(weight));
        // Much nearer to the eye than the splat is wide, it is still before the eye.
        add_wide(pixel, u32(weight), max(u32(min(visible / inverse, 1.0) * DEPTH_ONE), 1u));
        return;
    }
    if OUTPUT == OUTPUT_NORMAL {
        let n = fixed(paint.normal, weight);
        weigh(pixel, n.x, u32(weight));
        add_1(pixel, n.y, n.z);
        return;
    }
    let c = fixed(paint.color, weight);
    weigh(pixel, c.r, u32(weight));
    add_1(pixel, c.g, c.b);
    if DEFERRED {
        add_normal(pixel, fixed(paint.normal, weight), u32(round(visible / inverse * weight)));
    }
}
