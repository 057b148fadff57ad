// Four pixels about a corner of the next coarser level, and the four coarser pixels that meet there.

fn corner_is_within(corner: vec2<i32>, bounds: vec4<i32>) -> bool {
    return all(2 * corner >= bounds.xy) && all(2 * corner - vec2<i32>(1) < bounds.zw);
}

// The coarser pixels, in places relative to the corner.
fn patches_around(corner: vec2<i32>, drawn: vec4<u32>, widen: f32) -> Around {
    let half = f32(1u << level.level);
    let bounds = level_bounds(drawn, level.level + 1u);
    return around_of(
        coarser(corner - vec2<i32>(1, 1), bounds, vec2<f32>(-half, -half)),
        coarser(corner - vec2<i32>(0, 1), bounds, vec2<f32>(half, -half)),
        coarser(corner - vec2<i32>(1, 0), bounds, vec2<f32>(-half, half)),
        coarser(corner, bounds, vec2<f32>(half, half)),
        widen,
    );
}

fn coarser(at: vec2<i32>, bounds: vec4<i32>, beside: vec2<f32>) -> Patch {
    if !is_within(at, bounds) {
        return no_patch();
    }
    return load_patch(patch_index(at, level.level + 1u, level.first_coarser), beside);
}

// Bilinear weights of the four coarser pixels for the pixel on one side of the corner: -1 or 0 along each axis.
fn bilinear(side: vec2<i32>) -> vec4<f32> {
    let right = select(0.25, 0.75, side.x == 0);
    let down = select(0.25, 0.75, side.y == 0);
    return vec4<f32>((1.0 - right) * (1.0 - down), right * (1.0 - down), (1.0 - right) * down, right * down);
}
