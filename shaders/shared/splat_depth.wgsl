// A splat at a pixel of the visibility buffer: its surface, moved back by the offset.
struct Paint {
    unused: u32,
}

struct PaintSlot {
    unused: u32,
}

fn paint_slot(slot: SplatSlot) -> PaintSlot {
    return PaintSlot(0u);
}

fn paint_of(slot: SplatSlot, shared_paint: PaintSlot, sample: u32) -> Paint {
    return Paint(0u);
}

fn emit(splat: Splat, paint: Paint, pixel: u32, d: vec2<f32>, q: f32) -> bool {
    visibility_write(pixel, kept_inverse(splat, splat_inverse(splat, d)), splat.id);
    return true;
}
