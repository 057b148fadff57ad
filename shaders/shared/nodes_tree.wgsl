// Nodes of a point tree: which of them are drawn (Dachsbacher et al. 2003, §3.6). `crate::bake::tree` says what the words are.
//!include shared/accepted
const TREE: bool = true;
const KERNEL_WORDS: u32 = 3u;

// 0: errors, 1: sizes.
override MEASURE: u32 = 0u;

// Of each node its kernel, then its two words.
@group(1) @binding(1) var<storage, read> kernels: array<u32>;

const NO_CODE: u32 = 0xfffu;
const NO_PARENT: u32 = 0u;

// Of a code, in units of its base.
fn code_value(code: u32) -> f32 {
    return select(exp2(f32(code) * -0.0078125), 0.0, code == NO_CODE);
}

// `unit`: the base of the node's codes in camera space; `centre`: the node's, there.
fn node_is_drawn(sample: u32, unit: f32, centre: vec3<f32>) -> bool {
    let first = kernels[sample * KERNEL_WORDS + 1u];
    var word = first;
    if MEASURE == 1u {
        word = kernels[sample * KERNEL_WORDS + 2u];
    }
    let parent = (word >> 12u) & 0xfffu;
    let delta = unit * exp2(f32(first >> 24u) * -0.125);
    let far = length(centre);
    let slack = DEPTH_SLACK * far;
    return unit * code_value(word & 0xfffu) <= accepted(centre.z, far)
        && (parent == NO_PARENT || unit * code_value(parent) > accepted(centre.z - delta - slack, far + delta + slack));
}
