// Computes where the chosen chunks of each group of instances begin in the list of entries, segment by segment, and sizes
// the dispatches over that list. One workgroup.
//!include shared/frame
//!include shared/scene
//!include shared/chosen
//!include shared/launch

@group(0) @binding(4) var<storage, read_write> stats: array<Stats>;
@group(2) @binding(0) var<storage, read_write> chosen_first: array<u32>;
@group(2) @binding(1) var<storage, read> listed: array<u32>;
@group(2) @binding(2) var<storage, read_write> segments: array<Segment>;
@group(2) @binding(3) var<storage, read_write> sizes: Sizes;
@group(2) @binding(4) var<storage, read_write> dispatches: array<Dispatch>;

// Largest number of pages that hold a scene's assets.
const MOST_SEGMENTS: u32 = 32u;
const GROUP: u32 = 32u;

var<workgroup> partial: array<u32, 64>;

@compute @workgroup_size(64)
fn list_entries(@builtin(local_invocation_index) lane: u32) {
    begin_view(0u);
    let count = listed[0];
    let share = (count + 63u) / 64u;
    let first = min(lane * share, count);
    let end = min(first + share, count);
    let segment_count = min(frame.segment_count, arrayLength(&segments));
    // The value is uniform over all threads.
    var begin = 0u;
    for (var segment = 0u; segment < MOST_SEGMENTS; segment++) {
        if segment >= segment_count {
            break;
        }
        let row = segment * frame.instance_groups;
        var sum = 0u;
        for (var i = first; i < end; i++) {
            // A sum of this size is too large in any case; the minimum keeps it from wrapping.
            sum = min(sum + min(chosen_first[row + i], 1u << 24u), 1u << 24u);
        }
        partial[lane] = sum;
        workgroupBarrier();
        var running = begin;
        var all = begin;
        for (var i = 0u; i < 64u; i++) {
            running += select(0u, partial[i], i < lane);
            all += partial[i];
        }
        workgroupBarrier();
        for (var i = first; i < end; i++) {
            let own = chosen_first[row + i];
            chosen_first[row + i] = running;
            running += own;
        }
        let padded = (all + GROUP - 1u) / GROUP;
        if lane == 0u {
            segments[segment] = Segment(begin / GROUP, padded);
        }
        // The minimum prevents wrapping here as well: there are up to 32 segments.
        begin = min(padded * GROUP, 1u << 26u);
    }
    if lane == 0u {
        let fits = begin <= frame.entry_capacity;
        atomicStore(&stats[0].entries_wanted, begin);
        sizes.group_count = select(0u, begin / GROUP, fits);
        sizes.segment_count = segment_count;
        for (var segment = 0u; segment < segment_count && !fits; segment++) {
            segments[segment] = Segment(0u, 0u);
        }
        let launches = arrayLength(&dispatches) - LOD_LAUNCHES;
        set_launch(launches + LAUNCH_CULL, (sizes.group_count + 31u) / 32u, 1u);
        set_launch(launches + LAUNCH_COMPACT, (sizes.group_count + 1u) / 2u, 1u);
    }
}
