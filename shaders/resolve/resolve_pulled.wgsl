// The surface that pull-push reconstructs: level 0 of the push phase. A pixel that shows a sample keeps it unless what the coarser level knows
// to be nearer hides it; all other pixels that patches cover are filled. A thread takes the four pixels about a corner of level 1.
//!include shared/frame
//!include shared/scene
//!include shared/normals
//!include shared/kept
//!include shared/clipping
//!include shared/resolve
//!include shared/patches
//!include shared/level_bounds
//!include shared/corner

// Weight of the sample in a pixel, beside those of the patches around it.
const OWN: f32 = 0.25;

@compute @workgroup_size(64)
fn resolve_pulled(@builtin(global_invocation_id) invocation: vec3<u32>) {
    begin_view(invocation.z);
    let corner = vec2<i32>(invocation.xy);
    let drawn = drawn_pixels();
    let bounds = level_bounds(drawn, 0u);
    if !corner_is_within(corner, bounds) {
        return;
    }
    let around = patches_around(corner, drawn, WIDEN_PX);
    let counts = resolve_one(corner, vec2<i32>(-1, -1), around, bounds)
        + resolve_one(corner, vec2<i32>(0, -1), around, bounds)
        + resolve_one(corner, vec2<i32>(-1, 0), around, bounds)
        + resolve_one(corner, vec2<i32>(0, 0), around, bounds);
    if counts.x != 0u {
        atomicAdd(&stats[frame.view].pixels_of_samples, counts.x);
    }
    if counts.y != 0u {
        atomicAdd(&stats[frame.view].pixels_filled, counts.y);
    }
}

// Returns whether the pixel shows samples, and whether it was filled.
fn resolve_one(corner: vec2<i32>, side: vec2<i32>, around: Around, bounds: vec4<i32>) -> vec2<u32> {
    let at = 2 * corner + side;
    if !is_within(at, bounds) {
        return vec2<u32>(0u);
    }
    let place = vec2<f32>(side) + vec2<f32>(0.5);
    let pixel = frame.first_pixel + u32(at.y) * frame.size_px.x + u32(at.x);
    let shown = visibility[pixel];
    var own = load_patch(patch_index(at, 0u, 0u), place);
    let of_own = shape_of(own, WIDEN_PX);
    // Drawn here, but its disk is elsewhere: beside the image, or on the other side of a clip line.
    let is_elsewhere = own.word != 0u && distance_2(of_own, own.at - place) > 1.0;
    if is_elsewhere {
        own.word = 0u;
        visibility[pixel] = vec2<u32>(0u);
    }
    var four = see_four(around, place);
    if own.word == 0u {
        cover_between(&four, around, place, WIDEN_PX, true);
    }
    let before = front_of(four);
    let side_before = side_at(four, before, around);
    // Depth of the sample or triangle in this pixel.
    let inverse = select(bitcast<f32>(shown.y), 0.0, is_elsewhere);
    let is_own = own.word != 0u && inverse >= before && !is_other_side(own.facing, side_before);
    // Triangles hide what is behind them; patches before them hide them.
    if !is_own && (before == 0.0 || (own.word == 0u && inverse >= before)) {
        return vec2<u32>(0u);
    }
    let front = max(before, select(0.0, behind(of_own, inverse), is_own));
    let facing = select(side_before, own.facing, is_own && front > before);
    let weight = weights(four, front, facing, around) * bilinear(side);
    let own_weight = select(0.0, OWN, is_own);
    let all = combine(own, of_own, own_weight, around, weight, facing);
    let sum = own_weight + weight.x + weight.y + weight.z + weight.w;
    let inverses = select(vec4<f32>(0.0), four.inverse, weight > vec4<f32>(0.0));
    var surface: Surface;
    surface.depth_scale = 1.0;
    surface.inverse_depth = (dot(inverses, weight) + select(0.0, inverse * own_weight, is_own)) / sum;
    if !is_own && !place_is_shown(at_depth(pixel_centre(vec2<u32>(at)), 1.0 / surface.inverse_depth)) {
        return vec2<u32>(0u);
    }
    var shown_patch = all;
    if is_own {
        shown_patch.word = own.word;
    }
    show(&surface, shown_patch, at, pixel);
    return vec2<u32>(1u, select(1u, 0u, is_own));
}

// Finishes the surface of a pixel that shows a patch.
fn show(surface: ptr<function, Surface>, one: Patch, at: vec2<i32>, pixel: u32) {
    let id = ~one.word;
    visibility[pixel] = vec2<u32>(one.word, bitcast<u32>((*surface).inverse_depth));
    (*surface).slot = id >> SLOT_SHIFT;
    if needs_id() {
        (*surface).id = instances[slots[frame.first_slot + (*surface).slot].instance].id;
    }
    if COLORS {
        (*surface).color = one.color;
    }
    if NORMALS {
        let length_2 = dot(one.normal, one.normal);
        (*surface).is_ball = length_2 > 1e-4 && length_2 < LONGEST_BALL * LONGEST_BALL;
        if !(*surface).is_ball {
            let way = world_from_camera(towards(ray_through(pixel_centre(vec2<u32>(at)))));
            (*surface).normal = facing_normal(one.normal, way);
        }
    }
    finish(pixel, vec2<u32>(at), *surface);
}
