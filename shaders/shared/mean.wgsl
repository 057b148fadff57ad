// Means of the words of pixels, in linear light and weighted by alpha.
//!include shared/colour

// The colour of a pixel times alpha, and alpha.
fn light_of(word: u32) -> vec4<f32> {
    let alpha = unpack4x8unorm(word).a;
    return vec4<f32>(linear_color(word) * alpha, alpha);
}

// The mean of `count` pixels with this sum. Pixels without alpha all show the same background, `nothing`.
fn word_of_mean(sum: vec4<f32>, count: f32, nothing: u32) -> u32 {
    if sum.a > 0.0 {
        return pack4x8unorm(vec4<f32>(srgb_from_linear(sum.rgb / sum.a), sum.a / count));
    }
    return nothing;
}
