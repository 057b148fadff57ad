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

// The part of a kernel that clip lines keep, as an ellipse in kernel coordinates: its centre and the images of both axes.
struct KeptPart {
    centre: vec2<f32>,
    u: vec2<f32>,
    v: vec2<f32>,
}

fn kept_part(lines: vec2<u32>) -> KeptPart {
    return KeptPart(vec2<f32>(0.0), vec2<f32>(1.0, 0.0), vec2<f32>(0.0, 1.0));
}

fn clip_keeps(clip: ClipForms, d: vec2<f32>) -> bool {
    return true;
}

// As words: lines that keep everything.
fn clip_record(clip: ClipForms, by: vec2<f32>) -> array<vec4<u32>, 2> {
    let whole = vec4<u32>(bitcast<u32>(1.0), 0u, 0u, 0u);
    return array<vec4<u32>, 2>(whole, whole);
}
