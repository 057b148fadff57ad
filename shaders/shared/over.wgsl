// The word of a pixel that shows `over`, whose colour is linear and multiplied by alpha, before what the pixel showed.
fn word_over(over: vec4<f32>, word: u32) -> u32 {
    let below = unpack4x8unorm(word).a * (1.0 - over.a);
    let alpha = over.a + below;
    let color = (over.rgb + below * linear_color(word)) / alpha;
    return pack4x8unorm(vec4<f32>(srgb_from_linear(color), alpha));
}
