// Slots of a segment whose turn it is to be drawn.
//!include shared/portions
//!include shared/turns

@group(2) @binding(5) var<storage, read_write> portions: array<Portion>;
@group(2) @binding(6) var<storage, read> turn_slots: array<vec2<u32>>;

fn turn_of(index: u32) -> Turn {
    let own = frame.first_run + segment.index;
    let place = portions[own].begin + index;
    if place >= portions[own].end {
        return Turn(0u, 0u);
    }
    let word = turn_slots[frame.first_slot + runs[own].first_slot + place];
    return Turn(word.x, word.y);
}
