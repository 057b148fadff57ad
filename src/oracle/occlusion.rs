//! Ambient occlusion from the depths of an image: what the renderer computes, in f64 and from the definitions.
//!
//! [`Occluders::openness`](super::shadow::Occluders::openness) is the truth that this approximates. Tests hold frames against both.
//!
//! The hemisphere above a surface is cut into slices through the direction to the eye (Jimenez et al. 2016). In a slice, an image pixel hides the angles
//! from the place that it shows to a place a thickness behind that (Therrien, Levesque & Gilet 2023). Angles are counted in 32 sectors of equal shares
//! of the cosine-weighted integral over the slice. Two slices with twelve pixels each are looked at from every pixel; the 4 × 4 pixels of a square
//! look in different directions and at different distances, and the mean over 4 × 4 pixels is the result.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use crate::math::View;
use crate::scene::AmbientOcclusion;

const SLICES: usize = 2;
const STEPS: usize = 6;
const SECTORS: usize = 32;
/// How far surfaces reach behind what is seen of them, in radii.
const THICKNESS: f64 = 0.5;
/// Distance from a tangent plane from which on a pixel shows another surface, in radii.
const SAME_SURFACE: f64 = 0.1;
/// Order of the pixels of a square (Bayer 1973), by rows.
const ORDER: [usize; 16] = [0, 8, 2, 10, 12, 4, 14, 6, 3, 11, 1, 9, 15, 7, 13, 5];

/// What the pixels of an image show.
struct Image<'a> {
    view: &'a View,
    depth: &'a [f64],
    /// In view space.
    normal: Vec<DVec3>,
}

/// The share of ambient light that arrives at each pixel, by rows. `depth` is infinite where a pixel shows nothing; `normal`: in world space, of unit length,
/// turned to the eye.
pub fn ambient_shares(
    occlusion: &AmbientOcclusion,
    view: &View,
    depth: &[f64],
    normal: &[DVec3],
) -> Vec<f64> {
    let normal = normal.iter().map(|&normal| view.view_from_world * normal).collect();
    let image = Image { view, depth, normal };
    let open: Vec<f64> = (0..depth.len())
        .into_par_iter()
        .map(|pixel| image.open_at(pixel, occlusion.radius))
        .collect();
    let share =
        |pixel| 1.0 - occlusion.strength * (1.0 - image.mean(pixel, &open, occlusion.radius));
    (0..depth.len()).into_par_iter().map(share).collect()
}

impl Image<'_> {
    fn at(&self, pixel: usize) -> (i64, i64) {
        let width = self.view.width as usize;
        ((pixel % width) as i64, (pixel / width) as i64)
    }

    /// The number of the pixel at a column and row that shows something, and the place in view space that it shows.
    fn seen(&self, (x, y): (i64, i64)) -> Option<(usize, DVec3)> {
        let (width, height) = (i64::from(self.view.width), i64::from(self.view.height));
        if !(0..width).contains(&x) || !(0..height).contains(&y) {
            return None;
        }
        let pixel = (y * width + x) as usize;
        let ray = self.view.ray(DVec2::new(x as f64 + 0.5, y as f64 + 0.5));
        let depth = self.depth[pixel];
        depth.is_finite().then(|| (pixel, self.view.at_depth(ray, depth)))
    }

    fn to_eye(&self, place: DVec3) -> DVec3 {
        (-self.view.towards(place)).try_normalize().unwrap_or(DVec3::Z)
    }

    fn open_at(&self, pixel: usize, radius: f64) -> f64 {
        let (x, y) = self.at(pixel);
        let Some((_, place)) = self.seen((x, y)) else { return 1.0 };
        let to_eye = self.to_eye(place);
        let reach_px = radius * self.view.focal_px.y / self.view.divisor(-place.z);
        let number = ORDER[(y % 4 * 4 + x % 4) as usize];
        let (turn, shift) = (number as f64 / 16.0, (7 * number % 16) as f64 / 16.0);
        let (mut open, mut all) = (0.0, 0.0);
        for slice in 0..SLICES {
            let direction = PI * (slice as f64 + turn) / SLICES as f64;
            let along = DVec2::new(direction.cos(), direction.sin());
            let slice = Slice::new(self.view, along, to_eye, self.normal[pixel]);
            let mut hidden = [false; SECTORS];
            for (side, own_shift) in [(1.0, shift), (-1.0, (shift + 0.5).fract())] {
                for step in 0..STEPS {
                    let share = (step as f64 + own_shift) / STEPS as f64;
                    let offset = along * (side * (share.powf(1.5) * reach_px + 1.0));
                    let at = (DVec2::new(x as f64, y as f64) + 0.5 + offset).floor();
                    let Some((_, seen)) = self.seen((at.x as i64, at.y as i64)) else { continue };
                    let way = seen - place;
                    if way.length() <= radius {
                        let behind = way - self.to_eye(seen) * (THICKNESS * radius);
                        let angles = [way, behind].map(|way| side * way.angle_between(to_eye));
                        slice.hide(angles, &mut hidden);
                    }
                }
            }
            let free = hidden.iter().filter(|hidden| !**hidden).count() as f64 / SECTORS as f64;
            open += free * slice.weight;
            all += slice.weight;
        }
        open / all
    }

    /// The mean over the square around a pixel, as far as it shows the same surface.
    fn mean(&self, pixel: usize, open: &[f64], radius: f64) -> f64 {
        let (x, y) = self.at(pixel);
        let Some((_, place)) = self.seen((x, y)) else { return 1.0 };
        let (mut sum, mut weights) = (0.0, 0.0);
        for (dx, dy) in (-2..2).flat_map(|dy| (-2..2).map(move |dx| (dx, dy))) {
            let Some((other, seen)) = self.seen((x + dx, y + dy)) else { continue };
            let height = (seen - place).dot(self.normal[pixel]).abs();
            let weight = (1.0 - height / (SAME_SURFACE * radius)).max(0.0);
            sum += weight * open[other];
            weights += weight;
        }
        sum / weights
    }
}

/// Angles count from the direction to the eye, positive along the slice's direction in the image.
struct Slice {
    /// Angle of the normal, projected into the slice.
    tilt: f64,
    /// Share of the hemisphere's integral: the length of the projected normal times the integral over the slice.
    weight: f64,
}

impl Slice {
    fn new(view: &View, along: DVec2, to_eye: DVec3, normal: DVec3) -> Slice {
        // View space has y up.
        let across = DVec3::new(along.x / view.focal_px.x, -along.y / view.focal_px.y, 0.0);
        let aside = across.reject_from(to_eye).normalize_or_zero();
        let (up, side) = (normal.dot(to_eye).max(0.0), normal.dot(aside));
        let tilt = side.atan2(up);
        Slice { tilt, weight: up.hypot(side) * (tilt.cos() + tilt * tilt.sin()) }
    }

    /// The integral of cos(t − tilt) |sin t| from the lowest angle above the surface to `angle`, as a share of the whole.
    fn share(&self, angle: f64) -> f64 {
        // An antiderivative for positive angles; |sin t| is odd about 0.
        let half = |t: f64| {
            0.25 * (self.tilt.cos() - (2.0 * t - self.tilt).cos()) + 0.5 * t * self.tilt.sin()
        };
        let integral = |t: f64| if t < 0.0 { -half(t) } else { half(t) };
        let [low, high] = [self.tilt - FRAC_PI_2, self.tilt + FRAC_PI_2];
        (integral(angle.clamp(low, high)) - integral(low)) / (integral(high) - integral(low))
    }

    /// Hides the sectors whose middles lie between two angles.
    fn hide(&self, angles: [f64; 2], hidden: &mut [bool; SECTORS]) {
        let [one, other] = angles.map(|angle| self.share(angle));
        for (sector, hidden) in hidden.iter_mut().enumerate() {
            let middle = (sector as f64 + 0.5) / SECTORS as f64;
            *hidden |= (one.min(other)..=one.max(other)).contains(&middle);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_of_a_slice_are_its_integrals() {
        for tilt in [-1.2, -0.3, 0.0, 0.7, 1.5] {
            let slice = Slice { tilt, weight: 1.0 };
            let (steps, low) = (40_000, tilt - FRAC_PI_2);
            let at = |i: i32| low + PI * (f64::from(i) + 0.5) / f64::from(steps);
            let value = |t: f64| (t - tilt).cos() * t.sin().abs();
            let whole: f64 = (0..steps).map(|i| value(at(i))).sum();
            for end in [steps / 5, steps / 2, 4 * steps / 5] {
                let part: f64 = (0..end).map(|i| value(at(i))).sum();
                let found = slice.share(low + PI * f64::from(end) / f64::from(steps));
                assert!((found - part / whole).abs() < 1e-6, "{tilt} {end}: {found}");
            }
            let expected = whole * PI / f64::from(steps);
            assert!((tilt.cos() + tilt * tilt.sin() - expected).abs() < 1e-6);
        }
    }
}
