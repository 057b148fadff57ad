// Surroundings as octahedral images: for mirrors of each roughness, for light that Lambertian surfaces scatter, and for that of Lambertian balls; see
// `crate::bake::environment`.
//!include shared/halves
const ENVIRONMENT: bool = true;

// Number of images for mirrors. The first is not blurred; from one to the next, the square of the roughness doubles.
const MIRRORED_IMAGES: u32 = 10u;
const SCATTERED: u32 = 10u;
const BALL_SEEN: u32 = 11u;
// Roughness of the first image.
const FIRST_ROUGHNESS: f32 = 0.045;

// Where each image begins, and its side; the factor of all light; then the texels.
@group(1) @binding(13) var<storage, read> environment: array<vec2<u32>>;

fn environment_texel(index: u32) -> vec3<f32> {
    let word = environment[index];
    return vec3<f32>(halves(word.x), halves(word.y).x);
}

// The light of an image in a direction of the world, which need not have unit length, interpolated.
fn environment_at(direction: vec3<f32>, image: u32) -> vec3<f32> {
    let own = environment[image];
    let row = own.y + 2u;
    // Images have a border of a texel.
    let at = (octahedral_place(direction) * 0.5 + vec2<f32>(0.5)) * f32(own.y) + vec2<f32>(0.5);
    let corner = clamp(floor(at), vec2<f32>(0.0), vec2<f32>(f32(own.y)));
    let share = at - corner;
    let first = own.x + u32(corner.y) * row + u32(corner.x);
    let above = mix(environment_texel(first), environment_texel(first + 1u), share.x);
    let below = mix(environment_texel(first + row), environment_texel(first + row + 1u), share.x);
    return mix(above, below, share.y) * bitcast<f32>(environment[BALL_SEEN + 1u].x);
}

// What a mirror of a roughness shows in a direction.
fn mirrored_environment(direction: vec3<f32>, roughness: f32) -> vec3<f32> {
    let number = clamp(2.0 * log2(max(roughness, FIRST_ROUGHNESS) / FIRST_ROUGHNESS), 0.0, f32(MIRRORED_IMAGES - 1u));
    let finer = min(u32(number), MIRRORED_IMAGES - 2u);
    return mix(environment_at(direction, finer), environment_at(direction, finer + 1u), number - f32(finer));
}
