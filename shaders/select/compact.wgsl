// Turns visible entries into slots, each with the affine map from its samples to the image.
//!include shared/frame
//!include shared/scene
//!include shared/frustum
//!include shared/portions
//!include shared/turns
//!include shared/tested
//!include LIST

@group(1) @binding(1) var<storage, read> chunks: array<Chunk>;
@group(2) @binding(0) var<storage, read> placed: array<Placed>;
@group(2) @binding(1) var<storage, read> ranks: array<u32>;
@group(2) @binding(2) var<storage, read> group_counts: array<u32>;
@group(2) @binding(3) var<storage, read_write> slots: array<Slot>;
@group(2) @binding(4) var<storage, read_write> seen: array<atomic<u32>>;
@group(0) @binding(4) var<storage, read_write> stats: array<Stats>;
@group(2) @binding(7) var<storage, read_write> depths: array<atomic<u32>>;
@group(2) @binding(8) var<storage, read> segments: array<Segment>;
@group(2) @binding(9) var<storage, read> runs: array<Run>;
@group(2) @binding(10) var<storage, read_write> portions: array<Portion>;
@group(2) @binding(11) var<storage, read_write> turns: array<u32>;
@group(2) @binding(12) var<storage, read_write> turn_slots: array<vec2<u32>>;

// Occlusion culling is on.
override HIDES: bool = false;
// Samples are drawn wherever they are.
override UNASKED: bool = false;

const NOT_VISIBLE: u32 = 0xffffffffu;
const GROUP: u32 = 32u;

fn sample_slot(index: u32, chunk: Chunk, at: Placed, box: Box) -> Slot {
    let corner = grid_to_camera(at, chunk.origin);
    let scale = f32(1u << chunk.shift);
    let x = vec3<f32>(at.axis_x.x, at.axis_y.x, at.axis_z.x) * scale;
    let y = vec3<f32>(at.axis_x.y, at.axis_y.y, at.axis_z.y) * scale;
    let z = vec3<f32>(at.axis_x.z, at.axis_y.z, at.axis_z.z) * scale;
    let f = frame.focal_px;
    let c = frame.principal_px;
    let z_part = select(z, vec3<f32>(0.0), ORTHOGRAPHIC);
    let corner_part = divisor(corner.z);
    var slot: Slot;
    slot.row_x = vec4<f32>(f.x * x + c.x * z_part, f.x * corner.x + c.x * corner_part);
    slot.row_y = vec4<f32>(f.y * y + c.y * z_part, f.y * corner.y + c.y * corner_part);
    slot.row_z = vec4<f32>(z, corner.z);
    slot.unit = chunk.node_base * stretch(at);
    let one_sided = CLIP_BOXES == 0u && (chunk.flags & CHUNK_CLOSED) != 0u && at.position.w == 1.0;
    slot.flags = select(0u, SLOT_ONE_SIDED, one_sided)
        | select(0u, SLOT_SORTED, LISTS_SORTED && (chunk.flags & CHUNK_SORTED) != 0u);
    slot.limits = code_limits(chunk, at, box, slot.unit);
    slot.parts = wanted_parts(index, chunk, at, box, slot.unit, one_sided);
    return slot;
}

// Lists a slot for the first draw, or for a later turn of the occlusion test.
fn list_turn(group: u32, slot: u32, bin: u32, is_near: bool) {
    // Finds the segment of the group.
    var low = 0u;
    var high = frame.segment_count;
    while low + 1u < high {
        let middle = (low + high) / 2u;
        if segments[middle].first_group <= group {
            low = middle;
        } else {
            high = middle;
        }
    }
    let run = runs[frame.first_run + low];
    let first = frame.first_slot + run.first_slot;
    if is_near {
        turn_slots[first + atomicAdd(&portions[frame.first_run + low].listed, 1u)] = vec2<u32>(slot, ALL_PARTS);
    } else {
        turns[first + atomicAdd(&portions[frame.first_run + low].far, 1u)] = slot | (bin << TURN_SHIFT);
        let record = frame.view * DEPTHS_WORDS;
        var turn = 1u;
        while turn < TURNS && bin >= atomicLoad(&depths[record + DEPTH_ENDS + turn]) {
            turn++;
        }
        atomicAdd(&depths[record + DEPTH_ASKED + turn], 1u);
    }
}

@compute @workgroup_size(64)
fn compact(@builtin(global_invocation_id) invocation: vec3<u32>) {
    begin_view(invocation.z);
    let index = invocation.x + invocation.y * DISPATCH_ROW * 64u;
    if index >= entry_count() {
        return;
    }
    let rank = ranks[frame.first_entry + index];
    if rank == NOT_VISIBLE {
        return;
    }
    let entry = entries[index];
    let chunk = chunks[entry.chunk];
    let at = placed[frame.first_instance + entry.instance];
    let box = grid_box(at, chunk.origin, chunk.extent);
    let own = group_counts[frame.first_group + index / GROUP] + rank;
    // The pass that tests a slot for occlusion counts its samples.
    var counted = chunk.count;
    if HIDES {
        let bin = depth_bin(box_bounds(box).near);
        let is_near = bin < atomicLoad(&depths[frame.view * DEPTHS_WORDS + DEPTH_ENDS]);
        list_turn(index / GROUP, own, bin, is_near);
        counted = select(0u, chunk.count, is_near || (UNASKED && chunk.kind == SAMPLES));
    }
    var slot: Slot;
    if chunk.kind == TRIANGLES {
        count_triangles(counted);
        slot.parts = ALL_PARTS;
    } else if chunk.kind == SEGMENTS {
        count_segments(counted);
        slot.parts = ALL_PARTS;
    } else {
        slot = sample_slot(entry.chunk, chunk, at, box);
        if COUNTS_SAMPLES {
            count_samples(counted);
        }
    }
    slot.instance = entry.instance;
    slot.chunk = entry.chunk;
    slot.first = chunk.first;
    slot.count = chunk.count;
    slots[frame.first_slot + own] = slot;
    if atomicExchange(&seen[frame.first_instance + entry.instance], 1u) == 0u {
        atomicAdd(&stats[frame.view].instances_drawn, 1u);
    }
}
