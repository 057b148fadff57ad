// All visible slots of a segment are drawn at once.
//!include shared/turns

fn turn_of(index: u32) -> Turn {
    let run = runs[frame.first_run + segment.index];
    return Turn(run.first_slot + index, select(0u, ALL_PARTS, index < run.count));
}
