// Draws each sample as one pixel. A workgroup takes a slot's chunk, and its threads take turns at the samples.
//!include shared/frame
//!include shared/scene
//!include shared/octahedral
//!include shared/clipping
//!include VISIBILITY
//!include NODES

//!include shared/lanes
//!include shared/tested

@group(1) @binding(0) var<storage, read> positions: array<vec2<u32>>;
@group(1) @binding(3) var<storage, read> instances: array<Instance>;
@group(1) @binding(6) var<storage, read> attributes: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read_write> stats: array<Stats>;
@group(2) @binding(0) var<storage, read> slots: array<Slot>;
@group(2) @binding(1) var<storage, read> runs: array<Run>;
@group(2) @binding(2) var<uniform> segment: SegmentUse;
//!include PORTION

// A sample's position in the image.
struct Place {
    image: vec2<f32>,
    z: f32,
    inverse: f32,
}

fn place_of(word: vec2<u32>, row_x: vec4<f32>, row_y: vec4<f32>, row_z: vec4<f32>) -> Place {
    let q = sample_cell(word);
    let z = fma(row_z.x, q.x, fma(row_z.y, q.y, fma(row_z.z, q.z, row_z.w)));
    let inverse = 1.0 / z;
    let by = select(inverse, 1.0, ORTHOGRAPHIC);
    let x = fma(row_x.x, q.x, fma(row_x.y, q.y, fma(row_x.z, q.z, row_x.w))) * by;
    let y = fma(row_y.x, q.x, fma(row_y.y, q.y, fma(row_y.z, q.z, row_y.w))) * by;
    return Place(vec2<f32>(x, y), z, inverse);
}

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
    let limits = slots[at].limits;
    let sorted = (slots[at].flags & SLOT_SORTED) != 0u;
    let parts = turn.parts & slots[at].parts;
    let sure = slots[at].parts >> 16u;
    var key = 0u;
    var areas: Areas;
    if TREE {
        key = instance_key(slots[at].instance);
        areas = areas_of(
            camera_vector(vec3<f32>(row_x.x, row_y.x, row_z.x)),
            camera_vector(vec3<f32>(row_x.y, row_y.y, row_z.y)),
            camera_vector(vec3<f32>(row_x.z, row_y.z, row_z.z)),
        );
    }
    var drawn = 0u;
    var looked_at = 0u;
    let size = vec2<f32>(frame.size_px);
    let width = frame.size_px.x;
    // Most nodes are not drawn. The drawn ones among up to 32 are gathered before any expensive work is done for them.
    let block = select(count, 32u * LANES, TREE);
    var start = lane;
    while start < count {
        let stop = min(count, start + block);
        let base = start;
        var gathered = 0u;
        for (var i = next_element(start, parts, lane, stop); i < stop; i = next_element(i + LANES, parts, lane, stop)) {
            let sample = first + i;
            let is_sure = ((sure >> (i / PART)) & 1u) != 0u;
            if TREE {
                looked_at++;
                if !is_sure && !is_within_limits(sample, limits) {
                    if sorted && is_behind_prefix(sample, limits & 0xffffu) {
                        start = count;
                        break;
                    }
                    continue;
                }
            }
            let at = place_of(positions[sample], row_x, row_y, row_z);
            let is_before = at.z > NEAREST && all(at.image >= vec2<f32>(0.0)) && all(at.image < size);
            if is_before && place_is_shown(at_depth(at.image, at.z)) {
                if !TREE || is_sure {
                    drawn++;
                    visibility_write(frame.first_pixel + u32(at.image.y) * width + u32(at.image.x), at.inverse, (slot_index << SLOT_SHIFT) | i);
                } else if node_is_drawn(sample, unit, at_depth(at.image, at.z), UNTILTED) {
                    gathered |= 1u << ((i - base) / LANES);
                }
            }
        }
        while gathered != 0u {
            let i = base + firstTrailingBit(gathered) * LANES;
            gathered &= gathered - 1u;
            let word = positions[first + i];
            let at = place_of(word, row_x, row_y, row_z);
            let own = attributes[first + i];
            let centre = at_depth(at.image, at.z);
            var kept: bool;
            if is_whole(own.x) {
                let beside = at_depth(floor(at.image) + vec2<f32>(0.5), at.z) - centre;
                kept = covers_pixel(first + i, own, unit, centre, beside, areas);
            } else {
                let seen = seen_area(areas, octahedral_decode(own.y), centre);
                kept = is_kept(first + i, own.x, unit, centre, seen, 1.0, word, key);
            }
            if kept {
                drawn++;
                visibility_write(frame.first_pixel + u32(at.image.y) * width + u32(at.image.x), at.inverse, (slot_index << SLOT_SHIFT) | i);
            }
        }
        start += block;
    }
    if TREE && FIRST_HALF {
        count_samples(looked_at);
        if drawn != 0u {
            atomicAdd(&stats[frame.view].nodes_drawn, drawn);
        }
    }
}
