// Draws the segments of lines that project_lines has listed. Eight threads, one CPU vector, take a segment in a band of the image and go
// through the columns of its box there.
//!include shared/frame
//!include shared/scene
//!include VISIBILITY
//!include shared/line_walk
//!include shared/large
//!include shared/walk

@group(1) @binding(2) var<storage, read> chunks: array<Chunk>;
@group(2) @binding(0) var<storage, read> slots: array<Slot>;
@group(2) @binding(3) var<storage, read> placed: array<Placed>;

fn walk_one(id: u32, band: vec2<i32>, lane: u32) -> u32 {
    let slot = frame.first_slot + (id >> SLOT_SHIFT);
    let chunk = chunks[slots[slot].chunk];
    let at = placed[frame.first_instance + slots[slot].instance];
    let seen = seen_line(line_of(at, radius_scale(at), chunk.vertex_first, chunk.first + (id & SLOT_MASK)));
    let bounds = line_bounds(seen);
    for (var x = bounds.low.x + i32(lane); x <= bounds.high.x; x += LANES) {
        let rows = line_rows(bounds, seen.strip, x);
        let last = min(rows.y, band.y);
        for (var y = max(rows.x, band.x); y <= last; y++) {
            write_line(seen, vec2<i32>(x, y), id);
        }
    }
    return walk_rounds(bounds.high.x - bounds.low.x, min(i32(most_rows(bounds)), band.y - band.x));
}

@compute @workgroup_size(8)
fn walk_lines(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    walk_list(group, groups.x, lane);
}
