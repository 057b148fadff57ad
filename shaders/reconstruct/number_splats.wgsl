// Gives every sample that may be painted a place in the list: one workgroup adds up how many the threads of count_splats have.
//!include shared/frame
//!include shared/scene
//!include shared/painted
//!include shared/lanes
@group(0) @binding(4) var<storage, read_write> stats: array<Stats>;
@group(0) @binding(5) var<storage, read_write> paint_list: PaintList;
@group(2) @binding(1) var<storage, read> runs: array<Run>;

const THREADS: u32 = 256u;
// Counts that the threads may go through: lavapipe has 65535 rounds for all loops of a thread.
const MOST_COUNTS: u32 = THREADS * 30000u;

var<workgroup> partial: array<u32, 256>;

@compute @workgroup_size(256)
fn number_splats(@builtin(local_invocation_index) lane: u32) {
    begin_view(0u);
    // Segments of samples come first, and their slots lie one behind the other.
    let last = runs[frame.sample_segments - 1u];
    let wanted = (last.first_slot + last.count) * LANES;
    let most = min(MOST_COUNTS, arrayLength(&paint_list.begins));
    let total = min(wanted, most);
    let share = (total + THREADS - 1u) / THREADS;
    let first = min(lane * share, total);
    let end = min(first + share, total);
    var sum = 0u;
    for (var i = first; i < end; i++) {
        sum += paint_list.begins[i];
    }
    partial[lane] = sum;
    workgroupBarrier();
    var running = 0u;
    for (var i = 0u; i < lane; i++) {
        running += partial[i];
    }
    for (var i = first; i < end; i++) {
        let count = paint_list.begins[i];
        paint_list.begins[i] = running;
        running += count;
    }
    if lane == THREADS - 1u {
        let places = select(running, TOO_MANY, wanted > most);
        atomicMax(&stats[0].splats_wanted, places);
        // A frame with more than there is room for is not shown.
        paint_list.places = select(0u, places, places <= frame.paint_capacity);
        paint_list.painted = 0u;
        atomicStore(&paint_list.nearest, 0u);
        atomicStore(&paint_list.farthest, 0u);
    }
}
