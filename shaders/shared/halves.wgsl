// Two numbers in half precision (IEEE 754, 5 bits of exponent), rounded to the nearest; drivers differ in how they round. Smaller ones than
// the least normal one are 0, and larger ones the most.
const LEAST_HALF: f32 = 6.1035156e-5;
const MOST_HALF: f32 = 60000.0;

fn half_pair(v: vec2<f32>) -> u32 {
    let size = abs(v);
    let bits = bitcast<vec2<u32>>(clamp(size, vec2<f32>(LEAST_HALF), vec2<f32>(MOST_HALF)));
    let rounded = (bits - vec2<u32>(0x37fff000u)) >> vec2<u32>(13u);
    let half = select(rounded | ((bitcast<vec2<u32>>(v) >> vec2<u32>(16u)) & vec2<u32>(0x8000u)), vec2<u32>(0u), size < vec2<f32>(LEAST_HALF));
    return half.x | (half.y << 16u);
}

// The two numbers of a word of `half_pair`. `unpack2x16float` would need a capability beyond the core.
fn halves(word: u32) -> vec2<f32> {
    let half = vec2<u32>(word & 0xffffu, word >> 16u);
    let size = bitcast<vec2<f32>>(((half & vec2<u32>(0x7fffu)) << vec2<u32>(13u)) + vec2<u32>(0x38000000u));
    let signed = select(size, -size, (half & vec2<u32>(0x8000u)) != vec2<u32>(0u));
    return select(signed, vec2<f32>(0.0), half == vec2<u32>(0u));
}
