//! Arithmetic with the same bits on every machine.
//!
//! IEEE 754 fixes the results of `+ − × ÷ √` and of rounding, but not those of sine, cosine or arctangent: the platform's library
//! may use different code on different processors. Generated assets are compared byte by byte, so the generators use the
//! polynomials below, which are accurate to 1e-12.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::DVec3;

use crate::scene::random::mix;

/// Sine and cosine of an angle in radians, for |angle| up to a few thousand.
pub fn sin_cos(angle: f64) -> (f64, f64) {
    let quarter = (angle * (1.0 / FRAC_PI_2)).round();
    let r = angle - quarter * FRAC_PI_2;
    let s = r * r;
    // Taylor series about 0, |r| ≤ π/4. The first omitted term is below 1e-13.
    let sine = r
        * (1.0
            + s * (-1.0 / 6.0
                + s * (1.0 / 120.0
                    + s * (-1.0 / 5_040.0
                        + s * (1.0 / 362_880.0
                            + s * (-1.0 / 39_916_800.0 + s * (1.0 / 6_227_020_800.0)))))));
    let cosine = 1.0
        + s * (-0.5
            + s * (1.0 / 24.0
                + s * (-1.0 / 720.0
                    + s * (1.0 / 40_320.0
                        + s * (-1.0 / 3_628_800.0 + s * (1.0 / 479_001_600.0))))));
    match quarter.rem_euclid(4.0) as u8 {
        0 => (sine, cosine),
        1 => (cosine, -sine),
        2 => (-sine, -cosine),
        _ => (-cosine, sine),
    }
}

pub fn sin(angle: f64) -> f64 {
    sin_cos(angle).0
}

pub fn cos(angle: f64) -> f64 {
    sin_cos(angle).1
}

/// The angle of `(x, y)` in −π..=π, 0 for the origin.
pub fn atan2(y: f64, x: f64) -> f64 {
    let (ax, ay) = (x.abs(), y.abs());
    let (low, high) = if ax > ay { (ay, ax) } else { (ax, ay) };
    if high == 0.0 {
        return 0.0;
    }
    // Halving the angle twice brings the slope below 0.199, where few terms of the series suffice.
    let halve = |z: f64| z / (1.0 + (1.0 + z * z).sqrt());
    let z = halve(halve(low / high));
    let s = z * z;
    let series = z
        * (1.0
            + s * (-1.0 / 3.0
                + s * (0.2
                    + s * (-1.0 / 7.0
                        + s * (1.0 / 9.0 + s * (-1.0 / 11.0 + s * (1.0 / 13.0 - s / 15.0)))))));
    let mut angle = 4.0 * series;
    if ay > ax {
        angle = FRAC_PI_2 - angle;
    }
    if x < 0.0 {
        angle = PI - angle;
    }
    if y < 0.0 { -angle } else { angle }
}

/// Pseudo-random number in `[0, 1)` for a lattice point.
pub fn hash_unit(x: i64, y: i64, z: i64, seed: u64) -> f64 {
    let bits = mix(seed ^ mix((x as u64) ^ mix((y as u64) ^ mix(z as u64 ^ 0x5851_f42d))));
    (bits >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
}

/// Smooth noise in −1..1 with features of about one unit (trilinear between lattice values).
pub fn noise(p: DVec3, seed: u64) -> f64 {
    let cell = p.floor();
    let f = p - cell;
    let w = f * f * (DVec3::splat(3.0) - 2.0 * f);
    let [x, y, z] = cell.to_array().map(|c| c as i64);
    let at = |dx, dy, dz| hash_unit(x + dx, y + dy, z + dz, seed);
    let along_x = |dy, dz| lerp(at(0, dy, dz), at(1, dy, dz), w.x);
    let along_y = |dz| lerp(along_x(0, dz), along_x(1, dz), w.y);
    2.0 * lerp(along_y(0), along_y(1), w.z) - 1.0
}

/// `octaves` layers of [`noise`], each with half the feature size and half the amplitude of the previous one.
pub fn fractal(p: DVec3, octaves: u32, seed: u64) -> f64 {
    let (mut sum, mut height, mut q) = (0.0, 0.5, p);
    for octave in 0..octaves {
        sum += height * noise(q, seed.wrapping_add(u64::from(octave)));
        height *= 0.5;
        q = q * 2.0 + DVec3::splat(17.3);
    }
    sum
}

pub fn lerp(a: f64, b: f64, t: f64) -> f64 {
    a + (b - a) * t
}

/// 0 below `low`, 1 above `high`, smooth in between.
pub fn smoothstep(low: f64, high: f64, x: f64) -> f64 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn trigonometry_is_accurate() {
        for i in -4_000..4_000 {
            let angle = f64::from(i) * 0.01;
            let (s, c) = sin_cos(angle);
            assert!((s - angle.sin()).abs() < 2e-12, "sin {angle}");
            assert!((c - angle.cos()).abs() < 2e-12, "cos {angle}");
            let (y, x) = (s * 3.0, c * 3.0);
            assert!((atan2(y, x) - y.atan2(x)).abs() < 1e-11, "atan2 {y} {x}");
        }
        assert_eq!(atan2(0.0, 0.0), 0.0);
        assert_eq!(atan2(0.0, -1.0), PI);
    }

    #[test]
    fn noise_is_continuous_and_bounded() {
        let mut last = noise(DVec3::ZERO, 7);
        for i in 1..5_000 {
            let here = noise(DVec3::new(f64::from(i) * 0.01, 0.3, f64::from(i) * -0.007), 7);
            assert!(here.abs() <= 1.0 && (here - last).abs() < 0.1);
            last = here;
        }
    }
}
