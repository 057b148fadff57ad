// Draws each sample as one pixel, and each node of a point tree in the pixels whose centres it covers. A workgroup takes a slot's chunk, and its threads take turns at the samples.
//!include shared/frame
//!include shared/scene
//!include shared/octahedral
//!include shared/clipping
//!include VISIBILITY
//!include NODES
//!include shared/landing
//!include shared/lanes
//!include shared/tested
//!include shared/sorts

@group(1) @binding(0) var<storage, read> positions: array<vec2<u32>>;
@group(1) @binding(2) var<storage, read> chunks: array<Chunk>;
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
    let limits = slots[at].limits;
    let sorted = (slots[at].flags & SLOT_SORTED) != 0u;
    let parts = turn.parts & slots[at].parts;
    let sure = slots[at].parts >> 16u;
    let instance_flags = instances[slots[at].instance].flags;
    var key = 0u;
    var areas: Areas;
    var longest = 0.0;
    if TREE || EXPANDED {
        let x = camera_vector(vec3<f32>(row_x.x, row_y.x, row_z.x));
        let y = camera_vector(vec3<f32>(row_x.y, row_y.y, row_z.y));
        let z = camera_vector(vec3<f32>(row_x.z, row_y.z, row_z.z));
        if TREE {
            key = instance_key(slots[at].instance);
            areas = areas_of(x, y, z);
        }
        if EXPANDED {
            longest = longest_axis(chunks[slots[at].chunk].kernel_base, x, y, z);
        }
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
            let pixel = landing(at, sample, longest);
            var may_show = pixel != NO_PIXEL && is_drawn_with(attributes[sample].x >> 24u, instance_flags);
            if TREE && !EXPANDED {
                // Nodes beside the image reach into it.
                may_show = at.z > NEAREST && all(at.image >= vec2<f32>(-1.0)) && all(at.image < size + 1.0)
                    && place_is_shown(at_depth(at.image, at.z));
            }
            if may_show {
                if !TREE {
                    drawn++;
                    visibility_write(pixel, at.inverse, (slot_index << SLOT_SHIFT) | i);
                } else if is_sure || node_is_drawn(sample, unit, at_depth(at.image, at.z), UNTILTED) {
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
            let id = (slot_index << SLOT_SHIFT) | i;
            if EXPANDED {
                var is_left = true;
                if !is_whole(own.x) {
                    let seen = seen_area(areas, octahedral_decode(own.y), centre);
                    let drawn_px = footprint_px(first + i, longest, at.z, select(seen, 1.0, own.y == NO_NORMAL));
                    is_left = is_kept(first + i, own.x, unit, centre, seen, drawn_px, word, key);
                }
                if is_left {
                    drawn++;
                    visibility_write(landing(at, first + i, longest), at.inverse, id);
                }
                continue;
            }
            let pixel = floor(at.image);
            let reach = select(0.0, node_reach_px(first + i, own.x, unit, centre), is_whole(own.x));
            if reach > OWN_PIXEL {
                let low = max(ceil(at.image - reach - 0.5), vec2<f32>(0.0));
                let high = min(floor(at.image + reach - 0.5), size - 1.0);
                var is_seen = false;
                for (var y = low.y; y <= high.y; y += 1.0) {
                    for (var x = low.x; x <= high.x; x += 1.0) {
                        let place = at_depth(vec2<f32>(x, y) + 0.5, at.z);
                        let covered = all(vec2<f32>(x, y) == pixel) || covers_pixel(first + i, own, unit, centre, place - centre, areas);
                        if covered && place_is_shown(place) {
                            visibility_write(frame.first_pixel + u32(y) * width + u32(x), at.inverse, id);
                            is_seen = true;
                        }
                    }
                }
                drawn += u32(is_seen);
                continue;
            }
            if any(at.image < vec2<f32>(0.0)) || any(at.image >= size) {
                continue;
            }
            var kept = true;
            if !is_whole(own.x) {
                let seen = seen_area(areas, octahedral_decode(own.y), centre);
                kept = is_kept(first + i, own.x, unit, centre, seen, 1.0, word, key);
            } else if (own.x >> 24u) < FILLS {
                let beside = at_depth(pixel + vec2<f32>(0.5), at.z) - centre;
                kept = covers_pixel(first + i, own, unit, centre, beside, areas);
            }
            if kept {
                drawn++;
                visibility_write(frame.first_pixel + u32(at.image.y) * width + u32(at.image.x), at.inverse, id);
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
