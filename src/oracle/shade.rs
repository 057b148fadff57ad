//! Phong's model with ambient, head, sun and point lights, without shadows.

use glam::DVec3;

use crate::scene::Light;

use super::surface::Surface;

/// Linear RGB, not clamped.
///
/// `albedo · Σ ambient + Σ color · (albedo · n·l + specular · max(0, r·v)^shininess)` over the lights in front of
/// the surface (`n·l > 0`), where `r` is `l` mirrored at the normal and `v` points to the eye. Without
/// lights, without a normal or when the material is unlit, the albedo.
pub fn shade(surface: &Surface, lights: &[Light], eye: DVec3) -> [f64; 3] {
    let normal = surface.normal_world;
    if lights.is_empty() || surface.unlit || normal == DVec3::ZERO {
        return surface.albedo;
    }
    let to_eye = (-surface.way).try_normalize().unwrap_or(DVec3::ZERO);
    let mut sum = [0.0; 3];
    for light in lights {
        let (to_light, color) = match *light {
            Light::Ambient { color } => {
                add(&mut sum, color, 1.0, |channel| surface.albedo[channel]);
                continue;
            }
            Light::Headlight { color } => (to_eye, (color, 1.0)),
            Light::Sun { direction, color, .. } => (-direction, (color, 1.0)),
            Light::Point { position, color, range } => {
                let offset = position - eye - surface.position_from_eye;
                let falloff = 1.0 / (1.0 + (offset.length() / range).powi(2));
                (offset, (color, falloff))
            }
        };
        let to_light = to_light.try_normalize().unwrap_or(DVec3::ZERO);
        let facing = normal.dot(to_light);
        if facing > 0.0 {
            let mirrored = 2.0 * facing * normal - to_light;
            let highlight = mirrored.dot(to_eye).max(0.0).powf(surface.shininess);
            add(&mut sum, color.0, color.1, |channel| {
                surface.albedo[channel] * facing + surface.specular[channel] * highlight
            });
        }
    }
    sum
}

fn add(sum: &mut [f64; 3], color: [f32; 3], strength: f64, reflected: impl Fn(usize) -> f64) {
    for (channel, sum) in sum.iter_mut().enumerate() {
        *sum += f64::from(color[channel]) * strength * reflected(channel);
    }
}
