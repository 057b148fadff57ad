//! Light of an image of surroundings, from its definition: every mean is an integral over directions.

use std::f64::consts::{PI, TAU};

use glam::{DMat3, DVec3};

use crate::assets::EnvironmentImage;
use crate::scene::Environment;

/// Smoother surfaces reflect as this rough ones.
const LEAST_ROUGHNESS: f64 = 0.045;
/// Directions of an integral from the middle outwards, and around it.
const RINGS: u32 = 48;
const SECTORS: u32 = 64;

/// An image of surroundings, and how a scene has it.
#[derive(Clone, Copy, Debug)]
pub struct Surroundings<'a> {
    pub image: &'a EnvironmentImage,
    pub environment: &'a Environment,
}

impl Surroundings<'_> {
    /// The light of a direction of the world, interpolated between the image's pixels.
    pub fn light(&self, direction: DVec3) -> [f64; 3] {
        let way = (self.environment.image_from_world * direction).normalize_or(DVec3::Y);
        let (width, height) = (self.image.width as i64, self.image.height as i64);
        let x = (way.x.atan2(-way.z) / TAU + 0.5) * width as f64 - 0.5;
        let y = way.y.clamp(-1.0, 1.0).acos() / PI * height as f64 - 0.5;
        let mut sum = [0.0; 3];
        for (column, row) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let (i, j) = (x.floor() as i64 + column, y.floor() as i64 + row);
            let weight = (1.0 - (x - i as f64).abs()) * (1.0 - (y - j as f64).abs());
            let index = j.clamp(0, height - 1) * width + i.rem_euclid(width);
            for (sum, channel) in sum.iter_mut().zip(self.image.radiance[index as usize]) {
                *sum += weight * self.environment.strength * f64::from(channel);
            }
        }
        sum
    }

    /// Light that a white Lambertian surface reflects.
    pub fn falling(&self, normal: DVec3) -> [f64; 3] {
        // The sine squared is distributed evenly where the weight is the cosine.
        self.mean(normal, |share| (share.sqrt().asin(), 1.0))
    }

    /// The mean of [`Surroundings::falling`] over the normals of a cylinder's visible half, each counted as it is seen.
    pub fn falling_on_cylinder(&self, tangent: DVec3, to_eye: DVec3) -> [f64; 3] {
        let Some(facing) = to_eye.reject_from(tangent).try_normalize() else {
            return self.falling(to_eye);
        };
        let aside = tangent.cross(facing);
        let steps = 24;
        let mut sum = [0.0; 3];
        for step in 0..steps {
            let sine = (f64::from(step) + 0.5) / f64::from(steps) * 2.0 - 1.0;
            let normal = facing * (1.0 - sine * sine).sqrt() + aside * sine;
            let light = self.falling(normal);
            sum = std::array::from_fn(|i| sum[i] + light[i] / f64::from(steps));
        }
        sum
    }

    /// What a mirror of a roughness shows in a direction: the mean weighted by GGX's distribution of the half vector and the cosine of the light, for an eye
    /// along the normal (Karis 2013).
    pub fn mirrored(&self, direction: DVec3, roughness: f64) -> [f64; 3] {
        let alpha_squared = roughness.max(LEAST_ROUGHNESS).powi(4);
        self.mean(direction, |share| {
            let half = (alpha_squared * share / (1.0 - share)).sqrt().atan();
            (2.0 * half, (2.0 * half).cos().max(0.0))
        })
    }

    /// A weighted mean over directions about an axis. `ring` takes shares, evenly distributed from 0 to 1, to angles and weights.
    fn mean(&self, axis: DVec3, ring: impl Fn(f64) -> (f64, f64)) -> [f64; 3] {
        let axis = axis.normalize_or(DVec3::Y);
        let (u, v) = axis.any_orthonormal_pair();
        let frame = DMat3::from_cols(u, v, axis);
        let (mut sum, mut weights) = ([0.0; 3], 0.0);
        for i in 0..RINGS {
            let (angle, weight) = ring((f64::from(i) + 0.5) / f64::from(RINGS));
            if weight <= 0.0 {
                continue;
            }
            let (sine, cosine) = angle.sin_cos();
            for j in 0..SECTORS {
                let turn = TAU * (f64::from(j) + 0.5 * f64::from(i % 2)) / f64::from(SECTORS);
                let local = DVec3::new(sine * turn.cos(), sine * turn.sin(), cosine);
                let light = self.light(frame * local);
                sum = std::array::from_fn(|k| sum[k] + weight * light[k]);
                weights += weight;
            }
        }
        sum.map(|channel| channel / weights)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::EnvironmentSource;

    fn environment(strength: f64, image_from_world: DMat3) -> Environment {
        let image = EnvironmentSource::File("sky.hdr".into());
        Environment { image, strength, image_from_world, shown: true }
    }

    /// Light that is a linear function of the direction.
    fn sloping(slope: DVec3) -> EnvironmentImage {
        let (width, height) = (128, 64);
        let light = |i: u32| {
            let turn = TAU * ((f64::from(i % width) + 0.5) / f64::from(width) - 0.5);
            let down = PI * (f64::from(i / width) + 0.5) / f64::from(height);
            let way = DVec3::new(down.sin() * turn.sin(), down.cos(), -down.sin() * turn.cos());
            [(1.0 + slope.dot(way)) as f32; 3]
        };
        EnvironmentImage { width, height, radiance: (0..width * height).map(light).collect() }
    }

    #[test]
    fn directions_find_their_pixels() {
        let slope = DVec3::new(0.2, 0.5, -0.3);
        let (image, upright) = (sloping(slope), environment(2.0, DMat3::IDENTITY));
        let surroundings = Surroundings { image: &image, environment: &upright };
        for way in [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::Z, DVec3::new(0.48, -0.6, 0.64)] {
            let found = surroundings.light(way)[0];
            // Above the uppermost row there is nothing to interpolate with.
            let bound = if way == DVec3::Y { 0.03 } else { 2e-3 };
            assert!((found - 2.0 * (1.0 + slope.dot(way))).abs() < bound, "{way}: {found}");
        }
        let turned = environment(1.0, DMat3::from_rotation_y(-0.5 * PI));
        let found = Surroundings { image: &image, environment: &turned }.light(DVec3::NEG_X)[1];
        // Surroundings that are turned to the left show at the left what lay ahead.
        assert!((found - (1.0 + slope.dot(DVec3::NEG_Z))).abs() < 2e-3, "{found}");
    }

    /// A Lambertian surface sees two thirds of a linear slope.
    #[test]
    fn means_are_those_of_linear_light() {
        let slope = DVec3::new(0.0, 0.6, 0.3);
        let (image, own) = (sloping(slope), environment(1.0, DMat3::IDENTITY));
        let surroundings = Surroundings { image: &image, environment: &own };
        for normal in [DVec3::Y, DVec3::NEG_X, DVec3::new(0.6, 0.0, 0.8)] {
            let found = surroundings.falling(normal)[0];
            assert!((found - (1.0 + slope.dot(normal) * 2.0 / 3.0)).abs() < 1e-3, "{found}");
            let sharp = surroundings.mirrored(normal, 0.0)[2];
            assert!((sharp - (1.0 + slope.dot(normal))).abs() < 2e-3, "{sharp}");
        }
        // Of a cylinder's visible half the mean normal is π / 4 long.
        let found = surroundings.falling_on_cylinder(DVec3::X, DVec3::Y)[0];
        assert!((found - (1.0 + 0.6 * PI / 6.0)).abs() < 2e-3, "{found}");
        let end_on = surroundings.falling_on_cylinder(DVec3::Y, DVec3::Y);
        assert_eq!(end_on, surroundings.falling(DVec3::Y));
    }

    /// A sky over ground, with a lamp of some width.
    fn lit_sky() -> EnvironmentImage {
        let mut image = sloping(DVec3::new(0.0, 0.6, 0.0));
        for y in 8..16 {
            for x in 70..86 {
                image.radiance[y * 128 + x] = [12.0; 3];
            }
        }
        image
    }

    /// What a surface mirrors is not exactly the product of its reflectance and of a blurred image. The errors against the integral over the same reflection,
    /// relative to its root mean square, are less in the direction of most light than in the mirrored one.
    #[test]
    fn mirrored_light_is_near_the_integral() {
        use super::super::physical::Reflection;
        let (image, own) = (lit_sky(), environment(1.0, DMat3::IDENTITY));
        let surroundings = Surroundings { image: &image, environment: &own };
        let (width, height) = (128, 64);
        let directions: Vec<(DVec3, f64, f64)> = (0..width * height)
            .map(|i| {
                let turn = TAU * ((f64::from(i % width) + 0.5) / f64::from(width) - 0.5);
                let down = PI * (f64::from(i / width) + 0.5) / f64::from(height);
                let way = DVec3::new(down.sin() * turn.sin(), down.cos(), -down.sin() * turn.cos());
                let solid_angle = down.sin() * TAU / f64::from(width) * PI / f64::from(height);
                (way, solid_angle, image.radiance[i as usize][0].into())
            })
            .collect();
        for (roughness, bound) in [(0.3, 0.15), (0.5, 0.18), (0.75, 0.13), (1.0, 0.07)] {
            let metal = Reflection {
                metallic: 1.0,
                roughness,
                dielectric: [0.04; 3],
                grazing: 1.0,
                transmission: None,
            };
            let (mut errors, mut sums) = ([0.0, 0.0], 0.0);
            for step in 0..120 {
                let turn = 2.4 * f64::from(step);
                let z = (f64::from(step) + 0.5) / 60.0 - 1.0;
                let normal = DVec3::new(
                    (1.0 - z * z).sqrt() * turn.cos(),
                    z,
                    (1.0 - z * z).sqrt() * turn.sin(),
                );
                let facing = 0.1 + 0.9 * f64::from(step * 37 % 120) / 119.0;
                let aside = normal.any_orthonormal_vector();
                let to_eye = normal * facing + aside * (1.0 - facing * facing).sqrt();
                let exact: f64 = directions
                    .iter()
                    .map(|(way, solid_angle, light)| {
                        metal.towards_eye(1.0, 0, [normal, *way, to_eye]) * solid_angle / PI * light
                    })
                    .sum();
                let white: f64 = directions
                    .iter()
                    .map(|(way, solid_angle, _)| {
                        metal.towards_eye(1.0, 0, [normal, *way, to_eye]) * solid_angle / PI
                    })
                    .sum();
                let mirrored = 2.0 * facing * normal - to_eye;
                let most = metal.direction_of_most(normal, to_eye);
                for (error, direction) in errors.iter_mut().zip([mirrored, most]) {
                    let found = white * surroundings.mirrored(direction, roughness)[0];
                    *error += (found - exact).powi(2);
                }
                sums += exact * exact;
            }
            let relative = errors.map(|error| (error / sums).sqrt());
            println!("roughness {roughness}: {relative:.3?}");
            assert!(relative[1] < bound && relative[1] < 0.8 * relative[0], "{relative:?}");
        }
    }
}
