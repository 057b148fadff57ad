// Parts of levels in which something may be drawn; only there do coarser levels hold anything.

// Pixels of the image in which something may be drawn: the first ones, and those behind the last ones.
fn drawn_pixels() -> vec4<u32> {
    let before = vec2<u32>(atomicLoad(&stats[frame.view].drawn_before[0]), atomicLoad(&stats[frame.view].drawn_before[1]));
    let end = vec2<u32>(atomicLoad(&stats[frame.view].drawn_end[0]), atomicLoad(&stats[frame.view].drawn_end[1]));
    return vec4<u32>(frame.size_px - before, end);
}

// The pixels of a level that hold these, and one more on each side: the level's rim, or nothing.
fn level_bounds(drawn: vec4<u32>, number: u32) -> vec4<i32> {
    let rounded = (drawn.zw + vec2<u32>((1u << number) - 1u)) >> vec2<u32>(number);
    return vec4<i32>(vec2<i32>(drawn.xy >> vec2<u32>(number)) - vec2<i32>(1), vec2<i32>(rounded) + vec2<i32>(1));
}

fn is_within(at: vec2<i32>, bounds: vec4<i32>) -> bool {
    return all(at >= bounds.xy) && all(at < bounds.zw);
}
