// Eye-dome lighting (Boucheny 2009, §4): a pixel is the darker, the farther its neighbours stand before it. Distances count by their
// ratio, and in orthographic views differences by the height of the image that the view is a part of, so that the effect does not depend on the scene's unit.
const EDL_NEIGHBOURS: u32 = 8u;
// How steeply light falls with the ratio's logarithm; as in Potree, so that strengths mean the same.
const EDL_STEEPNESS: f32 = 300.0;
// A neighbour counts by at most this (log2 of the ratio, 0.7 % of the distance): outlines stay a shade and do not turn black where the
// step is deep.
const EDL_MOST: f32 = 0.01;

// Returns the fraction of a pixel's light that remains.
fn eye_dome(at: vec2<u32>, inverse_depth: f32) -> f32 {
    let diagonal = 0.70710678 * frame.edl.y;
    let own = log2(inverse_depth);
    // Units of a logarithm for each unit of depth: as in perspective where the view is as high as it is far away.
    let steps = 1.442695 * frame.focal_px.y / frame.image_height;
    var before = 0.0;
    var least = EDL_MOST;
    for (var k = 0u; k < EDL_NEIGHBOURS; k++) {
        let axis = vec2<f32>(select(0.0, 1.0, (k & 1u) == 0u), select(1.0, 0.0, (k & 1u) == 0u)) * frame.edl.y;
        let slanted = vec2<f32>(1.0, select(1.0, -1.0, (k & 1u) == 0u)) * diagonal;
        let side = select(1.0, -1.0, (k & 2u) != 0u);
        let offset = side * select(slanted, axis, k < 4u);
        var nearer = 0.0;
        let place = vec2<i32>(at) + vec2<i32>(round(offset));
        if all(place >= vec2<i32>(0)) && all(place < vec2<i32>(frame.size_px)) {
            let neighbour = bitcast<f32>(visibility[frame.first_pixel + u32(place.y) * frame.size_px.x + u32(place.x)].y);
            // Nothing stands where the background is.
            var farther = log2(neighbour) - own;
            if ORTHOGRAPHIC {
                farther = (1.0 / inverse_depth - 1.0 / neighbour) * steps;
            }
            nearer = select(0.0, farther, neighbour > inverse_depth);
        }
        before += min(nearer, EDL_MOST);
        least = min(least, nearer);
    }
    // All neighbours of a gap between samples stand before it. What they have in common does not darken it.
    return exp(-EDL_STEEPNESS * frame.edl.x * (before / f32(EDL_NEIGHBOURS) - least));
}
