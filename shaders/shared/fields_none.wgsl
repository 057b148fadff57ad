// Samples and lines have the colours of their file, or those of `painted`.
const SHOWS_FIELD: bool = false;

fn field_color(sample: u32, instance: u32) -> u32 {
    return 0u;
}

fn field_color_between(vertices: vec2<u32>, share: f32, instance: u32) -> u32 {
    return 0u;
}
