// Writes the chunk that each pixel shows and the element's index in that chunk plus one; slot numbers mean nothing after
// the frame. Pixels that show nothing keep zeros.
//!include shared/frame
//!include shared/scene
//!include VOTE
//!include shared/column

@group(0) @binding(1) var<storage, read_write> visibility: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read_write> stats: array<Stats>;
@group(2) @binding(0) var<storage, read> slots: array<Slot>;

@compute @workgroup_size(64)
fn identify(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    begin_view(group.z);
    var column = column_begin(group, lane);
    loop {
        if column_ends(column) {
            break;
        }
        column_load(&column);
        if column.mine {
            let chunk = slots[frame.first_slot + slot_of(column.word)].chunk;
            visibility[column.pixel] = vec2<u32>(chunk, (~column.word.x & SLOT_MASK) + 1u);
        }
        column_step(&column);
    }
}
