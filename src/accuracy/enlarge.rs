//! Enlarges frames that are drawn smaller than they are shown. Pure.

use image::RgbaImage;
use image::imageops::{FilterType, resize};

/// Interpolates bytes linearly between the middles of pixels, as browsers enlarge images. `pixels` has `from[0] · from[1]` pixels, row by row. An image
/// of the wanted size, or of other pixels than `from` says, stays as it is.
pub fn bilinear(pixels: Vec<[u8; 4]>, from: [u32; 2], to: [u32; 2]) -> Vec<[u8; 4]> {
    if from == to {
        return pixels;
    }
    match RgbaImage::from_raw(from[0], from[1], pixels.as_flattened().to_vec()) {
        Some(image) => {
            let larger = resize(&image, to[0], to[1], FilterType::Triangle);
            larger.pixels().map(|pixel| pixel.0).collect()
        }
        None => pixels,
    }
}

/// The value of the nearest pixel, for values between which there is nothing, such as depths of two surfaces.
pub fn nearest<T: Copy>(pixels: &[T], from: [u32; 2], to: [u32; 2]) -> Vec<T> {
    let [width, height] = from.map(|side| side as usize);
    let [wide, high] = to.map(|side| side as usize);
    let place = |at: usize, of: usize, own: usize| (2 * at + 1) * own / (2 * of);
    let value =
        |i: usize| pixels[place(i / wide, high, height) * width + place(i % wide, wide, width)];
    (0..wide * high).map(value).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gray(values: &[u8]) -> Vec<[u8; 4]> {
        values.iter().map(|&value| [value, value, value, 255]).collect()
    }

    #[test]
    fn colours_are_interpolated_between_the_middles_of_pixels() {
        let found = bilinear(gray(&[0, 100]), [2, 1], [4, 2]);
        // The middles of the four pixels lie a quarter of a pixel beside those of the two.
        assert_eq!(found, gray(&[0, 25, 75, 100, 0, 25, 75, 100]));
        assert_eq!(bilinear(gray(&[7, 9]), [2, 1], [2, 1]), gray(&[7, 9]));
        let even = bilinear(gray(&[50; 12]), [4, 3], [5, 4]);
        assert_eq!(even, gray(&[50; 20]));
    }

    #[test]
    fn depths_are_those_of_the_nearest_pixel() {
        assert_eq!(nearest(&[1, 2], [2, 1], [4, 2]), [1, 1, 2, 2, 1, 1, 2, 2]);
        assert_eq!(nearest(&[1, 2, 3], [3, 1], [4, 1]), [1, 2, 2, 3]);
        assert_eq!(nearest(&[1, 2, 3, 4], [2, 2], [2, 2]), [1, 2, 3, 4]);
    }
}
