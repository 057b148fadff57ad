// Splats keep their own colours: there are no lights, or pixels are lit once all is blended.
const LIT: bool = false;

fn lit(color: vec3<f32>, normal: vec3<f32>, ball: bool, over_plus_one: u32, slot: SplatSlot, sample: u32) -> vec3<f32> {
    return color;
}
