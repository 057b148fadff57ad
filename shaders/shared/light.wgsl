// Light of a resolved surface.
//!include shared/phong

// Where a surface is relative to the frame's origin, in world axes.
fn place_of(surface: Surface, at: vec2<u32>) -> vec3<f32> {
    let inverse = surface.inverse_depth / surface.depth_scale;
    if ORTHOGRAPHIC {
        return from_origin(at_depth(pixel_centre(at), 1.0 / inverse));
    }
    return world_from_camera(ray_through(pixel_centre(at))) / inverse;
}

// The colour of a surface that is not lit: of its surroundings' light it has what ambient light would be.
fn unlit_color(color: vec3<f32>) -> vec3<f32> {
    if OCCLUSION {
        return color * ambient_share;
    }
    return color;
}

// The material of a surface, with what its maps say there.
fn material_of(surface: Surface) -> Material {
    var material: Material;
    if MATERIALS {
        material = materials[chunks[slots[frame.first_slot + surface.slot].chunk].material];
    }
    if OVERRIDES {
        material = effective_material(material, instances[slots[frame.first_slot + surface.slot].instance].material);
    }
    if MAPS {
        mapped_share = 1.0 - material.occlusion_strength * surface.taken.x;
        material.roughness *= 1.0 - surface.taken.y;
        material.metallic *= 1.0 - surface.taken.z;
        material.emissive *= vec3<f32>(1.0) - surface.dimmed;
        if TRANSMITS {
            material.transmission *= 1.0 - surface.stopped;
        }
    }
    return material;
}

// The linear colour of a surface under all lights; `at`: its pixel.
fn lit_color(surface: Surface, material: Material, at: vec2<u32>) -> vec3<f32> {
    if (material.flags & MATERIAL_UNLIT) != 0u {
        return unlit_color(surface.color);
    }
    // Normals are as exact as where a later pass computes light.
    let packed = octahedral_encode(surface.normal);
    if packed == NO_NORMAL && !surface.is_ball {
        return unlit_color(surface.color) + emitted(material);
    }
    let place = place_of(surface, at);
    if surface.is_ball {
        return toned(ball_lights(surface.color, material, place) + emitted(material));
    }
    return toned(all_lights(surface.color, material, octahedral_decode(packed), place) + emitted(material));
}
