// Up to two lines in a splat's tangent plane, beyond which it is not drawn (Zwicker et al. 2004, §5). Sides of a line are
// linear functions of the pixel, whatever the filter.
struct ClipForms {
    first: vec3<f32>,
    second: vec3<f32>,
    // Keep what either keeps.
    either: bool,
}

// Direction in 2^-16 turns and signed offset; what stands for no line has the least offset.
@group(1) @binding(5) var<storage, read> clips: array<vec2<u32>>;

const OFFSET_STEP: f32 = 8.0 / 32767.0;
const TURN: f32 = 6.2831853 / 65536.0;

fn clip_words(sample: u32) -> vec2<u32> {
    return clips[sample];
}

fn clip_form(word: u32, forms: KernelForms, spread: vec2<f32>, spread_t: f32) -> vec3<f32> {
    let offset = i32(word << 16u) >> 16u;
    if offset < -32767 {
        return vec3<f32>(1.0, 0.0, 0.0);
    }
    let angle = f32(word >> 16u) * TURN;
    let normal = vec2<f32>(cos(angle), sin(angle));
    // In coordinates of the kernel that is drawn, which the low-pass filter may have widened.
    let drawn = vec2<f32>(dot(normal, spread), normal.y * spread_t);
    return drawn.x * forms.s + drawn.y * forms.t - f32(offset) * OFFSET_STEP / frame.splat_width * forms.n;
}

fn clip_forms(lines: vec2<u32>, forms: KernelForms, spread: vec2<f32>, spread_t: f32) -> ClipForms {
    return ClipForms(
        clip_form(lines.x, forms, spread, spread_t),
        clip_form(lines.y, forms, spread, spread_t),
        lines.x > lines.y,
    );
}

fn clip_keeps(clip: ClipForms, d: vec2<f32>) -> bool {
    let first = linear(clip.first, d) >= 0.0;
    let second = linear(clip.second, d) >= 0.0;
    return select(first && second, first || second, clip.either);
}
