// Slots of a segment that might have been hidden and are not, in their turn.
//!include shared/portions
//!include shared/turns

@group(2) @binding(5) var<storage, read_write> portions: array<Portion>;
@group(2) @binding(6) var<storage, read> late: array<vec2<u32>>;

fn turn_of(index: u32) -> Turn {
    let own = frame.first_run + segment.index;
    let place = atomicLoad(&portions[own].before) + index;
    if place >= atomicLoad(&portions[own].late) {
        return Turn(0u, 0u);
    }
    let word = late[frame.first_slot + runs[own].first_slot + place];
    return Turn(word.x, word.y);
}
