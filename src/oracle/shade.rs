//! Phong's model and that of physical materials with ambient, head, sun and point lights. Suns and point lights cast shadows.

use glam::DVec3;

use crate::scene::Light;

use super::environment::Surroundings;
use super::physical::Reflection;
use super::prepare::Prepared;
use super::surface::{LitAs, Surface};
use super::tone;

/// Linear RGB, not clamped.
///
/// `albedo · Σ ambient + Σ color · (albedo · n·l + specular · max(0, r·v)^shininess)` over the lights in front of
/// the surface (`n·l > 0`), where `r` is `l` mirrored at the normal and `v` points to the eye. Without
/// lights, without a normal or when the material is unlit, the albedo. Ribbons have `|n·l|` in place of `n·l`, and thin lines the
/// mean over a cylinder ([`line()`]). Ambient light, and the albedo of what is not lit, count by [`Surface::open`]. The light of a sun
/// that casts shadows counts by the share of its disc that the place sees. Solids of metallic-roughness materials reflect as
/// [`Reflection`] has it; surroundings are mirrored and scattered by their shares of ambient light. What a surface gives off is added where lights are,
/// and the sum is mapped to what can be shown.
pub fn shade(surface: &Surface, prepared: &Prepared<'_>, eye: DVec3) -> [f64; 3] {
    let lights = prepared.scene.lights;
    let normal = surface.normal_world;
    let is_line = matches!(surface.lit_as, LitAs::Line(_));
    let details = &surface.details;
    let unlit = surface.albedo.map(|channel| channel * surface.open);
    let surroundings = &prepared.scene.surroundings;
    if (lights.is_empty() && surroundings.is_none()) || surface.unlit {
        let passes = details.reflection.and_then(|own| Some((own, own.transmission?)));
        let stays = passes.map_or(1.0, |(own, light)| 1.0 - light.share * (1.0 - own.metallic));
        return unlit.map(|channel| channel * stays);
    }
    if normal == DVec3::ZERO && !is_line {
        return std::array::from_fn(|channel| unlit[channel] + details.emissive[channel]);
    }
    let to_eye = (-surface.way).try_normalize().unwrap_or(DVec3::ZERO);
    let reflection = details.reflection.filter(|_| surface.lit_as == LitAs::Solid);
    let mut sum = details.emissive;
    if let Some(surroundings) = surroundings {
        let open = surface.open * details.unoccluded;
        let [falling, mirrored] = around(surroundings, surface, to_eye, reflection);
        for channel in 0..3 {
            let albedo = surface.albedo[channel];
            let [once, scattered] = reflection.map_or([0.0, albedo], |own| {
                own.of_surroundings(albedo, channel, normal.dot(to_eye))
            });
            sum[channel] += open * (once * mirrored[channel] + scattered * falling[channel]);
        }
    }
    for light in lights {
        let (to_light, color) = match *light {
            Light::Ambient { color } => {
                add(&mut sum, color, surface.open * details.unoccluded, |channel| {
                    let albedo = surface.albedo[channel];
                    reflection.map_or(albedo, |own| {
                        let shares = own.of_surroundings(albedo, channel, normal.dot(to_eye));
                        shares[0] + shares[1]
                    })
                });
                continue;
            }
            // The scene's image says what light it is.
            Light::Surroundings { .. } => continue,
            Light::Headlight { color } => (to_eye, (color, 1.0)),
            Light::Sun { direction, color, .. } => (-direction, (color, 1.0)),
            Light::Point { position, color, range, .. } => {
                let offset = position - eye - surface.position_from_eye;
                let falloff = 1.0 / (1.0 + (offset.length() / range).powi(2));
                (offset, (color, falloff))
            }
        };
        let to_light = to_light.try_normalize().unwrap_or(DVec3::ZERO);
        let facing = normal.dot(to_light);
        let mirrored = 2.0 * facing * normal - to_light;
        let highlight = mirrored.dot(to_eye).max(0.0).powf(surface.shininess);
        let (facing, highlight) = match surface.lit_as {
            LitAs::Solid => (facing, highlight),
            LitAs::Sheet => (facing.abs(), highlight),
            LitAs::Line(tangent) => line(tangent, to_light, to_eye, surface.shininess),
        };
        if facing > 0.0 {
            let strength = color.1 * prepared.lit_share(surface, light);
            add(&mut sum, color.0, strength, |channel| {
                let albedo = surface.albedo[channel];
                reflection.map_or(albedo * facing + surface.specular[channel] * highlight, |own| {
                    own.towards_eye(albedo, channel, [normal, to_light, to_eye])
                })
            });
        }
    }
    prepared.scene.tone.map_or(sum, |tone| tone::mapped(sum, &tone))
}

/// Light of surroundings that falls on a surface, and that it mirrors.
fn around(
    surroundings: &Surroundings<'_>,
    surface: &Surface,
    to_eye: DVec3,
    reflection: Option<Reflection>,
) -> [[f64; 3]; 2] {
    let normal = surface.normal_world;
    let falling = match surface.lit_as {
        LitAs::Solid => surroundings.falling(normal),
        LitAs::Sheet => {
            let sides = [normal, -normal].map(|normal| surroundings.falling(normal));
            std::array::from_fn(|channel| 0.5 * (sides[0][channel] + sides[1][channel]))
        }
        LitAs::Line(tangent) => surroundings.falling_on_cylinder(tangent, to_eye),
    };
    let mirrored = reflection
        .map(|own| surroundings.mirrored(own.direction_of_most(normal, to_eye), own.roughness));
    [falling, mirrored.unwrap_or_default()]
}

/// The mean of `max(0, n·l)` over the visible half of a cylinder, and about that of its highlight (Mallo et al. 2005; Zöckler et al. 1996
/// take the brightest normal instead). Normals at angles θ from the eye count as they are seen, by cos θ / 2; with the light at φ, the first is
/// `|l⊥| (sin φ + (π − φ) cos φ) / 4`. A highlight has its peak at φ / 2, where its value is `|l⊥| |v⊥| − (l·t)(v·t)`, and falls off around it like
/// a Gaussian of variance `1 / (4 shininess)`; one more than the exponent keeps the mean of wide ones finite.
fn line(tangent: DVec3, to_light: DVec3, to_eye: DVec3, shininess: f64) -> (f64, f64) {
    let (lt, vt) = (to_light.dot(tangent), to_eye.dot(tangent));
    let across = |along: f64| (1.0 - along * along).max(0.0).sqrt();
    let (l, v) = (across(lt), across(vt));
    let cosine = ((to_light.dot(to_eye) - lt * vt) / (l * v).max(1e-12)).clamp(-1.0, 1.0);
    let angle = cosine.acos();
    let mean = l * 0.25 * (angle.sin() + (std::f64::consts::PI - angle) * cosine);
    let peak = (l * v - lt * vt).max(0.0).powf(shininess);
    let width = (std::f64::consts::PI / (2.0 * shininess + 2.0)).sqrt();
    (mean, peak * 0.5 * width * (0.5 * angle).cos())
}

fn add(sum: &mut [f64; 3], color: [f32; 3], strength: f64, reflected: impl Fn(usize) -> f64) {
    for (channel, sum) in sum.iter_mut().enumerate() {
        *sum += f64::from(color[channel]) * strength * reflected(channel);
    }
}
