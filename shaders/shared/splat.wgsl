// A sample as an elliptical Gaussian in its tangent plane, taken to the image (Zwicker et al. 2004, §4).
//
// Positions and tangents come multiplied by the camera's intrinsics: in perspective (x·z px, y·z px, z). With pc the centre's image, and
// for each tangent t its image j = (t.xy − pc·t.z) / z and its slope β = t.z / z, everything follows without an inverse:
//
//   variance    V = Σ j jᵀ                                                 affine (Zwicker et al. 2001)
//               V = (Σ j jᵀ + F² m mᵀ / k) / k,  m = Σ j β,  k = 1 − F² |β|²   perspective: the dual conic, in which
//   centre      pc − F² m / k                                              nothing is left to cancel
//   determinant (j_u × j_v)² / k³                                          exactly
//   kernel coordinates at pc + d:  s = (d × j_v) / N,  t = (j_u × d) / N,  N = j_u × j_v − β_u (d × j_v) − β_v (j_u × d)
//   inverse depth there:           N / (z · j_u × j_v)
//
// Each of these is therefore a linear function of the pixel, or a quotient of two. Where rays are parallel, z counts as 1 and β as 0 in all
// but the last, and z itself is linear: z + u.z s + v.z t. The paper inverts the matrix of tangents and
// centre instead, which fails for splats seen edge-on.

// 0 affine, 1 perspective, 2 exact.
override FILTER: u32 = 1u;
// Kernels are convolved with a low-pass filter.
override PREFILTER: bool = true;
// Kernel coordinates need a division a pixel: of the exact filter, and of splats that reach the camera plane.
override GENERAL: bool = true;
// Samples are discs that face the image plane, not kernels.
override DISCS: bool = false;
// Splats are blended, and so have a depth offset.
override WEIGHTED: bool = true;

// Splats are painted in the order of their distances: however small, each covers its own share of the image.
override PAINTED: bool = false;

// Visibility is decided by disks without the filter, and by the pixel of a disk's centre: widened by the filter, everything would be a pixel
// larger all around and hide its neighbours. All pixels that the filter reaches are blended. The file that includes this says with `NARROW`
// whether disks are drawn without the filter.

const AFFINE: u32 = 0u;
const EXACT: u32 = 2u;

//!include shared/linear
//!include shared/clipping
//!include shared/kept
//!include shared/kernel
// A clip line that keeps everything.
const NO_LINE: u32 = 0x8000u;

const NOTHING: u32 = 0u;
const SMALL: u32 = 1u;
const LARGE: u32 = 2u;

// Weights do not fall below this share of the kernel's own: what many tiny splats add up to keeps its digits.
// In a single pass, which covers disks as they are, half of it.
const LEAST_AMPLITUDE: f32 = select(0.125, 0.5, NARROW);

fn least_amplitude() -> f32 {
    return select(LEAST_AMPLITUDE, 0.0, PAINTED);
}

const FARTHEST: f32 = 1e30;
const GAP: f32 = 0.0000019073486;
// Standard deviations below this many pixels are as good as none.
const THINNEST: f32 = 1e-15;
// Square roots of determinants above this have no finite square in f32: those of disks that the eye almost touches.
const ROOT_WITHOUT_SQUARE: f32 = 1e18;

fn cross_2d(a: vec2<f32>, b: vec2<f32>) -> f32 {
    return a.x * b.y - a.y * b.x;
}

struct Splat {
    id: u32,
    way: u32,
    // Reaches the camera plane.
    crosses: bool,
    // Leaves out the pixel that holds its centre: its node does not cover the middle of that pixel.
    passed_by: bool,
    facing: u32,
    // Origin of offsets.
    centre: vec2<f32>,
    // Squared distance in kernel units: (s² + t²) / n², where n > 0.
    s: vec3<f32>,
    t: vec3<f32>,
    n: vec3<f32>,
    // s and t without the filter, where disks are drawn without it.
    own_s: vec3<f32>,
    own_t: vec3<f32>,
    // 1/z, or z where rays are parallel; and bounds of 1/z.
    inverse: vec3<f32>,
    least: f32,
    most: f32,
    amplitude: f32,
    // In z.
    offset: f32,
    // First and last pixel of its box in the image.
    low: vec2<i32>,
    high: vec2<i32>,
    clip: ClipForms,
}

// Kernel coordinates as quotients of linear functions: (s, t) = (s/n, t/n).
struct KernelForms {
    s: vec3<f32>,
    t: vec3<f32>,
    n: vec3<f32>,
}

fn distance_of(splat: Splat, s_form: vec3<f32>, t_form: vec3<f32>, d: vec2<f32>) -> f32 {
    let s = linear(s_form, d);
    let t = linear(t_form, d);
    let q = fma(s, s, t * t);
    if GENERAL {
        let n = linear(splat.n, d);
        return select(FARTHEST, q / (n * n), n > 0.0);
    }
    return q;
}

// With the filter.
fn splat_distance(splat: Splat, d: vec2<f32>) -> f32 {
    return distance_of(splat, splat.s, splat.t, d);
}

// Clamps a distance to the cutoff, for weights.
fn splat_weight(splat: Splat, q: f32) -> f32 {
    return max(round(splat.amplitude * exp(-0.5 * min(q, frame.splat_cutoff * frame.splat_cutoff)) * frame.weight_one), 1.0);
}

// Whether a splat is drawn at an offset from its centre, `q` being the squared distance there.
fn splat_meets(splat: Splat, d: vec2<f32>, q: f32) -> bool {
    // Parallel rays meet the disk behind the eye as well.
    if ORTHOGRAPHIC && !(linear(splat.inverse, d) > NEAREST) {
        return false;
    }
    let holds_centre = !splat.crosses && !splat.passed_by && all(d > vec2<f32>(-0.5)) && all(d <= vec2<f32>(0.5));
    var own = q;
    if NARROW {
        own = distance_of(splat, splat.own_s, splat.own_t, d);
    }
    let meets = holds_centre || own <= frame.splat_cutoff * frame.splat_cutoff;
    if CLIP_BOXES == 0u {
        return meets;
    }
    return meets && place_is_shown(at_depth(splat.centre + d, 1.0 / splat_inverse(splat, d)));
}

fn splat_inverse(splat: Splat, d: vec2<f32>) -> f32 {
    let value = linear(splat.inverse, d);
    return clamp(select(value, 1.0 / value, ORTHOGRAPHIC), splat.least, splat.most);
}

// Behind the surface by the splat's offset.
fn offset_inverse(splat: Splat, inverse: f32) -> f32 {
    if WEIGHTED {
        return inverse / fma(splat.offset, inverse, 1.0);
    }
    return inverse;
}

// The depth that is kept of a pixel's nearest splat: behind its surface, and which side is seen.
fn kept_inverse(splat: Splat, inverse: f32) -> f32 {
    if WEIGHTED {
        return bitcast<f32>((bitcast<u32>(offset_inverse(splat, inverse)) & ~FACING_BITS) | splat.facing);
    }
    return inverse;
}

// `volume`: of both tangents and the centre; `orientation`: 0 where normals do not tell, −1 where the transform mirrors.
fn facing_of(volume: f32, orientation: f32) -> u32 {
    return select(select(FACING_BACK, FACING_FRONT, volume * orientation < 0.0), 0u, orientation == 0.0);
}

// Applies the intrinsics to a direction.
fn with_intrinsics(v: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(fma(frame.focal_px, v.xy, frame.principal_px * select(v.z, 0.0, ORTHOGRAPHIC)), v.z);
}

// Pixels whose centres lie in a box, cut to the image; none where high < low.
fn set_box(splat: ptr<function, Splat>, centre: vec2<f32>, extent: vec2<f32>) {
    let last = vec2<f32>(frame.size_px) - vec2<f32>(1.0);
    (*splat).low = vec2<i32>(clamp(ceil(centre - extent - 0.5), vec2<f32>(0.0), last + 1.0));
    (*splat).high = vec2<i32>(clamp(floor(centre + extent - 0.5), vec2<f32>(-1.0), last));
}

// Variance matrix of an ellipse, its determinant, the square root of that, and the centre.
struct Ellipse {
    xx: f32,
    xy: f32,
    yy: f32,
    determinant: f32,
    root: f32,
    shift: vec2<f32>,
}

// `jx` and `jy`: horizontal and vertical parts of both tangents' images.
fn outline(jx: vec2<f32>, jy: vec2<f32>, slopes: vec2<f32>, affine: bool) -> Ellipse {
    let area = cross_2d(jx, jy);
    if affine {
        return Ellipse(dot(jx, jx), dot(jx, jy), dot(jy, jy), area * area, abs(area), vec2<f32>(0.0));
    }
    let f2 = frame.splat_cutoff * frame.splat_cutoff;
    let inverse_k = 1.0 / (1.0 - f2 * dot(slopes, slopes));
    let m = vec2<f32>(dot(jx, slopes), dot(jy, slopes));
    let n = f2 * inverse_k * m;
    var e: Ellipse;
    e.xx = fma(n.x, m.x, dot(jx, jx)) * inverse_k;
    e.xy = fma(n.x, m.y, dot(jx, jy)) * inverse_k;
    e.yy = fma(n.y, m.y, dot(jy, jy)) * inverse_k;
    e.determinant = area * area * inverse_k * inverse_k * inverse_k;
    e.root = abs(area) * inverse_k * sqrt(inverse_k);
    e.shift = -n;
    return e;
}

// Forms of s and t whose squares add up to the distance in an ellipse, half the sides of its box in standard deviations, and the area of the
// ellipse without the filter over its area with it.
struct EllipseForms {
    s: vec3<f32>,
    t: vec3<f32>,
    extent: vec2<f32>,
    own_share: f32,
}

// `lowpass`: the variance that the filter adds.
fn ellipse_forms(e: Ellipse, lowpass: f32) -> EllipseForms {
    let xx = e.xx + lowpass;
    let yy = e.yy + lowpass;
    let added = e.xx + e.yy + lowpass;
    let determinant = fma(lowpass, added, e.determinant);
    var root = sqrt(determinant);
    var own_share = sqrt(e.determinant / determinant);
    if e.root > ROOT_WITHOUT_SQUARE {
        let widening = sqrt(1.0 + lowpass * (added / e.root) / e.root);
        root = e.root * widening;
        own_share = 1.0 / widening;
    }
    // Cholesky's factor of the variance, inverted.
    let l_x = max(sqrt(xx), THINNEST);
    let l_y = max(root / l_x, THINNEST);
    let lean = e.xy / (l_x * l_x);
    return EllipseForms(
        vec3<f32>(-e.shift.x, 1.0, 0.0) / l_x,
        vec3<f32>(fma(lean, e.shift.x, -e.shift.y), -lean, 1.0) / l_y,
        sqrt(vec2<f32>(xx, yy)),
        own_share,
    );
}

// As the filter widens it, and as it is.
fn set_ellipse(splat: ptr<function, Splat>, e: Ellipse) {
    var lowpass = 0.0;
    if PREFILTER {
        lowpass = frame.splat_lowpass_px * frame.splat_lowpass_px;
    }
    let forms = ellipse_forms(e, lowpass);
    if PREFILTER {
        (*splat).amplitude = max(forms.own_share, least_amplitude());
    }
    (*splat).s = forms.s;
    (*splat).t = forms.t;
    (*splat).n = vec3<f32>(1.0, 0.0, 0.0);
    var extent = forms.extent;
    if NARROW {
        let own = ellipse_forms(e, 0.0);
        (*splat).own_s = own.s;
        (*splat).own_t = own.t;
        extent = own.extent;
    }
    set_box(splat, (*splat).centre + e.shift, frame.splat_cutoff * extent);
}

// Extends a box by the points of an edge before the eye. Where it meets the camera plane its image runs off to infinity.
fn extend_box(low: ptr<function, vec2<f32>>, high: ptr<function, vec2<f32>>, p: vec3<f32>, q: vec3<f32>) {
    let far = vec2<f32>(1e6);
    if p.z > 0.0 {
        let image = clamp(p.xy / p.z, -far, far);
        *low = min(*low, image);
        *high = max(*high, image);
    }
    if (p.z > 0.0) != (q.z > 0.0) {
        let meets = p.xy + p.z / (p.z - q.z) * (q.xy - p.xy);
        let slack = 1e-5 * max(abs(p.xy), abs(q.xy));
        *low = min(*low, select(far, -far, meets <= slack));
        *high = max(*high, select(-far, far, meets >= -slack));
    }
}

// A splat that reaches the camera plane: each pixel's ray is met with its plane, and nothing is filtered.
fn crossing_splat(splat: ptr<function, Splat>, p_in: vec3<f32>, u_in: vec3<f32>, v_in: vec3<f32>, lines: vec2<u32>, orientation: f32) {
    let sizes = max(abs(p_in), max(abs(u_in), abs(v_in)));
    let size = max(sizes.x, max(sizes.y, sizes.z));
    // Neither over- nor underflow in products of three.
    let p = p_in / size;
    let u = u_in / size;
    let v = v_in / size;
    let normal = cross(u, v);
    let volume = dot(normal, p);
    if !(abs(volume) > 1e-30) {
        return;
    }
    (*splat).crosses = true;
    (*splat).facing = facing_of(volume, orientation);
    (*splat).way = LARGE;
    (*splat).centre = vec2<f32>(frame.size_px) * 0.5;
    let s = cross(v, p) / volume;
    let t = cross(p, u) / volume;
    let n = normal / volume;
    let c = vec3<f32>((*splat).centre, 1.0);
    let forms = KernelForms(vec3<f32>(dot(s, c), s.xy), vec3<f32>(dot(t, c), t.xy), vec3<f32>(dot(n, c), n.xy));
    (*splat).s = forms.s;
    (*splat).t = forms.t;
    (*splat).own_s = forms.s;
    (*splat).own_t = forms.t;
    (*splat).n = forms.n;
    (*splat).inverse = forms.n / size;
    (*splat).least = NEAREST;
    (*splat).most = FARTHEST;
    (*splat).clip = clip_forms(lines, forms, vec2<f32>(1.0, 0.0), 1.0);
    let f = frame.splat_cutoff;
    var low = vec2<f32>(2e6);
    var high = vec2<f32>(-2e6);
    let a = p + f * (u + v);
    let b = p + f * (u - v);
    let d = p - f * (u + v);
    let e = p - f * (u - v);
    extend_box(&low, &high, a, b);
    extend_box(&low, &high, b, d);
    extend_box(&low, &high, d, e);
    extend_box(&low, &high, e, a);
    let middle = 0.5 * (low + high);
    set_box(splat, middle, high - middle + 1.0);
}

// The part of a tangent's divisor that comes from its depth.
fn tilt(z: f32) -> f32 {
    return select(z, 0.0, ORTHOGRAPHIC);
}

// The splat of centre p and tangents u, v, all multiplied by the intrinsics.
fn make_splat(id: u32, p: vec3<f32>, u_in: vec3<f32>, v_in: vec3<f32>, lines: vec2<u32>, orientation: f32) -> Splat {
    var splat: Splat;
    splat.id = id;
    splat.way = NOTHING;
    splat.amplitude = 1.0;
    splat.high = vec2<i32>(-1);
    let f = frame.splat_cutoff;
    var filter_px = 0.0;
    if PREFILTER {
        filter_px = f * frame.splat_lowpass_px;
    }
    let u_camera = camera_vector(u_in);
    let v_camera = camera_vector(v_in);
    let longest = sqrt(max(dot(u_camera, u_camera), dot(v_camera, v_camera)));
    let pixel_reach = filter_px * abs(divisor(p.z)) / frame.focal_px.y;
    splat.offset = frame.splat_offset * fma(f, longest, pixel_reach);
    let reach = f * length(vec2<f32>(u_in.z, v_in.z));
    // Within rounding of the camera plane a disk has no outline that could be told from one that reaches it.
    if ORTHOGRAPHIC {
        if p.z <= -reach {
            return splat;
        }
    } else if p.z * (1.0 - GAP) <= max(reach, NEAREST) {
        if p.z >= -reach && reach > 0.0 {
            crossing_splat(&splat, p, u_in, v_in, lines, orientation);
        }
        return splat;
    }
    let w = 1.0 / divisor(p.z);
    let centre = p.xy * w;
    splat.centre = centre;
    var ju = (u_in.xy - centre * tilt(u_in.z)) * w;
    var jv = (v_in.xy - centre * tilt(v_in.z)) * w;
    // Change of depth along both tangents, over the divisor.
    var slopes = vec2<f32>(u_in.z, v_in.z) * w;
    var area = cross_2d(ju, jv);
    splat.facing = facing_of(area, orientation);
    // Kernel coordinates from those of the kernel that is drawn: (spread.x · s, spread.y · s + spread_t · t).
    var spread = vec2<f32>(1.0, 0.0);
    var spread_t = 1.0;
    var exact = FILTER == EXACT;
    let own_ju = ju;
    let own_jv = jv;
    let own_slopes = slopes;
    let own_area = area;
    if FILTER == EXACT && PREFILTER {
        // Object-space EWA (Ren, Pfister & Zwicker 2002): the low-pass filter taken to the tangent plane at the centre.
        let lowpass = frame.splat_lowpass_px * frame.splat_lowpass_px;
        let size = dot(ju, ju) + dot(jv, jv);
        if lowpass * size <= area * area {
            let b = vec3<f32>(dot(jv, jv), -dot(ju, jv), dot(ju, ju)) * (lowpass / (area * area));
            let l_u = sqrt(1.0 + b.x);
            let l_uv = b.y / l_u;
            let l_v = sqrt(max(1.0 + b.z - l_uv * l_uv, 1.0));
            let wide = vec2<f32>(fma(l_u, slopes.x, l_uv * slopes.y), l_v * slopes.y);
            exact = ORTHOGRAPHIC || f * f * dot(wide, wide) < 1.0 - GAP;
            if exact {
                splat.amplitude = max(1.0 / (l_u * l_v), least_amplitude());
                slopes = wide;
                ju = l_u * ju + l_uv * jv;
                jv = l_v * jv;
                area *= l_u * l_v;
                spread = vec2<f32>(l_u, l_uv);
                spread_t = l_v;
            }
        } else {
            exact = false;
        }
    }
    let flat = abs(area) < 1e-30;
    let inverse_area = select(1.0 / area, 0.0, flat);
    var forms: KernelForms;
    forms.s = vec3<f32>(0.0, jv.y, -jv.x) * inverse_area;
    forms.t = vec3<f32>(0.0, -ju.y, ju.x) * inverse_area;
    if ORTHOGRAPHIC {
        forms.n = vec3<f32>(1.0, 0.0, 0.0);
        splat.inverse = vec3<f32>(p.z, 0.0, 0.0) + slopes.x * forms.s + slopes.y * forms.t;
    } else {
        forms.n = vec3<f32>(1.0, 0.0, 0.0) - slopes.x * forms.s - slopes.y * forms.t;
        splat.inverse = w * forms.n;
    }
    // Far beyond its disk a splat's plane says nothing of where the surface is: the filter adds no more than the disk's own radius.
    // Else the undersides of what is smaller than a pixel, drawn out upwards, would be before all else.
    let beyond = reach + min(pixel_reach, f * longest);
    if ORTHOGRAPHIC {
        splat.least = 1.0 / max(p.z + beyond, NEAREST);
        splat.most = select(FARTHEST, 1.0 / (p.z - beyond), p.z - beyond > NEAREST);
    } else {
        let relative = beyond * w;
        splat.least = w / (1.0 + relative);
        splat.most = select(FARTHEST, w / (1.0 - relative), relative < 1.0);
    }
    splat.clip = clip_forms(lines, forms, spread, spread_t);
    if NARROW {
        ju = own_ju;
        jv = own_jv;
        slopes = own_slopes;
    }
    let ellipse = outline(vec2<f32>(ju.x, jv.x), vec2<f32>(ju.y, jv.y), slopes, FILTER == AFFINE || ORTHOGRAPHIC);
    if exact {
        // Seen edge-on it covers nothing but the pixel of its centre.
        let nowhere = vec3<f32>(1.0 / THINNEST, 0.0, 0.0);
        splat.s = select(forms.s, nowhere, flat);
        splat.t = forms.t;
        splat.own_s = select(vec3<f32>(0.0, own_jv.y, -own_jv.x) / own_area, nowhere, flat);
        splat.own_t = select(vec3<f32>(0.0, -own_ju.y, own_ju.x) / own_area, nowhere, flat);
        splat.n = forms.n;
        set_box(&splat, centre + ellipse.shift, f * sqrt(vec2<f32>(ellipse.xx, ellipse.yy)));
    } else {
        set_ellipse(&splat, ellipse);
    }
    set_way(&splat);
    return splat;
}

// Adds the pixel of the centre to the box, and decides who walks it.
fn set_way(splat: ptr<function, Splat>) {
    let own = floor((*splat).centre);
    if all(own >= vec2<f32>(0.0)) && all(own < vec2<f32>(frame.size_px)) {
        (*splat).low = min((*splat).low, vec2<i32>(own));
        (*splat).high = max((*splat).high, vec2<i32>(own));
    }
    let side = (*splat).high - (*splat).low;
    if min(side.x, side.y) >= 0 {
        (*splat).way = select(SMALL, LARGE, max(side.x, side.y) >= frame.small_splat_px);
    }
}

// Discs reach no farther in pixels.
const WIDEST_DISC_PX: f32 = 1e6;

// Half the sides of a disc's box in pixels, at a depth. `extent`: distance in camera space of what a node stands for, which the disc covers.
fn disc_px(z: f32, extent: f32) -> vec2<f32> {
    let radius = max(frame.disc_radius, extent);
    return clamp(radius * frame.focal_px / divisor(z), vec2<f32>(frame.splat_lowpass_px), vec2<f32>(WIDEST_DISC_PX));
}

// A disc that faces the image plane, at the depth of its centre p, which is multiplied by the intrinsics.
fn make_disc(id: u32, p: vec3<f32>, extent: f32) -> Splat {
    var splat: Splat;
    splat.id = id;
    splat.way = NOTHING;
    splat.amplitude = 1.0;
    splat.high = vec2<i32>(-1);
    if !(p.z > NEAREST) {
        return splat;
    }
    let inverse = 1.0 / p.z;
    let radius = disc_px(p.z, extent);
    splat.centre = p.xy / divisor(p.z);
    splat.s = vec3<f32>(0.0, 1.0 / radius.x, 0.0);
    splat.t = vec3<f32>(0.0, 0.0, 1.0 / radius.y);
    splat.n = vec3<f32>(1.0, 0.0, 0.0);
    splat.own_s = splat.s;
    splat.own_t = splat.t;
    splat.inverse = vec3<f32>(inverse, 0.0, 0.0);
    splat.least = inverse;
    splat.most = inverse;
    splat.clip = clip_forms(vec2<u32>(NO_LINE), KernelForms(splat.s, splat.t, splat.n), vec2<f32>(1.0, 0.0), 1.0);
    set_box(&splat, splat.centre, radius);
    set_way(&splat);
    return splat;
}
