// Moves each key to where its digit puts it.
//!include shared/keys
@group(0) @binding(8) var<storage, read_write> sort_to: array<vec2<u32>>;

@compute @workgroup_size(LANES)
fn move_keys(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let worker = group.x * LANES + lane;
    add_up_values(lane);
    if worker == 0u {
        paint_list.painted = begins[VALUES];
    }
    let span = key_span();
    let share = share_of(worker, key_count(begins[VALUES]));
    for (var i = share.first; i < share.end; i++) {
        let entry = sort_from[i];
        if entry.x != NO_KEY {
            let value = digit_of(entry.x, span);
            let at = paint_counts[value * WORKERS + worker];
            paint_counts[value * WORKERS + worker] = at + 1u;
            sort_to[begins[value] + at] = entry;
        }
    }
}
