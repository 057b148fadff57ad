// Pull phase (Marroquim et al. 2008, §3.2): a pixel of a level combines the four of the finer level below it. A thread takes one.
//!include shared/frame
//!include shared/scene
//!include shared/octahedral
//!include shared/kept
//!include shared/patches
//!include shared/level_bounds

@group(0) @binding(4) var<storage, read_write> stats: array<Stats>;

@compute @workgroup_size(64)
fn pull(@builtin(global_invocation_id) invocation: vec3<u32>) {
    begin_view(invocation.z);
    let at = vec2<i32>(invocation.xy) - vec2<i32>(1);
    let drawn = drawn_pixels();
    if !is_within(at, level_bounds(drawn, level.level + 1u)) {
        return;
    }
    let half = f32(1u << level.level) * 0.5;
    let bounds = level_bounds(drawn, level.level);
    let a = child(2 * at, bounds, vec2<f32>(-half, -half));
    let b = child(2 * at + vec2<i32>(1, 0), bounds, vec2<f32>(half, -half));
    let c = child(2 * at + vec2<i32>(0, 1), bounds, vec2<f32>(-half, half));
    let d = child(2 * at + vec2<i32>(1, 1), bounds, vec2<f32>(half, half));
    var one = no_patch();
    if (a.word | b.word | c.word | d.word) != 0u {
        let around = around_of(a, b, c, d, WIDEN * 4.0 * half);
        var four = see_four(around, vec2<f32>(0.0));
        if !any(four.covers) {
            let centre = (vec2<f32>(at) + vec2<f32>(0.5)) * 4.0 * half;
            four.covers = vec4<bool>(is_beside(a, centre), is_beside(b, centre), is_beside(c, centre), is_beside(d, centre));
        }
        let front = front_of(four);
        let facing = side_at(four, front, around);
        var unused: Shape;
        one = combine(no_patch(), unused, 0.0, around, weights(four, front, facing, around), facing);
    }
    store_patch(patch_index(at, level.level + 1u, level.first_coarser), one);
}

// Whether a patch's centre lies beside the image. Pixels along the border have to keep such a patch: the rim is narrower than the patch may be
// far away.
fn is_beside(one: Patch, centre: vec2<f32>) -> bool {
    let place = centre + one.at;
    return one.word != 0u && (any(place < vec2<f32>(0.0)) || any(place > vec2<f32>(frame.size_px)));
}

// A pixel of the finer level, whose centre is `beside` the coarser one's; nothing if its disks are too small for the coarser level.
fn child(at: vec2<i32>, bounds: vec4<i32>, beside: vec2<f32>) -> Patch {
    if !is_within(at, bounds) {
        return no_patch();
    }
    var one = load_patch(patch_index(at, level.level, level.first), beside);
    if one.radius < LEAST_DISK * f32(2u << level.level) {
        one.word = 0u;
    }
    return one;
}
