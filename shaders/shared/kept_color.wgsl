// Linear colours that wait for a later pass, 16 bits a channel; at most 1, as albedos are.
fn kept_color(c: vec3<f32>) -> vec2<u32> {
    return vec2<u32>(pack2x16unorm(c.rg), pack2x16unorm(vec2<f32>(c.b, 0.0)));
}

fn color_of_kept(words: vec2<u32>) -> vec3<f32> {
    return vec3<f32>(unpack2x16unorm(words.x), unpack2x16unorm(words.y).x);
}
