// Exclusive prefix sum of the groups' counts, in one workgroup, and the indirect dispatch of every segment.
//!include shared/frame
//!include shared/scene

struct Sizes {
    group_count: u32,
    segment_count: u32,
}

@group(1) @binding(0) var<storage, read> segments: array<Segment>;
@group(1) @binding(1) var<uniform> sizes: Sizes;
@group(2) @binding(0) var<storage, read_write> group_counts: array<u32>;
@group(2) @binding(1) var<storage, read_write> dispatches: array<Dispatch>;

var<workgroup> partial: array<u32, 64>;

@compute @workgroup_size(64)
fn scan(@builtin(local_invocation_index) lane: u32) {
    let share = (sizes.group_count + 63u) / 64u;
    let first = min(lane * share, sizes.group_count);
    let end = min(first + share, sizes.group_count);
    var sum = 0u;
    for (var i = first; i < end; i++) {
        sum += group_counts[i];
    }
    partial[lane] = sum;
    workgroupBarrier();
    var running = 0u;
    for (var i = 0u; i < lane; i++) {
        running += partial[i];
    }
    for (var i = first; i < end; i++) {
        let count = group_counts[i];
        group_counts[i] = running;
        running += count;
    }
    // The last workgroup's end is the total; the array has one element more than there are groups.
    if lane == 63u {
        group_counts[sizes.group_count] = running;
    }
    storageBarrier();
    workgroupBarrier();
    // See shade for why the bound is no uniform alone.
    let segment_count = min(sizes.segment_count, arrayLength(&segments));
    for (var s = lane; s < segment_count; s += 64u) {
        let segment = segments[s];
        let begin = group_counts[segment.first_group];
        let count = group_counts[segment.end_group] - begin;
        var out: Dispatch;
        out.groups_x = min(count, DISPATCH_ROW);
        out.groups_y = (count + DISPATCH_ROW - 1u) / DISPATCH_ROW;
        out.groups_z = 1u;
        out.first_slot = begin;
        out.count = count;
        dispatches[s] = out;
    }
}
