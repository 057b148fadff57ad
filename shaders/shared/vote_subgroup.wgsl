// Whether any thread of the vector says so.
fn any_lane(mine: bool) -> bool {
    return subgroupAny(mine);
}

// The most that any thread of the vector says.
fn most_of_lanes(mine: u32, bound: u32) -> u32 {
    return subgroupMax(mine);
}
