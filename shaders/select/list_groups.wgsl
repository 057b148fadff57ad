// Lists in order the groups of instances that may show anything, and sizes the dispatches over them. One workgroup.
//!include shared/frame
//!include shared/scene
//!include shared/chosen
//!include shared/launch

@group(2) @binding(0) var<storage, read> group_flags: array<u32>;
@group(2) @binding(1) var<storage, read_write> listed: array<u32>;
@group(2) @binding(2) var<storage, read_write> dispatches: array<Dispatch>;

var<workgroup> partial: array<u32, 64>;

@compute @workgroup_size(64)
fn list_groups(@builtin(local_invocation_index) lane: u32) {
    begin_view(0u);
    // See all_lights in shared/phong for why the bound is no uniform alone.
    let count = min(frame.instance_groups, arrayLength(&group_flags));
    let share = (count + 63u) / 64u;
    let first = min(lane * share, count);
    let end = min(first + share, count);
    var sum = 0u;
    for (var i = first; i < end; i++) {
        sum += group_flags[i];
    }
    partial[lane] = sum;
    workgroupBarrier();
    var running = 0u;
    for (var i = 0u; i < lane; i++) {
        running += partial[i];
    }
    for (var i = first; i < end; i++) {
        if group_flags[i] != 0u {
            listed[1u + running] = i;
            running++;
        }
    }
    if lane == 63u {
        listed[0] = running;
        // These launches follow those of the segments.
        let launches = arrayLength(&dispatches) - LOD_LAUNCHES;
        set_launch(launches + LAUNCH_PLACE, (running * INSTANCE_GROUP + 63u) / 64u, 1u);
        set_launch(launches + LAUNCH_SELECT, (running + 63u) / 64u, 1u);
    }
}
