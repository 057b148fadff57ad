// No image of surroundings lights surfaces.
const ENVIRONMENT: bool = false;

const SCATTERED: u32 = 0u;
const BALL_SEEN: u32 = 0u;

fn environment_at(direction: vec3<f32>, image: u32) -> vec3<f32> {
    return vec3<f32>(0.0);
}

fn mirrored_environment(direction: vec3<f32>, roughness: f32) -> vec3<f32> {
    return vec3<f32>(0.0);
}
