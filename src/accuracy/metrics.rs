//! Error metrics between two images of the same pose.
//!
//! All slices hold `width · height` pixels row by row. The first argument is the reference (usually the [oracle](crate::oracle)),
//! the second the image under test.

use std::fmt;

use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

mod flip;

pub use flip::{PIXELS_PER_DEGREE, flip, flip_map};

/// The slices have different sizes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a reference of {reference} pixels cannot be compared with an image of {image}{expected}")]
pub struct SizeMismatch {
    pub reference: usize,
    pub image: usize,
    pub expected: ExpectedSize,
}

/// The size that both slices should have, if it is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ExpectedSize(pub Option<(u32, u32)>);

impl fmt::Display for ExpectedSize {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            Some((width, height)) => write!(f, ", {width} × {height} are expected"),
            None => Ok(()),
        }
    }
}

/// Whether both slices have the same size, or that of an image of `width · height` pixels.
pub(super) fn check<A, B>(
    reference: &[A],
    image: &[B],
    size: Option<(u32, u32)>,
) -> Result<(), SizeMismatch> {
    let pixels = size.map_or(reference.len(), |(w, h)| w as usize * h as usize);
    if reference.len() == pixels && image.len() == pixels {
        return Ok(());
    }
    let expected = ExpectedSize(size);
    Err(SizeMismatch { reference: reference.len(), image: image.len(), expected })
}

/// Mean squared error of the bytes of red, green and blue; 0 for images without pixels.
///
/// # Errors
/// The images have different sizes.
pub fn mse(reference: &[[u8; 4]], image: &[[u8; 4]]) -> Result<f64, SizeMismatch> {
    check(reference, image, None)?;
    let squares: u64 = rgb_differences(reference, image).map(|d| u64::from(d).pow(2)).sum();
    Ok(squares as f64 / (3 * reference.len()).max(1) as f64)
}

/// Peak signal-to-noise ratio in dB over the bytes of red, green and blue; infinite for equal images.
///
/// # Errors
/// The images have different sizes.
pub fn psnr(reference: &[[u8; 4]], image: &[[u8; 4]]) -> Result<f64, SizeMismatch> {
    Ok(psnr_db(mse(reference, image)?).unwrap_or(f64::INFINITY))
}

/// Peak signal-to-noise ratio in dB of a mean squared error; `None` for equal images.
pub fn psnr_db(mse: f64) -> Option<f64> {
    (mse > 0.0).then(|| 10.0 * (255.0 * 255.0 / mse).log10())
}

/// The largest difference of any red, green or blue byte.
///
/// # Errors
/// The images have different sizes.
pub fn max_error(reference: &[[u8; 4]], image: &[[u8; 4]]) -> Result<u8, SizeMismatch> {
    check(reference, image, None)?;
    Ok(rgb_differences(reference, image).max().unwrap_or(0))
}

fn rgb_differences<'a>(a: &'a [[u8; 4]], b: &'a [[u8; 4]]) -> impl Iterator<Item = u8> + 'a {
    a.iter().zip(b).flat_map(|(a, b)| (0..3).map(move |channel| a[channel].abs_diff(b[channel])))
}

/// Mean structural similarity of the luma (Rec. 601, from sRGB bytes), 1 for equal images.
///
/// Wang, Bovik, Sheikh and Simoncelli, *Image Quality Assessment: From Error Visibility to Structural Similarity* (2004): a
/// Gaussian window of 11 × 11 pixels with σ = 1.5, K₁ = 0.01, K₂ = 0.03, averaged over the windows that lie inside the image.
/// Along a side shorter than 11 pixels there are none, and windows are cut off at the border instead.
///
/// # Errors
/// A slice is not `width · height` long.
pub fn ssim(
    reference: &[[u8; 4]],
    image: &[[u8; 4]],
    width: u32,
    height: u32,
) -> Result<f64, SizeMismatch> {
    check(reference, image, Some((width, height)))?;
    let (width, height) = (width as usize, height as usize);
    if reference.is_empty() {
        return Ok(1.0);
    }
    let (x, y) = (luma(reference), luma(image));
    let mean_of = |plane: Vec<f64>| blur(&plane, width, height);
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).collect();
    let (xx, yy, xy) =
        (mean_of(product(&x, &x)), mean_of(product(&y, &y)), mean_of(product(&x, &y)));
    let (x, y) = (mean_of(x), mean_of(y));
    let (c1, c2) = ((0.01f64 * 255.0).powi(2), (0.03f64 * 255.0).powi(2));
    let similarity = |i: usize| {
        let (variance_x, variance_y) = (xx[i] - x[i] * x[i], yy[i] - y[i] * y[i]);
        let covariance = xy[i] - x[i] * y[i];
        (2.0 * x[i] * y[i] + c1) * (2.0 * covariance + c2)
            / ((x[i] * x[i] + y[i] * y[i] + c1) * (variance_x + variance_y + c2))
    };
    let centres = |size: usize| if size > 2 * REACH { REACH..size - REACH } else { 0..size };
    let (columns, rows) = (centres(width), centres(height));
    let count = columns.len() * rows.len();
    let sum: f64 =
        rows.flat_map(|y| columns.clone().map(move |x| y * width + x)).map(similarity).sum();
    Ok(sum / count as f64)
}

/// Pixels from a window's centre to its edge.
const REACH: usize = 5;

fn luma(image: &[[u8; 4]]) -> Vec<f64> {
    let luma = |&[r, g, b, _]: &[u8; 4]| {
        0.299 * f64::from(r) + 0.587 * f64::from(g) + 0.114 * f64::from(b)
    };
    image.iter().map(luma).collect()
}

/// The Gaussian mean around every pixel. Weights outside the image are left out, and the rest are normalised.
fn blur(plane: &[f64], width: usize, height: usize) -> Vec<f64> {
    let weight = |distance: usize| (-(distance as f64).powi(2) / (2.0 * 1.5 * 1.5)).exp();
    let weights: [f64; REACH + 1] = std::array::from_fn(weight);
    let mean = |at: usize, size: usize, value: &dyn Fn(usize) -> f64| {
        let (mut sum, mut total) = (0.0, 0.0);
        for i in at.saturating_sub(REACH)..(at + REACH + 1).min(size) {
            sum += weights[i.abs_diff(at)] * value(i);
            total += weights[i.abs_diff(at)];
        }
        sum / total
    };
    let pixels = || (0..width * height).into_par_iter();
    let across: Vec<f64> =
        pixels().map(|i| mean(i % width, width, &|x| plane[i / width * width + x])).collect();
    pixels().map(|i| mean(i / width, height, &|y| across[y * width + i % width])).collect()
}

/// Pixels that one image covers and the other does not.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Coverage {
    pub covered_reference: u64,
    pub covered_image: u64,
    /// Covered in the reference, background in the image.
    pub holes: u64,
    /// Background in the reference, covered in the image.
    pub leaks: u64,
    /// Holes away from every silhouette: the reference covers the whole 3 × 3 neighbourhood (as far as it lies in the image).
    pub holes_inside: u64,
    /// Leaks away from every silhouette: the reference shows background in the whole 3 × 3 neighbourhood.
    pub leaks_outside: u64,
    /// Pixels covered in both over pixels covered in either; 1 when neither covers any.
    pub silhouette_iou: f64,
}

/// Compares which pixels are covered, from ids (0 is background) or depths (see [`covered_by_depth`]).
///
/// # Errors
/// A slice is not `width · height` long.
pub fn coverage(
    reference: &[bool],
    image: &[bool],
    width: u32,
    height: u32,
) -> Result<Coverage, SizeMismatch> {
    check(reference, image, Some((width, height)))?;
    let (width, height) = (width as usize, height as usize);
    let neighbourhood_is = |i: usize, covered: bool| {
        let near = |at: usize, size: usize| at.saturating_sub(1)..(at + 2).min(size);
        near(i / width, height)
            .all(|y| near(i % width, width).all(|x| reference[y * width + x] == covered))
    };
    let mut found = Coverage::default();
    let mut both = 0u64;
    for (i, (&expected, &is)) in reference.iter().zip(image).enumerate() {
        found.covered_reference += u64::from(expected);
        found.covered_image += u64::from(is);
        match (expected, is) {
            (true, true) => both += 1,
            (true, false) => {
                found.holes += 1;
                found.holes_inside += u64::from(neighbourhood_is(i, true));
            }
            (false, true) => {
                found.leaks += 1;
                found.leaks_outside += u64::from(neighbourhood_is(i, false));
            }
            (false, false) => {}
        }
    }
    let either = both + found.holes + found.leaks;
    found.silhouette_iou = if either == 0 { 1.0 } else { both as f64 / either as f64 };
    Ok(found)
}

/// The one-sided Hausdorff distance in pixels: the largest distance of a covered pixel of `from` to the nearest one of `to`.
/// Infinite if `to` covers none, 0 if `from` covers none.
///
/// # Errors
/// A slice is not `width · height` long.
pub fn farthest_px(
    from: &[bool],
    to: &[bool],
    width: u32,
    height: u32,
) -> Result<f64, SizeMismatch> {
    check(from, to, Some((width, height)))?;
    let (width, height) = (width as usize, height as usize);
    // The distance of each pixel along its column, then the minimum over columns.
    let mut along = vec![f64::INFINITY; to.len()];
    for x in 0..width {
        for y in 0..height {
            let before = if y > 0 { along[(y - 1) * width + x] + 1.0 } else { f64::INFINITY };
            along[y * width + x] = if to[y * width + x] { 0.0 } else { before };
        }
        for y in (1..height).rev() {
            let behind = along[y * width + x] + 1.0;
            let own = &mut along[(y - 1) * width + x];
            *own = own.min(behind);
        }
    }
    let mut farthest: f64 = 0.0;
    for (pixel, _) in from.iter().zip(to).enumerate().filter(|(_, (from, to))| **from && !**to) {
        let (x, row) = (pixel % width, &along[pixel - pixel % width..][..width]);
        let mut nearest = row[x] * row[x];
        for off in 1..width {
            let across = (off * off) as f64;
            if across >= nearest {
                break;
            }
            for column in [x.checked_sub(off), Some(x + off)].into_iter().flatten() {
                if let Some(reach) = row.get(column) {
                    nearest = nearest.min(across + reach * reach);
                }
            }
        }
        farthest = farthest.max(nearest);
    }
    Ok(farthest.sqrt())
}

/// The pixels all of whose neighbours up to `reach` pixels away, in rows and columns, are set. Pixels beyond the image's border count as set.
///
/// # Errors
/// The slice is not `width · height` long.
pub fn shrunk(
    mask: &[bool],
    width: u32,
    height: u32,
    reach: u32,
) -> Result<Vec<bool>, SizeMismatch> {
    check(mask, mask, Some((width, height)))?;
    let (width, height, reach) = (width as usize, height as usize, reach as usize);
    let near = |at: usize, size: usize| at.saturating_sub(reach)..(at + reach + 1).min(size);
    let pixels = || 0..width * height;
    let across: Vec<bool> =
        pixels().map(|i| near(i % width, width).all(|x| mask[i / width * width + x])).collect();
    Ok(pixels().map(|i| near(i / width, height).all(|y| across[y * width + i % width])).collect())
}

/// Sizes of the connected areas of set pixels, in pixels; neighbours share a side.
///
/// # Errors
/// The slice is not `width · height` long.
pub fn areas(mask: &[bool], width: u32, height: u32) -> Result<Vec<usize>, SizeMismatch> {
    check(mask, mask, Some((width, height)))?;
    let width = width as usize;
    let (mut left, mut sizes, mut stack) = (mask.to_vec(), Vec::new(), Vec::new());
    for first in 0..mask.len() {
        let mut size = 0;
        stack.push(first);
        while let Some(pixel) = stack.pop() {
            if !std::mem::take(&mut left[pixel]) {
                continue;
            }
            size += 1;
            let x = pixel % width;
            let beside = [
                (x > 0).then(|| pixel - 1),
                (x + 1 < width).then_some(pixel + 1),
                pixel.checked_sub(width),
                (pixel + width < mask.len()).then_some(pixel + width),
            ];
            stack.extend(beside.into_iter().flatten());
        }
        if size > 0 {
            sizes.push(size);
        }
    }
    Ok(sizes)
}

/// The covered pixels of an id image.
pub fn covered_by_id(id: &[u32]) -> Vec<bool> {
    id.iter().map(|&id| id != 0).collect()
}

/// The covered pixels of a depth image: those with a finite depth.
pub fn covered_by_depth<T: Copy + Into<f64>>(depth: &[T]) -> Vec<bool> {
    depth.iter().map(|&depth| depth.into().is_finite()).collect()
}

/// Distribution of an error over the pixels that can be compared.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Spread {
    pub pixels: u64,
    pub max: f64,
    pub mean: f64,
    /// Half of the pixels have this error or less (nearest rank).
    pub median: f64,
    /// 99 % of the pixels have this error or less (nearest rank).
    pub p99: f64,
}

impl Spread {
    /// `None` if there are no errors.
    fn of(mut errors: Vec<f64>) -> Option<Spread> {
        errors.sort_unstable_by(f64::total_cmp);
        let at = |percent: usize| (errors.len() * percent).div_ceil(100).checked_sub(1);
        Some(Spread {
            pixels: errors.len() as u64,
            max: *errors.last()?,
            mean: errors.iter().sum::<f64>() / errors.len() as f64,
            median: *errors.get(at(50)?)?,
            p99: *errors.get(at(99)?)?,
        })
    }
}

/// `|image − reference| / reference` over the pixels where both depths and the ratio are finite; `None` if there are none. The ratio is infinite where
/// the reference has a depth of 0, as a surface in the eye's plane has in an orthographic view.
///
/// # Errors
/// The images have different sizes.
pub fn depth_error<A, B>(reference: &[A], image: &[B]) -> Result<Option<Spread>, SizeMismatch>
where
    A: Copy + Into<f64>,
    B: Copy + Into<f64>,
{
    check(reference, image, None)?;
    let pairs = reference.iter().zip(image).map(|(&a, &b)| (a.into(), b.into()));
    let covered = pairs.filter(|(a, b): &(f64, f64)| a.is_finite() && b.is_finite());
    // Equal depths agree even at 0, where a ratio says nothing.
    let errors = covered.map(|(a, b)| if a == b { 0.0 } else { ((b - a) / a).abs() });
    Ok(Spread::of(errors.filter(|error| error.is_finite()).collect()))
}

/// The angle in degrees over the pixels where both images have a normal (finite and not zero); `None` if there are none.
///
/// # Errors
/// The images have different sizes.
pub fn normal_error_deg(
    reference: &[DVec3],
    image: &[DVec3],
) -> Result<Option<Spread>, SizeMismatch> {
    check(reference, image, None)?;
    let is_normal = |normal: &DVec3| normal.is_finite() && *normal != DVec3::ZERO;
    let known = |(a, b): &(&DVec3, &DVec3)| is_normal(a) && is_normal(b);
    // The arc cosine alone would lose small angles.
    let angle = |(a, b): (&DVec3, &DVec3)| a.cross(*b).length().atan2(a.dot(*b)).to_degrees();
    Ok(Spread::of(reference.iter().zip(image).filter(known).map(angle).collect()))
}

/// The normals of a normal image: `n · 127 + 128` per byte; zero where alpha is zero.
pub fn normals_from_rgba8(rgba: &[[u8; 4]]) -> Vec<DVec3> {
    let component = |byte: u8| (f64::from(byte) - 128.0) / 127.0;
    let normal = |&[x, y, z, known]: &[u8; 4]| match known {
        0 => DVec3::ZERO,
        _ => DVec3::new(component(x), component(y), component(z)),
    };
    rgba.iter().map(normal).collect()
}

#[cfg(test)]
mod tests;
