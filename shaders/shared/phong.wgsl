// Reflection over all lights of a scene: Phong's model, or that of a physical material.
//!include SHADOWS
//!include ENVIRONMENT
//!include shared/physical
//!include shared/tone
// Kinds of lights, see `Light` in src/scene/mod.rs.
const LIGHT_AMBIENT: u32 = 0u;
const LIGHT_HEAD: u32 = 1u;
const LIGHT_SUN: u32 = 2u;
const LIGHT_POINT: u32 = 3u;
const LIGHT_SURROUNDINGS: u32 = 4u;

struct Light {
    kind: u32,
    // Distance at which a point light has lost half.
    range: f32,
    // Its number among the suns, or the point lights, that cast shadows, counted from 1; 0 for lights that cast none.
    map: u32,
    unused: u32,
    // Linear, intensity included.
    color: vec4<f32>,
    // Direction of travel, or the position as the sum of two floats an axis.
    place_hi: vec4<f32>,
    place_lo: vec4<f32>,
}

@group(1) @binding(9) var<storage, read> lights: array<Light>;
// The first lights once more: uniforms at fixed places are read once for a whole vector of threads.
@group(1) @binding(10) var<uniform> few_lights: array<Light, 4>;

// Some material is unlit, shines or is overridden, so that pixels and splats look up theirs.
override MATERIALS: bool = true;
// Some material reflects specularly.
override SPECULAR: bool = true;
// Some light stands at a point.
override POINT_LIGHTS: bool = true;
// How many lights there are, if `few_lights` has them all, or 0.
override FEW_LIGHTS: u32 = 0u;

// Surfaces hide ambient light from each other.
override OCCLUSION: bool = false;

// The share of ambient light that reaches the surface that is being lit: what surfaces around it leave, and what its own map says.
var<private> ambient_share: f32 = 1.0;
var<private> mapped_share: f32 = 1.0;

// Some material reflects as the metallic-roughness model has it.
override PHYSICAL: bool = true;
// Some material gives off light.
override EMISSIVE: bool = true;

fn light_count() -> u32 {
    if FEW_LIGHTS != 0u {
        return FEW_LIGHTS;
    }
    // A bound that is a uniform alone makes lavapipe build the shader anew for every frame, with the value inlined.
    return min(frame.light_count, arrayLength(&lights));
}

fn light_at(i: u32) -> Light {
    if FEW_LIGHTS != 0u {
        return few_lights[i];
    }
    return lights[i];
}

// Returns the light's direction from the surface, and the fraction of the light that arrives; `place`: where the surface is, relative
// to the frame's origin, in world axes.
fn arriving(light: Light, place: vec3<f32>, to_eye: vec3<f32>) -> vec4<f32> {
    let sun = vec4<f32>(-light.place_hi.xyz, 1.0);
    let head = vec4<f32>(to_eye, 1.0);
    if !POINT_LIGHTS || light.kind != LIGHT_POINT {
        return select(head, sun, light.kind == LIGHT_SUN);
    }
    let d = (light.place_hi.xyz - frame.eye_hi.xyz) + (light.place_lo.xyz - frame.eye_lo.xyz) - place;
    let distance = length(d);
    let ratio = distance / light.range;
    return vec4<f32>(d / max(distance, 1e-30), 1.0 / (1.0 + ratio * ratio));
}

// Whether light comes from all directions alike. That of surroundings does where their image is left out.
fn is_ambient(light: Light) -> bool {
    return light.kind == LIGHT_AMBIENT || light.kind == LIGHT_SURROUNDINGS;
}

// The share of a light that is not kept away as ambient light.
fn arriving_ambient(light: Light) -> f32 {
    var share = 1.0;
    if OCCLUSION {
        share = ambient_share;
    }
    if MAPS {
        share *= mapped_share;
    }
    return select(1.0, share, is_ambient(light));
}

// Light that a surface gives off.
fn emitted(material: Material) -> vec3<f32> {
    if EMISSIVE {
        return material.emissive;
    }
    return vec3<f32>(0.0);
}

// Light of the surroundings that a surface reflects.
fn reflected_environment(albedo: vec3<f32>, material: Material, n: vec3<f32>, to_eye: vec3<f32>) -> vec3<f32> {
    let falling = environment_at(n, SCATTERED);
    if !PHYSICAL || (material.flags & MATERIAL_PHYSICAL) == 0u {
        return albedo * falling;
    }
    let shares = ambient_shares(albedo, material, n, to_eye);
    let roughness = clamp(material.roughness, 0.0, 1.0);
    let seen = mirrored_environment(mirrored_direction(n, to_eye, roughness), roughness);
    return shares.mirrored * seen + shares.scattered * falling;
}

fn phong(light: Light, albedo: vec3<f32>, material: Material, n: vec3<f32>, place: vec3<f32>, to_eye: vec3<f32>) -> vec3<f32> {
    if ENVIRONMENT && light.kind == LIGHT_SURROUNDINGS {
        return reflected_environment(albedo, material, n, to_eye) * arriving_ambient(light);
    }
    let l = arriving(light, place, to_eye);
    let cosine = select(max(dot(n, l.xyz), 0.0), 1.0, is_ambient(light));
    var reflected = albedo * cosine;
    if PHYSICAL && (material.flags & MATERIAL_PHYSICAL) != 0u {
        if is_ambient(light) {
            let shares = ambient_shares(albedo, material, n, to_eye);
            reflected = shares.mirrored + shares.scattered;
        } else {
            reflected = reflected_light(albedo, material, n, l.xyz, to_eye);
        }
    } else if SPECULAR && !is_ambient(light) && cosine > 0.0 {
        let r = 2.0 * cosine * n - l.xyz;
        reflected += material.specular * pow(max(dot(r, to_eye), 0.0), material.shininess);
    }
    return reflected * light.color.rgb * (l.w * reaching(light, cosine, place, n) * arriving_ambient(light));
}

// The unit direction towards the eye.
fn eye_from(place: vec3<f32>) -> vec3<f32> {
    if ORTHOGRAPHIC {
        return -frame.forward.xyz;
    }
    return -place / max(length(place), 1e-30);
}

// Light that a surface reflects at a place, from all lights.
fn all_lights(albedo: vec3<f32>, material: Material, n: vec3<f32>, place: vec3<f32>) -> vec3<f32> {
    let to_eye = eye_from(place);
    let count = light_count();
    var color = vec3<f32>(0.0);
    for (var i = 0u; i < count; i++) {
        color += phong(light_at(i), albedo, material, n, place, to_eye);
    }
    return color;
}

// Light from a surface that looks everywhere, as the mean over the visible half of a ball: the phase function of a Lambertian sphere
// (Schönberg 1929) over π. A ball reflects highlights alike in all directions.
fn phong_ball(light: Light, albedo: vec3<f32>, material: Material, place: vec3<f32>, to_eye: vec3<f32>) -> vec3<f32> {
    if ENVIRONMENT && light.kind == LIGHT_SURROUNDINGS {
        let is_physical = PHYSICAL && (material.flags & MATERIAL_PHYSICAL) != 0u;
        let own = select(albedo, reflected_by_ball(albedo, material), is_physical);
        return own * environment_at(to_eye, BALL_SEEN) * arriving_ambient(light);
    }
    let l = arriving(light, place, to_eye);
    let c = clamp(dot(l.xyz, to_eye), -1.0, 1.0);
    let mean = 0.21220659 * (sqrt(1.0 - c * c) + (3.1415927 - acos(c)) * c);
    var reflected = albedo * select(mean, 1.0, is_ambient(light));
    if PHYSICAL && (material.flags & MATERIAL_PHYSICAL) != 0u {
        reflected = reflected_by_ball(albedo, material) * select(mean, 1.0, is_ambient(light));
    } else if SPECULAR && !is_ambient(light) {
        reflected += material.specular * (0.5 / (material.shininess + 1.0));
    }
    return reflected * light.color.rgb * (l.w * reaching(light, mean, place, l.xyz) * arriving_ambient(light));
}

fn ball_lights(albedo: vec3<f32>, material: Material, place: vec3<f32>) -> vec3<f32> {
    let to_eye = eye_from(place);
    let count = light_count();
    var color = vec3<f32>(0.0);
    for (var i = 0u; i < count; i++) {
        color += phong_ball(light_at(i), albedo, material, place, to_eye);
    }
    return color;
}
