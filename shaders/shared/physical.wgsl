// Metallic-roughness reflection: Lambert's model under Fresnel's, with the GGX distribution, Smith's height-correlated visibility and Schlick's
// approximation (glTF 2.0, appendix B). As for Phong's model, a white Lambertian surface that faces a light of 1 reflects 1.

//!include shared/transmits

// Smoother surfaces reflect as this rough ones: their lobe would be narrower than single precision can tell.
const LEAST_ROUGHNESS: f32 = 0.045;

// Reflectance at normal incidence.
fn facing_reflectance(albedo: vec3<f32>, material: Material) -> vec3<f32> {
    return mix(material.dielectric, albedo, material.metallic);
}

// At grazing angles.
fn grazing_reflectance(material: Material) -> f32 {
    return mix(material.grazing, 1.0, material.metallic);
}

// The part of the light below the surface that comes back: neither taken up by a metal nor gone through.
fn scattered_share(material: Material) -> f32 {
    let share = 1.0 - material.metallic;
    if TRANSMITS {
        return share * (1.0 - material.transmission);
    }
    return share;
}

// The share of the light from behind that passes (KHR_materials_transmission), straight on: light is not refracted, and roughness does not
// spread it. `n` is zero where the surface has no normal, and then nothing is reflected.
fn passing_light(albedo: vec3<f32>, material: Material, n: vec3<f32>, to_eye: vec3<f32>) -> vec3<f32> {
    let f0 = facing_reflectance(albedo, material);
    let m = 1.0 - clamp(dot(n, to_eye), 0.0, 1.0);
    let fresnel = f0 + (vec3<f32>(grazing_reflectance(material)) - f0) * (m * m * m * m * m);
    let reflected = select(vec3<f32>(0.0), fresnel, any(n != vec3<f32>(0.0)));
    return (vec3<f32>(1.0) - reflected) * albedo * material.volume * (material.transmission * (1.0 - material.metallic));
}

fn reflected_light(albedo: vec3<f32>, material: Material, n: vec3<f32>, to_light: vec3<f32>, to_eye: vec3<f32>) -> vec3<f32> {
    let f0 = facing_reflectance(albedo, material);
    let roughness = max(material.roughness, LEAST_ROUGHNESS);
    let alpha = roughness * roughness;
    let squared = alpha * alpha;
    let nl = max(dot(n, to_light), 0.0);
    let nv = clamp(dot(n, to_eye), 1e-4, 1.0);
    let sum = to_light + to_eye;
    let sum_length = length(sum);
    let h = sum / max(sum_length, 1e-6);
    // 1 − (n·h)² as a cross product: the difference would lose what narrow lobes consist of.
    let nh = dot(n, h);
    let across = cross(n, h);
    // No less than at the middle of the lobe. Where light and eye are opposite there is no half vector, and no facet mirrors one to the other.
    let spread = select(1.0, max(squared * nh * nh + dot(across, across), squared), sum_length > 1e-6);
    let distribution = squared / (spread * spread);
    let visibility = 0.5 / (nl * sqrt(nv * nv * (1.0 - squared) + squared) + nv * sqrt(nl * nl * (1.0 - squared) + squared));
    let m = 1.0 - clamp(dot(to_eye, h), 0.0, 1.0);
    let fresnel = f0 + (vec3<f32>(grazing_reflectance(material)) - f0) * (m * m * m * m * m);
    let diffuse = albedo * scattered_share(material);
    return mix(diffuse, vec3<f32>(distribution * visibility), fresnel) * nl;
}

// A polynomial in the roughness, whose coefficients are cubic in 1 − n·v.
fn polynomial(roughness: f32, u: vec4<f32>, c0: vec4<f32>, c1: vec4<f32>, c2: vec4<f32>, c3: vec4<f32>, c4: vec4<f32>) -> f32 {
    return dot(u, c0 + roughness * (c1 + roughness * (c2 + roughness * (c3 + roughness * c4))));
}

// What the reflection of a white metal adds up to over all directions of light, and the part of it that Fresnel's term makes: fitted to
// the integrals, see crate::oracle::physical::fit.
fn reflectances(roughness: f32, nv: f32) -> vec2<f32> {
    let v = 1.0 - nv;
    let u = vec4<f32>(1.0, v, v * v, v * v * v);
    let all = polynomial(
        roughness,
        u,
        vec4<f32>(1.008, -0.012, -0.133, 0.180),
        vec4<f32>(-0.269, -0.513, 7.245, -7.840),
        vec4<f32>(2.066, 3.320, -40.165, 38.781),
        vec4<f32>(-5.208, -5.971, 63.667, -56.584),
        vec4<f32>(2.705, 3.553, -31.152, 26.215),
    );
    let grazing = polynomial(
        roughness,
        u,
        vec4<f32>(-0.016, 0.409, -1.902, 2.443),
        vec4<f32>(0.094, -1.954, 6.776, -5.331),
        vec4<f32>(-0.162, 2.467, -2.663, -6.284),
        vec4<f32>(0.088, -0.148, -10.135, 22.023),
        vec4<f32>(-0.004, -0.781, 7.973, -12.886),
    );
    let bounded = clamp(all, 0.0, 1.0);
    return vec2<f32>(bounded, clamp(grazing, 0.0, bounded));
}

// What a surface reflects of light from all directions: the part that facets mirror once, and the part that is scattered below the surface, or between
// facets more than once (Fdez-Agüera 2019, equations 15 to 20).
struct AmbientShares {
    mirrored: vec3<f32>,
    scattered: vec3<f32>,
}

fn ambient_shares(albedo: vec3<f32>, material: Material, n: vec3<f32>, to_eye: vec3<f32>) -> AmbientShares {
    let f0 = facing_reflectance(albedo, material);
    let share = reflectances(clamp(material.roughness, 0.0, 1.0), clamp(dot(n, to_eye), 0.0, 1.0));
    let f90 = vec3<f32>(grazing_reflectance(material));
    let once = f0 * (share.x - share.y) + f90 * share.y;
    let missing = 1.0 - share.x;
    let mean = f0 + (f90 - f0) / 21.0;
    let again = missing * once * mean / (vec3<f32>(1.0) - mean * missing);
    let diffuse = albedo * scattered_share(material);
    return AmbientShares(once, again + diffuse * (vec3<f32>(1.0) - once - again));
}

// The direction from which most of the light comes that a surface mirrors towards the eye: the rougher it is, the nearer to the normal (Lagarde & de
// Rousiers 2014, listing 21). A bent normal that looks away from the eye mirrors what lies straight behind, as at the rim.
fn mirrored_direction(n: vec3<f32>, to_eye: vec3<f32>, roughness: f32) -> vec3<f32> {
    let smoothness = 1.0 - roughness * roughness;
    return mix(n, 2.0 * max(dot(n, to_eye), 0.0) * n - to_eye, smoothness * (sqrt(smoothness) + 1.0 - smoothness));
}

// By a surface that looks everywhere: without highlights, a metal's colour is that of what it reflects.
fn reflected_by_ball(albedo: vec3<f32>, material: Material) -> vec3<f32> {
    let f0 = facing_reflectance(albedo, material);
    return f0 + albedo * (1.0 - material.metallic) * (vec3<f32>(1.0) - f0);
}
