// Turns the counts of each value of a digit into where the workers' entries begin among those of that value. A workgroup takes a value.
//!include shared/digits

// Threads that share a value.
override SUMMERS: u32 = 64u;
var<workgroup> partial: array<u32, 256>;

@compute @workgroup_size(SUMMERS)
fn sum_counts(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let row = group.x * WORKERS;
    let share = (WORKERS + SUMMERS - 1u) / SUMMERS;
    let first = min(lane * share, WORKERS);
    let end = min(first + share, WORKERS);
    var sum = 0u;
    for (var i = first; i < end; i++) {
        sum += paint_counts[row + i];
    }
    partial[lane] = sum;
    workgroupBarrier();
    var running = 0u;
    for (var i = 0u; i < lane; i++) {
        running += partial[i];
    }
    for (var i = first; i < end; i++) {
        let count = paint_counts[row + i];
        paint_counts[row + i] = running;
        running += count;
    }
    if lane == SUMMERS - 1u {
        paint_counts[VALUES * WORKERS + group.x] = running;
    }
}
