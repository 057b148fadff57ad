// Digits of keys.
//!include shared/digits

@group(0) @binding(6) var<storage, read> sort_from: array<vec2<u32>>;
// The digit's number.
@group(2) @binding(2) var<uniform> digit: vec4<u32>;

const DIGIT_BITS: u32 = 8u;
const DIGITS: u32 = 3u;

// Where the digits of keys are: the first three that tell the nearest from the farthest.
struct Span {
    least: u32,
    shift: u32,
}

fn key_span() -> Span {
    let least = ~atomicLoad(&paint_list.nearest);
    let width = 32u - countLeadingZeros(atomicLoad(&paint_list.farthest) - least);
    return Span(least, max(width, DIGITS * DIGIT_BITS) - DIGITS * DIGIT_BITS + digit.x * DIGIT_BITS);
}

fn digit_of(key: u32, span: Span) -> u32 {
    return ((key - span.least) >> span.shift) & (VALUES - 1u);
}

// The first digit's list has places where nothing is drawn.
fn key_count(painted: u32) -> u32 {
    return select(painted, paint_list.places, digit.x == 0u);
}
