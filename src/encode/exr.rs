//! OpenEXR, run-length coded without loss, one layer of scan lines.
//!
//! Depth is one f32 channel `Z`, infinite where there is nothing. Colour is linear half-float `R G B A`, premultiplied by alpha
//! as the format requires. Normals are half-float `N.X N.Y N.Z` in −1..1, zero where there is none. Ids are one u32 channel `id`.

use std::io::Cursor;

use exr::image::write::channels::WritableChannels;
use exr::prelude::{
    Encoding, Image, Layer, LayerAttributes, SpecificChannels, Vec2, WritableImage, f16,
};

use super::{EncodeError, Encoded, FrameImage};

/// Encodes any image.
///
/// # Errors
/// Errors of the encoder.
pub fn encode(image: &FrameImage) -> Result<Encoded, EncodeError> {
    let (width, _) = image.size();
    let at = |Vec2(x, y): Vec2<usize>| y * width as usize + x;
    let bytes = match image {
        FrameImage::Depth { depth, .. } => write(&framed(
            image,
            SpecificChannels::build()
                .with_channel::<f32>("Z")
                .with_pixel_fn(|position| (depth[at(position)],)),
        )),
        FrameImage::Id { id, .. } => write(&framed(
            image,
            SpecificChannels::build()
                .with_channel::<u32>("id")
                .with_pixel_fn(|position| (id[at(position)],)),
        )),
        FrameImage::Normal { rgba, .. } => {
            let component: [f16; 256] =
                std::array::from_fn(|byte| f16::from_f32((byte as f32 - 128.0) / 127.0));
            write(&framed(
                image,
                SpecificChannels::build()
                    .with_channel::<f16>("N.X")
                    .with_channel::<f16>("N.Y")
                    .with_channel::<f16>("N.Z")
                    .with_pixel_fn(|position| match rgba[at(position)] {
                        [_, _, _, 0] => (f16::ZERO, f16::ZERO, f16::ZERO),
                        [x, y, z, _] => {
                            (component[x as usize], component[y as usize], component[z as usize])
                        }
                    }),
            ))
        }
        FrameImage::Color { rgba, .. } => {
            let linear: [f32; 256] = std::array::from_fn(|byte| linear_from_srgb(byte as u8));
            write(&framed(
                image,
                SpecificChannels::rgba(|position: Vec2<usize>| {
                    let [r, g, b, a] = rgba[at(position)];
                    let alpha = f32::from(a) / 255.0;
                    let channel = |byte: u8| f16::from_f32(linear[byte as usize] * alpha);
                    (channel(r), channel(g), channel(b), f16::from_f32(alpha))
                }),
            ))
        }
    }?;
    Ok(Encoded::new(bytes, "image/x-exr"))
}

/// A file with one layer.
fn framed<'c, C: WritableChannels<'c> + 'c>(frame: &FrameImage, channels: C) -> Image<Layer<C>> {
    let (width, height) = frame.size();
    let size = (width as usize, height as usize);
    Image::from_layer(Layer::new(
        size,
        LayerAttributes::default(),
        Encoding::FAST_LOSSLESS,
        channels,
    ))
}

fn write<'c, C>(image: &'c Image<Layer<C>>) -> Result<Vec<u8>, EncodeError>
where
    C: WritableChannels<'c>,
{
    let mut bytes = Cursor::new(Vec::new());
    image
        .write()
        .non_parallel()
        .to_buffered(&mut bytes)
        .map_err(|error| EncodeError::Failed(error.to_string()))?;
    Ok(bytes.into_inner())
}

/// The sRGB transfer function (IEC 61966-2-1).
fn linear_from_srgb(byte: u8) -> f32 {
    let value = f32::from(byte) / 255.0;
    if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
}

#[cfg(test)]
mod tests {
    use exr::prelude::*;

    use super::super::FrameImage;

    /// All channels of the first layer by name, read by the library.
    fn channels(bytes: &[u8]) -> Vec<(String, FlatSamples)> {
        let image = read()
            .no_deep_data()
            .largest_resolution_level()
            .all_channels()
            .first_valid_layer()
            .all_attributes()
            .from_buffered(std::io::Cursor::new(bytes))
            .unwrap();
        let list = image.layer_data.channel_data.list;
        list.into_iter().map(|c| (c.name.to_string(), c.sample_data)).collect()
    }

    #[test]
    fn depth_and_infinity_return_exactly() {
        let mut depth: Vec<f32> = (0..35).map(|i| 0.3 + i as f32 / 7.0).collect();
        depth[11] = f32::INFINITY;
        let image = FrameImage::Depth { width: 7, height: 5, depth: depth.clone() };
        let found = channels(&super::encode(&image).unwrap().bytes);
        assert_eq!(found, vec![("Z".to_owned(), FlatSamples::F32(depth))]);
    }

    #[test]
    fn ids_return_exactly() {
        let id = vec![0, 1, u32::MAX, 1 << 24, 77, 3];
        let image = FrameImage::Id { width: 2, height: 3, id: id.clone() };
        let found = channels(&super::encode(&image).unwrap().bytes);
        assert_eq!(found, vec![("id".to_owned(), FlatSamples::U32(id))]);
    }

    #[test]
    fn colour_is_linear_and_premultiplied() {
        let rgba = vec![[255, 0, 188, 255], [255, 188, 0, 51], [13, 10, 11, 0]];
        let image = FrameImage::Color { width: 3, height: 1, rgba };
        let found = channels(&super::encode(&image).unwrap().bytes);
        let names: Vec<&str> = found.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["A", "B", "G", "R"]);
        let half = |channel: usize| -> Vec<f32> { found[channel].1.values_as_f32().collect() };
        // sRGB 188/255 is 0.5029 in linear light.
        let near = |a: f32, b: f32| assert!((a - b).abs() < 6e-4, "{a} {b}");
        for (channel, expected) in
            [[1.0, 0.2, 0.0], [0.5029, 0.0, 0.0], [0.0, 0.5029 * 0.2, 0.0], [1.0, 0.2, 0.0]]
                .into_iter()
                .enumerate()
        {
            half(channel).into_iter().zip(expected).for_each(|(a, b)| near(a, b));
        }
        assert!(matches!(found[0].1, FlatSamples::F16(_)));
    }

    #[test]
    fn normals_are_signed_and_zero_where_there_is_none() {
        let rgba = vec![[128, 255, 1, 255], [0, 0, 0, 0]];
        let image = FrameImage::Normal { width: 2, height: 1, rgba };
        let found = channels(&super::encode(&image).unwrap().bytes);
        let names: Vec<&str> = found.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["N.X", "N.Y", "N.Z"]);
        for (channel, expected) in [[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0]].into_iter().enumerate() {
            assert_eq!(found[channel].1.values_as_f32().collect::<Vec<_>>(), expected);
        }
    }
}
