// Nodes of a point tree: which of them are drawn (Dachsbacher et al. 2003, §3.6). `crate::bake::tree` says what the words are.
//!include shared/accepted
//!include shared/codes
//!include shared/stretch
const TREE: bool = true;
const KERNEL_WORDS: u32 = 3u;

// 0: errors, 1: sizes.
override MEASURE: u32 = 0u;
// Errors are those of the angle that a node is seen at; src/bake/tree/tilt.rs says how, and has the same numbers.
override SPLIT: bool = false;

// For each node its kernel, then its two words.
@group(1) @binding(1) var<storage, read> kernels: array<u32>;

// Nodes show how high they stand above the leaves (Dachsbacher et al. 2003, Fig. 1).
override LEVELS: bool = false;

// The sRGB8 colour of a node that has `own`.
fn painted(sample: u32, own: u32) -> u32 {
    if !LEVELS {
        return own;
    }
    let level = (kernels[sample * KERNEL_WORDS + 2u] >> 22u) & 31u;
    // Hues of neighbours lie well apart.
    let hue = fract(f32(level) * 0.381966 + 0.02) * 6.0;
    let color = clamp(abs((vec3<f32>(hue) + vec3<f32>(0.0, 4.0, 2.0)) % 6.0 - 3.0) - 1.0, vec3<f32>(0.0), vec3<f32>(1.0));
    return pack4x8unorm(vec4<f32>(0.25 + 0.7 * color, 1.0));
}

// Whether a node's codes are within the limits of its slot.
fn is_within_limits(sample: u32, limits: u32) -> bool {
    let word = kernels[sample * KERNEL_WORDS + 1u + MEASURE];
    return ((word >> CODE_BITS) & CODE) < (limits & 0xffffu) && (word & CODE) >= (limits >> 16u);
}

// In chunks that are sorted: whether no node from this one on has a parent with a smaller code, in either measure.
fn is_behind_prefix(sample: u32, limit: u32) -> bool {
    let error = (kernels[sample * KERNEL_WORDS + 1u] >> CODE_BITS) & CODE;
    let size = (kernels[sample * KERNEL_WORDS + 2u] >> CODE_BITS) & CODE;
    return min(error, size) >= limit;
}

// Sine of the widest angle between a node's normal and those of the leaves below it; cone_sine of src/bake/tree/sequence.rs.
fn cone_sine(sample: u32) -> f32 {
    let code = (kernels[sample * KERNEL_WORDS + 2u] >> 27u) & 7u;
    return select(f32(code * code) / 48.0, 2.0, code == 7u);
}

// How far the parent is, at most, in units of the base: from twice its size on in quarters of an octave, or as large as any.
fn parent_way(words: vec2<u32>) -> f32 {
    let code = (words.x >> 22u) & 15u;
    let size = (words.y >> CODE_BITS) & CODE;
    return select(exp2(1.25 - 0.25 * f32(code) - 0.015625 * f32(size)), 1.0, code == 0u);
}

// A cosine for what is seen alike from all sides.
const UNTILTED: f32 = 2.0;
const TURN_SLACK: f32 = 0.004;

// Which part of an error is seen at an angle of this cosine, or at most at one that is `turn` away from it.
fn share_seen(code: u32, cosine: f32, turn: f32) -> f32 {
    let sine = sqrt(max(1.0 - cosine * cosine, 0.0));
    let share = min(exp2(0.5 * f32(code) - 8.0) * (sine + turn) + max(cosine, SIDEWAYS) + turn, 1.0);
    return select(share, 1.0, code == 15u);
}

// `unit`: the base of the node's codes in camera space; `centre`: the node's, there; `cosine`: of the angle between its normal and
// the way to the eye, or UNTILTED.
fn node_is_drawn(sample: u32, unit: f32, centre: vec3<f32>, cosine: f32) -> bool {
    let at = sample * KERNEL_WORDS;
    let words = vec2<u32>(kernels[at + 1u], kernels[at + 2u]);
    let word = select(words.x, words.y, MEASURE == 1u);
    let parent = (word >> CODE_BITS) & CODE;
    let delta = unit * parent_way(words);
    let far = length(centre);
    let slack = DEPTH_SLACK * far;
    var own_value = unit * code_value(word & CODE);
    var parent_value = unit * code_value(parent);
    if SPLIT {
        own_value *= share_seen((words.x >> 26u) & 15u, cosine, 0.0);
        let code = (words.x >> 30u) | ((words.y >> 30u) << 2u);
        parent_value *= share_seen(code, cosine, select(delta / max(far, NEAREST), 0.0, ORTHOGRAPHIC) + TURN_SLACK);
    }
    return own_value <= accepted(centre.z, far)
        && (parent == NO_PARENT || parent_value > accepted(centre.z - delta - slack, far + delta + slack));
}

// By how much the image of what faces the eye is larger beside the optical axis than on it.
fn slant(centre: vec3<f32>) -> f32 {
    if ORTHOGRAPHIC {
        return 1.0;
    }
    return length(centre) / centre.z;
}

// How often a node is drawn that covers less of the image than what it is drawn as; src/bake/tree/coverage.rs says how, and has the
// same numbers.
const ALWAYS: u32 = 255u;
const WHOLE: u32 = 3u;

fn mixed(value: u32) -> u32 {
    var x = value;
    x = (x ^ (x >> 16u)) * 0x7feb352du;
    x = (x ^ (x >> 15u)) * 0x846ca68bu;
    return x ^ (x >> 16u);
}

// The key is independent of the instance's place in memory, and differs between copies so that they are not thinned alike.
fn instance_key(instance: u32) -> u32 {
    let place = bitcast<vec3<u32>>(instances[instance].origin_hi);
    return mixed(mixed(mixed(place.x ^ instances[instance].id) ^ place.y) ^ place.z);
}

// Without a normal, and yet no sample that has none: normals of leaves below cancel. `own`: colour and normal.
fn is_ball(own: vec2<u32>) -> bool {
    return own.y == NO_NORMAL && (own.x >> 24u) != ALWAYS;
}

fn is_whole(own: u32) -> bool {
    return (own >> 30u) == WHOLE;
}

// Bound on the distance of the leaves below a node from its centre, in camera space; 0 for leaves.
fn node_extent(sample: u32, unit: f32) -> f32 {
    return unit * code_value(kernels[sample * KERNEL_WORDS + 2u] & CODE);
}

// The part of a node's disk that what it stands for covers.
fn node_part(own: u32) -> f32 {
    return exp2(-0.125 * f32((own >> 24u) & 63u));
}

// Returns whether thinning keeps this node. `own`: its colour word; `seen`: what is seen of its area, see `seen_area`; `drawn_px`: the
// area in the image that it is drawn as; `place`: its stored position.
fn is_kept(sample: u32, own: u32, unit: f32, centre: vec3<f32>, seen: f32, drawn_px: f32, place: vec2<u32>, key: u32) -> bool {
    let extent = node_extent(sample, unit);
    // About the eye there is no area in the image.
    if !ORTHOGRAPHIC && extent >= centre.z {
        return true;
    }
    let size = extent / divisor(centre.z);
    let area_px = 3.1415927 * node_part(own) * size * size * frame.focal_px.x * frame.focal_px.y * slant(centre);
    let share = area_px * seen / drawn_px;
    let around = (own >> 30u) & 3u;
    let left = select(0.2, 0.5, around == 1u);
    let probability = select(1.0 - pow(left, share / (1.0 - left)), share, around == 0u);
    return dithered(f32(mixed(mixed(place.x ^ key) ^ place.y) >> 8u) * 5.9604645e-8) < probability;
}

// Nodes of this byte and those above fill the pixel that they are in; FILLS of src/bake/tree/coverage.rs.
const FILLS: u32 = 254u;

// Radius in pixels of what a whole node stands for; 0 for samples that stand for themselves.
fn node_reach_px(sample: u32, own: u32, unit: f32, centre: vec3<f32>) -> f32 {
    let seen = towards(centre);
    let reach = node_extent(sample, unit) * length(seen) * max(frame.focal_px.x, frame.focal_px.y) / (seen.z * seen.z);
    return select(reach, 0.0, (own >> 24u) == ALWAYS);
}

// Nodes up to this radius in pixels reach the centre of no pixel but their own.
const OWN_PIXEL: f32 = 0.5;

// Whether a whole node, in camera space at `centre`, is drawn in a pixel whose centre is `beside` it there: where the ray through the
// pixel's centre meets the ball about all leaves. Nodes of a mesh have to meet it with their disk, thickened as normals below it turn: as
// triangles are drawn, so that outlines do not grow by half a pixel. Every point of a surface is in the disk of a node, and so is a pixel's
// centre: no gap opens.
fn covers_pixel(sample: u32, own: vec2<u32>, unit: f32, centre: vec3<f32>, beside: vec3<f32>, areas: Areas) -> bool {
    let extent = node_extent(sample, unit);
    let seen = towards(centre);
    let way = seen / length(seen);
    let along = dot(beside, way);
    if dot(beside, beside) - along * along > extent * extent {
        return false;
    }
    let n = octahedral_decode(own.y);
    let mapped = areas.x * n.x + areas.y * n.y + areas.z * n.z;
    let size = length(mapped);
    // Without a normal, or flattened by its map: a ball.
    if (own.x >> 24u) >= FILLS || !(size > 0.0) {
        return true;
    }
    let normal = mapped / size;
    let cosine = dot(normal, way);
    let side = normal - cosine * way;
    let sine = length(side);
    return abs(dot(beside, side)) <= extent * sine * (abs(cosine) + cone_sine(sample) * sine);
}
