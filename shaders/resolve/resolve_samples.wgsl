// Attributes of the pixels that show a sample of one page.
//!include shared/frame
//!include shared/scene
//!include shared/octahedral
//!include shared/colour
//!include shared/material
//!include shared/resolve

// sRGB8 colour and octahedral normal.
@group(1) @binding(0) var<storage, read> attributes: array<vec2<u32>>;
@group(1) @binding(3) var<storage, read> instances: array<Instance>;
@group(1) @binding(4) var<storage, read> materials: array<Material>;

fn sample_color(own: u32, over_plus_one: u32) -> u32 {
    if over_plus_one == 0u {
        return own | 0xff000000u;
    }
    let over = materials[over_plus_one - 1u];
    if (over.overrides & OVERRIDE_BASE_COLOR) == 0u {
        return own | 0xff000000u;
    }
    let c = linear_from_srgb(unpack4x8unorm(own).rgb) * over.base_color.rgb;
    return pack4x8unorm(vec4<f32>(srgb_from_linear(c), 1.0));
}

@compute @workgroup_size(64)
fn resolve_samples(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let pixel_count = frame.size_px.x * frame.size_px.y;
    let begin = dispatches[segment.index].first_slot;
    let count = dispatches[segment.index].count;
    var shown = 0u;
    for (var k = 0u; k < PIXELS_EACH; k++) {
        let pixel = (group.x * PIXELS_EACH + k) * 64u + lane;
        if pixel >= pixel_count {
            break;
        }
        let word = visibility[pixel];
        if word.y == 0u {
            if segment.first != 0u {
                pixels[pixel] = background_word();
            }
            continue;
        }
        let id = ~word.x;
        let slot = id >> SLOT_SHIFT;
        if slot - begin >= count {
            continue;
        }
        shown++;
        if frame.output == OUTPUT_DEPTH {
            pixels[pixel] = bitcast<u32>(1.0 / bitcast<f32>(word.y));
            continue;
        }
        let instance = slots[slot].instance;
        if frame.output == OUTPUT_ID {
            pixels[pixel] = instances[instance].id;
            continue;
        }
        let packed = attributes[slots[slot].first + (id & SLOT_MASK)];
        if frame.output == OUTPUT_NORMAL || segment.shaded != 0u {
            let at = vec2<f32>(f32(pixel % frame.size_px.x), f32(pixel / frame.size_px.x)) + vec2<f32>(0.5);
            let n = world_normal(instance, octahedral_decode(packed.y), world_from_camera(ray_through(at)));
            if frame.output == OUTPUT_NORMAL {
                pixels[pixel] = normal_word(n);
                continue;
            }
            normals[pixel] = octahedral_encode(n);
        }
        pixels[pixel] = sample_color(packed.x, instances[instance].material);
    }
    if shown != 0u {
        atomicAdd(&stats.pixels_of_samples, shown);
    }
}
