// Visible entries → slots, each with the affine map that takes its samples to the image.
//!include shared/frame
//!include shared/scene
//!include shared/frustum
//!include LIST

@group(1) @binding(1) var<storage, read> chunks: array<Chunk>;
@group(2) @binding(0) var<storage, read> placed: array<Placed>;
@group(2) @binding(1) var<storage, read> ranks: array<u32>;
@group(2) @binding(2) var<storage, read> group_counts: array<u32>;
@group(2) @binding(3) var<storage, read_write> slots: array<Slot>;
@group(2) @binding(4) var<storage, read_write> seen: array<atomic<u32>>;
@group(0) @binding(4) var<storage, read_write> stats: array<Stats>;

const NOT_VISIBLE: u32 = 0xffffffffu;
const GROUP: u32 = 32u;
// Chunks of triangles carry this shift.
const TRIANGLES: u32 = 0xffffffffu;
// Sides::Closed.
const CLOSED: u32 = 2u;

fn sample_slot(entry: Entry, chunk: Chunk, at: Placed) -> Slot {
    let corner = grid_to_camera(at, chunk.origin);
    let scale = f32(1u << chunk.shift);
    let x = vec3<f32>(at.axis_x.x, at.axis_y.x, at.axis_z.x) * scale;
    let y = vec3<f32>(at.axis_x.y, at.axis_y.y, at.axis_z.y) * scale;
    let z = vec3<f32>(at.axis_x.z, at.axis_y.z, at.axis_z.z) * scale;
    let f = frame.focal_px;
    let c = frame.principal_px;
    var slot: Slot;
    slot.row_x = vec4<f32>(f.x * x + c.x * z, f.x * corner.x + c.x * corner.z);
    slot.row_y = vec4<f32>(f.y * y + c.y * z, f.y * corner.y + c.y * corner.z);
    slot.row_z = vec4<f32>(z, corner.z);
    slot.unit = chunk.node_base * stretch(at);
    slot.one_sided = u32(chunk.vertex_first == CLOSED && at.position.w == 1.0);
    slot.limit = parent_limit(chunk, at, slot.unit);
    slot.sorted = chunk.sorted & u32(LISTS_SORTED);
    return slot;
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
    var slot: Slot;
    if chunk.shift == TRIANGLES {
        let old = atomicAdd(&stats[frame.view].triangles_tested_lo, chunk.count);
        if old + chunk.count < old {
            atomicAdd(&stats[frame.view].triangles_tested_hi, 1u);
        }
    } else {
        slot = sample_slot(entry, chunk, placed[frame.first_instance + entry.instance]);
        if COUNTS_SAMPLES {
            let old = atomicAdd(&stats[frame.view].samples_tested_lo, chunk.count);
            if old + chunk.count < old {
                atomicAdd(&stats[frame.view].samples_tested_hi, 1u);
            }
        }
    }
    slot.instance = entry.instance;
    slot.chunk = entry.chunk;
    slot.first = chunk.first;
    slot.count = chunk.count;
    slots[frame.first_slot + group_counts[frame.first_group + index / GROUP] + rank] = slot;
    if atomicExchange(&seen[frame.first_instance + entry.instance], 1u) == 0u {
        atomicAdd(&stats[frame.view].instances_drawn, 1u);
    }
}
