// Splats that keep their whole kernels.
struct ClipForms {
    unused: u32,
}

fn clip_words(sample: u32) -> vec2<u32> {
    return vec2<u32>(0u);
}

fn clip_forms(lines: vec2<u32>, forms: KernelForms, spread: vec2<f32>, spread_t: f32) -> ClipForms {
    return ClipForms(0u);
}

fn clip_keeps(clip: ClipForms, d: vec2<f32>) -> bool {
    return true;
}
