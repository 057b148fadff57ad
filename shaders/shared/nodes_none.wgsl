// Samples of an asset without a point tree: all are drawn.
//!include shared/stretch
@group(1) @binding(1) var<storage, read> kernels: array<u32>;

const TREE: bool = false;
const SPLIT: bool = false;
const UNTILTED: f32 = 2.0;
const KERNEL_WORDS: u32 = 1u;

fn is_within_limits(sample: u32, limits: u32) -> bool {
    return true;
}

fn is_behind_prefix(sample: u32, limit: u32) -> bool {
    return false;
}

fn cone_sine(sample: u32) -> f32 {
    return 2.0;
}

fn painted(sample: u32, own: u32) -> u32 {
    return own;
}

fn node_is_drawn(sample: u32, unit: f32, centre: vec3<f32>, cosine: f32) -> bool {
    return true;
}

fn instance_key(instance: u32) -> u32 {
    return 0u;
}

fn node_extent(sample: u32, unit: f32) -> f32 {
    return 0.0;
}

fn node_part(own: u32) -> f32 {
    return 1.0;
}

fn is_ball(own: vec2<u32>) -> bool {
    return false;
}

fn is_whole(own: u32) -> bool {
    return true;
}

fn is_kept(sample: u32, own: u32, unit: f32, centre: vec3<f32>, seen: f32, drawn_px: f32, place: vec2<u32>, key: u32) -> bool {
    return true;
}

fn node_reach_px(sample: u32, own: u32, unit: f32, centre: vec3<f32>) -> f32 {
    return 0.0;
}

const OWN_PIXEL: f32 = 0.5;
const FILLS: u32 = 254u;

fn covers_pixel(sample: u32, own: vec2<u32>, unit: f32, centre: vec3<f32>, beside: vec3<f32>, areas: Areas) -> bool {
    return true;
}
