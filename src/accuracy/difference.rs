//! The errors of one image against another of the same pose, from colours and coverage. Pure.

use super::metrics::{self, Coverage, SizeMismatch};

/// An image to compare.
#[derive(Clone, Copy, Debug)]
pub struct Shot<'a> {
    /// Opaque sRGB, row by row.
    pub color: &'a [[u8; 4]],
    /// Pixels that show the scene.
    pub covered: &'a [bool],
}

/// Errors of an image.
#[derive(Clone, Debug, PartialEq)]
pub struct Difference {
    /// Mean squared error of the red, green and blue bytes.
    pub mse: f64,
    pub ssim: f64,
    /// Mean of `map`.
    pub flip: f64,
    pub max_error: u8,
    pub coverage: Coverage,
    /// FLIP of each pixel, from 0 to 1.
    pub map: Vec<f64>,
}

impl Difference {
    /// The errors of an image of `width · height` pixels against a reference.
    ///
    /// # Errors
    /// A slice has another size.
    pub fn between(
        reference: Shot<'_>,
        image: Shot<'_>,
        [width, height]: [u32; 2],
    ) -> Result<Difference, SizeMismatch> {
        let (expected, color) = (reference.color, image.color);
        let map = metrics::flip_map(expected, color, width, height, metrics::PIXELS_PER_DEGREE)?;
        Ok(Difference {
            mse: metrics::mse(expected, color)?,
            ssim: metrics::ssim(expected, color, width, height)?,
            flip: map.iter().sum::<f64>() / map.len().max(1) as f64,
            max_error: metrics::max_error(expected, color)?,
            coverage: metrics::coverage(reference.covered, image.covered, width, height)?,
            map,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_those_of_the_metrics() {
        let size = [16, 12];
        let expected = vec![[40, 90, 200, 255]; 16 * 12];
        let mut color = expected.clone();
        color[100] = [50, 90, 200, 255];
        let (covered, mut holes) = (vec![true; 16 * 12], vec![true; 16 * 12]);
        holes[3] = false;
        let reference = Shot { color: &expected, covered: &covered };
        let found =
            Difference::between(reference, Shot { color: &color, covered: &holes }, size).unwrap();
        assert!((found.mse - 100.0 / (3.0 * 192.0)).abs() < 1e-12);
        assert_eq!((found.max_error, found.coverage.holes, found.coverage.leaks), (10, 1, 0));
        assert!(found.ssim < 1.0 && found.flip > 0.0 && found.map.len() == 192);
        let same = Difference::between(reference, reference, size).unwrap();
        assert_eq!((same.mse, same.ssim, same.flip, same.max_error), (0.0, 1.0, 0.0, 0));
        let short = Shot { color: &color[1..], covered: &holes };
        assert!(Difference::between(reference, short, size).is_err());
    }
}
