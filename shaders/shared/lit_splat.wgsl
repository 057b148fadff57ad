// Splats are lit one by one, by their own normals.
//!include shared/phong
const LIT: bool = true;

fn lit(color: vec3<f32>, normal: vec3<f32>, ball: bool, over_plus_one: u32, slot: SplatSlot, sample: u32) -> vec3<f32> {
    var material: Material;
    if MATERIALS {
        material = materials[chunks[slots[frame.first_slot + slot.index].chunk].material];
    }
    if OVERRIDES {
        material = effective_material(material, over_plus_one);
    }
    if (material.flags & MATERIAL_UNLIT) != 0u {
        return color;
    }
    if all(normal == vec3<f32>(0.0)) && !ball {
        return clamp(color + emitted(material), vec3<f32>(0.0), vec3<f32>(1.0));
    }
    let place = from_origin(camera_place(splat_centre(slot, sample)));
    if ball {
        return clamp(toned(ball_lights(color, material, place) + emitted(material)), vec3<f32>(0.0), vec3<f32>(1.0));
    }
    return clamp(toned(all_lights(color, material, normal, place) + emitted(material)), vec3<f32>(0.0), vec3<f32>(1.0));
}
