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

// Nodes show how high they stand above the leaves (Dachsbacher et al. 2003, Fig. 1).
override LEVELS: bool = false;

// The sRGB8 colour of a node that has `own`.
fn painted(sample: u32, own: u32) -> u32 {
    if !LEVELS {
        return own;
    }
    let level = (kernels[sample * KERNEL_WORDS + 2u] >> 24u) & 31u;
    // Hues of neighbours lie well apart.
    let hue = fract(f32(level) * 0.381966 + 0.02) * 6.0;
    let color = clamp(abs((vec3<f32>(hue) + vec3<f32>(0.0, 4.0, 2.0)) % 6.0 - 3.0) - 1.0, vec3<f32>(0.0), vec3<f32>(1.0));
    return pack4x8unorm(vec4<f32>(0.25 + 0.7 * color, 1.0));
}

// Whether a node's parent has a smaller code.
fn is_in_prefix(sample: u32, limit: u32) -> bool {
    return ((kernels[sample * KERNEL_WORDS + 1u + MEASURE] >> 12u) & 0xfffu) < limit;
}

// In chunks that are sorted: whether no node from this one on has a parent with a smaller code, in either measure.
fn is_behind_prefix(sample: u32, limit: u32) -> bool {
    let error = (kernels[sample * KERNEL_WORDS + 1u] >> 12u) & 0xfffu;
    let size = (kernels[sample * KERNEL_WORDS + 2u] >> 12u) & 0xfffu;
    return min(error, size) >= limit;
}

// Sine of the widest angle between a node's normal and those of the leaves below it; cone_sine of src/bake/tree/sequence.rs.
fn cone_sine(sample: u32) -> f32 {
    let code = kernels[sample * KERNEL_WORDS + 2u] >> 29u;
    return select(f32(code * code) / 48.0, 2.0, code == 7u);
}

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
