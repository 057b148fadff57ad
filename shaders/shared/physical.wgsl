// Metallic-roughness reflection: Lambert's model under Fresnel's, with the GGX distribution, Smith's height-correlated visibility and Schlick's
// approximation (glTF 2.0, appendix B). As for Phong's model, a white Lambertian surface that faces a light of 1 reflects 1.

// Smoother surfaces reflect as this rough ones: their lobe would be narrower than single precision can tell.
const LEAST_ROUGHNESS: f32 = 0.045;

// Reflectance at normal incidence.
fn facing_reflectance(albedo: vec3<f32>, material: Material) -> vec3<f32> {
    return mix(material.dielectric, albedo, material.metallic);
}

fn reflected_light(albedo: vec3<f32>, material: Material, n: vec3<f32>, to_light: vec3<f32>, to_eye: vec3<f32>) -> vec3<f32> {
    let f0 = facing_reflectance(albedo, material);
    let roughness = max(material.roughness, LEAST_ROUGHNESS);
    let alpha = roughness * roughness;
    let squared = alpha * alpha;
    let nl = max(dot(n, to_light), 0.0);
    let nv = clamp(dot(n, to_eye), 1e-4, 1.0);
    let sum = to_light + to_eye;
    let h = sum / max(length(sum), 1e-6);
    // 1 − (n·h)² as a cross product: the difference would lose what narrow lobes consist of.
    let nh = dot(n, h);
    let across = cross(n, h);
    let spread = squared * nh * nh + dot(across, across);
    let distribution = squared / max(spread * spread, 1e-20);
    let visibility = 0.5 / (nl * sqrt(nv * nv * (1.0 - squared) + squared) + nv * sqrt(nl * nl * (1.0 - squared) + squared));
    let m = 1.0 - clamp(dot(to_eye, h), 0.0, 1.0);
    let fresnel = f0 + (vec3<f32>(1.0) - f0) * (m * m * m * m * m);
    let diffuse = albedo * (1.0 - material.metallic);
    return mix(diffuse, vec3<f32>(distribution * visibility), fresnel) * nl;
}

// Under light that is alike from everywhere: the reflectance over all directions (Karis 2014, its analytic form), and what is scattered
// between facets more than once (Fdez-Agüera 2019, equations 15 to 20).
fn reflected_ambient(albedo: vec3<f32>, material: Material, n: vec3<f32>, to_eye: vec3<f32>) -> vec3<f32> {
    let f0 = facing_reflectance(albedo, material);
    let nv = clamp(dot(n, to_eye), 0.0, 1.0);
    let r = material.roughness * vec4<f32>(-1.0, -0.0275, -0.572, 0.022) + vec4<f32>(1.0, 0.0425, 1.04, -0.04);
    let a = min(r.x * r.x, exp2(-9.28 * nv)) * r.x + r.y;
    let scale = -1.04 * a + r.z;
    let bias = 1.04 * a + r.w;
    let once = f0 * scale + vec3<f32>(bias);
    let missing = 1.0 - (scale + bias);
    let mean = f0 + (vec3<f32>(1.0) - f0) / 21.0;
    let again = missing * once * mean / (vec3<f32>(1.0) - mean * missing);
    let diffuse = albedo * (1.0 - material.metallic);
    return once + again + diffuse * (vec3<f32>(1.0) - once - again);
}

// By a surface that looks everywhere: without highlights, a metal's colour is that of what it reflects.
fn reflected_by_ball(albedo: vec3<f32>, material: Material) -> vec3<f32> {
    let f0 = facing_reflectance(albedo, material);
    return f0 + albedo * (1.0 - material.metallic) * (vec3<f32>(1.0) - f0);
}
