// Fog before a surface: the light of the surface is absorbed exponentially with the length of its way to the eye (Beer–Lambert), and the fog's own
// light takes its place. Density may fall exponentially with height; its integral along a straight way is then known as well.

// 0: there is no fog; 1: it is as dense everywhere; 2: it becomes thinner with height.
override FOG: u32 = 0u;

// Distance that stands for infinity.
const FOG_FARTHEST: f32 = 1e25;
// Optical depth behind which nothing is left.
const FOG_DEEPEST: f32 = 80.0;

// The mean of exp(-t) for t from 0 to x. Near 0, where the difference of the exponentials would cancel, it is a series.
fn mean_of_decay(x: f32) -> f32 {
    if x < 0.25 {
        return 1.0 - x * (0.5 - x * (0.16666667 - x * (0.041666668 - x * (0.008333334 - x * 0.0013888889))));
    }
    return (1.0 - exp(-x)) / x;
}

// The optical depth of the fog before a place in camera space. Orthographic: from the plane through the eye on.
fn fog_depth(position: vec3<f32>) -> f32 {
    var start = vec3<f32>(0.0);
    if ORTHOGRAPHIC {
        start = vec3<f32>(position.xy, 0.0);
    }
    let way = position - start;
    // Squares of large numbers would overflow.
    let size = max(max(abs(way.x), abs(way.y)), max(abs(way.z), 1e-30));
    var density = frame.fog.w;
    if FOG == 2u {
        let rise = dot(frame.fog_up.xyz, way);
        // The fog is densest at the lower end: exponentials count from there, and none of them is large.
        let lower = frame.fog_up.w + dot(frame.fog_up.xyz, start) + min(rise, 0.0);
        density *= exp(-clamp(lower, -60.0, 80.0)) * mean_of_decay(abs(rise));
    }
    return min(size * length(way / size) * density, FOG_DEEPEST);
}

// A linear colour as it is seen through the fog from a place in camera space.
fn fogged(color: vec3<f32>, position: vec3<f32>) -> vec3<f32> {
    if FOG == 0u {
        return color;
    }
    return mix(frame.fog.rgb, color, exp(-fog_depth(position)));
}

// As fogged, for the depth along the viewing axis that a pixel shows.
fn fogged_at(color: vec3<f32>, at: vec2<u32>, depth: f32) -> vec3<f32> {
    if FOG == 0u {
        return color;
    }
    return fogged(color, at_depth(vec2<f32>(at) + vec2<f32>(0.5), min(depth, FOG_FARTHEST)));
}
