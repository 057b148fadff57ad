// Surface appearance. An instance may lay a second material over the asset's own; `overrides` says which properties of
// the second one count.
struct Material {
    // Linear RGB and alpha.
    base_color: vec4<f32>,
    specular: vec3<f32>,
    shininess: f32,
    // Texture plus one, or 0.
    texture: u32,
    flags: u32,
    alpha_cutoff: f32,
    overrides: u32,
    // Of the metallic-roughness model: reflectance at normal incidence where the surface is no metal.
    dielectric: vec3<f32>,
    metallic: f32,
    // Linear RGB of light that the surface gives off.
    emissive: vec3<f32>,
    roughness: f32,
    // Textures plus one, or 0.
    reflection_map: u32,
    normal_map: u32,
    occlusion_map: u32,
    emissive_map: u32,
    normal_scale: f32,
    occlusion_strength: f32,
    // Reflectance at grazing angles where the surface is no metal.
    grazing: f32,
    // Share of the light that is not reflected which passes in place of being scattered, where the surface is no metal.
    transmission: f32,
    // What the volume behind the surface leaves of the light that passes.
    volume: vec3<f32>,
    // Texture plus one, or 0.
    transmission_map: u32,
}

// Some material has maps beside that of its colour.
override MAPS: bool = true;

const MATERIAL_DOUBLE_SIDED: u32 = 1u;
const MATERIAL_UNLIT: u32 = 2u;
const MATERIAL_ALPHA_TEST: u32 = 4u;
// Surfaces reflect as the metallic-roughness model has it, and not as Phong's.
const MATERIAL_PHYSICAL: u32 = 8u;
// Alpha does not say how much the surface hides.
const MATERIAL_SOLID: u32 = 16u;

const OVERRIDE_BASE_COLOR: u32 = 1u;
const OVERRIDE_SPECULAR: u32 = 2u;
const OVERRIDE_SHININESS: u32 = 4u;
const OVERRIDE_UNLIT: u32 = 8u;
const OVERRIDE_DOUBLE_SIDED: u32 = 16u;
const OVERRIDE_METALLIC: u32 = 32u;
const OVERRIDE_ROUGHNESS: u32 = 64u;
const OVERRIDE_EMISSIVE: u32 = 128u;
const OVERRIDE_TRANSMISSION: u32 = 256u;

fn effective_material(own: Material, over_plus_one: u32) -> Material {
    if over_plus_one == 0u {
        return own;
    }
    let over = materials[over_plus_one - 1u];
    var m = own;
    if (over.overrides & OVERRIDE_BASE_COLOR) != 0u {
        m.base_color = over.base_color;
        m.flags = select(m.flags, m.flags & ~MATERIAL_SOLID, over.base_color.a < 1.0);
    }
    if (over.overrides & OVERRIDE_SPECULAR) != 0u {
        m.specular = over.specular;
    }
    if (over.overrides & OVERRIDE_SHININESS) != 0u {
        m.shininess = over.shininess;
    }
    if (over.overrides & (OVERRIDE_SPECULAR | OVERRIDE_SHININESS)) != 0u {
        m.flags &= ~MATERIAL_PHYSICAL;
        // Phong's model has none.
        m.transmission = 0.0;
    }
    if (over.overrides & (OVERRIDE_METALLIC | OVERRIDE_ROUGHNESS | OVERRIDE_TRANSMISSION)) != 0u {
        m.flags |= MATERIAL_PHYSICAL;
    }
    if (over.overrides & OVERRIDE_METALLIC) != 0u {
        m.metallic = over.metallic;
    }
    if (over.overrides & OVERRIDE_ROUGHNESS) != 0u {
        m.roughness = over.roughness;
    }
    if (over.overrides & OVERRIDE_TRANSMISSION) != 0u {
        m.transmission = over.transmission;
    }
    if (over.overrides & OVERRIDE_EMISSIVE) != 0u {
        m.emissive = over.emissive;
    }
    if (over.overrides & OVERRIDE_UNLIT) != 0u {
        m.flags = (m.flags & ~MATERIAL_UNLIT) | (over.flags & MATERIAL_UNLIT);
    }
    if (over.overrides & OVERRIDE_DOUBLE_SIDED) != 0u {
        m.flags = (m.flags & ~MATERIAL_DOUBLE_SIDED) | (over.flags & MATERIAL_DOUBLE_SIDED);
    }
    return m;
}
