// Draws segments of lines of a few pixels: a thread takes one segment and goes through the columns of its box. Longer and wider ones, and
// those that meet the camera plane, are listed for walk_lines.
//!include shared/frame
//!include shared/scene
//!include VISIBILITY
//!include shared/line_walk
//!include shared/accepted
//!include shared/list
//!include shared/lanes
//!include VOTE
//!include PORTION

const COUNTS: bool = FIRST_HALF;

@group(1) @binding(2) var<storage, read> chunks: array<Chunk>;
@group(1) @binding(3) var<storage, read> instances: array<Instance>;
@group(2) @binding(0) var<storage, read> slots: array<Slot>;
@group(2) @binding(3) var<storage, read> placed: array<Placed>;

// On lavapipe all loops of a thread and of its vector share 65535 rounds; code after the last round never runs. A segment is listed
// when no rounds are left for it.
const ROUNDS: u32 = 60000u;

// Columns of a box that one thread goes through: 48 where small splats are 32 pixels long.
fn most_columns() -> u32 {
    return u32(frame.small_splat_px) * 3u / 2u;
}

// Pixels of a strip that one thread goes through: 400 where small splats are 32 pixels long.
fn most_pixels() -> u32 {
    return u32(frame.small_splat_px * frame.small_splat_px) * 25u / 64u;
}

// Whether a segment's own level of detail is accepted and that above is not, both in its middle; src/bake/line_levels.rs says why.
// Lines at full detail have one level, which no frame refuses.
fn level_is_drawn(line: Line, chunk: Chunk, scale: f32) -> bool {
    let centre = line.a + 0.5 * line.ab;
    let far = length_of(centre);
    let delta = scale * chunk.delta_most + DEPTH_SLACK * far;
    return scale * chunk.error_least <= accepted(centre.z, far)
        && scale * chunk.error_parent > accepted(centre.z - delta, far + delta);
}

// Returns an upper bound of the rounds that were taken.
fn segment_of_slot(slot_index: u32, at: Placed, scale: f32, chunk: Chunk, index: u32, rounds: u32) -> u32 {
    let id = (slot_index << SLOT_SHIFT) | index;
    let seen = seen_line(line_of(at, scale, chunk.vertex_first, chunk.first + index));
    var bounds = line_bounds(seen);
    // The part of its box that the pass draws. A segment counts in the window where its box begins.
    let drawn = vec2<i32>(drawn_rows());
    let begins = u32(bounds.low.y >= drawn.x);
    bounds.low.y = max(bounds.low.y, drawn.x);
    bounds.high.y = min(bounds.high.y, drawn.y - 1);
    bounds.is_seen = bounds.is_seen && bounds.low.y <= bounds.high.y
        && level_is_drawn(seen.line, chunk, scale) && is_drawn_with(line_alpha(seen.line), instances[slots[frame.first_slot + slot_index].instance].flags);
    let columns = u32(bounds.high.x - bounds.low.x + 1);
    let pixels = columns * most_rows(bounds);
    let is_small = columns <= most_columns() && pixels <= most_pixels();
    let wanted = select(0u, pixels + columns, bounds.is_seen && is_small);
    let most = most_of_lanes(wanted, most_pixels() + most_columns()) + 2u;
    let walks = rounds + most <= ROUNDS;
    if bounds.is_seen && !(is_small && walks) {
        list_entry(id, vec2<u32>(bounds.low), vec2<u32>(bounds.high));
        list_units((pixels + 4095u) / 4096u);
        if COUNTS {
            atomicAdd(&stats[frame.view].segments_listed, begins);
        }
    }
    var x = select(bounds.high.x + 1, bounds.low.x, wanted != 0u && walks);
    var rows = line_rows(bounds, seen.strip, x);
    var y = rows.x;
    loop {
        if x > bounds.high.x {
            break;
        }
        if y <= rows.y {
            write_line(seen, vec2<i32>(x, y), id);
        }
        y++;
        if y > rows.y {
            x++;
            rows = line_rows(bounds, seen.strip, x);
            y = rows.x;
        }
    }
    return most;
}

@compute @workgroup_size(LANES)
fn project_lines(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    begin_view(group.z);
    let turn = turn_of(group.y * DISPATCH_ROW + group.x);
    if turn.parts == 0u {
        return;
    }
    let slot = slots[frame.first_slot + turn.slot];
    let chunk = chunks[slot.chunk];
    let at = placed[frame.first_instance + slot.instance];
    let scale = radius_scale(at);
    var rounds = 0u;
    var i = next_element(lane, turn.parts, lane, chunk.count);
    while i < chunk.count {
        rounds += segment_of_slot(turn.slot, at, scale, chunk, i, rounds);
        i = next_element(i + LANES, turn.parts, lane, chunk.count);
    }
}
