// Writes the attributes of the pixels that show a sample of one page.
//!include shared/frame
//!include shared/scene
//!include shared/normals
//!include shared/resolve
//!include NODES
//!include FIELDS

// sRGB8 colour and octahedral normal.
@group(1) @binding(0) var<storage, read> attributes: array<vec2<u32>>;

fn sample_color(own: u32, over_plus_one: u32) -> u32 {
    let plain = own | 0xff000000u;
    if !OVERRIDES || over_plus_one == 0u {
        return plain;
    }
    let over = materials[over_plus_one - 1u];
    if (over.overrides & OVERRIDE_BASE_COLOR) == 0u {
        return plain;
    }
    return color_word(linear_color(own) * over.base_color.rgb);
}

fn resolve(pixel: u32, at: vec2<u32>, word: vec2<u32>) {
    var surface: Surface;
    surface.inverse_depth = bitcast<f32>(word.y);
    surface.depth_scale = 1.0;
    let id = ~word.x;
    surface.slot = id >> SLOT_SHIFT;
    if OUTPUT == OUTPUT_ID {
        surface.id = instances[slots[frame.first_slot + surface.slot].instance].id;
    }
    if OUTPUT == OUTPUT_COLOR || OUTPUT == OUTPUT_NORMAL {
        let slot = frame.first_slot + surface.slot;
        let instance = slots[slot].instance;
        let sample = slots[slot].first + (id & SLOT_MASK);
        let packed = attributes[sample];
        if needs_normal() {
            let way = world_from_camera(towards(ray_through(pixel_centre(at))));
            surface.normal = facing_normal(turned(normal_map(instance), octahedral_decode(packed.y)), way);
            surface.is_ball = is_ball(packed);
        }
        if SHOWS_FIELD {
            surface.color = field_color(sample, instance);
        } else {
            surface.color = sample_color(painted(sample, packed.x), instances[instance].material);
        }
    }
    finish(pixel, at, surface);
}

@compute @workgroup_size(64)
fn resolve_samples(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    begin_view(group.z);
    let begin = runs[frame.first_run + segment.index].first_slot;
    let count = runs[frame.first_run + segment.index].count;
    var column = column_begin(group, lane);
    var resolved = 0u;
    resolve_load(&column, begin, count);
    // Runs of one chunk are short here: caching their common values costs more than it saves.
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
