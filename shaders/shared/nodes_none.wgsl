// Samples of an asset as it is: all are drawn.
@group(1) @binding(1) var<storage, read> kernels: array<u32>;

const TREE: bool = false;
const KERNEL_WORDS: u32 = 1u;

fn node_is_drawn(sample: u32, unit: f32, centre: vec3<f32>) -> bool {
    return true;
}
