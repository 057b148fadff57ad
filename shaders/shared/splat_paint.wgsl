// A splat's contribution to pixels: its colour, lit or not, and its normal.
//!include shared/output
//!include shared/albedo
//!include FIELDS
//!include shared/fog
override OVERRIDES: bool = true;
// Pixels are lit, or write_output runs, after the splats are blended: normals are blended too.
override DEFERRED: bool = true;
@group(1) @binding(4) var<storage, read> materials: array<Material>;

// Values that the samples of a slot have in common.
struct PaintSlot {
    normals: NormalMap,
    // Overriding material plus one, or 0.
    material: u32,
}

struct Paint {
    // Linear light.
    color: vec3<f32>,
    // n · ½ + ½ in world space, towards the eye; short of what looks everywhere.
    normal: vec3<f32>,
    // A number of the sample's own, whatever the view.
    key: u32,
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
    if needs_depth() {
        return paint;
    }
    let packed = attributes[slot.first + sample];
    let place = positions[slot.first + sample];
    paint.key = place.x ^ (place.y * 0x9e3779b1u) ^ slot.key;
    var normal = vec3<f32>(0.0);
    if OUTPUT == OUTPUT_NORMAL || DEFERRED || LIT {
        // Unit, turned towards the eye; zero where the sample has none.
        let way = world_from_camera(towards(camera_place(splat_centre(slot, sample))));
        normal = facing_normal(turned(shared_paint.normals, octahedral_decode(packed.y)), way);
        paint.normal = fma(normal, vec3<f32>(0.5), vec3<f32>(0.5));
        if needs_color() && is_ball(packed) {
            paint.normal = fma(facing_normal(-way, way), vec3<f32>(0.5 * BALL_NORMAL), vec3<f32>(0.5));
        }
    }
    if needs_color() {
        let at = slot.first + sample;
        var own: vec3<f32>;
        if SHOWS_FIELD {
            own = albedo(field_color(at, slot.instance), 0u);
        } else {
            own = albedo(painted(at, packed.x), shared_paint.material);
        }
        paint.color = lit(own, normal, is_ball(packed), shared_paint.material, slot, sample);
        if FOG != 0u {
            paint.color = fogged(paint.color, camera_place(splat_centre(slot, sample)));
        }
    }
    return paint;
}

// Weights below this have so few steps that rounding to the nearest would make what is dark black: of a crowd of splats far
// smaller than a pixel, or where so many overlap that weights had to be made smaller.
const LIGHT: f32 = 256.0;

// The addend before rounding down: a half, and of light weights anything up to 1, by sample and pixel of the image, so that sums are right on the
// average. It does not depend on the camera, which may move without changing pixels, nor on the frame's place among those drawn with it.
fn carry_of(weight: f32, pixel: u32, key: u32) -> f32 {
    let own = pixel - frame.first_pixel;
    let mixed = (key ^ (key >> 16u)) * 0x7feb352du;
    let hash = (mixed ^ (mixed >> 15u) ^ (own * 0x85ebca6bu)) * 0x9e3779b1u;
    return select(0.5, dithered(f32((hash ^ (hash >> 15u)) >> 8u) * 5.9604645e-8), weight < LIGHT);
}
