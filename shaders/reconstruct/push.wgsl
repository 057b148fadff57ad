// Push phase (Marroquim et al. 2008, §3.3): pixels of a level take what the next coarser level knows of their surroundings. A thread takes
// the four pixels about a corner of the coarser level: the same four coarser pixels are the nearest ones to each of them.
//!include shared/frame
//!include shared/scene
//!include shared/octahedral
//!include shared/kept
//!include shared/patches
//!include shared/level_bounds
//!include shared/corner

@group(0) @binding(4) var<storage, read_write> stats: array<Stats>;

@compute @workgroup_size(64)
fn push(@builtin(global_invocation_id) invocation: vec3<u32>) {
    begin_view(invocation.z);
    let corner = vec2<i32>(invocation.xy);
    let drawn = drawn_pixels();
    let bounds = level_bounds(drawn, level.level);
    if !corner_is_within(corner, bounds) {
        return;
    }
    let around = patches_around(corner, drawn, WIDEN * f32(1u << level.level));
    push_one(corner, vec2<i32>(-1, -1), around, bounds);
    push_one(corner, vec2<i32>(0, -1), around, bounds);
    push_one(corner, vec2<i32>(-1, 0), around, bounds);
    push_one(corner, vec2<i32>(0, 0), around, bounds);
}

fn push_one(corner: vec2<i32>, side: vec2<i32>, around: Around, bounds: vec4<i32>) {
    let at = 2 * corner + side;
    if !is_within(at, bounds) {
        return;
    }
    let size = f32(1u << level.level);
    let place = (vec2<f32>(side) + vec2<f32>(0.5)) * size;
    let index = patch_index(at, level.level, level.first);
    let own = load_patch(index, place);
    let of_own = shape_of(own, 0.0);
    var four = see_four(around, place);
    if own.word == 0u {
        cover_between(&four, around, place, WIDEN * size, false);
    }
    let before = front_of(four);
    let side_before = side_at(four, before, around);
    // The coarser level has a nearer surface here, or the patch shows the back of that one.
    let inverse = plane_inverse(own.value, of_own, own.at - place);
    let is_seen = own.word != 0u && inverse >= before && !is_other_side(own.facing, side_before);
    let front = max(before, select(0.0, behind(of_own, inverse), is_seen));
    let facing = select(side_before, own.facing, is_seen && front > before);
    let weight = weights(four, front, facing, around) * bilinear(side);
    var all = combine(own, of_own, select(0.0, 1.0, is_seen), around, weight, facing);
    all.at -= place;
    store_patch(index, all);
}
