// The pixels that may show a segment of a line, and writing them. Shared by the passes that draw segments.
//!include shared/clipping
//!include shared/line

// Writes a pixel if it shows the segment.
fn write_line(seen: SeenLine, at: vec2<i32>, id: u32) {
    let pixel = vec2<f32>(at) + vec2<f32>(0.5);
    let hit = meet_line(seen, pixel);
    if hit.z > NEAREST && place_is_shown(on_ray(ray_through(pixel), hit.z)) {
        visibility_write(frame.first_pixel + u32(at.y) * frame.size_px.x + u32(at.x), 1.0 / hit.z, id);
    }
}

// The pixels that may show a segment: a box, and a strip in it.
struct LineBounds {
    low: vec2<i32>,
    high: vec2<i32>,
    // Half the height of the strip in a column, and how it rises.
    half: f32,
    slope: f32,
    is_seen: bool,
}

// Bounds in the image of a ball before the camera plane.
fn ball_bounds(centre: vec3<f32>, radius: f32) -> vec4<f32> {
    let low = centre.xy - vec2<f32>(radius);
    let high = centre.xy + vec2<f32>(radius);
    let near = divisor(centre.z - radius);
    let far = divisor(centre.z + radius);
    let least = low / select(vec2<f32>(near), vec2<f32>(far), low > vec2<f32>(0.0));
    let most = high / select(vec2<f32>(far), vec2<f32>(near), high > vec2<f32>(0.0));
    let far_off = vec2<f32>(1e8);
    return vec4<f32>(
        clamp(fma(frame.focal_px, least, frame.principal_px), -far_off, far_off),
        clamp(fma(frame.focal_px, most, frame.principal_px), -far_off, far_off),
    );
}

// Whether all of a segment, widened by a pixel, is on the negative side of a plane that holds a line of the image.
fn is_beyond(line: Line, normal: vec3<f32>) -> bool {
    let reach = line.radius * length(vec3<f32>(normal.xy, select(normal.z, 0.0, ORTHOGRAPHIC)));
    let from_a = dot(normal, image_vector(line.a));
    let from_b = dot(normal, image_vector(line.b));
    let slack = 4e-6 * (dot(abs(normal), abs(image_vector(line.a))) + dot(abs(normal), abs(image_vector(line.b))));
    return from_a + reach.x < -slack && from_b + reach.y < -slack;
}

// How far bounds reach beyond what rounding errors may move.
const SLACK_PX: f32 = 0.0625;

// The pixels whose centres lie between two corners; nothing is seen where there are none.
fn bound_centres(bounds: ptr<function, LineBounds>, least: vec2<f32>, most: vec2<f32>) {
    let size = vec2<f32>(frame.size_px);
    (*bounds).low = vec2<i32>(clamp(ceil(least - vec2<f32>(0.5 + SLACK_PX)), vec2<f32>(0.0), size));
    (*bounds).high = vec2<i32>(clamp(floor(most - vec2<f32>(0.5 - SLACK_PX)), vec2<f32>(-1.0), size - vec2<f32>(1.0)));
    (*bounds).is_seen = all((*bounds).low <= (*bounds).high);
}

// Whether no pixel shows a strip of less than a pixel's length, because both keys that its places may have leave it out.
fn is_left_out(seen: SeenLine) -> bool {
    let strip = seen.strip;
    let near = min(strip.z.x, strip.z.y);
    var pixels = strip.length / whole_share(seen.line, strip);
    if !ORTHOGRAPHIC {
        pixels *= max(strip.z.x, strip.z.y) / near;
    }
    let start = strip_key(seen.line, strip, 0.0, near);
    let end = strip_key(seen.line, strip, 1.0, near);
    return SORT != SORT_TRANSLUCENT && pixels < 0.99 && min(start, end) > 1.001 * seen.widths.y;
}

fn line_bounds(seen: SeenLine) -> LineBounds {
    let line = seen.line;
    let strip = seen.strip;
    var bounds: LineBounds;
    let f = frame.focal_px;
    let c = frame.principal_px;
    let size = vec2<f32>(frame.size_px);
    bounds.is_seen = max(line.a.z + line.radius.x, line.b.z + line.radius.y) > NEAREST
        && max(line.radius.x, line.radius.y) > 0.0
        && !is_beyond(line, vec3<f32>(f.x, 0.0, c.x + 1.0)) && !is_beyond(line, vec3<f32>(-f.x, 0.0, size.x - c.x + 1.0))
        && !is_beyond(line, vec3<f32>(0.0, f.y, c.y + 1.0)) && !is_beyond(line, vec3<f32>(0.0, -f.y, size.y - c.y + 1.0));
    bounds.low = vec2<i32>(0);
    bounds.high = vec2<i32>(size - vec2<f32>(1.0));
    bounds.half = 1e9;
    bounds.slope = 0.0;
    if !bounds.is_seen {
        return bounds;
    }
    let is_steep = abs(strip.along.x) < 1e-3 || strip.length < 1.0;
    let slope = strip.along.y / select(strip.along.x, 1.0, is_steep);
    // A strip is one pixel wide. It is cut off where it would meet the camera plane.
    let begin = strip.origin - strip.along * strip.before;
    let end = strip.origin + strip.along * (strip.length + strip.behind);
    let across = 0.5 * abs(strip.along.yx);
    if strip.is_seen && seen.widths.y < 1.0 {
        bound_centres(&bounds, min(begin, end) - across, max(begin, end) + across);
        bounds.is_seen = bounds.is_seen && !is_left_out(seen);
        bounds.slope = slope;
        bounds.half = select((0.5 + SLACK_PX) / abs(strip.along.x), 1e9, is_steep);
        return bounds;
    }
    let is_before = min(line.a.z - line.radius.x, line.b.z - line.radius.y) > NEAREST;
    if !(ORTHOGRAPHIC || is_before) {
        return bounds;
    }
    var reach = 0.0;
    if RIBBONS {
        let far_off = vec2<f32>(1e8);
        let a0 = clamp(image_position(line.a - line.side_a), -far_off, far_off);
        let a1 = clamp(image_position(line.a + line.side_a), -far_off, far_off);
        let b0 = clamp(image_position(line.b - line.side_b), -far_off, far_off);
        let b1 = clamp(image_position(line.b + line.side_b), -far_off, far_off);
        var least = min(min(a0, a1), min(b0, b1));
        var most = max(max(a0, a1), max(b0, b1));
        if strip.is_seen && seen.widths.x < 1.0 {
            least = min(least, min(begin, end) - across);
            most = max(most, max(begin, end) + across);
        }
        bound_centres(&bounds, least, most);
        let normal = vec2<f32>(-strip.along.y, strip.along.x);
        let outer_a = max(abs(dot(a0 - strip.origin, normal)), abs(dot(a1 - strip.origin, normal)));
        let outer_b = max(abs(dot(b0 - strip.origin, normal)), abs(dot(b1 - strip.origin, normal)));
        reach = max(max(outer_a, outer_b), 0.5) + SLACK_PX;
        // Rounding errors are larger where a ribbon reaches far beyond the image.
        reach = select(reach, 1e9, reach > 1e4);
    } else {
        let of_a = ball_bounds(line.a, line.radius.x);
        let of_b = ball_bounds(line.b, line.radius.y);
        // Where it is thinner than a pixel, it is drawn as a strip.
        let beside = select(0.0, 0.75, seen.widths.x < 1.0);
        bound_centres(&bounds, min(of_a.xy, of_b.xy) - vec2<f32>(beside), max(of_a.zw, of_b.zw) + vec2<f32>(beside));
        let at_a = fma(f, line.a.xy / divisor(line.a.z), c);
        let at_b = fma(f, line.b.xy / divisor(line.b.z), c);
        let out_a = max(max(of_a.zw - at_a, at_a - of_a.xy), vec2<f32>(0.0));
        let out_b = max(max(of_b.zw - at_b, at_b - of_b.xy), vec2<f32>(0.0));
        reach = max(length(out_a), length(out_b)) + beside + 0.5;
    }
    if strip.is_seen && !is_steep {
        bounds.slope = slope;
        bounds.half = min(reach / abs(strip.along.x), 1e9);
    }
    return bounds;
}

// First and last row of a column.
fn line_rows(bounds: LineBounds, strip: Strip, x: i32) -> vec2<i32> {
    let middle = strip.origin.y + (f32(x) + 0.5 - strip.origin.x) * bounds.slope;
    let low = clamp(middle - bounds.half - 0.5, f32(bounds.low.y), f32(bounds.high.y) + 1.0);
    let high = clamp(middle + bounds.half - 0.5, f32(bounds.low.y) - 1.0, f32(bounds.high.y));
    return vec2<i32>(vec2<f32>(ceil(low), floor(high)));
}

// An upper bound of the rows of a column.
fn most_rows(bounds: LineBounds) -> u32 {
    let box = f32(bounds.high.y - bounds.low.y + 1);
    return u32(clamp(2.0 * bounds.half + 2.0, 0.0, box));
}
