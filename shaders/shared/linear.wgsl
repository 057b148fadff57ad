// A linear function of the offset from a reference place of the image: constant, slopes.
fn linear(form: vec3<f32>, d: vec2<f32>) -> f32 {
    return fma(form.y, d.x, fma(form.z, d.y, form.x));
}
