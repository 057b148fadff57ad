// Every instance.
fn member(index: u32) -> u32 {
    return index;
}
