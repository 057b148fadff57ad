// Shared by passes that go through a segment and list whatever is too large for one thread. The file that includes this says whether
// they count it: `COUNTS`.
//!include shared/large
struct LargeList {
    // As an indirect draw's arguments: three to an entry.
    vertex_count: atomic<u32>,
    instance_count: u32,
    first_vertex: u32,
    first_instance: u32,
    // See LIST_ENTRY.
    entries: array<vec2<u32>>,
}

@group(0) @binding(4) var<storage, read_write> stats: array<Stats>;
@group(2) @binding(1) var<storage, read> runs: array<Run>;
@group(2) @binding(2) var<uniform> segment: SegmentUse;
@group(2) @binding(4) var<storage, read_write> large: LargeList;

// Lists what lies in a box of pixels, `high` included.
fn list_entry(id: u32, low: vec2<u32>, high: vec2<u32>) {
    let at = atomicAdd(&large.vertex_count, 3u) / 3u;
    atomicMax(&stats[0].large_longest, at + 1u);
    if at < frame.large_capacity {
        large.entries[at] = vec2<u32>(id, list_word(low.y, high.y, frame.view));
    }
}

// Lists what is large, of which a frame may have a limited amount.
fn list_large(id: u32, low: vec2<u32>, high: vec2<u32>) {
    list_entry(id, low, high);
    let box = high - low + vec2<u32>(1u);
    list_units((box.x * box.y + 4095u) / 4096u);
}

// Adds to the amount, in units of 4096 pixels.
fn list_units(units: u32) {
    if COUNTS {
        let old = atomicAdd(&stats[frame.view].large_units, units);
        if old + units < old {
            atomicMax(&stats[frame.view].large_wrapped, 1u);
        }
    }
}
