//! WebP, lossless (VP8L), for colour, normals and ids.

use image_webp::{ColorType, WebPEncoder};

use super::{EncodeError, Encoded, FrameImage, ImageFormat, pack, unsupported};

/// Largest side: VP8L stores sides, minus one, in 14 bits.
const MAX_SIDE: u32 = 1 << 14;

/// Encodes colour, normals or ids.
///
/// # Errors
/// The image is depth, or a side is longer than 16384 pixels.
pub fn encode(image: &FrameImage) -> Result<Encoded, EncodeError> {
    let packed = pack::rgb_or_rgba(image).ok_or_else(|| unsupported(ImageFormat::Webp, image))?;
    let (width, height) = image.size();
    if width > MAX_SIDE || height > MAX_SIDE {
        let format = ImageFormat::Webp;
        return Err(EncodeError::TooLarge { format, limit: MAX_SIDE, width, height });
    }
    let color = if packed.alpha { ColorType::Rgba8 } else { ColorType::Rgb8 };
    // The encoder would panic if these disagreed.
    if packed.bytes.len() != image.pixels() * if packed.alpha { 4 } else { 3 }
        || image.pixels() as u64 != u64::from(width) * u64::from(height)
    {
        return Err(EncodeError::Failed("pixel count and frame size disagree".into()));
    }
    let mut bytes = Vec::with_capacity(packed.bytes.len() / 2);
    WebPEncoder::new(&mut bytes)
        .encode(&packed.bytes, width, height, color)
        .map_err(|error| EncodeError::Failed(error.to_string()))?;
    Ok(Encoded::new(bytes, "image/webp"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colour_returns_exactly() {
        for opaque in [true, false] {
            let rgba: Vec<[u8; 4]> = (0..41 * 29u32)
                .map(|i| {
                    [i as u8, (i >> 2) as u8, (i * i) as u8, if opaque { 255 } else { i as u8 }]
                })
                .collect();
            let image = FrameImage::Color { width: 41, height: 29, rgba: rgba.clone() };
            let encoded = encode(&image).unwrap();
            assert_eq!(encoded.content_type, "image/webp");
            let found = ::image::load_from_memory(&encoded.bytes).unwrap();
            assert_eq!(found.color().has_alpha(), !opaque);
            assert_eq!(found.to_rgba8().as_raw().as_slice(), bytemuck::cast_slice::<_, u8>(&rgba));
        }
    }

    #[test]
    fn limits_are_named() {
        let image = FrameImage::Id { width: 16_385, height: 1, id: vec![0; 16_385] };
        let message = encode(&image).unwrap_err().to_string();
        assert!(message.contains("16384") && message.contains("16385"), "{message}");
    }
}
