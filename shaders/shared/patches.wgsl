// Levels of the pull-push pyramid (Marroquim et al. 2008, §3), and how patches of the surface in them are combined.
//
// A pixel of level l is a square of 2^l × 2^l pixels of the image. It holds a patch: an ellipse in the image (as its centre relative to the
// pixel's and its variance, so that the outline is where the squared distance is 1), the plane of the surface, colour and normal. At level 0
// patches are the disks of single samples. Five things differ from the paper:
//
// 1. Ellipses lie about the true images of their samples, not about the centres of pixels.
// 2. Patches carry their planes. Depths are compared where they are asked for, not as intervals about the samples.
// 3. A combined ellipse has the mean of the variances and a part of that of the centres. The mean of disks alone would not cover what they
//    cover: at grazing angles it leaves holes.
// 4. Going down, patches are combined with those that a level has already. Otherwise a patch that covers a part of
//    a pixel's square would hide the neighbouring patches from finer levels.
// 5. A place between patches that lie on opposite sides is covered a little beyond their outlines.
//
// A rim of one pixel surrounds each level: rows and columns are numbered from -1. The rim of level 0 has samples beside the image whose disks
// may reach into it. Their patches act through coarser levels, as those of all other samples do, and only where their ellipses cover the image.
//!include shared/halves

// Which level a pass makes. Pixels of all levels lie one behind the other, level 0 first, each with its rim.
struct LevelUse {
    level: u32,
    // The first pixels of the level and of the next coarser one, and the pixels of all levels, of one view, with their rims.
    first: u32,
    first_coarser: u32,
    total: u32,
}

@group(0) @binding(5) var<storage, read_write> patches_0: array<vec2<u32>>;
@group(0) @binding(6) var<storage, read_write> patches_1: array<vec2<u32>>;
@group(0) @binding(7) var<storage, read_write> patches_2: array<vec2<u32>>;
@group(0) @binding(8) var<storage, read_write> patches_3: array<vec2<u32>>;
@group(2) @binding(7) var<uniform> level: LevelUse;

// Samples weigh alike wherever they lie within an ellipse, not as a Gaussian.
override BOX: bool = false;
// Patches have colours, and normals.
override COLORS: bool = true;
override NORMALS: bool = true;

// `WIDEN` widens an ellipse, in pixels of the level that asks for it. `WIDEN_PX` replaces it at level 0, in pixels of the image.
const WIDEN: f32 = 0.3;
const WIDEN_PX: f32 = 0.75;
// Factor of the variance of the patches' centres in a combined ellipse. A factor of three would cover a row of equal patches exactly.
const CENTRES: f32 = 2.3;
// Least radius of a patch's disks, in pixels of the next level. Smaller patches are dropped there.
const LEAST_DISK: f32 = 0.4;
// Squared distance up to which places between patches count as covered, and that between four patches.
const BETWEEN: f32 = 4.0;
const BETWEEN_FOUR: f32 = 16.0;
// Two patches lie on opposite sides of a place where the cosine of the angle between their directions is below this.
const OPPOSITE: f32 = -0.3;
// Exponent of weights at an ellipse's outline.
const FALL: f32 = 2.5;
// How far before or behind its centre a plane is followed, in radii of its disks.
const FOLLOWED: f32 = 1.5;
const OUTSIDE: f32 = 1e30;

struct Patch {
    // Complement of the id of the sample that counts the most; 0 where there is nothing.
    word: u32,
    facing: u32,
    // At the ellipse's centre: 1/z, or z where rays are parallel.
    value: f32,
    // The centre, relative to the place that the patch is asked for at, in pixels of the image.
    at: vec2<f32>,
    // Variance: xx, xy, yy.
    spread: vec3<f32>,
    // Radius in pixels of the samples' disks, if they faced the eye.
    radius: f32,
    // Change of the value for each pixel, times the focal length; relative to the value in perspective.
    slope: vec2<f32>,
    // Linear light.
    color: vec3<f32>,
    // Normal in world space. It is short where blended normals disagree, and zero without a normal.
    normal: vec3<f32>,
}

// Pixels in a row of a level, with its rim.
fn level_width(number: u32) -> u32 {
    return ((frame.size_px.x + (1u << number) - 1u) >> number) + 2u;
}

fn patch_index(at: vec2<i32>, number: u32, first: u32) -> u32 {
    return frame.view * level.total + first + u32(at.y + 1) * level_width(number) + u32(at.x + 1);
}

fn no_patch() -> Patch {
    var none: Patch;
    return none;
}

// The patch of a pixel, whose centre is `beside` the place that it is asked for at.
fn load_patch(index: u32, beside: vec2<f32>) -> Patch {
    var one: Patch;
    let head = patches_0[index];
    one.word = head.x;
    if head.x == 0u {
        return one;
    }
    one.facing = head.y & FACING_BITS;
    one.value = bitcast<f32>(head.y & ~FACING_BITS);
    let shape = patches_1[index];
    one.at = halves(shape.x) + beside;
    let lower = halves(shape.y);
    let rest = patches_2[index];
    let last = halves(rest.x);
    one.spread = vec3<f32>(lower.x * lower.x, lower.x * lower.y, lower.y * lower.y + last.x * last.x);
    one.radius = last.y;
    one.slope = halves(rest.y);
    if COLORS || NORMALS {
        let look = patches_3[index];
        if COLORS {
            let root = vec3<f32>(vec3<u32>(look.x & 1023u, (look.x >> 10u) & 1023u, (look.x >> 20u) & 1023u)) / 1023.0;
            one.color = root * root;
        }
        if NORMALS {
            one.normal = octahedral_decode(look.y);
            if look.y == BALL {
                one.normal = vec3<f32>(0.0, 0.0, 0.5 * BALL_NORMAL);
            }
        }
    }
    return one;
}

// Stores the patch of a pixel, whose place is relative to the pixel's centre.
fn store_patch(index: u32, one: Patch) {
    patches_0[index] = vec2<u32>(one.word, (bitcast<u32>(one.value) & ~FACING_BITS) | one.facing);
    if one.word == 0u {
        return;
    }
    let x = max(sqrt(max(one.spread.x, 0.0)), 1e-3);
    let lean = one.spread.y / x;
    let y = sqrt(max(one.spread.z - lean * lean, 0.0));
    patches_1[index] = vec2<u32>(half_pair(one.at), half_pair(vec2<f32>(x, lean)));
    patches_2[index] = vec2<u32>(half_pair(vec2<f32>(y, one.radius)), half_pair(one.slope));
    if COLORS || NORMALS {
        let root = vec3<u32>(round(sqrt(clamp(one.color, vec3<f32>(0.0), vec3<f32>(1.0))) * 1023.0));
        let length_2 = dot(one.normal, one.normal);
        let is_ball = length_2 > 1e-4 && length_2 < LONGEST_BALL * LONGEST_BALL;
        let normal = select(select(NO_NORMAL, octahedral_encode(one.normal), length_2 > 1e-4), BALL, is_ball);
        patches_3[index] = vec2<u32>(root.x | (root.y << 10u) | (root.z << 20u), normal);
    }
}

// A patch's ellipse and plane, prepared for the places that are asked for. They are worked out once for all places that a patch is asked for at.
struct Shape {
    // Inverse of the variance, widened: xx, xy, yy; and the squared distance of all places where there is no patch.
    inverse: vec3<f32>,
    least: f32,
    // Change of the value for each pixel.
    slope: vec2<f32>,
    // The least and the most of the plane's value: relative to the centre's in perspective.
    range: vec2<f32>,
    // Depth offset of a patch's disks: 1/z behind the surface over that of the surface in perspective, else a distance.
    offset: f32,
}

fn shape_of(one: Patch, widen: f32) -> Shape {
    let xx = one.spread.x + widen * widen;
    let yy = one.spread.z + widen * widen;
    let over = 1.0 / max(xx * yy - one.spread.y * one.spread.y, 1e-12);
    let angle = one.radius / frame.focal_px.y;
    let offset = frame.splat_offset * angle;
    let far = FOLLOWED * angle;
    var shape: Shape;
    shape.inverse = vec3<f32>(yy, -one.spread.y, xx) * over;
    shape.least = select(0.0, OUTSIDE, one.word == 0u);
    shape.slope = one.slope / frame.focal_px;
    if ORTHOGRAPHIC {
        shape.range = vec2<f32>(one.value - far, one.value + far);
        shape.offset = offset;
    } else {
        shape.range = vec2<f32>(1.0 / (1.0 + far), select(1e6, 1.0 / (1.0 - far), far < 0.999));
        shape.offset = 1.0 / (1.0 + offset);
    }
    return shape;
}

// The squared distance of the place that a patch is asked for at, in half axes of its ellipse.
fn distance_2(shape: Shape, at: vec2<f32>) -> f32 {
    let q = shape.inverse.x * at.x * at.x + 2.0 * shape.inverse.y * at.x * at.y + shape.inverse.z * at.y * at.y;
    return max(q, shape.least);
}

// The value of a patch's plane at the place that it is asked for at.
fn plane_value(value: f32, shape: Shape, at: vec2<f32>) -> f32 {
    let along = -dot(shape.slope, at);
    if ORTHOGRAPHIC {
        return clamp(value + along, shape.range.x, shape.range.y);
    }
    return value * clamp(1.0 + along, shape.range.x, shape.range.y);
}

// 1/z of a patch's plane at the place that it is asked for at.
fn plane_inverse(value: f32, shape: Shape, at: vec2<f32>) -> f32 {
    let there = plane_value(value, shape, at);
    return select(there, 1.0 / max(there, NEAREST), ORTHOGRAPHIC);
}

// Behind the surface by the depth offset of a patch's disks.
fn behind(shape: Shape, inverse: f32) -> f32 {
    return select(inverse * shape.offset, inverse / (1.0 + shape.offset * inverse), ORTHOGRAPHIC);
}

// Four patches, and their shapes.
struct Around {
    a: Patch,
    b: Patch,
    c: Patch,
    d: Patch,
    of_a: Shape,
    of_b: Shape,
    of_c: Shape,
    of_d: Shape,
}

fn around_of(a: Patch, b: Patch, c: Patch, d: Patch, widen: f32) -> Around {
    return Around(a, b, c, d, shape_of(a, widen), shape_of(b, widen), shape_of(c, widen), shape_of(d, widen));
}

// Four patches as they are seen from one place.
struct Four {
    distance: vec4<f32>,
    inverse: vec4<f32>,
    behind: vec4<f32>,
    // Those that cover the place.
    covers: vec4<bool>,
}

// `place`: relative to the one that the patches' places are relative to.
fn see_four(around: Around, place: vec2<f32>) -> Four {
    let a = around.a.at - place;
    let b = around.b.at - place;
    let c = around.c.at - place;
    let d = around.d.at - place;
    var four: Four;
    four.distance = vec4<f32>(
        distance_2(around.of_a, a), distance_2(around.of_b, b), distance_2(around.of_c, c), distance_2(around.of_d, d),
    );
    four.inverse = vec4<f32>(
        plane_inverse(around.a.value, around.of_a, a),
        plane_inverse(around.b.value, around.of_b, b),
        plane_inverse(around.c.value, around.of_c, c),
        plane_inverse(around.d.value, around.of_d, d),
    );
    four.behind = vec4<f32>(
        behind(around.of_a, four.inverse.x),
        behind(around.of_b, four.inverse.y),
        behind(around.of_c, four.inverse.z),
        behind(around.of_d, four.inverse.w),
    );
    four.covers = four.distance <= vec4<f32>(1.0);
    return four;
}

// The direction in which a patch lies, as the ellipse of another patch measures it.
fn direction(at: vec2<f32>, by: vec3<f32>, widened: f32) -> vec2<f32> {
    let x = sqrt(by.x + widened);
    let lean = by.y / x;
    let y = sqrt(max(by.z + widened - lean * lean, 1e-12));
    let across = at.x / x;
    let v = vec2<f32>(across, (at.y - lean * across) / y);
    return v / max(length(v), 1e-12);
}

// Marks patches on opposite sides of the place as covering it, if no patch covers it. `is_last`: at level 0, whose pixels are the image's.
fn cover_between(four: ptr<function, Four>, around: Around, place: vec2<f32>, widen: f32, is_last: bool) {
    let q = (*four).distance;
    if any((*four).covers) || !any(q <= vec4<f32>(BETWEEN_FOUR)) {
        return;
    }
    let near = q <= vec4<f32>(BETWEEN);
    let least = min(min(q.x, q.y), min(q.z, q.w));
    var by = select(around.d.spread, around.c.spread, q.z == least);
    by = select(by, around.b.spread, q.y == least);
    by = select(by, around.a.spread, q.x == least);
    let widened = widen * widen;
    let u = direction(around.a.at - place, by, widened);
    let v = direction(around.b.at - place, by, widened);
    let s = direction(around.c.at - place, by, widened);
    let t = direction(around.d.at - place, by, widened);
    let between = (near.x && near.y && dot(u, v) < OPPOSITE) || (near.x && near.z && dot(u, s) < OPPOSITE)
        || (near.x && near.w && dot(u, t) < OPPOSITE) || (near.y && near.z && dot(v, s) < OPPOSITE)
        || (near.y && near.w && dot(v, t) < OPPOSITE) || (near.z && near.w && dot(s, t) < OPPOSITE);
    let all_four = is_last && all(q <= vec4<f32>(BETWEEN_FOUR));
    if between || all_four {
        (*four).covers = select(near, vec4<bool>(true), vec4<bool>(all_four));
    }
}

// Depth behind the nearest of the patches that cover the place: what lies before it belongs to the same surface. 0 if none does.
fn front_of(four: Four) -> f32 {
    let behind = select(vec4<f32>(0.0), four.behind, four.covers);
    return max(max(behind.x, behind.y), max(behind.z, behind.w));
}

// Which side of its surface the patch at a depth shows.
fn side_at(four: Four, front: f32, around: Around) -> u32 {
    let is_it = four.covers & (four.behind == vec4<f32>(front));
    var facing = select(0u, around.d.facing, is_it.w);
    facing = select(facing, around.c.facing, is_it.z);
    facing = select(facing, around.b.facing, is_it.y);
    return select(facing, around.a.facing, is_it.x);
}

fn is_other_side(facing: u32, than: u32) -> bool {
    return (facing | than) == FACING_BITS;
}

// Weights of those patches that cover the place and belong to its nearest surface.
fn weights(four: Four, front: f32, facing: u32, around: Around) -> vec4<f32> {
    let other = vec4<bool>(
        is_other_side(around.a.facing, facing),
        is_other_side(around.b.facing, facing),
        is_other_side(around.c.facing, facing),
        is_other_side(around.d.facing, facing),
    );
    let counts = four.covers & (four.inverse >= vec4<f32>(front)) & !other;
    var weight = vec4<f32>(1.0);
    if !BOX {
        weight = exp(-FALL * min(four.distance, vec4<f32>(1.0)));
    }
    return select(vec4<f32>(0.0), weight, counts);
}

fn mean_2(own: vec2<f32>, a: vec2<f32>, b: vec2<f32>, c: vec2<f32>, d: vec2<f32>, own_share: f32, share: vec4<f32>) -> vec2<f32> {
    return own * own_share + a * share.x + b * share.y + c * share.z + d * share.w;
}

fn mean_3(own: vec3<f32>, a: vec3<f32>, b: vec3<f32>, c: vec3<f32>, d: vec3<f32>, own_share: f32, share: vec4<f32>) -> vec3<f32> {
    return own * own_share + a * share.x + b * share.y + c * share.z + d * share.w;
}

// Variance that a patch adds to a combined one.
fn spread_about(one: Patch, centre: vec2<f32>) -> vec3<f32> {
    let d = one.at - centre;
    return one.spread + CENTRES * vec3<f32>(d.x * d.x, d.x * d.y, d.y * d.y);
}

// One patch of up to five; all places are relative to the same one. Nothing if all weights are 0.
fn combine(own: Patch, of_own: Shape, own_weight: f32, around: Around, weight: vec4<f32>, facing: u32) -> Patch {
    let sum = own_weight + weight.x + weight.y + weight.z + weight.w;
    if !(sum > 0.0) {
        return no_patch();
    }
    let a = around.a;
    let b = around.b;
    let c = around.c;
    let d = around.d;
    let over = 1.0 / sum;
    let own_share = own_weight * over;
    let share = weight * over;
    var all: Patch;
    let most = max(own_weight, max(max(weight.x, weight.y), max(weight.z, weight.w)));
    all.word = select(d.word, c.word, weight.z == most);
    all.word = select(all.word, b.word, weight.y == most);
    all.word = select(all.word, a.word, weight.x == most);
    all.word = select(all.word, own.word, own_weight == most);
    all.facing = facing;
    all.at = mean_2(own.at, a.at, b.at, c.at, d.at, own_share, share);
    all.spread = mean_3(
        spread_about(own, all.at), spread_about(a, all.at), spread_about(b, all.at), spread_about(c, all.at), spread_about(d, all.at),
        own_share, share,
    );
    all.radius = own.radius * own_share + dot(vec4<f32>(a.radius, b.radius, c.radius, d.radius), share);
    all.slope = mean_2(own.slope, a.slope, b.slope, c.slope, d.slope, own_share, share);
    let values = vec4<f32>(
        plane_value(a.value, around.of_a, a.at - all.at),
        plane_value(b.value, around.of_b, b.at - all.at),
        plane_value(c.value, around.of_c, c.at - all.at),
        plane_value(d.value, around.of_d, d.at - all.at),
    );
    all.value = select(0.0, plane_value(own.value, of_own, own.at - all.at) * own_share, own_weight > 0.0)
        + dot(select(vec4<f32>(0.0), values, weight > vec4<f32>(0.0)), share);
    if COLORS {
        all.color = mean_3(own.color, a.color, b.color, c.color, d.color, own_share, share);
    }
    if NORMALS {
        let normal = mean_3(own.normal, a.normal, b.normal, c.normal, d.normal, own_share, share);
        let size = length(normal);
        all.normal = select(normal, normal / max(size, 1e-6), size >= LONGEST_BALL);
    }
    return all;
}
