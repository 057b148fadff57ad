// What a splat does at a pixel of the visibility buffer: its surface, moved back by the offset.
struct Paint {
    unused: u32,
}

fn paint_of(slot: SplatSlot, sample: u32) -> Paint {
    return Paint(0u);
}

fn emit(splat: Splat, paint: Paint, pixel: u32, d: vec2<f32>, q: f32) {
    visibility_write(pixel, kept_inverse(splat, splat_inverse(splat, d)), splat.id);
}
