// The frame's colour map; `crate::scene::color_map` has the same functions.
fn ramp_word(index: u32) -> u32 {
    return frame.ramp_colors[index / 4u][index % 4u];
}

// The colour map's sRGB8 at a share of the range.
fn ramp_color(share: f32) -> u32 {
    let place = clamp(share, 0.0, 1.0) * f32(frame.ramp_count - 1u);
    let index = min(u32(place), frame.ramp_count - 2u);
    let low = unpack4x8unorm(ramp_word(index));
    let high = unpack4x8unorm(ramp_word(index + 1u));
    return pack4x8unorm(mix(low, high, place - f32(index)));
}
