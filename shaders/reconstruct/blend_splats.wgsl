// Weighted sums of the splats that lie at the visible surface, second of three passes (Zwicker et al. 2004, §6).
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
//!include SUMS
//!include NORMAL_SUMS
//!include shared/splat_sums
//!include LIT
//!include shared/scatter

// project_splats has already counted these samples.
const COUNTS: bool = false;
const NARROW: bool = false;

@compute @workgroup_size(LANES)
fn blend_splats(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    scatter(group, lane);
}
