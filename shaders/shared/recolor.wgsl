// Colours of surfaces by a value, in place of their own; `crate::scene::recolor` has the same functions.
//!include shared/ramp

// A hue for an instance: neighbouring ids have different ones.
fn instance_color(id: u32) -> vec3<f32> {
    let hue = f32((id * 0x9e3779b9u) >> 8u) * 5.9604645e-8 * 6.0;
    let part = clamp(abs((vec3<f32>(hue) + vec3<f32>(0.0, 4.0, 2.0)) % 6.0 - 3.0) - 1.0, vec3<f32>(0.0), vec3<f32>(1.0));
    return linear_from_srgb(0.25 + 0.7 * part);
}

// The linear colour of a surface before light.
fn recoloured(surface: Surface, at: vec2<u32>) -> vec3<f32> {
    if COLOR_BY == BY_HEIGHT {
        let place = at_depth(pixel_centre(at), surface.depth_scale / surface.inverse_depth);
        return linear_color(ramp_color(dot(frame.ramp.xyz, place) + frame.ramp.w));
    }
    if COLOR_BY == BY_NORMAL {
        let has_normal = dot(surface.normal, surface.normal) >= 0.25;
        return select(linear_color(GREY), linear_from_srgb(fma(surface.normal, vec3<f32>(0.5), vec3<f32>(0.5))), has_normal);
    }
    if COLOR_BY == BY_INSTANCE {
        return instance_color(instances[slots[frame.first_slot + surface.slot].instance].id);
    }
    return surface.color;
}
