// Boxes in camera space: their bounds, and the test against the view frustum.
//!include shared/stretch
//!include shared/clipping

// Relative error that f32 may add while terms are summed, as a fraction of their magnitude.
const SLACK: f32 = 4e-6;

// Half edges of a box in camera space, and its middle.
struct Box {
    centre: vec3<f32>,
    x: vec3<f32>,
    y: vec3<f32>,
    z: vec3<f32>,
    // Rounding error of a place in it in f32, and how far is drawn around it.
    slack: f32,
}

// The box of a chunk.
fn grid_box(at: Placed, origin: vec3<i32>, extent: vec3<f32>) -> Box {
    let half = extent * 0.5;
    let x = at.axis_x.xyz * half.x;
    let y = at.axis_y.xyz * half.y;
    let z = at.axis_z.xyz * half.z;
    let centre = grid_to_camera(at, origin) + x + y + z;
    let far_off = abs(centre) + abs(x) + abs(y) + abs(z);
    return Box(centre, x, y, z, SLACK * (far_off.x + far_off.y + far_off.z));
}

// No place of a box is farther from the eye.
fn box_far(box: Box) -> f32 {
    return length(box.centre) + length(box.x) + length(box.y) + length(box.z);
}

// Half of the box's extent in depth.
fn box_deep(box: Box) -> f32 {
    return abs(box.x.z) + abs(box.y.z) + abs(box.z.z);
}

// Bounds of a box: nearest depth, and the rectangle in the image in pixels. Boxes that surround the eye get 0, and in perspective
// everything.
struct BoxBounds {
    near: f32,
    least: vec2<f32>,
    most: vec2<f32>,
}

// Distance that snapping to parts of pixels and f32 may move a place.
const BOUNDS_SLACK_PX: f32 = 0.0625;

fn divisors(no: f32, yes: f32, is: vec2<bool>) -> vec2<f32> {
    return select(vec2<f32>(divisor(no)), vec2<f32>(divisor(yes)), is);
}

fn box_bounds(box: Box) -> BoxBounds {
    let reach = abs(box.x) + abs(box.y) + abs(box.z);
    let near = box.centre.z - reach.z - box.slack;
    let far = box.centre.z + reach.z + box.slack;
    if !ORTHOGRAPHIC && !(near > NEAREST) {
        return BoxBounds(0.0, vec2<f32>(0.0), vec2<f32>(frame.size_px));
    }
    let low = box.centre.xy - reach.xy - box.slack;
    let high = box.centre.xy + reach.xy + box.slack;
    let least = low / divisors(near, far, low > vec2<f32>(0.0));
    let most = high / divisors(far, near, high > vec2<f32>(0.0));
    return BoxBounds(
        select(near, 0.0, ORTHOGRAPHIC && !(near > NEAREST)),
        fma(frame.focal_px, least, frame.principal_px) - vec2<f32>(BOUNDS_SLACK_PX),
        fma(frame.focal_px, most, frame.principal_px) + vec2<f32>(BOUNDS_SLACK_PX),
    );
}

// Bounds of what is drawn of a box, where that is splats that reach so many pixels beyond their own outlines.
fn drawn_bounds(box: Box, filter_px: f32) -> BoxBounds {
    let bounds = box_bounds(box);
    return BoxBounds(bounds.near, bounds.least - vec2<f32>(filter_px), bounds.most + vec2<f32>(filter_px));
}

// The part of the image within bounds.
fn cover_of(bounds: BoxBounds) -> f32 {
    let size = vec2<f32>(frame.size_px);
    let sides = clamp(bounds.most, vec2<f32>(0.0), size) - clamp(bounds.least, vec2<f32>(0.0), size);
    return sides.x * sides.y / (size.x * size.y);
}

// False when the box, and all within `radius` of it, lies on the negative side of a plane.
fn reaches(normal: vec3<f32>, offset: f32, centre: vec3<f32>, x: vec3<f32>, y: vec3<f32>, z: vec3<f32>, radius: f32) -> bool {
    let reach = abs(dot(normal, x)) + abs(dot(normal, y)) + abs(dot(normal, z)) + radius * length(normal);
    var scale = dot(abs(normal), abs(centre)) + reach;
    var side = dot(normal, centre) + reach;
    if ORTHOGRAPHIC {
        scale += abs(offset);
        side += offset;
    }
    return side >= -SLACK * scale;
}

// Tests a plane that holds a line of the image: `line` · (x, y, 1) is 0 there, with x and y over the divisor.
fn reaches_line(line: vec3<f32>, centre: vec3<f32>, x: vec3<f32>, y: vec3<f32>, z: vec3<f32>, radius: f32) -> bool {
    if ORTHOGRAPHIC {
        return reaches(vec3<f32>(line.xy, 0.0), line.z, centre, x, y, z, radius);
    }
    return reaches(line, 0.0, centre, x, y, z, radius);
}

// Along one axis of a clip box, the middle of a box and half its extent, rounding included.
fn clip_span(axis: vec3<f32>, centre: vec3<f32>, x: vec3<f32>, y: vec3<f32>, z: vec3<f32>, radius: f32) -> vec2<f32> {
    let extent = abs(dot(axis, x)) + abs(dot(axis, y)) + abs(dot(axis, z)) + radius * length(axis);
    return vec2<f32>(dot(axis, centre), extent + SLACK * (dot(abs(axis), abs(centre)) + extent));
}

// Adds a clip box to what was found of a box with half edges x, y, z and all within `radius` of it: whether any of it may be in a clip box whose
// inside is shown, and whether all of it is in one whose outside is.
fn meets_clip_box(found: vec2<bool>, clip: ClipBox, centre: vec3<f32>, x: vec3<f32>, y: vec3<f32>, z: vec3<f32>, radius: f32) -> vec2<bool> {
    let across = clip_span(clip.x.xyz, centre, x, y, z, radius);
    let along = clip_span(clip.y.xyz, centre, x, y, z, radius);
    let up = clip_span(clip.z.xyz, centre, x, y, z, radius);
    let middle = vec3<f32>(across.x, along.x, up.x);
    let extent = vec3<f32>(across.y, along.y, up.y);
    let low = vec3<f32>(clip.x.w, clip.y.w, clip.z.w);
    if clip.high.w == 0.0 {
        let meets = all(middle + extent >= low) && all(middle - extent <= clip.high.xyz);
        return vec2<bool>(found.x || meets, found.y);
    }
    let holds = all(middle - extent >= low) && all(middle + extent <= clip.high.xyz);
    return vec2<bool>(found.x, found.y || holds);
}

// Whether anything of a box, and of what lies within `radius` of it, may be shown.
fn box_is_shown(centre: vec3<f32>, x: vec3<f32>, y: vec3<f32>, z: vec3<f32>, radius: f32) -> bool {
    if CLIP_BOXES == 0u {
        return true;
    }
    var found = meets_clip_box(vec2<bool>(CLIP_INSIDE == 0u, false), frame.clips[0], centre, x, y, z, radius);
    if CLIP_BOXES > 1u { found = meets_clip_box(found, frame.clips[1], centre, x, y, z, radius); }
    if CLIP_BOXES > 2u { found = meets_clip_box(found, frame.clips[2], centre, x, y, z, radius); }
    if CLIP_BOXES > 3u { found = meets_clip_box(found, frame.clips[3], centre, x, y, z, radius); }
    if CLIP_BOXES > 4u { found = meets_clip_box(found, frame.clips[4], centre, x, y, z, radius); }
    if CLIP_BOXES > 5u { found = meets_clip_box(found, frame.clips[5], centre, x, y, z, radius); }
    if CLIP_BOXES > 6u { found = meets_clip_box(found, frame.clips[6], centre, x, y, z, radius); }
    if CLIP_BOXES > 7u { found = meets_clip_box(found, frame.clips[7], centre, x, y, z, radius); }
    return found.x && !found.y;
}

// Whether anything may be seen of a box in camera space with half edges x, y, z and of what lies within `radius` of it; `margin`: pixels
// beside the image that count as well.
fn box_is_seen(centre: vec3<f32>, x: vec3<f32>, y: vec3<f32>, z: vec3<f32>, radius: f32, margin: f32) -> bool {
    let f = frame.focal_px;
    let c = frame.principal_px;
    let s = vec2<f32>(frame.size_px);
    return reaches(vec3<f32>(0.0, 0.0, 1.0), 0.0, centre, x, y, z, radius)
        && reaches_line(vec3<f32>(f.x, 0.0, c.x + margin), centre, x, y, z, radius)
        && reaches_line(vec3<f32>(-f.x, 0.0, s.x - c.x + margin), centre, x, y, z, radius)
        && reaches_line(vec3<f32>(0.0, f.y, c.y + margin), centre, x, y, z, radius)
        && reaches_line(vec3<f32>(0.0, -f.y, s.y - c.y + margin), centre, x, y, z, radius)
        && box_is_shown(centre, x, y, z, radius);
}

// How far splats may reach from their centres in camera space, of a chunk's longest kernel axis and an instance's stretch. Nearer to the eye
// that is by their disk's radius R and by no more for the filter. Sideways a perspective outline lies within R; the exact filter widens
// disks by √2 at most, and the affine outline, R (1 + |x/z|) / z on either side of x/z, lies within 2 R wherever all of that is before the eye.
fn splat_reach(chunk: Chunk, scale: f32) -> f32 {
    let reach = 2.02 * frame.splat_cutoff * frame.splat_width * chunk.kernel_base * exp2(f32(chunk.shift)) * scale;
    return max(reach, frame.disc_radius);
}

// How far lines in a box reach at least from their axes.
fn least_line_reach(box: Box) -> f32 {
    return 1.001 * least_line_radius(box.centre.z + box_deep(box));
}

// How far what an instance draws may reach beyond its box as a disc or as the thinnest line.
fn widest_reach(box: Box) -> f32 {
    return max(frame.disc_radius, least_line_reach(box));
}

// How far tubes and ribbons of a chunk may reach from their axes in camera space, of an instance's stretch.
fn line_reach(chunk: Chunk, scale: f32, box: Box) -> f32 {
    return max(1.001 * chunk.kernel_base * scale, least_line_reach(box));
}

// Pixels that thin lines may be widened by in the image.
const LINE_FILTER_PX: f32 = 1.0;
