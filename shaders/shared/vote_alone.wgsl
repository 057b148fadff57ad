// Without subgroups each thread goes by itself.
fn any_lane(mine: bool) -> bool {
    return mine;
}
