// Phong lighting of every covered pixel, once, from the resolved colour and normal.
//!include shared/frame
//!include shared/scene
//!include shared/octahedral
//!include shared/colour
//!include shared/material
//!include shared/phong
//!include VOTE
//!include shared/column

@group(0) @binding(1) var<storage, read> visibility: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read_write> pixels: array<u32>;
@group(0) @binding(3) var<storage, read> normals: array<u32>;
@group(1) @binding(2) var<storage, read> chunks: array<Chunk>;
@group(1) @binding(3) var<storage, read> instances: array<Instance>;
@group(1) @binding(4) var<storage, read> materials: array<Material>;
@group(2) @binding(0) var<storage, read> slots: array<Slot>;

// Some instance overrides its asset's materials.
override OVERRIDES: bool = true;
// Some material is unlit, shines or is overridden: pixels have to ask theirs.
override MATERIALS: bool = true;

fn light_up(pixel: u32, at: vec2<u32>, word: vec2<u32>) {
    let slot = frame.first_slot + slot_of(word);
    var material: Material;
    if MATERIALS {
        material = materials[chunks[slots[slot].chunk].material];
    }
    if OVERRIDES {
        material = effective_material(material, instances[slots[slot].instance].material);
    }
    let packed = normals[pixel];
    if (material.flags & MATERIAL_UNLIT) != 0u || packed == NO_NORMAL {
        return;
    }
    let albedo = linear_from_srgb(unpack4x8unorm(pixels[pixel]).rgb);
    let ray = world_from_camera(ray_through(vec2<f32>(at) + vec2<f32>(0.5)));
    let from_eye = ray / bitcast<f32>(word.y);
    var color: vec3<f32>;
    if packed == BALL {
        color = ball_lights(albedo, material, from_eye);
    } else {
        color = all_lights(albedo, material, octahedral_decode(packed), from_eye);
    }
    pixels[pixel] = pack4x8unorm(vec4<f32>(srgb_from_linear(color), 1.0));
}

@compute @workgroup_size(64)
fn shade(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    begin_view(group.z);
    var column = column_begin(group, lane);
    column_load(&column);
    loop {
        loop {
            if column_ends(column) || any_lane(column.mine) {
                break;
            }
            column_step(&column);
            column_load(&column);
        }
        if column_ends(column) {
            break;
        }
        if column.mine {
            light_up(column.pixel, column.at, column.word);
        }
        column_step(&column);
        column_load(&column);
    }
}
