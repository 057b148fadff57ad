// Occlusion culling in two portions (after Greene, Kass & Miller 1993): what is near is drawn first, and what lies behind it as a whole
// is not drawn at all. The order changes no pixel: the visibility buffer keeps the nearest, whoever came first.

// Of a segment, how many of its visible slots are drawn first, how many are asked whether they are hidden, and how many of these are
// drawn.
struct Portion {
    near: atomic<u32>,
    far: atomic<u32>,
    late: atomic<u32>,
    // Of the last, those before this turn.
    before: atomic<u32>,
}

// A view's record of depths: what begins in each eighth of an octave of depth covers, in parts of the image; and where
// near and each turn of what is far end.
const DEPTH_BINS: u32 = 512u;
const DEPTHS_WORDS: u32 = 520u;
// Of a far slot in the list: the slot, and from this bit on where its depth is among the bins.
const TURN_SHIFT: u32 = 22u;
const TURN_SLOT: u32 = 0x3fffffu;
const NO_TURN: u32 = 0xffffffffu;
// Far slots that a thread goes through.
const ASKED_EACH: u32 = 8u;
// What is far is asked in so many turns at most, each after what is nearer has been drawn.
const TURNS: u32 = 7u;
// Parts of the image, of which a slot covers so many at most.
const COVER_ONE: u32 = 1000u;

// The part of an octave of depth in which something begins; 0 where it surrounds the eye.
fn depth_bin(near: f32) -> u32 {
    // Exponent and the first bits of the mantissa, from 2^-32 on.
    let octaves = bitcast<u32>(max(near, 0.0)) >> 20u;
    return min(max(octaves, 760u) - 760u, DEPTH_BINS - 1u);
}

// Half edges of a box in camera space, and its middle.
struct Box {
    centre: vec3<f32>,
    x: vec3<f32>,
    y: vec3<f32>,
    z: vec3<f32>,
    // What f32 may lose of a place in it.
    slack: f32,
}

// Where a box is: nearest depth, and its bounds in the image in pixels. Of boxes that surround the eye, 0 and everything.
struct BoxBounds {
    near: f32,
    least: vec2<f32>,
    most: vec2<f32>,
}

// In parts of its distance.
const BOX_SLACK: f32 = 4e-6;

fn box_bounds(box: Box) -> BoxBounds {
    let reach = abs(box.x) + abs(box.y) + abs(box.z);
    let near = box.centre.z - reach.z - box.slack;
    let far = box.centre.z + reach.z + box.slack;
    if !(near > NEAREST) {
        return BoxBounds(0.0, vec2<f32>(0.0), vec2<f32>(frame.size_px));
    }
    let low = box.centre.xy - reach.xy - box.slack;
    let high = box.centre.xy + reach.xy + box.slack;
    let least = low / select(vec2<f32>(near), vec2<f32>(far), low > vec2<f32>(0.0));
    let most = high / select(vec2<f32>(far), vec2<f32>(near), high > vec2<f32>(0.0));
    return BoxBounds(
        near,
        fma(frame.focal_px, least, frame.principal_px) - vec2<f32>(1.0),
        fma(frame.focal_px, most, frame.principal_px) + vec2<f32>(1.0),
    );
}

// Of a chunk.
fn grid_box(at: Placed, origin: vec3<i32>, extent: vec3<f32>) -> Box {
    let half = extent * 0.5;
    let x = at.axis_x.xyz * half.x;
    let y = at.axis_y.xyz * half.y;
    let z = at.axis_z.xyz * half.z;
    let centre = grid_to_camera(at, origin) + x + y + z;
    let far_off = abs(centre) + abs(x) + abs(y) + abs(z);
    return Box(centre, x, y, z, BOX_SLACK * (far_off.x + far_off.y + far_off.z));
}

// The part of the image within bounds.
fn cover_of(bounds: BoxBounds) -> f32 {
    let size = vec2<f32>(frame.size_px);
    let sides = clamp(bounds.most, vec2<f32>(0.0), size) - clamp(bounds.least, vec2<f32>(0.0), size);
    return sides.x * sides.y / (size.x * size.y);
}
