// Phong lighting of every covered pixel, once, from the resolved colour and normal.
//!include shared/frame
//!include shared/scene
//!include shared/octahedral
//!include shared/colour
//!include shared/material

struct Light {
    // 0 ambient, 1 headlight, 2 sun, 3 point.
    kind: u32,
    // Distance at which a point light has lost half.
    range: f32,
    unused_0: u32,
    unused_1: u32,
    // Linear, intensity included.
    color: vec4<f32>,
    // Direction of travel, or the position as the sum of two floats an axis.
    place_hi: vec4<f32>,
    place_lo: vec4<f32>,
}

@group(0) @binding(1) var<storage, read> visibility: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read_write> pixels: array<u32>;
@group(0) @binding(3) var<storage, read> normals: array<u32>;
@group(1) @binding(0) var<storage, read> lights: array<Light>;
@group(1) @binding(2) var<storage, read> chunks: array<Chunk>;
@group(1) @binding(3) var<storage, read> instances: array<Instance>;
@group(1) @binding(4) var<storage, read> materials: array<Material>;
@group(2) @binding(0) var<storage, read> slots: array<Slot>;

const PIXELS_EACH: u32 = 8u;

fn phong(light: Light, albedo: vec3<f32>, material: Material, n: vec3<f32>, from_eye: vec3<f32>, to_eye: vec3<f32>) -> vec3<f32> {
    if light.kind == 0u {
        return albedo * light.color.rgb;
    }
    var l = to_eye;
    var strength = 1.0;
    if light.kind == 2u {
        l = -light.place_hi.xyz;
    }
    if light.kind == 3u {
        let d = (light.place_hi.xyz - frame.eye_hi.xyz) + (light.place_lo.xyz - frame.eye_lo.xyz) - from_eye;
        let distance = length(d);
        l = d / max(distance, 1e-30);
        let ratio = distance / light.range;
        strength = 1.0 / (1.0 + ratio * ratio);
    }
    let cosine = dot(n, l);
    if cosine <= 0.0 {
        return vec3<f32>(0.0);
    }
    var reflected = albedo * cosine;
    if any(material.specular > vec3<f32>(0.0)) {
        let r = 2.0 * cosine * n - l;
        reflected += material.specular * pow(max(dot(r, to_eye), 0.0), material.shininess);
    }
    return reflected * light.color.rgb * strength;
}

@compute @workgroup_size(64)
fn shade(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let pixel_count = frame.size_px.x * frame.size_px.y;
    for (var k = 0u; k < PIXELS_EACH; k++) {
        let pixel = (group.x * PIXELS_EACH + k) * 64u + lane;
        if pixel >= pixel_count {
            break;
        }
        let word = visibility[pixel];
        if word.y == 0u || normals[pixel] == NO_NORMAL {
            continue;
        }
        let slot = (~word.x) >> SLOT_SHIFT;
        let own = materials[chunks[slots[slot].chunk].material];
        let material = effective_material(own, instances[slots[slot].instance].material);
        if (material.flags & MATERIAL_UNLIT) != 0u {
            continue;
        }
        let albedo = linear_from_srgb(unpack4x8unorm(pixels[pixel]).rgb);
        let at = vec2<f32>(f32(pixel % frame.size_px.x), f32(pixel / frame.size_px.x)) + vec2<f32>(0.5);
        let ray = world_from_camera(ray_through(at));
        let from_eye = ray / bitcast<f32>(word.y);
        let to_eye = -ray / length(ray);
        let n = octahedral_decode(normals[pixel]);
        var color = vec3<f32>(0.0);
        for (var i = 0u; i < frame.light_count; i++) {
            color += phong(lights[i], albedo, material, n, from_eye, to_eye);
        }
        pixels[pixel] = pack4x8unorm(vec4<f32>(srgb_from_linear(color), 1.0));
    }
}
