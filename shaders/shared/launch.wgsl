// Writes the size of an indirect dispatch.
fn set_launch(at: u32, groups: u32, views: u32) {
    atomicStore(&dispatches[at].groups_x, min(groups, DISPATCH_ROW));
    atomicStore(&dispatches[at].groups_y, (groups + DISPATCH_ROW - 1u) / DISPATCH_ROW);
    atomicStore(&dispatches[at].groups_z, views);
}
