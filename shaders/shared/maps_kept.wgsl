// What maps say of a kept surface, as bytes: shares as they are, and the light that is given off as the sRGB of its factor.
@group(0) @binding(12) var<storage, read_write> mapped: array<vec2<u32>>;

fn keep_maps(pixel: u32, surface: Surface) {
    mapped[pixel] = vec2<u32>(pack4x8unorm(vec4<f32>(surface.taken, 0.0)), color_word(vec3<f32>(1.0) - surface.dimmed));
}

fn recall_maps(pixel: u32, surface: ptr<function, Surface>) {
    let words = mapped[pixel];
    (*surface).taken = unpack4x8unorm(words.x).xyz;
    (*surface).dimmed = vec3<f32>(1.0) - linear_color(words.y);
}
