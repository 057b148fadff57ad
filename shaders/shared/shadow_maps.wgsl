// Shadow maps (Williams 1978): a place is compared with the depths of what a sun sees, all over a disc (Reeves et al. 1987) as wide as the penumbra
// that the mean depth of what hides the sun gives (Fernando 2005, "Percentage-closer soft shadows").
@group(0) @binding(11) var<storage, read> shadow_maps: array<f32>;

// Pixels of the map at which what hides the sun is looked for, and at which the place is compared.
const SEARCHED: u32 = 16u;
const COMPARED: u32 = 24u;
// Radius of the disc in pixels of the map, at least and at most. Up to the least, a square of three pixels stands for the disc.
const NARROW_PX: f32 = 1.5;
const WIDE_PX: f32 = 48.0;
// Least distance in pixels at which what hides the sun is looked for.
const NEAREST_PX: f32 = 0.5;
// Distance of a place to the edge of a map that shows enough around it.
const MARGIN_PX: f32 = 50.0;
// Steepest surface of which neighbouring pixels' depths are known, in depths of a pixel's side a pixel.
const STEEPEST: f32 = 6.0;
// Cosine and sine of the golden angle: turning by it spreads any number of places over a disc evenly (Vogel 1979).
const GOLDEN: vec2<f32> = vec2<f32>(-0.73736888, 0.67549029);

// Maps of each sun, the finest first.
override SUN_MAPS: u32 = 1u;

fn map_at(number: u32) -> SunMap {
    // Fixed places: arrays that are indexed stay in memory.
    var map = frame.sun_maps[0];
    if number == 1u {
        map = frame.sun_maps[1];
    } else if number == 2u {
        map = frame.sun_maps[2];
    } else if number == 3u {
        map = frame.sun_maps[3];
    }
    return map;
}

// The finest map of a sun that shows a place and its surroundings. `sun`: its number, counted from 1.
fn sun_map(sun: u32, place: vec3<f32>) -> SunMap {
    let first = (sun - 1u) * SUN_MAPS;
    var found = map_at(first + SUN_MAPS - 1u);
    for (var i = 2u; i <= SUN_MAPS; i++) {
        let map = map_at(first + SUN_MAPS - i);
        let at = vec2<f32>(dot(map.x.xyz, place) + map.x.w, dot(map.y.xyz, place) + map.y.w);
        if all(at > vec2<f32>(MARGIN_PX)) && all(at < vec2<f32>(f32(map.side) - MARGIN_PX)) {
            found = map;
        }
    }
    return found;
}

// How much farther from the sun a place's surface is than what the map shows at an offset from the place, in world units; below 0 where nothing hides the
// sun. `slope`: how much farther the surface gets with each pixel of the map.
fn hidden_by(map: SunMap, place: vec3<f32>, slope: vec2<f32>, offset: vec2<f32>) -> f32 {
    let at = vec2<i32>(floor(place.xy + offset));
    let last = i32(map.side) - 1;
    let inside = clamp(at, vec2<i32>(0), vec2<i32>(last));
    let seen = shadow_maps[map.first + u32(inside.y * i32(map.side) + inside.x)];
    let own = place.z + dot(slope, vec2<f32>(at) + vec2<f32>(0.5) - place.xy);
    // Outside of the map nothing is known to hide the sun.
    return select(-1.0, own - seen, all(at == inside));
}

// The share of a square of three pixels of the map around a place in which the sun is hidden; it changes evenly with the place.
fn hidden_in_square(map: SunMap, place: vec3<f32>, slope: vec2<f32>) -> f32 {
    let share = fract(place.xy - vec2<f32>(0.5));
    var hidden = 0.0;
    for (var i = 0u; i < 16u; i++) {
        let column = vec2<f32>(f32(i & 3u), f32(i >> 2u));
        let first = select(vec2<f32>(1.0), vec2<f32>(1.0) - share, column == vec2<f32>(0.0));
        let weight = select(first, share, column == vec2<f32>(3.0));
        let offset = column - vec2<f32>(1.0) - share;
        hidden += select(0.0, weight.x * weight.y, hidden_by(map, place, slope, offset) > 0.0);
    }
    return hidden / 9.0;
}

// The share of a light that reaches a place of a surface with the normal `n`. `cosine`: 0 where the surface faces away from the light.
fn reaching(light: Light, cosine: f32, place: vec3<f32>, n: vec3<f32>) -> f32 {
    if light.map == 0u || cosine <= 0.0 {
        return 1.0;
    }
    let map = sun_map(light.map, place);
    // A pixel of the frame shows its place no more exactly than this.
    let camera = camera_position(place);
    let error = max(frame.lod_scale, 1.0 / max(frame.focal_px.x, frame.focal_px.y)) * divisor(max(camera.z, 0.0));
    let lifted = vec4<f32>(place + n * (0.75 * map.pixel + error), 1.0);
    let at = vec3<f32>(dot(map.x, lifted), dot(map.y, lifted), dot(map.depth, lifted));
    // The plane of the surface in the map: x and y in pixels.
    let across = vec2<f32>(dot(map.x.xyz, n), dot(map.y.xyz, n)) * (map.pixel * map.pixel);
    let along = min(dot(map.depth.xyz, n), -1e-6);
    var slope = -across / along;
    let steepness = length(slope) / map.pixel;
    slope *= min(1.0, STEEPEST / max(steepness, 1e-6));
    // Depths are those at the middle of a pixel of the map.
    let bias = map.pixel * (0.5 + 0.5 * min(steepness, STEEPEST)) + 1e-6 * at.z;
    let surface = vec3<f32>(at.xy, at.z - bias);

    // How far beside the place something may stand in the map and still hide a part of the sun, by its distance from the place.
    let pixels_per_unit = map.spread / map.pixel;
    let farthest = clamp(pixels_per_unit * at.z, NARROW_PX, WIDE_PX);
    // Radii grow by a factor: thin things near the place are found however far the search goes.
    let factor = exp2(log2(farthest / NEAREST_PX) / f32(SEARCHED - 1u));
    var radius = NEAREST_PX;
    var turn = vec2<f32>(1.0, 0.0);
    var hiding = 0.0;
    var distances = 0.0;
    for (var i = 0u; i < SEARCHED; i++) {
        let distance = hidden_by(map, surface, slope, radius * turn);
        let is_hiding = distance > 0.0 && radius <= max(NARROW_PX, pixels_per_unit * distance);
        let hides = select(0.0, 1.0, is_hiding);
        hiding += hides;
        distances += hides * max(distance, 0.0);
        radius *= factor;
        turn = vec2<f32>(dot(turn, vec2<f32>(GOLDEN.x, -GOLDEN.y)), dot(turn, GOLDEN.yx));
    }
    if hiding == 0.0 {
        return 1.0;
    }
    let wide = clamp(pixels_per_unit * (distances / hiding), NARROW_PX, WIDE_PX);
    if wide == NARROW_PX {
        return 1.0 - hidden_in_square(map, surface, slope);
    }
    turn = vec2<f32>(1.0, 0.0);
    var hidden = 0.0;
    for (var i = 0u; i < COMPARED; i++) {
        let reach = wide * sqrt((f32(i) + 0.5) / f32(COMPARED));
        hidden += select(0.0, 1.0, hidden_by(map, surface, slope, reach * turn) > 0.0);
        turn = vec2<f32>(dot(turn, vec2<f32>(GOLDEN.x, -GOLDEN.y)), dot(turn, GOLDEN.yx));
    }
    return 1.0 - hidden / f32(COMPARED);
}
