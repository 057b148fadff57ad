// Materials with an alpha cut-off: a pixel is covered where vertex · base · texture alpha reaches it. Cut-off and alpha are the
// asset's own: the alpha of an instance's colour says how much is hidden of what they leave. Where the asset blends, the cut-off
// leaves out fragments without alpha, so that there the alpha is that of the instance's colour.
//!include shared/material
//!include shared/colour
//!include shared/barycentric
//!include shared/texture

@group(1) @binding(5) var<storage, read> textures: array<Texture>;
@group(1) @binding(6) var<storage, read> texels_0: array<u32>;
@group(1) @binding(7) var<storage, read> texels_1: array<u32>;

struct AlphaTest {
    // 0 where the material cuts nothing.
    cutoff: f32,
    texture: u32,
    alpha: vec3<f32>,
    form: Barycentric,
    uv_a: vec2<f32>,
    uv_b: vec2<f32>,
    uv_c: vec2<f32>,
}

fn corner_alpha(word: u32) -> f32 {
    return unpack4x8unorm(vertices[word + 3u]).a;
}

fn corner_uv(word: u32) -> vec2<f32> {
    return vec2<f32>(bitcast<f32>(vertices[word + 5u]), bitcast<f32>(vertices[word + 6u]));
}

fn alpha_test(chunk: Chunk, instance: u32, corners: vec3<u32>, a: vec3<f32>, b: vec3<f32>, c: vec3<f32>) -> AlphaTest {
    var test: AlphaTest;
    let own = materials[chunk.material];
    let material = effective_material(own, instances[instance].material);
    if (material.flags & MATERIAL_ALPHA_TEST) == 0u {
        return test;
    }
    let base_alpha = select(material.base_color.a, own.base_color.a, (own.flags & MATERIAL_SOLID) != 0u);
    test.cutoff = material.alpha_cutoff;
    test.texture = material.texture;
    test.alpha = vec3<f32>(corner_alpha(corners.x), corner_alpha(corners.y), corner_alpha(corners.z)) * base_alpha;
    test.form = barycentric_forms(a, b, c);
    test.uv_a = corner_uv(corners.x);
    test.uv_b = corner_uv(corners.y);
    test.uv_c = corner_uv(corners.z);
    return test;
}

fn alpha_passes(test: AlphaTest, ray: vec3<f32>) -> bool {
    if test.cutoff <= 0.0 {
        return true;
    }
    let w = barycentric_weights(test.form, ray);
    var alpha = test.alpha.x + w.b * (test.alpha.y - test.alpha.x) + w.c * (test.alpha.z - test.alpha.x);
    if test.texture != 0u {
        let ab = test.uv_b - test.uv_a;
        let ac = test.uv_c - test.uv_a;
        alpha *= sample_texture(
            textures[test.texture - 1u],
            test.uv_a + w.b * ab + w.c * ac,
            w.dx.x * ab + w.dx.y * ac,
            w.dy.x * ab + w.dy.y * ac,
        ).a;
    }
    return alpha >= test.cutoff;
}
