// How open the surroundings of a pixel are: the mean of what `ambient_occlusion` has found at the 4 × 4 pixels around it, whose directions and distances
// differ, as far as they show the same surface.
//!include shared/kept_places
@group(0) @binding(5) var<storage, read> openness: array<f32>;

// Distance from the tangent plane of a pixel, as a share of the radius, from which on a neighbour shows another surface.
const SAME_SURFACE: f32 = 0.1;

fn open_share(at: vec2<u32>, pixel: u32) -> f32 {
    let own = vec2<i32>(at);
    let place = kept_place(own).xyz;
    let normal = kept_normal(own, pixel, place);
    var sum = vec2<f32>(0.0);
    for (var i = 0; i < 16; i++) {
        let neighbour = own + vec2<i32>(i & 3, i >> 2u) - vec2<i32>(2);
        let seen = kept_place(neighbour);
        var weight = seen.w * max(1.0 - abs(dot(seen.xyz - place, normal)) / (SAME_SURFACE * frame.occlusion.x), 0.0);
        // Whatever rounding does to its place.
        weight = select(weight, 1.0, all(neighbour == own));
        var open = 0.0;
        if weight > 0.0 {
            open = openness[frame.first_pixel + u32(neighbour.y) * frame.size_px.x + u32(neighbour.x)];
        }
        sum += vec2<f32>(open, 1.0) * weight;
    }
    return 1.0 - frame.occlusion.y * (1.0 - sum.x / sum.y);
}
