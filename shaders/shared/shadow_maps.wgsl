// Shadow maps (Williams 1978): a place is compared with the depths of what a light sees, all over a disc (Reeves et al. 1987) as wide as the penumbra
// that the mean depth of what hides the light gives (Fernando 2005, "Percentage-closer soft shadows").
@group(0) @binding(11) var<storage, read> shadow_maps: array<f32>;

// Pixels of the map at which what hides the light is looked for, in each of two patterns, and at which the place is compared.
const SEARCHED: u32 = 12u;
const COMPARED: u32 = 24u;
// Radius of the disc in pixels of the map, at least and at most. Up to the least, a square of three pixels stands for the disc.
const NARROW_PX: f32 = 1.5;
const WIDE_PX: f32 = 48.0;
// Least distance in pixels at which what hides the light is looked for.
const NEAREST_PX: f32 = 0.5;
// Distance of a place to the edge of a map that shows enough around it.
const MARGIN_PX: f32 = 50.0;
// Steepest surface of which neighbouring pixels' depths are known, in depths of a pixel's side a pixel.
const STEEPEST: f32 = 6.0;
// Cosine and sine of the golden angle: turning by it spreads any number of places over a disc evenly (Vogel 1979).
const GOLDEN: vec2<f32> = vec2<f32>(-0.73736888, 0.67549029);

// Maps of each sun, the finest first. Lamps have one record each, from the last back.
override SUN_MAPS: u32 = 1u;
override LAMP_MAPS: bool = false;
const RECORDS: u32 = 4u;

fn map_at(number: u32) -> ShadowMap {
    // Fixed places: arrays that are indexed stay in memory.
    var map = frame.map_records[0];
    if number == 1u {
        map = frame.map_records[1];
    } else if number == 2u {
        map = frame.map_records[2];
    } else if number == 3u {
        map = frame.map_records[3];
    }
    return map;
}

// The distance of a place to the edge of a sun's map in pixels, as far as it counts. Below 0 outside of the map.
fn inset(map: ShadowMap, place: vec3<f32>) -> f32 {
    let at = vec2<f32>(dot(map.x.xyz, place) + map.x.w, dot(map.y.xyz, place) + map.y.w);
    let nearest = min(at, vec2<f32>(f32(map.side)) - at);
    return min(min(nearest.x, nearest.y), MARGIN_PX);
}

// The finest map of a sun that shows a place and its surroundings. Where none shows them all, the map that shows most: a coarser map covers only what is
// farther from the eye. `sun`: its number, counted from 1.
fn sun_map(sun: u32, place: vec3<f32>) -> ShadowMap {
    let first = (sun - 1u) * SUN_MAPS;
    var found = map_at(first + SUN_MAPS - 1u);
    var most = inset(found, place);
    for (var i = 2u; i <= SUN_MAPS; i++) {
        let map = map_at(first + SUN_MAPS - i);
        let here = inset(map, place);
        if here >= most {
            found = map;
            most = here;
        }
    }
    return found;
}

// A lit surface as a shadow map sees it.
struct Seen {
    // Where the map begins in `shadow_maps`, and pixels along its side.
    first: u32,
    side: u32,
    is_of_lamp: bool,
    // In pixels of the map.
    at: vec2<f32>,
    // Distance from the plane that a sun's map counts from. In a lamp's map, whose rays meet in the lamp, −1/z, which is as linear in the pixel.
    value: f32,
    // How much the value grows with each pixel.
    slope: vec2<f32>,
    // Radius of the penumbra in pixels, for each unit of value that what hides the light is nearer to it.
    spread: f32,
    // Its largest radius.
    farthest: f32,
    // A lamp's disc, which faces the place, is an ellipse in the map: by how much it is longer away from the map's middle, as the root of that in that direction.
    lean: vec2<f32>,
}

fn seen_by_sun(light: Light, place: vec3<f32>, n: vec3<f32>, error: f32) -> Seen {
    let map = sun_map(light.map, place);
    let lifted = vec4<f32>(place + n * (0.75 * map.pixel + error), 1.0);
    // The plane of the surface in the map: x and y in pixels.
    let across = vec2<f32>(dot(map.x.xyz, n), dot(map.y.xyz, n)) * (map.pixel * map.pixel);
    let along = min(dot(map.depth.xyz, n), -1e-6);
    let slope = -across / along;
    let steepness = length(slope) / map.pixel;
    let z = dot(map.depth, lifted);
    let spread = map.spread / map.pixel;
    var seen: Seen;
    seen.first = map.first;
    seen.side = map.side;
    seen.at = vec2<f32>(dot(map.x, lifted), dot(map.y, lifted));
    seen.value = z - bias_of(map.pixel, steepness, z);
    seen.slope = slope * min(1.0, STEEPEST / max(steepness, 1e-6));
    seen.spread = spread;
    seen.farthest = clamp(spread * z, NARROW_PX, WIDE_PX);
    return seen;
}

// x, y and z in an order that begins with the axis that a map looks along.
fn from_axis(v: vec3<f32>, is_x: bool, is_y: bool) -> vec3<f32> {
    return select(select(v.zxy, v.yzx, is_y), v, is_x);
}

// Turns a vector of `from_axis` into the map's camera space: right, up, forward.
fn in_lamp_map(v: vec3<f32>, is_back: bool) -> vec3<f32> {
    return select(vec3<f32>(v.z, v.y, v.x), vec3<f32>(v.y, v.z, -v.x), is_back);
}

fn seen_by_lamp(light: Light, place: vec3<f32>, n: vec3<f32>, error: f32) -> Seen {
    let map = map_at(RECORDS - light.map);
    let from_lamp = place - ((light.place_hi.xyz - frame.eye_hi.xyz) + (light.place_lo.xyz - frame.eye_lo.xyz));
    let far = abs(from_lamp);
    let way = from_lamp + n * (0.75 * map.pixel * max(far.x, max(far.y, far.z)) + error);
    let size = abs(way);
    let is_x = size.x >= size.y && size.x >= size.z;
    let is_y = !is_x && size.y >= size.z;
    let ahead = from_axis(way, is_x, is_y);
    let is_back = ahead.x < 0.0;
    let p = in_lamp_map(ahead, is_back);
    let normal = in_lamp_map(from_axis(n, is_x, is_y), is_back);
    let z = max(p.z, NEAREST);
    // The plane: dot(normal, p) = -distance.
    let distance = max(-dot(normal, p), 1e-6 * z);
    let slope = vec2<f32>(normal.x, -normal.y) * (map.pixel / distance);
    let steepness = length(slope) * z / map.pixel;
    var seen: Seen;
    // The sides of the cube: +x, −x, +y, −y, +z, −z.
    let number = select(select(4u, 2u, is_y), 0u, is_x) + u32(is_back);
    seen.first = map.first + number * map.side * map.side;
    seen.side = map.side;
    seen.is_of_lamp = true;
    seen.at = vec2<f32>(0.5 * f32(map.side)) + vec2<f32>(p.x, -p.y) / (z * map.pixel);
    seen.value = -1.0 / z - bias_of(map.pixel * z, steepness, z) / (z * z);
    seen.slope = slope * min(1.0, STEEPEST / max(steepness, 1e-6));
    seen.spread = map.spread / map.pixel;
    let middle = 0.5 * f32(map.side);
    let aside = seen.at - vec2<f32>(middle);
    let longer = length(p) / z - 1.0;
    seen.lean = aside * (sqrt(longer) / max(length(aside), 1e-6));
    // An occluder may stand close to the ball, and the map has to show it.
    let border = middle - max(abs(aside.x), abs(aside.y)) - 1.0;
    seen.farthest = select(NARROW_PX, clamp(border / (1.0 + longer), NARROW_PX, WIDE_PX), map.spread > 0.0);
    return seen;
}

// How much nearer to the light a surface is taken to be, since depths are those at the middle of a pixel of the map. `pixel`: its side in world units.
fn bias_of(pixel: f32, steepness: f32, z: f32) -> f32 {
    return pixel * (0.5 + 0.5 * min(steepness, STEEPEST)) + 1e-6 * z;
}

// By how much what the map shows at an offset from the place is nearer to the light than the surface there; below 0 where nothing hides the light.
fn hidden_by(seen: Seen, offset: vec2<f32>) -> f32 {
    let at = vec2<i32>(floor(seen.at + offset));
    let last = i32(seen.side) - 1;
    let inside = clamp(at, vec2<i32>(0), vec2<i32>(last));
    var hiding = shadow_maps[seen.first + u32(inside.y * i32(seen.side) + inside.x)];
    if LAMP_MAPS {
        hiding = select(hiding, -1.0 / hiding, seen.is_of_lamp);
    }
    let own = seen.value + dot(seen.slope, vec2<f32>(at) + vec2<f32>(0.5) - seen.at);
    // Outside of the map nothing is known to hide the light.
    return select(-1.0, own - hiding, all(at == inside));
}

// An offset within the disc of the light, as the map shows it.
fn on_disc(seen: Seen, offset: vec2<f32>) -> vec2<f32> {
    return offset + seen.lean * dot(seen.lean, offset);
}

// The share of a square of three pixels of the map around a place in which the light is hidden; it changes evenly with the place.
fn hidden_in_square(seen: Seen) -> f32 {
    let share = fract(seen.at - vec2<f32>(0.5));
    var hidden = 0.0;
    for (var i = 0u; i < 16u; i++) {
        let column = vec2<f32>(f32(i & 3u), f32(i >> 2u));
        let first = select(vec2<f32>(1.0), vec2<f32>(1.0) - share, column == vec2<f32>(0.0));
        let weight = select(first, share, column == vec2<f32>(3.0));
        let offset = column - vec2<f32>(1.0) - share;
        hidden += select(0.0, weight.x * weight.y, hidden_by(seen, offset) > 0.0);
    }
    return hidden / 9.0;
}

// The share of a light that reaches a place of a surface with the normal `n`. `cosine`: 0 where the surface faces away from the light.
fn reaching(light: Light, cosine: f32, place: vec3<f32>, n: vec3<f32>) -> f32 {
    if light.map == 0u || cosine <= 0.0 {
        return 1.0;
    }
    // A pixel of the frame shows its place no more exactly than this.
    let camera = camera_position(place);
    let error = max(frame.lod_scale, 1.0 / max(frame.focal_px.x, frame.focal_px.y)) * divisor(max(camera.z, 0.0));
    var seen: Seen;
    if LAMP_MAPS && light.kind == LIGHT_POINT {
        seen = seen_by_lamp(light, place, n, error);
    } else {
        seen = seen_by_sun(light, place, n, error);
    }

    // Radii grow by a factor, so that thin things near the place are found however far the search goes; and so that each stands for the same area, so that
    // little is missed far away.
    let factor = exp2(log2(seen.farthest / NEAREST_PX) / f32(SEARCHED - 1u));
    var radius = NEAREST_PX;
    var turn = vec2<f32>(1.0, 0.0);
    var hiding = 0.0;
    var nearer = 0.0;
    for (var i = 0u; i < SEARCHED; i++) {
        let wide = seen.farthest * sqrt((f32(i) + 0.5) / f32(SEARCHED));
        let radii = vec2<f32>(radius, wide);
        let by = vec2<f32>(hidden_by(seen, on_disc(seen, radius * turn)), hidden_by(seen, on_disc(seen, -wide * turn)));
        let is_hiding = (by > vec2<f32>(0.0)) & (radii <= max(vec2<f32>(NARROW_PX), seen.spread * by));
        let hides = select(vec2<f32>(0.0), vec2<f32>(1.0), is_hiding);
        hiding += hides.x + hides.y;
        nearer += dot(hides, max(by, vec2<f32>(0.0)));
        radius *= factor;
        turn = vec2<f32>(dot(turn, vec2<f32>(GOLDEN.x, -GOLDEN.y)), dot(turn, GOLDEN.yx));
    }
    if hiding == 0.0 {
        return 1.0;
    }
    let wide = clamp(seen.spread * (nearer / hiding), NARROW_PX, seen.farthest);
    if wide == NARROW_PX {
        return 1.0 - hidden_in_square(seen);
    }
    turn = vec2<f32>(1.0, 0.0);
    var hidden = 0.0;
    for (var i = 0u; i < COMPARED; i++) {
        let reach = wide * sqrt((f32(i) + 0.5) / f32(COMPARED));
        hidden += select(0.0, 1.0, hidden_by(seen, on_disc(seen, reach * turn)) > 0.0);
        turn = vec2<f32>(dot(turn, vec2<f32>(GOLDEN.x, -GOLDEN.y)), dot(turn, GOLDEN.yx));
    }
    return 1.0 - hidden / f32(COMPARED);
}
