// Whether any thread of the vector says so.
fn any_lane(mine: bool) -> bool {
    return subgroupAny(mine);
}
