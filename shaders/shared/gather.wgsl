// Goes through the samples of a slot that are drawn, a sample a thread. The file that includes this says what happens before, with
// `begin_slot`, and to each: `take`.
//!include shared/lanes
//!include shared/tested
//!include shared/sorts
//!include VOTE
//!include PORTION

// Counts of what a thread did.
struct Tally {
    looked_at: u32,
    // Rounds of loops, which lavapipe limits.
    rounds: u32,
    scattered: u32,
    listed: u32,
    crossing: u32,
    // The largest distance of a painted splat, and the complement of the least one, as keys.
    farthest: u32,
    nearest: u32,
}

fn gather(group: vec3<u32>, lane: u32) -> Tally {
    var tally: Tally;
    begin_view(group.z);
    let turn = turn_of(group.y * DISPATCH_ROW + group.x);
    if turn.parts == 0u {
        return tally;
    }
    let slot = splat_slot(turn.slot);
    let count = slots[frame.first_slot + slot.index].count;
    let parts = turn.parts & slots[frame.first_slot + slot.index].parts;
    begin_slot(slot);
    // Many nodes are not drawn: those of up to 32 that are drawn are gathered before any expensive work.
    var start = lane;
    while start < count {
        let base = start;
        let stop = min(count, start + 32u * LANES);
        var gathered = 0u;
        for (var i = next_element(start, parts, lane, stop); i < stop; i = next_element(i + LANES, parts, lane, stop)) {
            tally.looked_at++;
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
            if !is_drawn_with(attributes[slot.first + i].x >> 24u, instances[slot.instance].flags) {
                continue;
            }
            gathered |= 1u << ((i - base) / LANES);
        }
        start += 32u * LANES;
        tally.rounds += 32u;
        while gathered != 0u {
            let i = base + firstTrailingBit(gathered) * LANES;
            gathered &= gathered - 1u;
            take(slot, i, &tally);
        }
    }
    return tally;
}
