// Without subgroups each thread goes by itself.
fn any_lane(mine: bool) -> bool {
    return mine;
}

// An upper bound of the values that the threads of a vector have.
fn most_of_lanes(mine: u32, bound: u32) -> u32 {
    return bound;
}
