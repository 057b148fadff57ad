// Blends large splats and splats that reach the camera plane in a single pass, as fuzzy_splats does for small ones.
//!include shared/frame
//!include shared/scene
//!include shared/octahedral
//!include shared/colour
//!include shared/material
//!include shared/normals
//!include shared/large
//!include shared/splat
//!include CLIPS
//!include shared/sample_splats
//!include shared/splat_fuzzy
//!include LIT
//!include shared/walk
//!include shared/walk_splat

const NARROW: bool = true;

@compute @workgroup_size(8)
fn fuzzy_walked(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    walk_list(group, groups.x, lane);
}
