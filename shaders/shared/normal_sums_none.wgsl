// No normals are blended.
fn add_normal(pixel: u32, normal: vec3<u32>, depth: u32) {
}
