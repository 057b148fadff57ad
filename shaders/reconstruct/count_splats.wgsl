// How many samples of each visible slot each thread of list_splats takes.
//!include shared/frame
//!include shared/scene
//!include shared/octahedral
//!include shared/splat
//!include shared/clip_none
//!include shared/sample_splats
//!include shared/painted
//!include shared/gather

const NARROW: bool = false;

@group(0) @binding(4) var<storage, read_write> stats: array<Stats>;
@group(0) @binding(5) var<storage, read_write> paint_list: PaintList;
@group(2) @binding(1) var<storage, read> runs: array<Run>;
@group(2) @binding(2) var<uniform> segment: SegmentUse;

fn begin_slot(slot: SplatSlot) {
}

fn take(slot: SplatSlot, i: u32, tally: ptr<function, Tally>) {
    (*tally).scattered++;
}

@compute @workgroup_size(LANES)
fn count_splats(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    begin_view(group.z);
    let index = group.y * DISPATCH_ROW + group.x;
    let tally = gather(group, lane);
    let run = runs[frame.first_run + segment.index];
    let at = (run.first_slot + index) * LANES + lane;
    if index < run.count && at < arrayLength(&paint_list.begins) {
        paint_list.begins[at] = tally.scattered;
    }
}
