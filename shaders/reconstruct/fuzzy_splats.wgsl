// Splats blended and depth-tested in a single pass (Dachsbacher et al. 2003, §5); large ones are listed.
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
//!include shared/scatter

const COUNTS: bool = true;
const NARROW: bool = true;

@compute @workgroup_size(LANES)
fn fuzzy_splats(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    scatter(group, lane);
}
