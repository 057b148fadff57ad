// One pixel a sample: a workgroup takes a slot's chunk, its threads take turns at its samples.
//!include shared/frame
//!include shared/scene
//!include shared/octahedral
//!include VISIBILITY
//!include NODES

struct SegmentUse {
    index: u32,
}

//!include shared/lanes

@group(1) @binding(0) var<storage, read> positions: array<vec2<u32>>;
@group(1) @binding(3) var<storage, read> instances: array<Instance>;
@group(1) @binding(6) var<storage, read> attributes: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read_write> stats: array<Stats>;
@group(2) @binding(0) var<storage, read> slots: array<Slot>;
@group(2) @binding(1) var<storage, read> runs: array<Run>;
@group(2) @binding(2) var<uniform> segment: SegmentUse;
//!include PORTION

@compute @workgroup_size(LANES)
fn project_samples(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    begin_view(group.z);
    let turn = turn_of(group.y * DISPATCH_ROW + group.x);
    if turn.parts == 0u {
        return;
    }
    let slot_index = turn.slot;
    let at = frame.first_slot + slot_index;
    let row_x = slots[at].row_x;
    let row_y = slots[at].row_y;
    let row_z = slots[at].row_z;
    let first = slots[at].first;
    let count = slots[at].count;
    let unit = slots[at].unit;
    let limit = slots[at].limit;
    let sorted = slots[at].sorted != 0u;
    var key = 0u;
    if TREE {
        key = instance_key(slots[at].instance);
    }
    var drawn = 0u;
    var looked_at = 0u;
    let size = vec2<f32>(frame.size_px);
    let width = frame.size_px.x;
    for (var i = next_element(lane, turn.parts, lane, count); i < count; i = next_element(i + LANES, turn.parts, lane, count)) {
        if TREE {
            looked_at++;
            if !is_in_prefix(first + i, limit) {
                if sorted && is_behind_prefix(first + i, limit) {
                    break;
                }
                continue;
            }
        }
        let word = positions[first + i];
        let q = vec3<f32>(
            f32(word.x & 0x1fffffu),
            f32(((word.x >> 21u) | (word.y << 11u)) & 0x1fffffu),
            f32((word.y >> 10u) & 0x1fffffu),
        );
        let z = fma(row_z.x, q.x, fma(row_z.y, q.y, fma(row_z.z, q.z, row_z.w)));
        let inverse = 1.0 / z;
        let x = fma(row_x.x, q.x, fma(row_x.y, q.y, fma(row_x.z, q.z, row_x.w))) * inverse;
        let y = fma(row_y.x, q.x, fma(row_y.y, q.y, fma(row_y.z, q.z, row_y.w))) * inverse;
        if z > NEAREST && x >= 0.0 && y >= 0.0 && x < size.x && y < size.y {
            if TREE {
                let image = vec2<f32>(x, y);
                let centre = z * ray_through(image);
                if !node_is_drawn(first + i, unit, centre, UNTILTED) {
                    continue;
                }
                let own = attributes[first + i];
                if !is_whole(own.x) {
                    let n = octahedral_decode(own.y);
                    let across = vec3<f32>(dot(row_x.xyz, n), dot(row_y.xyz, n), dot(row_z.xyz, n));
                    let seen = foreshortened(vec3<f32>((across.xy - frame.principal_px * across.z) / frame.focal_px, across.z), centre);
                    if !is_kept(first + i, own.x, unit, centre, seen, 1.0, word, key) {
                        continue;
                    }
                }
                drawn++;
            }
            visibility_write(frame.first_pixel + u32(y) * width + u32(x), inverse, (slot_index << SLOT_SHIFT) | i);
        }
    }
    if TREE && FIRST_HALF {
        let old = atomicAdd(&stats[frame.view].samples_tested_lo, looked_at);
        if old + looked_at < old {
            atomicAdd(&stats[frame.view].samples_tested_hi, 1u);
        }
        if drawn != 0u {
            atomicAdd(&stats[frame.view].nodes_drawn, drawn);
        }
    }
}
