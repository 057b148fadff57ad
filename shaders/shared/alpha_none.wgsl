// No material of the scene cuts holes: coverage needs no texture.
//!include shared/material

struct AlphaTest {
    unused: u32,
}

fn alpha_test(chunk: Chunk, instance: u32, corners: vec3<u32>, a: vec3<f32>, b: vec3<f32>, c: vec3<f32>) -> AlphaTest {
    return AlphaTest(0u);
}

fn alpha_passes(test: AlphaTest, ray: vec3<f32>) -> bool {
    return true;
}
