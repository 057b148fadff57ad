//! PNG (ISO/IEC 15948).
//!
//! The encoder limits the server's throughput long before projection does, so speed has priority over size: `fdeflate`'s one-pass
//! coding after one fixed row filter. Colour without translucency is written without alpha, which saves a quarter of filtering,
//! checksums and transfer.
//!
//! Depth is 16-bit grey, see [`DepthRange`]; ids are explained in the [parent module](super).

use png::{BitDepth, ColorType, DeflateCompression, Encoder, Filter, SrgbRenderingIntent};

use super::{EncodeError, Encoded, FrameImage, ImageFormat, pack, unsupported};

/// The mapping between 16-bit depth and distances.
///
/// The value 0 means that there is nothing. Otherwise a value `v` in 1..=65535 is the distance
///
/// ```text
/// z = far − (v − 1) / 65534 · (far − near)
/// ```
///
/// along the viewing axis in scene units, where `near` (the brightest, 65535) and `far` (the darkest, 1) are the smallest and
/// largest finite depth in the frame. The error is at most `(far − near) / 131068`. The file has both as `tEXt` chunks `near` and
/// `far`, in decimal with enough digits to restore the f32, beside `depth-mapping: linear`. [`Encoded::depth_range`] has them as
/// well. An empty frame has neither.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthRange {
    pub near: f32,
    pub far: f32,
}

impl DepthRange {
    /// The range of the finite depths; `None` if there are none.
    pub fn of(depth: &[f32]) -> Option<DepthRange> {
        depth.iter().filter(|z| z.is_finite()).fold(None, |range, &z| {
            let DepthRange { near, far } = range.unwrap_or(DepthRange { near: z, far: z });
            Some(DepthRange { near: near.min(z), far: far.max(z) })
        })
    }

    /// Maps a depth to its 16-bit value; 0 if it is not finite.
    pub fn quantise(&self, z: f32) -> u16 {
        if !z.is_finite() {
            return 0;
        }
        let extent = f64::from(self.far) - f64::from(self.near);
        if extent <= 0.0 {
            return u16::MAX;
        }
        let nearness = (f64::from(self.far) - f64::from(z)) / extent;
        // The cast saturates, and the fraction lies in 0..=1 for depths inside the range.
        1 + (nearness.clamp(0.0, 1.0) * 65534.0).round() as u16
    }

    /// Maps a 16-bit value to its depth; infinite for 0.
    pub fn restore(&self, value: u16) -> f32 {
        if value == 0 {
            return f32::INFINITY;
        }
        let (near, far) = (f64::from(self.near), f64::from(self.far));
        (far - f64::from(value - 1) / 65534.0 * (far - near)) as f32
    }
}

/// Encodes any image.
///
/// # Errors
/// Errors of the encoder, such as for a side longer than 2³¹ − 1 pixels.
pub fn encode(image: &FrameImage) -> Result<Encoded, EncodeError> {
    let (width, height) = image.size();
    if let FrameImage::Depth { depth, .. } = image {
        return encode_depth(width, height, depth);
    }
    let packed = pack::rgb_or_rgba(image).ok_or_else(|| unsupported(ImageFormat::Png, image))?;
    let mut bytes = Vec::with_capacity(packed.bytes.len() / 2);
    let mut encoder = Encoder::new(&mut bytes, width, height);
    encoder.set_color(if packed.alpha { ColorType::Rgba } else { ColorType::Rgb });
    encoder.set_depth(BitDepth::Eight);
    if let FrameImage::Color { .. } = image {
        encoder.set_source_srgb(SrgbRenderingIntent::RelativeColorimetric);
    }
    write(encoder, &packed.bytes)?;
    Ok(Encoded::new(bytes, "image/png"))
}

fn encode_depth(width: u32, height: u32, depth: &[f32]) -> Result<Encoded, EncodeError> {
    let range = DepthRange::of(depth);
    let mut grey = vec![0u8; depth.len() * 2];
    if let Some(range) = range {
        for (value, &z) in grey.as_chunks_mut::<2>().0.iter_mut().zip(depth) {
            *value = range.quantise(z).to_be_bytes();
        }
    }
    let mut bytes = Vec::with_capacity(grey.len());
    let mut encoder = Encoder::new(&mut bytes, width, height);
    encoder.set_color(ColorType::Grayscale);
    encoder.set_depth(BitDepth::Sixteen);
    if let Some(DepthRange { near, far }) = range {
        for (keyword, text) in [
            ("near", near.to_string()),
            ("far", far.to_string()),
            ("depth-mapping", "linear".to_owned()),
        ] {
            encoder.add_text_chunk(keyword.to_owned(), text).map_err(failed)?;
        }
    }
    write(encoder, &grey)?;
    Ok(Encoded {
        bytes,
        content_type: "image/png",
        depth_range: range.map(|range| [range.near, range.far]),
    })
}

fn write(mut encoder: Encoder<'_, &mut Vec<u8>>, data: &[u8]) -> Result<(), EncodeError> {
    encoder.set_deflate_compression(DeflateCompression::FdeflateUltraFast);
    encoder.set_filter(FILTER);
    let mut writer = encoder.write_header().map_err(failed)?;
    writer.write_image_data(data).map_err(failed)?;
    writer.finish().map_err(failed)
}

/// Predict from the left neighbour. On frames of a noisy, a smooth and a sparsely covered ball at 1024², `Sub` needs 3.2, 3.3 and
/// 4.8 ms on one core (`Up` 3.2, 3.1, 5.4; `Paeth` 3.5, 3.5, 5.6; adaptive 11.6, 10.4, 12.3). Its total size is the smallest
/// except for the adaptive filter's, which is 5 % smaller. zlib's level 1 takes two to five times as long for 10–20 % less.
const FILTER: Filter = Filter::Sub;

fn failed(error: png::EncodingError) -> EncodeError {
    EncodeError::Failed(error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decode(bytes: &[u8]) -> (png::OutputInfo, Vec<u8>, Vec<(String, String)>) {
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
        let mut data = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut data).unwrap();
        let text = &reader.info().uncompressed_latin1_text;
        let text = text.iter().map(|t| (t.keyword.clone(), t.text.clone())).collect();
        (info, data, text)
    }

    fn gradient(width: u32, height: u32, alpha: impl Fn(u32) -> u8) -> FrameImage {
        let rgba = (0..width * height)
            .map(|i| [(i * 7) as u8, (i / 3) as u8, (i * i) as u8, alpha(i)])
            .collect();
        FrameImage::Color { width, height, rgba }
    }

    #[test]
    fn opaque_colour_has_three_channels_and_translucent_four() {
        for (image, color) in [
            (gradient(37, 21, |_| 255), ColorType::Rgb),
            (gradient(37, 21, |i| i as u8), ColorType::Rgba),
        ] {
            let encoded = encode(&image).unwrap();
            assert_eq!(encoded.content_type, "image/png");
            assert_eq!(encoded.depth_range, None);
            assert_eq!(decode(&encoded.bytes).0.color_type, color);
            let FrameImage::Color { rgba, .. } = &image else { unreachable!() };
            let found = image::load_from_memory(&encoded.bytes).unwrap().to_rgba8();
            assert_eq!(found.dimensions(), (37, 21));
            assert_eq!(found.as_raw().as_slice(), bytemuck::cast_slice::<_, u8>(rgba));
        }
    }

    #[test]
    fn depth_returns_within_half_a_step() {
        let (width, height) = (64, 33);
        let mut depth: Vec<f32> =
            (0..width * height).map(|i| 3.25 + 0.37 * (i as f32).sqrt()).collect();
        depth[5] = f32::INFINITY;
        depth[700] = f32::NAN;
        let encoded = encode(&FrameImage::Depth { width, height, depth: depth.clone() }).unwrap();
        let (info, data, text) = decode(&encoded.bytes);
        assert_eq!((info.color_type, info.bit_depth), (ColorType::Grayscale, BitDepth::Sixteen));
        let number = |keyword: &str| -> f32 {
            text.iter().find(|(key, _)| key == keyword).unwrap().1.parse().unwrap()
        };
        let (near, far) = (number("near"), number("far"));
        assert_eq!(encoded.depth_range, Some([near, far]));
        assert_eq!(near, 3.25);
        assert_eq!(far, depth[depth.len() - 1]);
        let values = data.chunks_exact(2).map(|b| u16::from_be_bytes([b[0], b[1]]));
        for (value, &z) in values.zip(&depth) {
            if z.is_finite() {
                let found = far - f32::from(value - 1) / 65534.0 * (far - near);
                assert!((found - z).abs() <= (far - near) / 131_068.0 + 4e-6, "{found} {z}");
                assert_eq!(
                    found.is_finite(),
                    (DepthRange { near, far }).restore(value).is_finite()
                );
            } else {
                assert_eq!(value, 0);
            }
        }
    }

    #[test]
    fn depth_of_nothing_and_of_one_plane() {
        let nothing = FrameImage::Depth { width: 3, height: 2, depth: vec![f32::INFINITY; 6] };
        let encoded = encode(&nothing).unwrap();
        let (_, data, text) = decode(&encoded.bytes);
        assert!(text.is_empty());
        assert_eq!((encoded.depth_range, data), (None, vec![0; 12]));
        let plane = FrameImage::Depth { width: 3, height: 2, depth: vec![4.5; 6] };
        let encoded = encode(&plane).unwrap();
        assert_eq!(encoded.depth_range, Some([4.5, 4.5]));
        assert_eq!(decode(&encoded.bytes).1, vec![255; 12]);
        assert_eq!(DepthRange { near: 4.5, far: 4.5 }.restore(65535), 4.5);
    }

    #[test]
    fn depth_range_covers_extremes() {
        let range = DepthRange { near: -f32::MAX, far: f32::MAX };
        assert_eq!((range.quantise(f32::MAX), range.quantise(-f32::MAX)), (1, 65535));
        assert_eq!((range.restore(1), range.restore(65535)), (f32::MAX, -f32::MAX));
        assert_eq!(range.restore(0), f32::INFINITY);
        assert_eq!(DepthRange::of(&[f32::NAN, f32::INFINITY]), None);
    }

    #[test]
    fn ids_return_exactly() {
        for (top, channels) in [((1u32 << 24) - 1, 3), (u32::MAX, 4)] {
            let id: Vec<u32> = (0..600u32).map(|i| top - i * (top / 600)).chain([0, 1]).collect();
            let image = FrameImage::Id { width: 602, height: 1, id: id.clone() };
            let (info, data, _) = decode(&encode(&image).unwrap().bytes);
            assert_eq!(info.color_type.samples(), channels);
            let found: Vec<u32> = data
                .chunks_exact(channels)
                .map(|c| c.iter().rev().fold(0, |id, &byte| id << 8 | u32::from(byte)))
                .collect();
            assert_eq!(found, id);
        }
    }
}
