// Attributes of the pixels that show a sample of one page.
//!include shared/frame
//!include shared/scene
//!include shared/octahedral
//!include shared/colour
//!include shared/material
//!include shared/normals
//!include shared/resolve
//!include NODES

@group(0) @binding(1) var<storage, read> visibility: array<vec2<u32>>;
// sRGB8 colour and octahedral normal.
@group(1) @binding(0) var<storage, read> attributes: array<vec2<u32>>;
@group(1) @binding(3) var<storage, read> instances: array<Instance>;
@group(1) @binding(4) var<storage, read> materials: array<Material>;

fn sample_color(own: u32, over_plus_one: u32) -> u32 {
    let plain = own | 0xff000000u;
    if !OVERRIDES || over_plus_one == 0u {
        return plain;
    }
    let over = materials[over_plus_one - 1u];
    if (over.overrides & OVERRIDE_BASE_COLOR) == 0u {
        return plain;
    }
    let c = linear_from_srgb(unpack4x8unorm(own).rgb) * over.base_color.rgb;
    return pack4x8unorm(vec4<f32>(srgb_from_linear(c), 1.0));
}

fn resolve(pixel: u32, at: vec2<u32>, word: vec2<u32>) {
    if OUTPUT == OUTPUT_DEPTH {
        pixels[pixel] = bitcast<u32>(1.0 / bitcast<f32>(word.y));
        return;
    }
    let id = ~word.x;
    let slot = frame.first_slot + (id >> SLOT_SHIFT);
    let instance = slots[slot].instance;
    if OUTPUT == OUTPUT_ID {
        pixels[pixel] = instances[instance].id;
        return;
    }
    let sample = slots[slot].first + (id & SLOT_MASK);
    let packed = attributes[sample];
    if OUTPUT == OUTPUT_NORMAL || SHADED {
        let towards = world_from_camera(ray_through(pixel_centre(at)));
        let n = facing_normal(turned(normal_map(instance), octahedral_decode(packed.y)), towards);
        if OUTPUT == OUTPUT_NORMAL {
            pixels[pixel] = normal_word(n);
            return;
        }
        normals[pixel] = select(octahedral_encode(n), BALL, is_ball(packed));
    }
    pixels[pixel] = sample_color(painted(sample, packed.x), instances[instance].material);
}

@compute @workgroup_size(64)
fn resolve_samples(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    begin_view(group.z);
    let begin = runs[frame.first_run + segment.index].first_slot;
    let count = runs[frame.first_run + segment.index].count;
    var column = column_begin(group, lane);
    var resolved = 0u;
    resolve_load(&column, begin, count);
    // Runs of a chunk are short here: keeping what they have in common costs more than it saves.
    loop {
        resolve_seek(&column, begin, count);
        if column_ends(column) {
            break;
        }
        if column.mine {
            resolve(column.pixel, column.at, column.word);
            resolved++;
        }
        resolve_next(&column, begin, count);
    }
    if resolved != 0u {
        atomicAdd(&stats[frame.view].pixels_of_samples, resolved);
    }
}
