// The surface that pull-push reconstructs: level 0 of the push phase. A pixel that shows a sample keeps it unless what the coarser level knows
// to be nearer hides it; all other pixels that patches cover are filled. A thread takes the four pixels about a corner of level 1.
//
// A pixel of a coarser level knows the nearest surface at its centre alone. Beside an outline, the four coarser pixels may know nothing that
// covers a pixel, although the disk of a sample near by does. A pixel that stays open beside patches therefore asks the disks about it.
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
// How far from a corner, in pixels, an open pixel finds samples. Their disks are widened just enough that seen edge-on they still have an area.
const ABOUT: i32 = 8;
const ABOUT_WIDEN_PX: f32 = 0.1;

@compute @workgroup_size(64)
fn resolve_pulled(@builtin(global_invocation_id) invocation: vec3<u32>) {
    begin_view(invocation.z);
    let corner = vec2<i32>(invocation.xy);
    let drawn = drawn_pixels();
    let bounds = vec4<i32>(drawn);
    if !corner_is_within(corner, bounds) {
        return;
    }
    let around = patches_around(corner, drawn, WIDEN_PX);
    let a = resolve_one(corner, vec2<i32>(-1, -1), around, bounds);
    let b = resolve_one(corner, vec2<i32>(0, -1), around, bounds);
    let c = resolve_one(corner, vec2<i32>(-1, 0), around, bounds);
    let d = resolve_one(corner, vec2<i32>(0, 0), around, bounds);
    var counts = a.xy + b.xy + c.xy + d.xy;
    let is_open = vec4<u32>(a.z, b.z, c.z, d.z) != vec4<u32>(0u);
    if any(is_open) {
        let filled = fill_open(corner, is_open, level_bounds(drawn, 0u));
        counts += vec2<u32>(filled);
    }
    if counts.x != 0u {
        atomicAdd(&stats[frame.view].pixels_of_samples, counts.x);
    }
    if counts.y != 0u {
        atomicAdd(&stats[frame.view].pixels_filled, counts.y);
    }
}

// Returns whether the pixel shows samples, whether it was filled, and whether it stays open beside patches.
fn resolve_one(corner: vec2<i32>, side: vec2<i32>, around: Around, bounds: vec4<i32>) -> vec3<u32> {
    let at = 2 * corner + side;
    if !is_within(at, bounds) {
        return vec3<u32>(0u);
    }
    let place = vec2<f32>(side) + vec2<f32>(0.5);
    let pixel = frame.first_pixel + u32(at.y) * frame.size_px.x + u32(at.x);
    let shown = visibility[pixel];
    var own = load_patch(patch_index(at, 0u, 0u), place);
    let of_own = shape_of(own, WIDEN_PX);
    // Drawn here, but its disk is elsewhere: on the other side of a clip line.
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
        let is_beside = (around.a.word | around.b.word | around.c.word | around.d.word) != 0u;
        return vec3<u32>(0u, 0u, select(0u, 1u, own.word == 0u && before == 0.0 && is_beside));
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
        return vec3<u32>(0u);
    }
    var shown_patch = all;
    if is_own {
        shown_patch.word = own.word;
    }
    show(&surface, shown_patch, at, pixel);
    return vec3<u32>(1u, select(1u, 0u, is_own), 0u);
}

// The disk that covers an open pixel: where its sample is, in pixels from the corner, the squared distance of the pixel in half axes of the
// disk, 1/z there, and 1/z behind it. All are 0 where no disk was found.
struct Cover {
    way: vec2<i32>,
    distance: f32,
    inverse: f32,
    behind: f32,
}

// Fills the open pixels about a corner with the disks that cover them. Returns how many it filled.
fn fill_open(corner: vec2<i32>, is_open: vec4<bool>, bounds: vec4<i32>) -> u32 {
    var a: Cover;
    var b: Cover;
    var c: Cover;
    var d: Cover;
    for (var y = -ABOUT; y < ABOUT; y++) {
        for (var x = -ABOUT; x < ABOUT; x++) {
            let way = vec2<i32>(x, y);
            if !is_within(2 * corner + way, bounds) {
                continue;
            }
            let one = load_about(corner, way);
            let shape = shape_of(one, ABOUT_WIDEN_PX);
            cover_by(&a, one, shape, vec2<i32>(-1, -1), way);
            cover_by(&b, one, shape, vec2<i32>(0, -1), way);
            cover_by(&c, one, shape, vec2<i32>(-1, 0), way);
            cover_by(&d, one, shape, vec2<i32>(0, 0), way);
        }
    }
    var filled = 0u;
    if is_open.x {
        filled += fill(corner, vec2<i32>(-1, -1), a);
    }
    if is_open.y {
        filled += fill(corner, vec2<i32>(0, -1), b);
    }
    if is_open.z {
        filled += fill(corner, vec2<i32>(-1, 0), c);
    }
    if is_open.w {
        filled += fill(corner, vec2<i32>(0, 0), d);
    }
    return filled;
}

// The disk of a pixel, with its place relative to the corner.
fn load_about(corner: vec2<i32>, way: vec2<i32>) -> Patch {
    return load_patch(patch_index(2 * corner + way, 0u, 0u), vec2<f32>(way) + vec2<f32>(0.5));
}

// Takes a disk that covers a pixel in place of another one: if it belongs to a nearer surface, or to the same one and the pixel lies closer to
// its middle.
fn cover_by(cover: ptr<function, Cover>, one: Patch, shape: Shape, side: vec2<i32>, way: vec2<i32>) {
    let at = one.at - vec2<f32>(side) - vec2<f32>(0.5);
    let distance = distance_2(shape, at);
    if distance > 1.0 {
        return;
    }
    let inverse = plane_inverse(one.value, shape, at);
    let behind_it = behind(shape, inverse);
    if behind_it > (*cover).inverse || (inverse >= (*cover).behind && distance < (*cover).distance) {
        *cover = Cover(way, distance, inverse, behind_it);
    }
}

// Returns 1 if a disk covers the pixel and nothing hides the disk there.
fn fill(corner: vec2<i32>, side: vec2<i32>, cover: Cover) -> u32 {
    let at = 2 * corner + side;
    let pixel = frame.first_pixel + u32(at.y) * frame.size_px.x + u32(at.x);
    // Triangles hide what is behind them.
    if cover.inverse == 0.0 || bitcast<f32>(visibility[pixel].y) >= cover.behind {
        return 0u;
    }
    if !place_is_shown(at_depth(pixel_centre(vec2<u32>(at)), 1.0 / cover.inverse)) {
        return 0u;
    }
    var surface: Surface;
    surface.depth_scale = 1.0;
    surface.inverse_depth = cover.inverse;
    show(&surface, load_about(corner, cover.way), at, pixel);
    return 1u;
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
