// Light of a resolved surface.
//!include shared/phong

// Some material is unlit, shines or is overridden, so pixels have to look up theirs.
override MATERIALS: bool = true;

// sRGB8 of a surface under all lights; `at`: its pixel.
fn lit_color(surface: Surface, at: vec2<u32>) -> u32 {
    var material: Material;
    if MATERIALS {
        material = materials[chunks[slots[frame.first_slot + surface.slot].chunk].material];
    }
    if OVERRIDES {
        material = effective_material(material, instances[slots[frame.first_slot + surface.slot].instance].material);
    }
    // Normals are as exact as where a later pass computes light.
    let packed = octahedral_encode(surface.normal);
    if (material.flags & MATERIAL_UNLIT) != 0u || (packed == NO_NORMAL && !surface.is_ball) {
        return surface.color;
    }
    let albedo = linear_color(surface.color);
    let from_eye = world_from_camera(ray_through(pixel_centre(at))) / (surface.inverse_depth / surface.depth_scale);
    if surface.is_ball {
        return color_word(ball_lights(albedo, material, from_eye));
    }
    return color_word(all_lights(albedo, material, octahedral_decode(packed), from_eye));
}
