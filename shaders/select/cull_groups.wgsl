// Tests, in a scene of point trees, which groups of instances may show nodes of their own. The other groups lie beside the
// frustum, or so far away that nodes of the tree above stand for all of them.
//!include shared/frame
//!include shared/scene
//!include shared/frustum
//!include shared/accepted

@group(1) @binding(2) var<storage, read> instance_groups: array<InstanceGroup>;
@group(2) @binding(0) var<storage, read_write> group_flags: array<u32>;

// 0: errors, 1: sizes.
override MEASURE: u32 = 0u;

@compute @workgroup_size(64)
fn cull_groups(@builtin(global_invocation_id) invocation: vec3<u32>) {
    begin_view(invocation.z);
    let index = invocation.x + invocation.y * DISPATCH_ROW * 64u;
    if index >= frame.instance_groups {
        return;
    }
    let group = instance_groups[index];
    let from_eye = (group.centre_hi.xyz - frame.eye_hi.xyz) + (group.centre_lo.xyz - frame.eye_lo.xyz);
    let centre = camera_position(from_eye);
    let x = camera_from_world(vec3<f32>(group.half.x, 0.0, 0.0));
    let y = camera_from_world(vec3<f32>(0.0, group.half.y, 0.0));
    let z = camera_from_world(vec3<f32>(0.0, 0.0, group.half.z));
    let far = length(centre) + length(group.half.xyz);
    let near = centre.z - abs(x.z) - abs(y.z) - abs(z.z) - group.delta_most - DEPTH_SLACK * far;
    let parent = select(group.error_parent, group.size_parent, MEASURE == 1u);
    let wanted = parent > accepted(near, far + group.delta_most);
    group_flags[index] = u32(wanted && box_is_seen(centre, x, y, z, widest_reach(Box(centre, x, y, z, 0.0)), lod_margin()));
}
