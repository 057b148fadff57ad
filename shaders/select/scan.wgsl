// Computes the exclusive prefix sum of the groups' counts, in one workgroup a view, then each segment's run of visible slots
// and an indirect dispatch large enough for the longest run among the views. With occlusion culling, decides which slots are drawn first, and in
// how many turns the others are asked whether they are hidden.
//!include shared/frame
//!include shared/scene

//!include shared/chosen
//!include shared/portions

@group(2) @binding(3) var<storage, read> segments: array<Segment>;
@group(2) @binding(4) var<storage, read> sizes: Sizes;
@group(2) @binding(0) var<storage, read_write> group_counts: array<u32>;
@group(2) @binding(1) var<storage, read_write> dispatches: array<Dispatch>;
@group(2) @binding(2) var<storage, read_write> runs: array<Run>;
@group(2) @binding(5) var<storage, read_write> depths: array<u32>;

// Occlusion culling is on.
override HIDES: bool = false;
// Slots are near until they cover the rows that they occupy this many times.
const NEAR_LAYERS: f32 = 2.0;

// Time of drawing an element of a slot, in units of what a turn takes for each pixel of the image.
override ELEMENT_COST: u32 = 40u;
// Only samples are drawn, each a pixel: they hide nothing where they leave gaps.
override POINTS: bool = false;
// Most elements of a slot.
override ELEMENTS_EACH: u32 = 1024u;
// Pixels of the image that have to be covered for a box to be hidden.
const TESTED_PX: f32 = 64.0;

// What `layers_of` tells of each depth bin, and how much of the image its slots cover.
var<workgroup> bin_layers: array<f32, DEPTH_BINS>;
var<workgroup> bin_covers: array<f32, DEPTH_BINS>;

// How many times the slots of one depth bin cover the rows that they occupy.
fn layers_of(at: u32) -> f32 {
    let rows = max(depths[at + DEPTH_TOPS] + depths[at + DEPTH_BOTTOMS], frame.size_px.y + 1u) - frame.size_px.y;
    return f32(depths[at]) / f32(COVER_ONE) * f32(frame.size_px.y) / f32(rows);
}

// The number of turns in which to ask what is hidden; none where asking takes longer than drawing what could be hidden. `covered_px`: sum of the areas
// of all slots' boxes; `behind`: layers that are not near.
fn worthwhile_turns(slots: f32, covered_px: f32, layers: f32, behind: f32) -> u32 {
    let elements = slots * f32(ELEMENTS_EACH);
    var closed = 1.0;
    if POINTS {
        let each_px = NEAR_LAYERS * elements / max(covered_px, 1.0);
        closed = pow(1.0 - exp(-each_px), TESTED_PX);
    }
    let turns = clamp(ceil(2.0 * behind), 1.0, f32(TURNS));
    let most_saved = closed * elements * behind / max(layers, 1.0) * f32(ELEMENT_COST);
    return select(u32(turns), 0u, most_saved < turns * f32(frame.size_px.x) * f32(frame.size_px.y));
}

// Finds where near ends among the depth bins, and each of the turns that ask what is hidden.
fn find_turns(slots: u32) {
    let first = frame.view * DEPTHS_WORDS;
    var layers = 0.0;
    var covered = 0.0;
    for (var bin = 0u; bin < DEPTH_BINS; bin++) {
        layers += bin_layers[bin];
        covered += bin_covers[bin];
    }
    let behind = max(layers - NEAR_LAYERS, 0.0);
    let turns = worthwhile_turns(f32(slots), covered * f32(frame.size_px.x) * f32(frame.size_px.y), layers, behind);
    var bin = 0u;
    layers = 0.0;
    for (var turn = 0u; turn <= TURNS; turn++) {
        // Later turns hold more slots, because much of the far scene is hidden.
        let share = f32(turn) / f32(max(turns, 1u));
        let end = NEAR_LAYERS + behind * share * share;
        while bin < DEPTH_BINS && (layers < end || turn >= turns) {
            layers += bin_layers[bin];
            bin++;
        }
        depths[first + DEPTH_ENDS + turn] = bin;
    }
}

var<workgroup> partial: array<u32, 64>;

@compute @workgroup_size(64)
fn scan(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    begin_view(group.z);
    let base = frame.first_group;
    let share = (sizes.group_count + 63u) / 64u;
    let first = min(lane * share, sizes.group_count);
    let end = min(first + share, sizes.group_count);
    var sum = 0u;
    for (var i = first; i < end; i++) {
        sum += group_counts[base + i];
    }
    partial[lane] = sum;
    if HIDES {
        let record = frame.view * DEPTHS_WORDS;
        for (var bin = lane; bin < DEPTH_BINS; bin += 64u) {
            bin_layers[bin] = layers_of(record + bin);
            bin_covers[bin] = f32(depths[record + bin]) / f32(COVER_ONE);
        }
    }
    workgroupBarrier();
    var running = 0u;
    for (var i = 0u; i < lane; i++) {
        running += partial[i];
    }
    for (var i = first; i < end; i++) {
        let count = group_counts[base + i];
        group_counts[base + i] = running;
        running += count;
    }
    // The last workgroup's end is the total; the array has one element more than there are groups.
    if lane == 63u {
        group_counts[base + sizes.group_count] = running;
        if HIDES {
            find_turns(running);
        }
    }
    storageBarrier();
    workgroupBarrier();
    // See all_lights in shared/phong for why the bound is no uniform alone.
    let segment_count = min(sizes.segment_count, arrayLength(&segments));
    for (var s = lane; s < segment_count; s += 64u) {
        let segment = segments[s];
        let begin = group_counts[base + segment.first_group];
        let count = group_counts[base + segment.end_group] - begin;
        runs[frame.first_run + s] = Run(begin, count);
        atomicMax(&dispatches[s].groups_x, min(count, DISPATCH_ROW));
        atomicMax(&dispatches[s].groups_y, (count + DISPATCH_ROW - 1u) / DISPATCH_ROW);
        atomicMax(&dispatches[s].groups_z, frame.views);
    }
}
