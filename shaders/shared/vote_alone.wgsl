// Without subgroups each thread goes by itself.
fn any_lane(mine: bool) -> bool {
    return mine;
}

// What no thread of the vector says more than.
fn most_of_lanes(mine: u32, bound: u32) -> u32 {
    return bound;
}
