// The list of entries as `cull` has written it.
//!include shared/chosen
//!include shared/accepted
@group(2) @binding(5) var<storage, read> entries: array<Entry>;
@group(2) @binding(6) var<storage, read> sizes: Sizes;

fn entry_count() -> u32 {
    return sizes.group_count * 32u;
}

// The pass that draws nodes counts those that it has tested.
const COUNTS_SAMPLES: bool = false;
// The order of the first nodes is that of their parents' errors.
const LISTS_SORTED: bool = true;

// Nodes whose parents have this code or a larger one can be accepted wherever in the chunk's box they are.
fn parent_limit(chunk: Chunk, at: Placed, box: Box, unit: f32) -> u32 {
    let far = box_far(box);
    let near = box.centre.z - box_deep(box);
    let delta = stretch(at) * chunk.delta_most + 2.0 * DEPTH_SLACK * far;
    let least = accepted(near - delta, far + delta);
    if !(least > 0.0) || !(unit > 0.0) {
        return 0xffffffffu;
    }
    // Two more for rounding of the logarithm.
    return u32(clamp(ceil(64.0 * log2(unit / least)) + 2.0, 1.0, 1e6));
}
