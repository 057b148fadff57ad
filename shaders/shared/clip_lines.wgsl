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

// Direction of the side that a line keeps, and the line's offset in kernel coordinates.
fn line_of(word: u32) -> vec3<f32> {
    let angle = f32(word >> 16u) * TURN;
    let offset = i32(word << 16u) >> 16u;
    return vec3<f32>(cos(angle), sin(angle), f32(offset) * OFFSET_STEP / frame.splat_width);
}

fn is_line(word: u32) -> bool {
    return (i32(word << 16u) >> 16u) >= -32767;
}

fn clip_form(word: u32, forms: KernelForms, spread: vec2<f32>, spread_t: f32) -> vec3<f32> {
    if !is_line(word) {
        return vec3<f32>(1.0, 0.0, 0.0);
    }
    let line = line_of(word);
    let normal = line.xy;
    // In coordinates of the kernel that is drawn, which the low-pass filter may have widened.
    let drawn = vec2<f32>(dot(normal, spread), normal.y * spread_t);
    return drawn.x * forms.s + drawn.y * forms.t - line.z * forms.n;
}

fn clip_forms(lines: vec2<u32>, forms: KernelForms, spread: vec2<f32>, spread_t: f32) -> ClipForms {
    return ClipForms(
        clip_form(lines.x, forms, spread, spread_t),
        clip_form(lines.y, forms, spread, spread_t),
        lines.x > lines.y,
    );
}

// The part of a kernel that clip lines keep, as an ellipse in kernel coordinates: its centre and the images of both axes.
struct KeptPart {
    centre: vec2<f32>,
    u: vec2<f32>,
    v: vec2<f32>,
}

// Least part of a radius that is left, of a kernel of which a line keeps nothing.
const LEAST_KEPT: f32 = 0.02;

// The rest of a part on one side of a line: an ellipse that touches the line, and the outline opposite to it.
fn kept_side(part: KeptPart, word: u32) -> KeptPart {
    if !is_line(word) {
        return part;
    }
    let line = line_of(word);
    let across = vec2<f32>(dot(line.xy, part.u), dot(line.xy, part.v));
    let size = max(length(across), 1e-6);
    let n = across / size;
    let f = frame.splat_cutoff;
    let begin = clamp((line.z - dot(line.xy, part.centre)) / size, -f, f * (1.0 - 2.0 * LEAST_KEPT));
    let shrunk = (f - begin) / (2.0 * f) - 1.0;
    return KeptPart(
        part.centre + 0.5 * (begin + f) * (n.x * part.u + n.y * part.v),
        part.u + shrunk * n.x * (n.x * part.u + n.y * part.v),
        part.v + shrunk * n.y * (n.x * part.u + n.y * part.v),
    );
}

// Where a sample keeps what either line keeps, all of it.
fn kept_part(lines: vec2<u32>) -> KeptPart {
    let whole = KeptPart(vec2<f32>(0.0), vec2<f32>(1.0, 0.0), vec2<f32>(0.0, 1.0));
    if lines.x > lines.y {
        return whole;
    }
    return kept_side(kept_side(whole, lines.x), lines.y);
}

fn clip_keeps(clip: ClipForms, d: vec2<f32>) -> bool {
    let first = linear(clip.first, d) >= 0.0;
    let second = linear(clip.second, d) >= 0.0;
    return select(first && second, first || second, clip.either);
}

// As words, with offsets that count from another place.
fn clip_record(clip: ClipForms, by: vec2<f32>) -> array<vec4<u32>, 2> {
    return array<vec4<u32>, 2>(
        vec4<u32>(bitcast<vec3<u32>>(vec3<f32>(linear(clip.first, by), clip.first.yz)), u32(clip.either)),
        vec4<u32>(bitcast<vec3<u32>>(vec3<f32>(linear(clip.second, by), clip.second.yz)), 0u),
    );
}
