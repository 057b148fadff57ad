// The list of entries as `cull` has written it.
//!include shared/chosen
//!include shared/accepted
//!include shared/codes
//!include shared/octahedral
//!include shared/parts
@group(2) @binding(5) var<storage, read> entries: array<Entry>;
@group(2) @binding(6) var<storage, read> sizes: Sizes;

// 0: errors, 1: sizes.
override MEASURE: u32 = 0u;
// Errors are those of the angle that a node is seen at.
override SPLIT: bool = false;

fn entry_count() -> u32 {
    return sizes.group_count * 32u;
}

// The pass that draws nodes counts those that it has tested.
const COUNTS_SAMPLES: bool = false;
// The order of the first nodes is that of their parents' errors.
const LISTS_SORTED: bool = true;

// Codes that decide without a node's position, wherever in the chunk's box the node is: parents of the lower half's code and of larger codes
// can be accepted; nodes of codes below the upper half cannot.
fn code_limits(chunk: Chunk, at: Placed, box: Box, unit: f32) -> u32 {
    if !(unit > 0.0) {
        return MOST_LIMIT;
    }
    let far = box_far(box);
    let deep = box_deep(box);
    let near = box.centre.z - deep;
    let delta = stretch(at) * chunk.delta_most + 2.0 * DEPTH_SLACK * far;
    let least = accepted(near - delta, far + delta);
    let high = box.centre.z + deep + 2.0 * DEPTH_SLACK * far;
    let most = accepted(high, high) * select(1.0, 1.0 / SIDEWAYS, SPLIT);
    // Two more for rounding of the logarithm. An error of zero passes anywhere.
    let parents = select(f32(MOST_LIMIT), clamp(ceil(64.0 * log2(unit / least)) + 2.0, 1.0, f32(MOST_LIMIT)), least > 0.0);
    let own = select(f32(NO_CODE), clamp(floor(64.0 * log2(unit / most)) - 2.0, 0.0, f32(NO_CODE)), most > 0.0);
    return u32(parents) | (u32(own) << 16u);
}

// The value of a parent's code. Without a parent it is larger than any error.
fn parent_value(code: u32) -> f32 {
    return select(code_value(code), 1e30, code == NO_PARENT);
}

// The axis of a cone: two signed bytes of the octahedral map.
fn cone_axis(cone: u32) -> vec3<f32> {
    let bytes = vec2<i32>(i32(cone << 24u), i32(cone << 16u)) >> vec2<u32>(24u);
    let halves = vec2<u32>(bytes * 258) & vec2<u32>(0xffffu);
    return octahedral_decode(halves.x | (halves.y << 16u));
}

// Whether all splats of a part are seen from behind, by the test that splat_of makes for each of them. `axes`: columns of the map to camera
// space, divided by the factor that it scales by; `reach`: how far splats extend beyond their centres.
fn part_is_behind(cone: u32, axis: vec3<f32>, part: Box, reach: f32) -> bool {
    let spread = f32((cone >> 16u) & 255u) / 255.0;
    let sine = f32(cone >> 24u) / 255.0;
    let way = towards(part.centre);
    let far = length(way);
    let beside = select(length(part.x) + length(part.y) + length(part.z), 0.0, ORTHOGRAPHIC);
    let along = dot(axis, way);
    let across = sqrt(max(far * far - along * along, 0.0));
    let least = along * sqrt(max(1.0 - spread * spread, 0.0)) - across * spread - beside;
    return along > 0.0 && least > sine * (far + beside) + select(reach, 0.0, ORTHOGRAPHIC) + 0.002 * far;
}

// The parts of a chunk of nodes that may be drawn (Dachsbacher et al. 2003, §3.6 and §3.10, for 64 nodes at a time); in the upper half those
// whose nodes all pass node_is_drawn and, where they are drawn as one pixel each, is_kept and covers_pixel.
fn wanted_parts(index: u32, chunk: Chunk, at: Placed, whole: Box, unit: f32, one_sided: bool) -> u32 {
    if !(chunk.node_base > 0.0) {
        return ALL_PARTS;
    }
    let scale = stretch(at);
    let reach = 2.02 * frame.splat_cutoff * frame.splat_width * chunk.kernel_base * exp2(f32(chunk.shift)) * scale;
    let margin = frame.splat_cutoff * frame.splat_lowpass_px + select(0.0, lod_px(), MEASURE == 1u);
    let turns = MEASURE == 0u && one_sided && keeps_angles(at.axis_x.xyz / scale, at.axis_y.xyz / scale, at.axis_z.xyz / scale);
    let sideways = select(1.0, SIDEWAYS, SPLIT);
    var wanted = 0u;
    for (var i = 0u; i * PART < chunk.count; i++) {
        let own = parts[index][i];
        let any_codes = select(own.error, own.size, MEASURE == 1u);
        let all_codes = select(own.error_all, own.size_all, MEASURE == 1u);
        let box = part_box(whole, own.low, own.high);
        let deep = box_deep(box);
        let far = box_far(box);
        let slack = DEPTH_SLACK * far;
        let low = box.centre.z - deep - slack;
        let high = box.centre.z + deep + slack;
        let delta = scale * own.delta + slack;
        // Codes may be decoded with another rounding where nodes are tested.
        let parent_most = 1.0001 * unit * parent_value(any_codes >> CODE_BITS);
        let own_least = 0.9999 * unit * code_value(any_codes & CODE) * sideways;
        if !(parent_most > accepted(low - delta, far + delta)) || !(own_least <= accepted(high, high)) {
            continue;
        }
        let radius = max(reach * longest_of(own.low), frame.disc_radius) + box.slack;
        if !box_is_seen(box.centre, box.x, box.y, box.z, radius, margin) {
            continue;
        }
        if turns && own.cone != 0u {
            let n = cone_axis(own.cone);
            let axis = (at.axis_x.xyz * n.x + at.axis_y.xyz * n.y + at.axis_z.xyz * n.z) / scale;
            if part_is_behind(own.cone, axis, box, radius) {
                continue;
            }
        }
        wanted |= 1u << i;
        let parent_least = 0.9999 * unit * parent_value((all_codes >> CODE_BITS) & CODE) * sideways;
        let own_most = 1.0001 * unit * code_value(all_codes & CODE);
        let is_plain = MEASURE == 0u || (own.size_all & PLAIN) != 0u;
        if is_plain && own_most <= accepted(low, far + slack) && parent_least > accepted(high, high) {
            wanted |= 0x10000u << i;
        }
    }
    return wanted;
}
