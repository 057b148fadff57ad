//! JPEG: baseline, fixed Huffman tables, for colour and normals.
//!
//! Alpha is dropped, because the frame's background is already blended into its pixels. Chroma has half the resolution in both
//! directions below quality 90, and full resolution from 90.

use jpeg_encoder::{ColorType, Encoder};

use super::{EncodeError, Encoded, FrameImage, ImageFormat, unsupported};

/// Largest side: JPEG stores sides in 16 bits.
const MAX_SIDE: u32 = u16::MAX as u32;

/// Encodes colour or normals at `quality` 1..=100.
///
/// # Errors
/// The image is depth or ids, which lossy coding would ruin, or a side is longer than 65535 pixels.
pub fn encode(image: &FrameImage, quality: u8) -> Result<Encoded, EncodeError> {
    let (FrameImage::Color { width, height, rgba } | FrameImage::Normal { width, height, rgba }) =
        image
    else {
        return Err(unsupported(ImageFormat::Jpeg, image));
    };
    let (Ok(narrow_width), Ok(narrow_height)) = (u16::try_from(*width), u16::try_from(*height))
    else {
        return Err(EncodeError::TooLarge {
            format: ImageFormat::Jpeg,
            limit: MAX_SIDE,
            width: *width,
            height: *height,
        });
    };
    let mut bytes = Vec::with_capacity(rgba.len() / 2 + 1024);
    Encoder::new(&mut bytes, quality)
        .encode(bytemuck::cast_slice(rgba), narrow_width, narrow_height, ColorType::Rgba)
        .map_err(|error| EncodeError::Failed(error.to_string()))?;
    Ok(Encoded::new(bytes, "image/jpeg"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn smooth(width: u32, height: u32) -> Vec<[u8; 4]> {
        (0..width * height)
            .map(|i| {
                let (x, y) = (f64::from(i % width), f64::from(i / width));
                let wave = |phase: f64| (127.5 + 100.0 * (x / 17.0 + y / 23.0 + phase).sin()) as u8;
                [wave(0.0), wave(0.4), wave(0.8), if i % 2 == 0 { 255 } else { 0 }]
            })
            .collect()
    }

    fn psnr(a: &[[u8; 4]], b: &::image::RgbImage) -> f64 {
        let squares: f64 = a
            .iter()
            .zip(b.pixels())
            .flat_map(|(a, b)| (0..3).map(move |c| f64::from(a[c]) - f64::from(b.0[c])))
            .map(|d| d * d)
            .sum();
        10.0 * (255.0f64.powi(2) * (a.len() * 3) as f64 / squares).log10()
    }

    #[test]
    fn quality_is_kept_and_alpha_ignored() {
        let (width, height) = (123, 77);
        let rgba = smooth(width, height);
        let mut sizes = vec![];
        for (quality, at_least_db) in [(50, 33.0), (85, 38.0), (95, 44.0)] {
            let image = FrameImage::Color { width, height, rgba: rgba.clone() };
            let encoded = encode(&image, quality).unwrap();
            assert_eq!(encoded.content_type, "image/jpeg");
            let found = ::image::load_from_memory(&encoded.bytes).unwrap().to_rgb8();
            assert_eq!(found.dimensions(), (width, height));
            let found_db = psnr(&rgba, &found);
            assert!(found_db > at_least_db, "quality {quality}: {found_db} dB");
            sizes.push(encoded.bytes.len());
        }
        assert!(sizes.is_sorted(), "{sizes:?}");
    }

    #[test]
    fn limits_are_named() {
        let image = FrameImage::Color { width: 70_000, height: 1, rgba: vec![[0; 4]; 70_000] };
        let message = encode(&image, 85).unwrap_err().to_string();
        assert!(message.contains("65535") && message.contains("70000"), "{message}");
        let depth = FrameImage::Depth { width: 1, height: 1, depth: vec![1.0] };
        assert!(matches!(encode(&depth, 85), Err(EncodeError::Unsupported { .. })));
    }
}
