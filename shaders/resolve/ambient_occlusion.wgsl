// Ambient occlusion from the depths of the image: the cosine-weighted share of the hemisphere above each pixel's surface that no surface within a radius
// fills. Slices of the hemisphere are integrated as in ground-truth ambient occlusion (Jimenez et al. 2016, "Practical realtime strategies for accurate
// indirect occlusion", §5). Each pixel of a slice hides a range of angles, from what it shows to a thickness behind that, in a mask of sectors (Therrien,
// Levesque & Gilet 2023, "Screen space indirect lighting with visibility bitmask"), so that thin things hide little and distant ones nothing. Here, sectors
// count alike by their share of the integral.
//
// Directions and distances follow from the pixel's place in a square of 4 × 4 alone; shared/openness_near averages over such a square.
//!include shared/frame
//!include shared/scene
//!include VOTE
//!include shared/column
//!include shared/octahedral
//!include shared/kept_places

@group(0) @binding(1) var<storage, read> visibility: array<vec2<u32>>;
@group(0) @binding(3) var<storage, read> normals: array<u32>;
@group(0) @binding(4) var<storage, read_write> stats: array<Stats>;
@group(0) @binding(5) var<storage, read_write> openness: array<f32>;

const SLICES: u32 = 2u;
const STEPS: u32 = 6u;
const SECTORS: f32 = 32.0;
// How far surfaces reach behind what is seen of them, as a share of the radius.
const THICKNESS: f32 = 0.5;
const HALF_TURN: f32 = 3.1415927;

// Slice of the hemisphere through the direction to the eye: the angle of the projected normal from that direction, with its sine and cosine; the share of
// the whole integral below the lowest angle, and the integral over the slice.
struct Slice {
    tilt: f32,
    sine: f32,
    cosine: f32,
    begin: f32,
    whole: f32,
}

// The integral of cos(t - tilt) |sin t| for t from 0 to an angle.
fn integral(slice: Slice, angle: f32) -> f32 {
    let even = 0.25 * (slice.cosine - cos(2.0 * angle - slice.tilt));
    return select(even, -even, angle < 0.0) + 0.5 * abs(angle) * slice.sine;
}

// The sectors between two angles, in any order, whose middles are between them.
fn sectors(slice: Slice, one: f32, other: f32) -> u32 {
    let low = slice.tilt - 0.5 * HALF_TURN;
    let angles = clamp(vec2<f32>(min(one, other), max(one, other)), vec2<f32>(low), vec2<f32>(low + HALF_TURN));
    let shares = (vec2<f32>(integral(slice, angles.x), integral(slice, angles.y)) - slice.begin) / slice.whole;
    let first = clamp(ceil(SECTORS * shares.x - 0.5), 0.0, SECTORS);
    let end = clamp(floor(SECTORS * shares.y - 0.5) + 1.0, first, SECTORS);
    return insertBits(0u, 0xffffffffu, u32(first), u32(end - first));
}

// The angle between a way and the direction to the eye.
fn angle_to_eye(way: vec3<f32>, to_eye: vec3<f32>) -> f32 {
    return acos(clamp(dot(way, to_eye) / max(length(way), 1e-30), -1.0, 1.0));
}

// Which of the 16 pixels of a square this is: neighbours differ as much as possible (Bayer 1973).
fn number_in_square(at: vec2<u32>) -> u32 {
    let mixed = at.x ^ at.y;
    return ((mixed & 1u) << 3u) | ((at.y & 1u) << 2u) | (mixed & 2u) | ((at.y & 2u) >> 1u);
}

fn open_at(at: vec2<u32>, pixel: u32) -> f32 {
    let own = vec2<i32>(at);
    let place = kept_place(own).xyz;
    let to_eye = way_to_eye(place);
    let normal = kept_normal(own, pixel, place);
    let radius = frame.occlusion.x;
    let radius_px = radius * frame.focal_px.y / divisor(place.z);
    let number = number_in_square(at);
    let turn = f32(number) / 16.0;
    let shift = f32((7u * number) & 15u) / 16.0;
    var sum = vec2<f32>(0.0);
    for (var i = 0u; i < SLICES; i++) {
        let direction = HALF_TURN * (f32(i) + turn) / f32(SLICES);
        let along = vec2<f32>(cos(direction), sin(direction));
        // The slice is the plane of these two directions.
        let across = vec3<f32>(along / frame.focal_px, 0.0);
        let aside = across - to_eye * dot(across, to_eye);
        // The normal in the slice; one that looks away from the eye, by rounding, counts as square to the direction there.
        let projected = vec2<f32>(dot(normal, aside) / max(length(aside), 1e-30), max(dot(normal, to_eye), 0.0));
        let size = max(length(projected), 1e-6);
        var slice: Slice;
        slice.cosine = min(projected.y / size, 1.0);
        slice.tilt = acos(slice.cosine) * select(1.0, -1.0, projected.x < 0.0);
        slice.sine = sin(slice.tilt);
        slice.begin = integral(slice, slice.tilt - 0.5 * HALF_TURN);
        slice.whole = slice.cosine + slice.tilt * slice.sine;
        var hidden = 0u;
        for (var j = 0u; j < 2u * STEPS; j++) {
            let side = select(1.0, -1.0, j >= STEPS);
            let share = (f32(j % STEPS) + fract(shift + select(0.0, 0.5, j >= STEPS))) / f32(STEPS);
            let offset = side * fma(share * sqrt(share), radius_px, 1.0) * along;
            let seen = kept_place(vec2<i32>(floor(clamp(vec2<f32>(at) + vec2<f32>(0.5) + offset, vec2<f32>(-1.0), vec2<f32>(32768.0)))));
            let way = seen.xyz - place;
            let behind = way - way_to_eye(seen.xyz) * (THICKNESS * radius);
            if seen.w > 0.0 && dot(way, way) <= radius * radius {
                hidden |= sectors(slice, side * angle_to_eye(way, to_eye), side * angle_to_eye(behind, to_eye));
            }
        }
        sum += vec2<f32>(1.0 - f32(countOneBits(hidden)) / SECTORS, 1.0) * (size * slice.whole);
    }
    return sum.x / max(sum.y, 1e-30);
}

@compute @workgroup_size(64)
fn ambient_occlusion(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    begin_view(group.z);
    var column = column_begin(group, lane);
    column_load(&column);
    loop {
        loop {
            if column_ends(column) || any_lane(column.mine) {
                break;
            }
            column_step(&column);
            column_load(&column);
        }
        if column_ends(column) {
            break;
        }
        if column.mine {
            openness[column.pixel] = open_at(column.at, column.pixel);
        }
        column_step(&column);
        column_load(&column);
    }
}
