// Textures as words of four bytes in storage pages, levels one behind the other. Trilinear filtering, of colours in linear light.
struct Texture {
    first: u32,
    page: u32,
    width: u32,
    height: u32,
    levels: u32,
    // Two bits an axis: 0 repeat, 1 mirror, 2 clamp.
    wrap: u32,
    nearest: u32,
    // Bytes are values as they are, not sRGB.
    linear: u32,
}

fn texel_word(page: u32, index: u32) -> u32 {
    if page == 0u {
        return texels_0[index];
    }
    return texels_1[index];
}

// For indices from −size to 3 · size − 1, which is where reduced coordinates lie.
fn wrap_index(mode: u32, i: i32, size: i32) -> i32 {
    // Repeat: whole sizes off. Mirror: the second size runs backwards, and both ends into their neighbours.
    let once = select(i, i + size, i < 0);
    let twice = select(once, once - size, once >= size);
    let repeated = select(twice, twice - size, twice >= size);
    let left = select(i, -1 - i, i < 0);
    let mirrored = select(left, 2 * size - 1 - left, left >= size);
    let inside = select(repeated, select(mirrored, -1 - mirrored, mirrored < 0), mode == 1u);
    return select(inside, clamp(i, 0, size - 1), mode == 2u);
}

fn texel(t: Texture, first: u32, size: vec2<i32>, at: vec2<i32>) -> vec4<f32> {
    let x = wrap_index(t.wrap & 3u, at.x, size.x);
    let y = wrap_index((t.wrap >> 2u) & 3u, at.y, size.y);
    let c = unpack4x8unorm(texel_word(t.page, first + u32(y * size.x + x)));
    return vec4<f32>(select(linear_from_srgb(c.rgb), c.rgb, t.linear != 0u), c.a);
}

// Texture coordinates far outside keep their fraction: the integer part cannot be seen and would cost precision.
fn reduce(mode: u32, u: f32) -> f32 {
    if mode == 2u {
        return clamp(u, -1.0, 2.0);
    }
    return u - 2.0 * floor(u * 0.5);
}

// One of a texture's levels: its first texel and its size.
struct Level {
    first: u32,
    size: vec2<u32>,
}

fn below(l: Level) -> Level {
    return Level(l.first + l.size.x * l.size.y, max(l.size >> vec2<u32>(1u), vec2<u32>(1u)));
}

fn go_down(l: Level, go: bool) -> Level {
    let next = below(l);
    return Level(select(l.first, next.first, go), select(l.size, next.size, go));
}

// Written out: on lavapipe all loops of a thread share 65535 rounds, and a pixel should take none of them.
fn level_of(t: Texture, level: u32) -> Level {
    var l = Level(t.first, vec2<u32>(t.width, t.height));
    l = go_down(l, level > 0u);
    l = go_down(l, level > 1u);
    l = go_down(l, level > 2u);
    l = go_down(l, level > 3u);
    l = go_down(l, level > 4u);
    l = go_down(l, level > 5u);
    l = go_down(l, level > 6u);
    l = go_down(l, level > 7u);
    l = go_down(l, level > 8u);
    l = go_down(l, level > 9u);
    l = go_down(l, level > 10u);
    l = go_down(l, level > 11u);
    l = go_down(l, level > 12u);
    l = go_down(l, level > 13u);
    return go_down(l, level > 14u);
}

fn sample_level(t: Texture, level: Level, uv: vec2<f32>) -> vec4<f32> {
    let s = vec2<i32>(level.size);
    let p = uv * vec2<f32>(level.size) - vec2<f32>(0.5);
    let base = floor(p);
    let f = p - base;
    let i = vec2<i32>(base);
    let top = mix(texel(t, level.first, s, i), texel(t, level.first, s, i + vec2<i32>(1, 0)), f.x);
    let bottom = mix(texel(t, level.first, s, i + vec2<i32>(0, 1)), texel(t, level.first, s, i + vec2<i32>(1, 1)), f.x);
    return mix(top, bottom, f.y);
}

// `dx` and `dy`: what a step of one pixel covers, in texels.
fn sample_trilinear(t: Texture, uv: vec2<f32>, dx: vec2<f32>, dy: vec2<f32>) -> vec4<f32> {
    let footprint = sqrt(max(dot(dx, dx), dot(dy, dy)));
    let level = clamp(log2(max(footprint, 1e-20)), 0.0, f32(t.levels - 1u));
    let low = floor(level);
    let near = level_of(t, u32(low));
    let far = go_down(near, u32(low) + 1u < t.levels);
    return mix(sample_level(t, near, uv), sample_level(t, far, uv), level - low);
}

fn sample_texture(t: Texture, uv_in: vec2<f32>, dx: vec2<f32>, dy: vec2<f32>) -> vec4<f32> {
    let uv = vec2<f32>(reduce(t.wrap & 3u, uv_in.x), reduce((t.wrap >> 2u) & 3u, uv_in.y));
    let size = vec2<f32>(f32(t.width), f32(t.height));
    if t.nearest != 0u {
        return texel(t, t.first, vec2<i32>(size), vec2<i32>(floor(uv * size)));
    }
    return sample_trilinear(t, uv, dx * size, dy * size);
}
