// How many keys of each worker's share have each value of the digit.
//!include shared/keys

@compute @workgroup_size(LANES)
fn count_keys(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let worker = group.x * LANES + lane;
    let span = key_span();
    let share = share_of(worker, key_count(paint_list.painted));
    begin_counts(worker);
    for (var i = share.first; i < share.end; i++) {
        let key = sort_from[i].x;
        if key != NO_KEY {
            paint_counts[digit_of(key, span) * WORKERS + worker]++;
        }
    }
}
