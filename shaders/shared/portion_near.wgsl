// The visible slots of a segment that are drawn first.
//!include shared/portions
//!include shared/turns

@group(2) @binding(5) var<storage, read_write> portions: array<Portion>;
@group(2) @binding(6) var<storage, read> turns: array<u32>;

fn turn_of(index: u32) -> Turn {
    let own = frame.first_run + segment.index;
    if index >= atomicLoad(&portions[own].near) {
        return Turn(0u, 0u);
    }
    return Turn(turns[frame.first_slot + runs[own].first_slot + index], ALL_PARTS);
}
