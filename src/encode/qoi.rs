//! QOI, the "quite OK image format": lossless, simple, and fast at both ends.

use super::{EncodeError, Encoded, FrameImage, ImageFormat, pack, unsupported};

/// Encodes colour, normals or ids.
///
/// # Errors
/// The image is depth, or has more than 400 million pixels.
pub fn encode(image: &FrameImage) -> Result<Encoded, EncodeError> {
    let packed = pack::rgb_or_rgba(image).ok_or_else(|| unsupported(ImageFormat::Qoi, image))?;
    let (width, height) = image.size();
    let bytes = qoi::encode_to_vec(&packed.bytes, width, height)
        .map_err(|error| EncodeError::Failed(error.to_string()))?;
    Ok(Encoded::new(bytes, "image/qoi"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colour_returns_exactly() {
        for opaque in [true, false] {
            let rgba: Vec<[u8; 4]> = (0..31 * 17u32)
                .map(|i| [i as u8, 9, (i * i / 5) as u8, if opaque { 255 } else { (i / 7) as u8 }])
                .collect();
            let image = FrameImage::Color { width: 31, height: 17, rgba: rgba.clone() };
            let encoded = encode(&image).unwrap();
            assert_eq!(encoded.content_type, "image/qoi");
            let (header, data) = qoi::decode_to_vec(&encoded.bytes).unwrap();
            assert_eq!((header.width, header.height), (31, 17));
            let channels = if opaque { 3 } else { 4 };
            assert_eq!(header.channels.as_u8(), channels);
            for (found, expected) in data.chunks_exact(channels.into()).zip(&rgba) {
                assert_eq!(found, &expected[..channels.into()]);
            }
            assert_eq!(data.len(), rgba.len() * usize::from(channels));
        }
    }

    #[test]
    fn ids_return_exactly() {
        let id = vec![0, 1, 255, 256, 65_536, 1 << 20];
        let image = FrameImage::Id { width: 3, height: 2, id: id.clone() };
        let (_, data) = qoi::decode_to_vec(encode(&image).unwrap().bytes).unwrap();
        let found: Vec<u32> =
            data.chunks_exact(3).map(|c| u32::from_le_bytes([c[0], c[1], c[2], 0])).collect();
        assert_eq!(found, id);
    }
}
