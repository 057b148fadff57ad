// sRGB ↔ linear light (IEC 61966-2-1). The powers are replaced by polynomials that cost a fifth where there is no hardware
// for them; the error is below 6e-6 in linear light, and below 0.01 of a step of 8-bit sRGB.
fn linear_from_srgb(c: vec3<f32>) -> vec3<f32> {
    let low = c / 12.92;
    var high = vec3<f32>(-0.055621093);
    high = fma(high, c, vec3<f32>(0.22988621));
    high = fma(high, c, vec3<f32>(-0.43861118));
    high = fma(high, c, vec3<f32>(0.7195014));
    high = fma(high, c, vec3<f32>(0.5106837));
    high = fma(high, c, vec3<f32>(0.033245756));
    high = fma(high, c, vec3<f32>(0.0009095954));
    return select(high, low, c <= vec3<f32>(0.04045));
}

// The polynomial is in powers of the fourth root.
fn srgb_from_linear(c: vec3<f32>) -> vec3<f32> {
    let clamped = clamp(c, vec3<f32>(0.0), vec3<f32>(1.0));
    let low = clamped * 12.92;
    let half = sqrt(clamped);
    let quarter = sqrt(half);
    var high = vec3<f32>(0.081327724);
    high = fma(high, quarter, vec3<f32>(-0.33549595));
    high = fma(high, quarter, vec3<f32>(1.1226766));
    high = fma(high, quarter, vec3<f32>(0.19613774));
    high = fma(high, quarter, vec3<f32>(-0.06461178));
    return select(high, low, clamped <= vec3<f32>(0.0031308));
}

// An opaque linear colour as sRGB8.
fn color_word(c: vec3<f32>) -> u32 {
    return pack4x8unorm(vec4<f32>(srgb_from_linear(c), 1.0));
}

fn linear_color(word: u32) -> vec3<f32> {
    return linear_from_srgb(unpack4x8unorm(word).rgb);
}
