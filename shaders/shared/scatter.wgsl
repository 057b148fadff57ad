// A thread takes a sample, makes a splat of it and walks the pixels of its box; large ones are listed. The file that includes this
// says what happens at a pixel: `emit`, with what `paint_of` gives it for the whole splat.
//
// On lavapipe all loops of a thread, and of those that go with it, share 65535 rounds, and what comes after is never done. So threads
// keep account of theirs, and list what they have none left for.
//!include shared/list
//!include shared/lanes
//!include shared/tested
//!include VOTE
//!include PORTION
const ROUNDS: u32 = 60000u;

fn mark_full() {
    atomicMax(&stats[frame.view].sums_full, 1u);
}

fn scatter(group: vec3<u32>, lane: u32) {
    begin_view(group.z);
    let turn = turn_of(group.y * DISPATCH_ROW + group.x);
    if turn.parts == 0u {
        return;
    }
    let slot = splat_slot(turn.slot);
    let count = slots[frame.first_slot + slot.index].count;
    let parts = turn.parts & slots[frame.first_slot + slot.index].parts;
    let shared_paint = paint_slot(slot);
    let width = frame.size_px.x;
    var scattered = 0u;
    var listed = 0u;
    var crossing = 0u;
    var looked_at = 0u;
    var rounds = 0u;
    let longest = u32(frame.small_splat_px) + 1u;
    // Many nodes are not drawn: those of up to 32 that are drawn are gathered before any expensive work.
    var start = lane;
    while start < count {
        let base = start;
        let stop = min(count, start + 32u * LANES);
        var gathered = 0u;
        for (var i = next_element(start, parts, lane, stop); i < stop; i = next_element(i + LANES, parts, lane, stop)) {
            looked_at++;
            if TREE && ((slot.sure >> (i / PART)) & 1u) == 0u {
                let sample = slot.first + i;
                if !is_within_limits(sample, slot.limits) {
                    if slot.sorted && is_behind_prefix(sample, slot.limits & 0xffffu) {
                        start = count;
                        break;
                    }
                    continue;
                }
                if !splat_is_chosen(slot, i) {
                    continue;
                }
            }
            gathered |= 1u << ((i - base) / LANES);
        }
        start += 32u * LANES;
        rounds += 32u;
        while gathered != 0u {
            let i = base + firstTrailingBit(gathered) * LANES;
            gathered &= gathered - 1u;
            let splat = splat_of(slot, i);
            let box = vec2<u32>(splat.high - splat.low + vec2<i32>(1));
            let pixels = select(0u, box.x * box.y, splat.way == SMALL);
            let full = rounds + most_of_lanes(pixels, longest * longest) > ROUNDS;
            if splat.way == LARGE && all(splat.high >= splat.low) {
                list_large(splat.id, vec2<u32>(splat.low), vec2<u32>(splat.high));
                listed++;
                crossing += u32(splat.crosses);
            }
            if splat.way == SMALL && full {
                list_entry(splat.id, vec2<u32>(splat.low), vec2<u32>(splat.high));
                listed++;
            }
            var taken = 0u;
            if splat.way == SMALL && !full {
                scattered++;
                let paint = paint_of(slot, shared_paint, i);
                var at = splat.low;
                // One loop over both directions: threads of a vector end together where their boxes are alike in area.
                loop {
                    let d = vec2<f32>(at) + vec2<f32>(0.5) - splat.centre;
                    let q = splat_distance(splat, d);
                    var done = true;
                    if splat_meets(splat, d, q) && clip_keeps(splat.clip, d) {
                        done = emit(splat, paint, frame.first_pixel + u32(at.y) * width + u32(at.x), d, q);
                    }
                    taken++;
                    if done {
                        at.x++;
                    }
                    if at.x > splat.high.x {
                        at = vec2<i32>(splat.low.x, at.y + 1);
                    }
                    if at.y > splat.high.y {
                        break;
                    }
                }
            }
            rounds += most_of_lanes(taken, longest * longest) + frame.light_count + 1u;
        }
    }
    if COUNTS {
        if TREE {
            count_samples(looked_at);
        }
        if scattered != 0u {
            atomicAdd(&stats[frame.view].splats_scattered, scattered);
        }
        if listed != 0u {
            atomicAdd(&stats[frame.view].splats_listed, listed);
            atomicAdd(&stats[frame.view].splats_clipped, crossing);
        }
    }
}
