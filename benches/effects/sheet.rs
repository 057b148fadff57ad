//! Contact sheets: a row for each effect, with its frames side by side.

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder, Rgb, RgbImage};

/// Pixels between frames.
const GAP: u32 = 2;
const GAP_COLOR: Rgb<u8> = Rgb([255; 3]);

/// Frames of a row, from left to right.
pub type Frames = [Vec<[u8; 4]>; 4];

/// A PNG of rows of frames of one size.
///
/// # Errors
/// An image that cannot be encoded.
pub fn png(rows: &[&Frames], [width, height]: [u32; 2]) -> anyhow::Result<Vec<u8>> {
    let side = |count: usize, length: u32| (count as u32 * (length + GAP)).saturating_sub(GAP);
    let columns = rows.first().map_or(0, |frames| frames.len());
    let (sheet_width, sheet_height) = (side(columns, width), side(rows.len(), height));
    let mut sheet = RgbImage::from_pixel(sheet_width, sheet_height, GAP_COLOR);
    for (row, frames) in rows.iter().enumerate() {
        for (column, frame) in frames.iter().enumerate() {
            let (left, top) = (column as u32 * (width + GAP), row as u32 * (height + GAP));
            for (at, [r, g, b, _]) in (0u32..).zip(frame) {
                sheet.put_pixel(left + at % width, top + at / width, Rgb([*r, *g, *b]));
            }
        }
    }
    let mut bytes = Vec::new();
    PngEncoder::new_with_quality(&mut bytes, CompressionType::Best, FilterType::Adaptive)
        .write_image(sheet.as_raw(), sheet_width, sheet_height, ExtendedColorType::Rgb8)?;
    Ok(bytes)
}
