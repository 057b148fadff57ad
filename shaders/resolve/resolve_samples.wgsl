// Writes the attributes of the pixels that show a sample of one page, or the layers of translucent samples before them.
//!include shared/frame
//!include shared/scene
//!include shared/normals
//!include shared/resolve_each
//!include shared/albedo
//!include NODES
//!include FIELDS

// sRGB8 colour and octahedral normal.
@group(1) @binding(0) var<storage, read> attributes: array<vec2<u32>>;

fn resolve(column: Column) {
    var surface: Surface;
    surface.inverse_depth = bitcast<f32>(column.word.y);
    surface.depth_scale = 1.0;
    let id = ~column.word.x;
    surface.slot = id >> SLOT_SHIFT;
    if needs_id() {
        surface.id = instances[slots[frame.first_slot + surface.slot].instance].id;
    }
    if needs_color() || needs_normal() {
        let slot = frame.first_slot + surface.slot;
        let instance = slots[slot].instance;
        let sample = slots[slot].first + (id & SLOT_MASK);
        let packed = attributes[sample];
        if needs_normal() {
            let way = world_from_camera(towards(ray_through(pixel_centre(column.at))));
            surface.normal = facing_normal(turned(normal_map(instance), octahedral_decode(packed.y)), way);
            surface.is_ball = is_ball(packed);
        }
        surface.alpha = sample_alpha(packed.x, instances[instance].material);
        if SHOWS_FIELD {
            surface.color = linear_color(field_color(sample, instance));
        } else {
            surface.color = albedo(painted(sample, packed.x), instances[instance].material);
        }
    }
    finish(column.pixel, column.at, surface);
}

@compute @workgroup_size(64)
fn resolve_samples(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    begin_view(group.z);
    // Runs of one chunk are short here: caching their common values costs more than it saves.
    let resolved = resolve_each(group, lane, runs[frame.first_run + segment.index]);
    if resolved != 0u {
        note_samples(resolved);
    }
}
