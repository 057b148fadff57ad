// The alpha of a sample: its own, times that of a colour that its instance has.
fn sample_alpha(own: u32, over_plus_one: u32) -> f32 {
    let alpha = unpack4x8unorm(own).a;
    if !OVERRIDES || over_plus_one == 0u {
        return alpha;
    }
    let over = materials[over_plus_one - 1u];
    return alpha * select(1.0, over.base_color.a, (over.overrides & OVERRIDE_BASE_COLOR) != 0u);
}

// The linear colour of a sample: its own, times that of a material that its instance has.
fn albedo(own: u32, over_plus_one: u32) -> vec3<f32> {
    let color = linear_color(own);
    if !OVERRIDES || over_plus_one == 0u {
        return color;
    }
    let over = materials[over_plus_one - 1u];
    if (over.overrides & OVERRIDE_BASE_COLOR) == 0u {
        return color;
    }
    return min(color * over.base_color.rgb, vec3<f32>(1.0));
}
