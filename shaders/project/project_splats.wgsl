// Visibility of splats, first of three passes (Zwicker et al. 2004, §6): the nearest surface, shifted slightly backwards.
//!include shared/frame
//!include shared/scene
//!include shared/octahedral
//!include VISIBILITY
//!include shared/large
//!include shared/splat
//!include CLIPS
//!include shared/sample_splats
//!include shared/splat_depth
//!include shared/scatter

const COUNTS: bool = FIRST_HALF;
const NARROW: bool = true;

@compute @workgroup_size(LANES)
fn project_splats(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    scatter(group, lane);
}
