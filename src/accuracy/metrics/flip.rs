//! FLIP: the difference that a person sees when two images alternate in one place.
//!
//! Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström and Fairchild, *FLIP: A Difference Evaluator for Alternating Images* (HPG
//! 2020), for images of low dynamic range.
//!
//! ```text
//! sRGB ─► YCxCz ─► contrast sensitivity filter ─► L*a*b*, Hunt ─► HyAB ─► colour difference ─┐
//!           └ Y ─► edges and points (Gaussian derivatives) ─► feature difference ────────────┴► colour ^ (1 − feature)
//! ```
//! All filters are separable and continue the border's pixels. The reference implementation computes in f32, this one in f64: means
//! agree to 1e-5.

use std::f64::consts::PI;

use rayon::prelude::*;

use super::{SizeMismatch, check};
use crate::scene::color::linear_from_srgb;

/// Pixels per degree of visual angle that the paper assumes: a monitor of 3840 pixels on 0.7 m, seen from 0.7 m.
pub const PIXELS_PER_DEGREE: f64 = 67.0;

/// Exponent of the HyAB distance, and the share of the largest distance that maps to [`MAPPED`].
const DISTANCE_EXPONENT: f64 = 0.7;
const SHARE: f64 = 0.4;
const MAPPED: f64 = 0.95;
/// Width of the feature filters in degrees, and the exponent of feature differences.
const FEATURE_WIDTH_DEG: f64 = 0.082;
const FEATURE_EXPONENT: f64 = 0.5;
/// The largest variance parameter of the contrast sensitivity functions, which sets the reach of their filters.
const WIDEST: f64 = 0.04;

type Triple = [f64; 3];

/// Mean FLIP value over all pixels: 0 for equal images, at most 1.
///
/// # Errors
/// A slice is not `width · height` long.
pub fn flip(
    reference: &[[u8; 4]],
    image: &[[u8; 4]],
    width: u32,
    height: u32,
) -> Result<f64, SizeMismatch> {
    let map = flip_map(reference, image, width, height, PIXELS_PER_DEGREE)?;
    Ok(map.iter().sum::<f64>() / map.len().max(1) as f64)
}

/// FLIP value of each pixel, row by row, in 0..=1. `pixels_per_degree` is the resolution of the display as the eye sees it.
///
/// # Errors
/// A slice is not `width · height` long.
pub fn flip_map(
    reference: &[[u8; 4]],
    image: &[[u8; 4]],
    width: u32,
    height: u32,
    pixels_per_degree: f64,
) -> Result<Vec<f64>, SizeMismatch> {
    check(reference, image, Some((width, height)))?;
    if reference.is_empty() {
        return Ok(Vec::new());
    }
    let size = (width as usize, height as usize);
    let (a, b) = rayon::join(
        || Seen::new(reference, size, pixels_per_degree),
        || Seen::new(image, size, pixels_per_degree),
    );
    let largest = hyab(hunt([0.0, 1.0, 0.0]), hunt([0.0, 0.0, 1.0])).powf(DISTANCE_EXPONENT);
    let pixel = |i: usize| {
        let color = colour_difference(a.lab[i], b.lab[i], largest);
        let edges = (a.edges[i] - b.edges[i]).abs();
        let points = (a.points[i] - b.points[i]).abs();
        let feature = (edges.max(points) / 2f64.sqrt()).powf(FEATURE_EXPONENT);
        color.powf(1.0 - feature)
    };
    Ok((0..reference.len()).into_par_iter().map(pixel).collect())
}

/// An image as the eye sees it.
struct Seen {
    /// Filtered colours in L*a*b*, with Hunt's adjustment of a* and b*.
    lab: Vec<Triple>,
    /// Strength of edges and points.
    edges: Vec<f64>,
    points: Vec<f64>,
}

impl Seen {
    fn new(image: &[[u8; 4]], size: (usize, usize), pixels_per_degree: f64) -> Seen {
        let linear: [f64; 256] = std::array::from_fn(|byte| linear_from_srgb(byte as f64 / 255.0));
        let opponent: Vec<Triple> = image
            .par_iter()
            .map(|&[r, g, b, _]| ycxcz_of_linear([r, g, b].map(|byte| linear[usize::from(byte)])))
            .collect();
        let plane = |channel: usize| opponent.iter().map(|c| c[channel]).collect::<Vec<f64>>();
        let luminance = plane(0);
        let [achromatic, red_green, blue_yellow] = sensitivity(pixels_per_degree);
        let filtered = [
            achromatic.apply(&luminance, size),
            red_green.apply(&plane(1), size),
            blue_yellow.apply(&plane(2), size),
        ];
        let lab = (0..image.len()).into_par_iter().map(|i| {
            let linear = linear_of_ycxcz(std::array::from_fn(|channel| filtered[channel][i]));
            hunt(linear.map(|channel| channel.clamp(0.0, 1.0)))
        });
        let features = Features::new(pixels_per_degree);
        let grey: Vec<f64> = luminance.iter().map(|y| (y + 16.0) / 116.0).collect();
        let strength = |kernel: &[f64]| {
            let across = convolve(&grey, size, kernel, &features.smooth);
            let down = convolve(&grey, size, &features.smooth, kernel);
            across.into_iter().zip(down).map(|(x, y)| x.hypot(y)).collect::<Vec<f64>>()
        };
        Seen {
            lab: lab.collect(),
            edges: strength(&features.edge),
            points: strength(&features.point),
        }
    }
}

/// A sum of separable Gaussians: for each, its share of the total weight, and a kernel whose sum is 1.
struct Sensitivity(Vec<(f64, Vec<f64>)>);

impl Sensitivity {
    fn new(gaussians: &[(f64, f64)], pixels_per_degree: f64) -> Sensitivity {
        let reach = (3.0 * (WIDEST / (2.0 * PI * PI)).sqrt() * pixels_per_degree).ceil() as i64;
        let mut kernels = Vec::with_capacity(gaussians.len());
        for &(height, variance) in gaussians {
            let value = |at: i64| {
                let degrees = at as f64 / pixels_per_degree;
                (-PI * PI * degrees * degrees / variance).exp()
            };
            let kernel: Vec<f64> = (-reach..=reach).map(value).collect();
            let sum: f64 = kernel.iter().sum();
            let weight = height * (PI / variance).sqrt() * sum * sum;
            kernels.push((weight, kernel.into_iter().map(|value| value / sum).collect()));
        }
        let total: f64 = kernels.iter().map(|(weight, _)| weight).sum();
        Sensitivity(kernels.into_iter().map(|(weight, kernel)| (weight / total, kernel)).collect())
    }

    fn apply(&self, plane: &[f64], size: (usize, usize)) -> Vec<f64> {
        let mut sum = vec![0.0; plane.len()];
        for (weight, kernel) in &self.0 {
            let part = convolve(plane, size, kernel, kernel);
            sum.iter_mut().zip(part).for_each(|(sum, part)| *sum += weight * part);
        }
        sum
    }
}

/// Contrast sensitivity functions of the achromatic, the red–green and the blue–yellow channel (table 1 of the paper).
fn sensitivity(pixels_per_degree: f64) -> [Sensitivity; 3] {
    [&[(1.0, 0.0047)][..], &[(1.0, 0.0053)], &[(34.1, 0.04), (13.5, 0.025)]]
        .map(|gaussians| Sensitivity::new(gaussians, pixels_per_degree))
}

/// Kernels of the feature filters: a Gaussian, its negative first derivative and its second one. Positive weights of each sum to 1,
/// negative ones to −1.
struct Features {
    smooth: Vec<f64>,
    edge: Vec<f64>,
    point: Vec<f64>,
}

impl Features {
    fn new(pixels_per_degree: f64) -> Features {
        let deviation = 0.5 * FEATURE_WIDTH_DEG * pixels_per_degree;
        let reach = (3.0 * deviation).ceil() as i64;
        let places = || (-reach..=reach).map(|at| at as f64);
        let gaussian = |at: f64| (-at * at / (2.0 * deviation * deviation)).exp();
        let balanced = |kernel: Vec<f64>| {
            let positive: f64 = kernel.iter().filter(|value| **value > 0.0).sum();
            let negative: f64 = -kernel.iter().filter(|value| **value < 0.0).sum::<f64>();
            let scaled = |value: f64| value / if value > 0.0 { positive } else { negative };
            kernel.into_iter().map(|value| if value == 0.0 { 0.0 } else { scaled(value) }).collect()
        };
        Features {
            smooth: balanced(places().map(gaussian).collect()),
            edge: balanced(places().map(|at| -at * gaussian(at)).collect()),
            point: balanced(
                places()
                    .map(|at| (at * at / (deviation * deviation) - 1.0) * gaussian(at))
                    .collect(),
            ),
        }
    }
}

/// Convolves rows with `across` and columns with `down`. Both have an odd length; the border's pixels continue beyond the border.
fn convolve(
    plane: &[f64],
    (width, height): (usize, usize),
    across: &[f64],
    down: &[f64],
) -> Vec<f64> {
    let along = |kernel: &[f64], at: usize, size: usize, value: &dyn Fn(usize) -> f64| {
        let reach = kernel.len() / 2;
        let place = |tap: usize| (at + tap).saturating_sub(reach).min(size - 1);
        kernel.iter().enumerate().map(|(tap, weight)| weight * value(place(tap))).sum::<f64>()
    };
    let pixels = || (0..width * height).into_par_iter();
    let rows: Vec<f64> = pixels()
        .map(|i| along(across, i % width, width, &|x| plane[i / width * width + x]))
        .collect();
    pixels().map(|i| along(down, i / width, height, &|y| rows[y * width + i % width])).collect()
}

fn colour_difference(a: Triple, b: Triple, largest: f64) -> f64 {
    let distance = hyab(a, b).powf(DISTANCE_EXPONENT);
    let limit = SHARE * largest;
    if distance < limit {
        MAPPED / limit * distance
    } else {
        MAPPED + (distance - limit) / (largest - limit) * (1.0 - MAPPED)
    }
}

/// Distance of two colours (Abasi et al. 2020).
fn hyab([l, a, b]: Triple, other: Triple) -> f64 {
    (l - other[0]).abs() + (a - other[1]).hypot(b - other[2])
}

/// L*a*b* of a linear colour. Dark colours look less saturated (Hunt 1952).
fn hunt(linear: Triple) -> Triple {
    let [l, a, b] = lab(linear);
    [l, 0.01 * l * a, 0.01 * l * b]
}

/// Rows: X, Y and Z of linear sRGB, as the reference implementation has them.
const XYZ_OF_RGB: [Triple; 3] = [
    [10_135_552.0 / 24_577_794.0, 8_788_810.0 / 24_577_794.0, 4_435_075.0 / 24_577_794.0],
    [2_613_072.0 / 12_288_897.0, 8_788_810.0 / 12_288_897.0, 887_015.0 / 12_288_897.0],
    [1_425_312.0 / 73_733_382.0, 8_788_810.0 / 73_733_382.0, 70_074_185.0 / 73_733_382.0],
];

fn times(rows: &[Triple; 3], v: Triple) -> Triple {
    rows.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

/// X, Y and Z of white.
fn white() -> Triple {
    XYZ_OF_RGB.map(|row| row.iter().sum())
}

/// Coordinates relative to white.
fn relative(linear: Triple) -> Triple {
    let (xyz, white) = (times(&XYZ_OF_RGB, linear), white());
    std::array::from_fn(|i| xyz[i] / white[i])
}

fn ycxcz_of_linear(linear: Triple) -> Triple {
    let [x, y, z] = relative(linear);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

fn linear_of_ycxcz([luminance, cx, cz]: Triple) -> Triple {
    let y = (luminance + 16.0) / 116.0;
    let relative = [y + cx / 500.0, y, y - cz / 200.0];
    let white = white();
    let xyz = glam::DVec3::from(std::array::from_fn::<f64, 3, _>(|i| relative[i] * white[i]));
    let rgb_of_xyz = glam::DMat3::from_cols_array_2d(&XYZ_OF_RGB).transpose().inverse();
    (rgb_of_xyz * xyz).into()
}

fn lab(linear: Triple) -> Triple {
    let delta: f64 = 6.0 / 29.0;
    let curve = |value: f64| {
        if value > delta.powi(3) {
            value.cbrt()
        } else {
            value / (3.0 * delta * delta) + 4.0 / 29.0
        }
    };
    let [x, y, z] = relative(linear).map(curve);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two images that differ in hue, brightness and fine structure. Sides are 48 and 40 pixels.
    fn images(change: u32) -> [Vec<[u8; 4]>; 2] {
        let pixels = |f: &dyn Fn(u32, u32) -> [u32; 3]| {
            let pixel = |i: u32| {
                let [r, g, b] = f(i % 48, i / 48).map(|value| (value % 256) as u8);
                [r, g, b, 255]
            };
            (0..48 * 40).map(pixel).collect::<Vec<_>>()
        };
        [
            pixels(&|x, y| [4 * x + y, 2 * x + 3 * y, 5 * y]),
            pixels(&|x, y| {
                let dot = if x % 11 == 5 && y % 9 == 4 { 40 * change } else { 0 };
                [4 * x + y + dot, 2 * x + 3 * y + change * (x / 16), 5 * y + dot]
            }),
        ]
    }

    #[test]
    fn values_are_those_of_the_reference_implementation() {
        // `flip_evaluator.evaluate(reference, test, "LDR", parameters={"ppd": …})[1]` of flip-evaluator 1.7 from PyPI, for these images.
        for (change, pixels_per_degree, expected) in CASES {
            let [a, b] = images(change);
            let map = flip_map(&a, &b, 48, 40, pixels_per_degree).unwrap();
            let mean = map.iter().sum::<f64>() / map.len() as f64;
            assert!((mean - expected).abs() < 2e-5, "{change} {pixels_per_degree}: {mean}");
        }
        let [a, b] = images(1);
        assert_eq!(flip(&a, &b, 48, 40).unwrap(), {
            let map = flip_map(&a, &b, 48, 40, PIXELS_PER_DEGREE).unwrap();
            map.iter().sum::<f64>() / map.len() as f64
        });
    }

    /// Change of the second image, pixels per degree, and mean.
    const CASES: [(u32, f64, f64); 4] =
        [(1, 67.0, 0.0450521), (3, 67.0, 0.1029501), (3, 30.0, 0.1013579), (5, 120.0, 0.1513840)];

    #[test]
    fn equal_images_have_no_difference_and_black_and_white_the_largest() {
        let [a, _] = images(1);
        assert_eq!(flip(&a, &a, 48, 40), Ok(0.0));
        let (black, white) = (vec![[0, 0, 0, 255]; 64], vec![[255; 4]; 64]);
        let found = flip(&black, &white, 8, 8).unwrap();
        assert!((found - 0.967392).abs() < 1e-4, "{found}");
        assert!(flip(&a, &black, 48, 40).is_err());
        assert_eq!(flip(&[], &[], 0, 0), Ok(0.0));
    }
}
