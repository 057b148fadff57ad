//! Thin lenses and open shutters: the exposures whose mean is a frame with depth of field or motion blur.
//!
//! Each exposure is a sharp image, seen from one point of the lens at one time (P. Haeberli, K. Akeley, *The Accumulation Buffer:
//! Hardware Support for High-Quality Rendering*, SIGGRAPH 1990). A point at distance `z` that is out of focus becomes a disc, the
//! circle of confusion, of `focal_px · aperture · |1 / focus − 1 / z|` pixels.
//!
//! The exposures' places are the first 2ⁿ points of Sobol's sequence (S. Joe, F. Y. Kuo, *Constructing Sobol' Sequences with Better
//! Two-Dimensional Projections*, SIAM J. Sci. Comput. 30, 2008), at the middles of their strata. The time and the two coordinates on the
//! lens are a (0, n, 3)-net: every box of 2⁻ⁿ of their volume whose sides are powers of a half has exactly one point.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

use glam::DVec2;

use super::View;

/// Most exposures of a frame.
pub const MOST_EXPOSURES: u32 = 1 << BITS;
const BITS: usize = 8;

/// Direction numbers of Sobol's sequence, first to fourth dimension.
const DIRECTIONS: [[u32; BITS]; 4] = [
    [1, 1, 1, 1, 1, 1, 1, 1],
    [1, 3, 5, 15, 17, 51, 85, 255],
    [1, 3, 3, 9, 29, 23, 71, 197],
    [1, 3, 1, 5, 31, 29, 81, 147],
];

/// One exposure of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exposure {
    /// When it is taken, as a share of the time for which the shutter is open.
    pub time: f64,
    /// The point of the lens that it is seen from, on the unit disc.
    pub on_lens: DVec2,
    /// Offset of the image in pixels, each coordinate within ±½. Pixels are therefore means over their area.
    pub in_pixel: DVec2,
}

/// The exposures of a frame, in the order of their times. `count` is a power of two, up to [`MOST_EXPOSURES`].
pub fn exposures(count: u32) -> impl Iterator<Item = Exposure> {
    let middle = move |number: u32| (f64::from(number) + 0.5) / f64::from(count);
    (0..count).map(move |index| {
        let [x, y, column, row] = DIRECTIONS.map(|own| middle(sobol(&own, index, count)));
        Exposure {
            time: middle(index),
            on_lens: disc(2.0 * DVec2::new(x, y) - 1.0),
            in_pixel: DVec2::new(column, row) - 0.5,
        }
    })
}

/// Point `index` of the first `count` points of a dimension, as a multiple of `1 / count`.
fn sobol(directions: &[u32; BITS], index: u32, count: u32) -> u32 {
    let bits = count.trailing_zeros() as usize;
    let digits = directions.iter().take(bits).enumerate();
    let chosen = digits.filter(|(digit, _)| index >> digit & 1 == 1);
    chosen.fold(0, |sum, (digit, number)| sum ^ number << (bits - 1 - digit))
}

/// A point of the square ±1 as a point of the unit disc; areas keep their proportions (P. Shirley, K. Chiu, *A Low Distortion Map
/// Between Disk and Square*, J. Graphics Tools 2, 1997).
fn disc(DVec2 { x, y }: DVec2) -> DVec2 {
    let (radius, angle) = if x.abs() > y.abs() {
        (x, FRAC_PI_4 * (y / x))
    } else if y != 0.0 {
        (y, FRAC_PI_2 - FRAC_PI_4 * (x / y))
    } else {
        return DVec2::ZERO;
    };
    DVec2::from_angle(angle) * radius
}

impl View {
    /// This view from a point beside the eye, `offset` scene units to the right and up. What lies in the plane at distance `focus` along the
    /// viewing axis keeps its place in the image. Rays must not be parallel.
    #[must_use]
    pub fn from_lens(&self, offset: DVec2, focus: f64) -> View {
        let axes = self.view_from_world.transpose();
        let shift = self.focal_px * offset / focus;
        View {
            eye: self.eye + axes.x_axis * offset.x + axes.y_axis * offset.y,
            principal_px: self.principal_px + DVec2::new(shift.x, -shift.y),
            ..*self
        }
    }

    /// This view with the image moved by some pixels, to the right and down.
    #[must_use]
    pub fn moved(&self, pixels: DVec2) -> View {
        View { principal_px: self.principal_px + pixels, ..*self }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use glam::DVec3;

    use super::*;
    use crate::math::Camera;

    const COUNTS: [u32; 8] = [2, 4, 8, 16, 32, 64, 128, 256];

    /// The place of a point of the disc on the square; the inverse of [`disc`].
    fn square(point: DVec2) -> DVec2 {
        let radius = point.length();
        let angle = point.y.atan2(point.x);
        let quarter = (angle / FRAC_PI_2).round();
        let along = (angle - quarter * FRAC_PI_2) / FRAC_PI_4 * radius;
        match quarter as i32 {
            0 => DVec2::new(radius, along),
            1 => DVec2::new(-along, radius),
            -1 => DVec2::new(along, -radius),
            _ => DVec2::new(-radius, -along),
        }
    }

    #[test]
    fn every_box_of_the_net_has_one_exposure() {
        for count in COUNTS {
            let bits = count.trailing_zeros();
            let points: Vec<[f64; 3]> = exposures(count)
                .map(|exposure| {
                    let DVec2 { x, y } = 0.5 * square(exposure.on_lens) + 0.5;
                    [exposure.time, x, y]
                })
                .collect();
            for a in 0..=bits {
                for b in 0..=bits - a {
                    let sides = [a, b, bits - a - b];
                    let of = |point: &[f64; 3]| {
                        [0, 1, 2].map(|k| (point[k] * f64::from(1u32 << sides[k])) as u32)
                    };
                    let boxes: BTreeSet<[u32; 3]> = points.iter().map(of).collect();
                    assert_eq!(boxes.len(), count as usize, "{count} {sides:?}");
                }
            }
        }
    }

    #[test]
    fn each_coordinate_takes_the_middle_of_every_stratum_once() {
        for count in COUNTS {
            let strata = |value: fn(&Exposure) -> f64| {
                let scaled = exposures(count).map(|one| value(&one) * f64::from(count));
                let all: Vec<f64> = scaled.collect();
                assert!(all.iter().all(|value| (value.fract() - 0.5).abs() < 1e-9));
                all.into_iter().map(|value| value as u32).collect::<BTreeSet<_>>().len() as u32
            };
            assert_eq!(strata(|one| one.time), count);
            assert_eq!(strata(|one| one.in_pixel.x + 0.5), count);
            assert_eq!(strata(|one| one.in_pixel.y + 0.5), count);
            assert!(exposures(count).all(|one| one.on_lens.length() < 1.0));
            let places: BTreeSet<[u64; 2]> =
                exposures(count).map(|one| one.in_pixel.to_array().map(f64::to_bits)).collect();
            assert_eq!(places.len(), count as usize);
        }
    }

    /// The share of the points within half the radius is a quarter, and their mean is the centre.
    #[test]
    fn points_cover_the_lens_evenly() {
        let points: Vec<DVec2> = exposures(256).map(|exposure| exposure.on_lens).collect();
        let inner = points.iter().filter(|point| point.length() < 0.5).count();
        assert!((60..=68).contains(&inner), "{inner}");
        let mean = points.iter().sum::<DVec2>() / 256.0;
        assert!(mean.length() < 0.01, "{mean}");
        let second = points.iter().map(|point| point.length_squared()).sum::<f64>() / 256.0;
        assert!((second - 0.5).abs() < 0.01, "{second}");
        assert_eq!(disc(DVec2::ZERO), DVec2::ZERO);
    }

    #[test]
    fn what_is_in_focus_stays_and_the_rest_moves_as_a_thin_lens_says() {
        let (eye, target) = (DVec3::new(1.0, 2.0, 3.0), DVec3::new(-1.0, 0.5, 0.0));
        let view = Camera::perspective(eye, target, 40.0).view(640, 480).unwrap();
        let (offset, focus) = (DVec2::new(0.03, -0.02), 2.5);
        let beside = view.from_lens(offset, focus);
        for depth in [1.0, focus, 10.0, 1e6] {
            let world = view.eye
                + view.view_from_world.transpose() * DVec3::new(0.1 * depth, -0.2 * depth, -depth);
            let [before, after] =
                [&view, &beside].map(|view| view.project(view.to_view(world)).unwrap());
            let expected = view.focal_px * offset * (1.0 / focus - 1.0 / depth);
            let moved = (after - before) * DVec2::new(1.0, -1.0);
            assert!((moved - expected).length() < 1e-6, "{depth}: {moved} and {expected}");
        }
        let moved = view.moved(DVec2::new(0.25, -0.5));
        assert_eq!(moved.principal_px, view.principal_px + DVec2::new(0.25, -0.5));
    }
}
