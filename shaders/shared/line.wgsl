// Segments of lines: tubes, which are the balls whose centre and radius vary linearly along a segment, and ribbons, which are two
// triangles. Where a line is thinner than a pixel, it is drawn one pixel wide, and a pixel shows it with the probability of its width, by
// a key that is fixed to the place along the strand. Its mean brightness is that of its width. Where it is translucent, each pixel shows it,
// with an alpha that is multiplied by its width.
//
// Everything is relative to the eye, and a tube is met relative to its nearer end: nothing large is subtracted from something large.
//!include shared/plane
//!include shared/edges
//!include shared/octahedral
//!include shared/sorts
@group(1) @binding(0) var<storage, read> line_vertices: array<u32>;
@group(1) @binding(1) var<storage, read> line_segments: array<vec2<u32>>;

// The lines of the page are ribbons.
override RIBBONS: bool = false;

// Words of a vertex: grid position, sRGB8 colour, radius in cells; for ribbons also normal and direction of the width.
const TUBE_WORDS: u32 = 5u;
const RIBBON_WORDS: u32 = 7u;
const LINE_BEGINS: u32 = 0x100000u;
const LINE_ENDS: u32 = 0x200000u;
const LINE_HASH: u32 = 0xffc00000u;
// A strip as long as this many widths has half the area of a disc as wide: strands end in half balls.
const LINE_CAP: f32 = 0.39269908;

struct Line {
    a: vec3<f32>,
    b: vec3<f32>,
    // From a to b, from exact differences on the grid.
    ab: vec3<f32>,
    radius: vec2<f32>,
    // Ribbons: half their widths at both ends.
    side_a: vec3<f32>,
    side_b: vec3<f32>,
    // The part of the segment that this is: all of it, or what lies before the camera plane.
    range: vec2<f32>,
    // Word offsets of the vertices; flags and hash; number of the first vertex in its file.
    words: vec2<u32>,
    link: u32,
    number: u32,
}

// A segment in the image, cut off outside of it, as a strip of one pixel's width.
struct Strip {
    origin: vec2<f32>,
    along: vec2<f32>,
    length: f32,
    // How far it reaches beyond its ends.
    before: f32,
    behind: f32,
    // At the ends of the strip: depth, width in pixels over the divisor, share of the line.
    z: vec2<f32>,
    width: vec2<f32>,
    share: vec2<f32>,
    is_seen: bool,
    // No part is thinner than a pixel.
    is_whole: bool,
}

// Two triangles: planes through the eye and the edges, and the planes that they lie in.
struct Ribbon {
    start: vec3<f32>,
    right: vec3<f32>,
    end: vec3<f32>,
    left: vec3<f32>,
    // Edge of the first triangle; the second has it with the other sign.
    diagonal_0: vec3<f32>,
    diagonal_1: vec3<f32>,
    plane_0: Plane,
    plane_1: Plane,
}

// The place where a pixel's ray meets a segment. Without a depth there is none.
struct LineHit {
    z: f32,
    share: f32,
    // Normal of a tube, in camera space, of any length.
    normal: vec3<f32>,
    width_px: f32,
    // Triangle of a ribbon that is not drawn as a strip: 1 or 2.
    triangle: u32,
}

fn line_words() -> u32 {
    return select(TUBE_WORDS, RIBBON_WORDS, RIBBONS);
}

fn camera_of(at: Placed, d: vec3<f32>) -> vec3<f32> {
    return at.axis_x.xyz * d.x + at.axis_y.xyz * d.y + at.axis_z.xyz * d.z;
}

fn length_of(v: vec3<f32>) -> f32 {
    let most = max(abs(v.x), max(abs(v.y), abs(v.z)));
    return most * length(v / max(most, 1e-37));
}

// Factor of radii in cells: the length of the longest axis.
fn radius_scale(at: Placed) -> f32 {
    return max(length_of(at.axis_x.xyz), max(length_of(at.axis_y.xyz), length_of(at.axis_z.xyz)));
}

fn line_cell(word: u32) -> vec3<i32> {
    return vec3<i32>(bitcast<i32>(line_vertices[word]), bitcast<i32>(line_vertices[word + 1u]), bitcast<i32>(line_vertices[word + 2u]));
}

// The alpha of a segment, of 255, as what is translucent is told by it: full or none only if both ends have that.
fn line_alpha(line: Line) -> u32 {
    let a = line_vertices[line.words.x + 3u] >> 24u;
    let b = line_vertices[line.words.y + 3u] >> 24u;
    return select(min(max(a, b), 254u), 255u, min(a, b) == 255u);
}

fn side_of(at: Placed, word: u32) -> vec3<f32> {
    let side = camera_of(at, octahedral_decode(line_vertices[word + 6u]));
    let size = length_of(side);
    return side * select(1.0 / size, 0.0, size < 1e-37);
}

// Depth before which segments are cut, of the depth of their farther end.
fn nearest_of(farthest: f32) -> f32 {
    return max(1e-7 * farthest, NEAREST);
}

// Cuts a segment at the camera plane. A radius that grows with depth is then linear along what is left.
fn cut_before(line: Line) -> Line {
    let nearest = nearest_of(max(line.a.z, line.b.z));
    if ORTHOGRAPHIC || (line.a.z < nearest) == (line.b.z < nearest) {
        return line;
    }
    let share = (nearest - line.a.z) / line.ab.z;
    let place = line.a + line.ab * share;
    let radius = mix(line.radius.x, line.radius.y, share);
    let side = mix(line.side_a, line.side_b, share);
    var part = line;
    if line.a.z < nearest {
        part.a = vec3<f32>(place.xy, nearest);
        part.ab = line.ab * (1.0 - share);
        part.radius.x = radius;
        part.side_a = side;
        part.range.x = share;
        part.link &= ~LINE_BEGINS;
    } else {
        part.b = vec3<f32>(place.xy, nearest);
        part.ab = line.ab * share;
        part.radius.y = radius;
        part.side_b = side;
        part.range.y = share;
        part.link &= ~LINE_ENDS;
    }
    return part;
}

fn least_line_radii(line: Line) -> vec2<f32> {
    return vec2<f32>(least_line_radius(line.a.z), least_line_radius(line.b.z));
}

// The segment `index` of a page; `scale` is radius_scale.
fn line_of(at: Placed, scale: f32, vertex_first: u32, index: u32) -> Line {
    let segment_words = line_segments[index];
    var line: Line;
    line.link = segment_words.x;
    line.number = segment_words.y;
    line.words = (vec2<u32>(vertex_first) + vec2<u32>(line.link & 1023u, (line.link >> 10u) & 1023u)) * line_words();
    let a = line_cell(line.words.x);
    let b = line_cell(line.words.y);
    line.a = grid_to_camera(at, a);
    line.b = grid_to_camera(at, b);
    line.ab = camera_of(at, vec3<f32>(b - a));
    line.radius = scale * vec2<f32>(bitcast<f32>(line_vertices[line.words.x + 4u]), bitcast<f32>(line_vertices[line.words.y + 4u]));
    line.range = vec2<f32>(0.0, 1.0);
    if RIBBONS {
        line.side_a = side_of(at, line.words.x);
        line.side_b = side_of(at, line.words.y);
    }
    if any(line.radius < least_line_radii(line)) {
        line = cut_before(line);
        line.radius = max(line.radius, least_line_radii(line));
    }
    line.side_a *= line.radius.x;
    line.side_b *= line.radius.y;
    return line;
}

// Focal length in pixels of widths, whatever their direction.
fn width_focal() -> f32 {
    return sqrt(frame.focal_px.x * frame.focal_px.y);
}

// Cuts a share of a segment off where a plane's distances from its ends say so.
fn cut(range: vec2<f32>, from_a: f32, from_b: f32) -> vec2<f32> {
    let at = from_a / (from_a - from_b);
    let low = select(range.x, max(range.x, at), from_a < 0.0);
    let high = select(range.y, min(range.y, at), from_b < 0.0);
    return select(vec2<f32>(low, high), vec2<f32>(1.0, 0.0), from_a < 0.0 && from_b < 0.0);
}

// Width of a segment at a place, in pixels over the divisor.
fn width_at(line: Line, share: f32, place: vec3<f32>, along: vec2<f32>) -> f32 {
    if !RIBBONS {
        return 2.0 * mix(line.radius.x, line.radius.y, share) * width_focal();
    }
    let side = mix(line.side_a, line.side_b, share);
    var image = side.xy;
    if !ORTHOGRAPHIC {
        image -= side.z * (place.xy / place.z);
    }
    image *= frame.focal_px;
    return 2.0 * abs(along.x * image.y - along.y * image.x);
}

fn strip_of(line: Line) -> Strip {
    var strip: Strip;
    let farthest = max(line.a.z, line.b.z);
    // A tiny part is left out of a segment that passes through the eye.
    let nearest = nearest_of(farthest);
    var range = cut(vec2<f32>(0.0, 1.0), line.a.z - nearest, line.b.z - nearest);
    let f = frame.focal_px;
    let size = vec2<f32>(frame.size_px);
    // As far from the image as it is wide.
    let low = frame.principal_px + size + vec2<f32>(64.0);
    let high = 2.0 * size - frame.principal_px + vec2<f32>(64.0);
    let va = image_vector(line.a);
    let vb = image_vector(line.b);
    range = cut(range, f.x * va.x + low.x * va.z, f.x * vb.x + low.x * vb.z);
    range = cut(range, high.x * va.z - f.x * va.x, high.x * vb.z - f.x * vb.x);
    range = cut(range, f.y * va.y + low.y * va.z, f.y * vb.y + low.y * vb.z);
    range = cut(range, high.y * va.z - f.y * va.y, high.y * vb.z - f.y * vb.y);
    strip.is_seen = farthest > NEAREST && range.x <= range.y;
    if !strip.is_seen {
        return strip;
    }
    var p = line.a + line.ab * range.x;
    var q = select(line.a + line.ab * range.y, line.b, range.y == 1.0);
    p.z = max(p.z, nearest);
    q.z = max(q.z, nearest);
    strip.origin = image_position(p);
    let d = image_position(q) - strip.origin;
    strip.length = length(d);
    strip.along = select(d / strip.length, vec2<f32>(1.0, 0.0), strip.length < 1e-6);
    strip.z = vec2<f32>(p.z, q.z);
    strip.share = range;
    strip.width = vec2<f32>(width_at(line, range.x, p, strip.along), width_at(line, range.y, q, strip.along));
    if (line.link & LINE_BEGINS) != 0u && range.x == 0.0 && !RIBBONS {
        strip.before = LINE_CAP * strip.width.x / divisor(p.z);
    }
    if (line.link & LINE_ENDS) != 0u && range.y == 1.0 && !RIBBONS {
        strip.behind = LINE_CAP * strip.width.y / divisor(q.z);
    }
    // Strips that are a pixel wide have round ends, which overlap: a line has no gaps where it bends within a pixel.
    strip.is_whole = strip_widths(strip).x * WHOLE >= 1.0;
    let overlap = select(0.0, 0.5, strip.is_whole);
    strip.before = max(strip.before, select(overlap, 0.0, (line.link & LINE_BEGINS) != 0u && RIBBONS));
    strip.behind = max(strip.behind, select(overlap, 0.0, (line.link & LINE_ENDS) != 0u && RIBBONS));
    return strip;
}

// The narrowest and widest part of a strip, in pixels.
fn strip_widths(strip: Strip) -> vec2<f32> {
    let p = strip.width.x / divisor(strip.z.x);
    let q = strip.width.y / divisor(strip.z.y);
    return vec2<f32>(min(p, q), max(p, q));
}

// Share of the whole segment that a strip shows.
fn whole_share(line: Line, strip: Strip) -> f32 {
    return max((strip.share.y - strip.share.x) * (line.range.y - line.range.x), 1e-6);
}

// The key of a place along a strand, from 0 to 1. Strands, and the pieces that a segment of the file is split into, differ by a hash. Segments
// and the parts of a segment differ by steps of Martin Roberts' R2 sequence. A part is half a pixel to a pixel long.
fn strip_key(line: Line, strip: Strip, share: f32, z: f32) -> f32 {
    var pixels = strip.length / whole_share(line, strip);
    if !ORTHOGRAPHIC {
        pixels *= strip.z.x * strip.z.y / (z * z);
    }
    let parts = exp2(clamp(ceil(log2(max(pixels, 1.0))), 0.0, 22.0));
    let part = u32(clamp(mix(line.range.x, line.range.y, share), 0.0, 1.0) * parts);
    let key = (line.link & LINE_HASH) + line.number * 2447445414u + part * 3242174889u;
    return dithered(f32(key >> 8u) * 5.9604645e-8);
}

// A strip that is all but a pixel wide is whole: rounding errors must leave no pixel out of it.
const WHOLE: f32 = 1.0001;

// Where a pixel's centre is on a strip that is thinner than a pixel there.
fn meet_strip(line: Line, strip: Strip, pixel: vec2<f32>) -> LineHit {
    var hit: LineHit;
    let d = pixel - strip.origin;
    let x = dot(d, strip.along);
    let y = strip.along.x * d.y - strip.along.y * d.x;
    if !strip.is_seen || x < -strip.before || x >= strip.length + strip.behind || y < -0.5 || y >= 0.5 {
        return hit;
    }
    let beyond = max(max(-x, x - strip.length), 0.0);
    if strip.is_whole && beyond > 0.0 && beyond * beyond + y * y >= 0.25 {
        return hit;
    }
    let s = select(clamp(x / strip.length, 0.0, 1.0), 0.5, strip.length < 1e-6);
    var inner = s;
    if !ORTHOGRAPHIC {
        inner = s * strip.z.x / (strip.z.y + s * (strip.z.x - strip.z.y));
    }
    let z = mix(strip.z.x, strip.z.y, inner);
    let width_px = mix(strip.width.x, strip.width.y, inner) / divisor(z);
    let share = mix(strip.share.x, strip.share.y, inner);
    let is_shown = SORT == SORT_TRANSLUCENT || strip_key(line, strip, share, z) < WHOLE * width_px;
    if width_px >= 1.0 || !is_shown {
        return hit;
    }
    hit.z = z;
    hit.share = share;
    hit.width_px = width_px;
    return hit;
}

// The nearer of what was found and another place on the ray.
fn nearer(best: vec2<f32>, at: f32, share: f32, is_met: bool) -> vec2<f32> {
    return select(best, vec2<f32>(at, share), is_met && at < best.x);
}

// Where a ray enters a tube (`crate::math::tube` has the same in f64). Lengths are in parts of the segment's own size, from its nearer end.
fn meet_tube(line: Line, ray: vec3<f32>) -> LineHit {
    var hit: LineHit;
    let turned = abs(line.b.z) < abs(line.a.z);
    let a = select(line.a, line.b, turned);
    let unit = max(max(line.radius.x, line.radius.y), max(abs(line.ab.x), max(abs(line.ab.y), abs(line.ab.z))));
    if !(unit > 0.0) {
        return hit;
    }
    let ab = select(line.ab, -line.ab, turned) / unit;
    let r = select(line.radius, line.radius.yx, turned) / unit;
    let way = towards(ray);
    let dir = way / length(way);
    var o = vec3<f32>(ray.xy - a.xy, 0.0);
    if !ORTHOGRAPHIC {
        o = vec3<f32>(fma(ray.xy, vec2<f32>(a.z), -a.xy), 0.0);
    }
    o /= unit;
    const NONE: f32 = 3e38;
    var best = vec2<f32>(NONE, 0.0);
    // The balls at the ends.
    let ua = -dot(o, dir);
    let qa = o + dir * ua;
    let da = length(qa);
    best = nearer(best, ua - sqrt(max((r.x - da) * (r.x + da), 0.0)), 0.0, r.x > 0.0 && da <= r.x);
    let ob = o - ab;
    let ub = -dot(ob, dir);
    let qb = ob + dir * ub;
    let db = length(qb);
    best = nearer(best, ub - sqrt(max((r.y - db) * (r.y + db), 0.0)), 1.0, r.y > 0.0 && db <= r.y);
    // The surface between them: ρ cos α + y sin α = r.x.
    let span = length(ab);
    let sine = (r.x - r.y) / max(span, 1e-30);
    if abs(sine) < 1.0 && span > 1e-6 {
        let axis = ab / span;
        let cosine = sqrt((1.0 - sine) * (1.0 + sine));
        let c = dot(dir, axis);
        let across = dir - axis * c;
        let s2 = dot(across, across);
        // From where the ray is nearest to the axis, within reach of the segment.
        let reach = max(r.x, r.y);
        let wanted = -dot(o, across) / max(s2, 1e-12);
        let u = clamp(wanted, min(ua, ub) - reach, max(ua, ub) + reach);
        let q = o + dir * u;
        let y = dot(q, axis);
        let beside = q - axis * y;
        let left = r.x - y * sine;
        let rho = cosine * length(beside);
        let second = cosine * cosine * s2 - (c * sine) * (c * sine);
        let half = cosine * cosine * dot(beside, across) + left * c * sine;
        let none = (rho - left) * (rho + left);
        let square = half * half - second * none;
        if square >= 0.0 {
            let root = sqrt(square);
            let sum = -(half + select(root, -root, half < 0.0));
            // Along the axis of a tube, and along a cone's side, one root or both are at infinity.
            let has_first = abs(second) > 1e-13;
            let has_other = abs(sum) > 1e-13;
            let first = sum / select(1.0, second, has_first);
            let other = none / select(1.0, sum, has_other);
            let slope = sine / (cosine * cosine);
            let left_0 = left - first * c * sine;
            let left_1 = left - other * c * sine;
            let foot_0 = (y + first * c - left_0 * slope) / span;
            let foot_1 = (y + other * c - left_1 * slope) / span;
            best = nearer(best, u + first, foot_0, has_first && left_0 > 0.0 && foot_0 >= 0.0 && foot_0 <= 1.0);
            best = nearer(best, u + other, foot_1, has_other && left_1 > 0.0 && foot_1 >= 0.0 && foot_1 <= 1.0);
        }
    }
    let z = fma(best.x * unit, dir.z, a.z);
    if best.x == NONE || !(z > NEAREST) {
        return hit;
    }
    hit.z = z;
    hit.normal = o + dir * best.x - ab * best.y;
    hit.share = select(best.y, 1.0 - best.y, turned);
    let axis_z = divisor(max(line.a.z + line.ab.z * hit.share, NEAREST));
    hit.width_px = 2.0 * mix(line.radius.x, line.radius.y, hit.share) * width_focal() / axis_z;
    return hit;
}

fn ribbon_of(line: Line) -> Ribbon {
    let a0 = line.a - line.side_a;
    let a1 = line.a + line.side_a;
    let b0 = line.b - line.side_b;
    let b1 = line.b + line.side_b;
    // Rays inside of a triangle are on the positive side of all three planes.
    let turn_0 = select(1.0, -1.0, facing(a0, a1, b1) < 0.0);
    let turn_1 = select(1.0, -1.0, facing(a0, b1, b0) < 0.0);
    let i0 = image_vector(a0);
    let i1 = image_vector(a1);
    let j0 = image_vector(b0);
    let j1 = image_vector(b1);
    var ribbon: Ribbon;
    ribbon.start = edge_plane(i0, i1) * turn_0;
    ribbon.right = edge_plane(i1, j1) * turn_0;
    ribbon.diagonal_0 = edge_plane(j1, i0) * turn_0;
    ribbon.diagonal_1 = edge_plane(i0, j1) * turn_1;
    ribbon.end = edge_plane(j1, j0) * turn_1;
    ribbon.left = edge_plane(j0, i0) * turn_1;
    ribbon.plane_0 = triangle_plane(a0, a1, b1);
    ribbon.plane_1 = triangle_plane(a0, b1, b0);
    return ribbon;
}

fn meet_ribbon(ribbon: Ribbon, ray: vec3<f32>) -> LineHit {
    var hit: LineHit;
    let in_0 = inside(ribbon.start, ray) && inside(ribbon.right, ray) && inside(ribbon.diagonal_0, ray);
    let in_1 = inside(ribbon.diagonal_1, ray) && inside(ribbon.end, ray) && inside(ribbon.left, ray);
    if !in_0 && !in_1 {
        return hit;
    }
    let inverse = select(plane_inverse_depth(ribbon.plane_1, ray), plane_inverse_depth(ribbon.plane_0, ray), in_0);
    if !(inverse > 0.0 && inverse < 1.0 / NEAREST) {
        return hit;
    }
    hit.z = 1.0 / inverse;
    hit.triangle = select(2u, 1u, in_0);
    return hit;
}

// A segment with all that its pixels have in common.
struct SeenLine {
    line: Line,
    strip: Strip,
    ribbon: Ribbon,
    // Narrowest and widest part in pixels.
    widths: vec2<f32>,
}

fn seen_line(line: Line) -> SeenLine {
    var seen: SeenLine;
    seen.line = line;
    seen.strip = strip_of(line);
    seen.widths = select(vec2<f32>(3e38), strip_widths(seen.strip), seen.strip.is_seen);
    if RIBBONS && seen.widths.y >= 1.0 {
        seen.ribbon = ribbon_of(line);
    }
    return seen;
}

// Meets a pixel's ray with a segment: the strip where the segment is thinner than a pixel, else the tube or the ribbon.
fn meet_line(seen: SeenLine, pixel: vec2<f32>) -> LineHit {
    var hit: LineHit;
    let ray = ray_through(pixel);
    if seen.widths.y >= 1.0 {
        if RIBBONS {
            hit = meet_ribbon(seen.ribbon, ray);
            if hit.z > 0.0 && seen.widths.x < 1.0 {
                hit.width_px = ribbon_width(seen, pixel);
                hit.z = select(0.0, hit.z, hit.width_px >= 1.0);
            }
        } else {
            hit = meet_tube(seen.line, ray);
            hit.z = select(0.0, hit.z, hit.width_px >= 1.0);
        }
    }
    if seen.widths.x < 1.0 && hit.z == 0.0 {
        hit = meet_strip(seen.line, seen.strip, pixel);
    }
    return hit;
}

// The width in pixels of a ribbon beside a pixel's centre.
fn ribbon_width(seen: SeenLine, pixel: vec2<f32>) -> f32 {
    let x = dot(pixel - seen.strip.origin, seen.strip.along);
    let s = select(clamp(x / seen.strip.length, 0.0, 1.0), 0.5, seen.strip.length < 1e-6);
    let z = seen.strip.z;
    var inner = s;
    if !ORTHOGRAPHIC {
        inner = s * z.x / (z.y + s * (z.x - z.y));
    }
    return mix(seen.strip.width.x, seen.strip.width.y, inner) / divisor(mix(z.x, z.y, inner));
}
