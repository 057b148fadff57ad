//! Encodes images (floor 5): one file per format, and here the table of what each format can hold.
//!
//! | format | colour | depth | normal | id |
//! |---|---|---|---|---|
//! | [`png`] | RGB8, or RGBA8 where it is translucent | 16-bit grey, linear, see [`png::DepthRange`] | RGBA8 | RGB8 or RGBA8, see below |
//! | [`jpeg`] | 8-bit YCbCr, alpha dropped | – | alpha dropped | – |
//! | [`webp`] (lossless) | RGB8 or RGBA8 | – | RGBA8 | as PNG |
//! | [`qoi`] | RGB8 or RGBA8 | – | RGBA8 | as PNG |
//! | [`raw`] | RGBA8 | f32 | RGBA8 | u32 |
//! | [`exr`] | linear half `R G B A`, premultiplied | f32 `Z` | half `N.X N.Y N.Z` in −1..1 | u32 `id` |
//! | [`pfm`] | – | f32 | – | – |
//!
//! **Ids in 8-bit channels**: `id = R + 2⁸·G + 2¹⁶·B`. If every id is below 2²⁴, there is no alpha channel, because browsers
//! multiply by alpha when they decode, which would change the ids. An image with larger ids has an alpha channel that adds
//! `2²⁴·A`.
//!
//! Rows run from top to bottom in all formats but PFM, which requires the opposite. Each encoder runs on the calling thread; the
//! engine's pool encodes several frames in parallel.

pub mod exr;
mod format;
mod image;
pub mod jpeg;
mod pack;
pub mod pfm;
pub mod png;
pub mod qoi;
pub mod raw;
pub mod webp;

pub use format::ImageFormat;
pub use image::FrameImage;

use crate::plan::Output;

/// An encoded image.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Encoded {
    pub bytes: Vec<u8>,
    pub content_type: &'static str,
    /// Smallest and largest depth, in scene units, with which a client converts 16-bit depth to distances (see
    /// [`png::DepthRange`]). `None` for every other image, and where there is nothing.
    pub depth_range: Option<[f32; 2]>,
}

impl Encoded {
    fn new(bytes: Vec<u8>, content_type: &'static str) -> Self {
        Self { bytes, content_type, depth_range: None }
    }
}

/// Why an image cannot be encoded.
#[derive(Debug, thiserror::Error)]
pub enum EncodeError {
    #[error("format: {format:?} cannot hold {output:?}: {accepted}")]
    Unsupported { format: ImageFormat, output: Output, accepted: &'static str },
    /// A frame larger than the format allows.
    #[error(
        "format: {format:?} allows at most {limit} pixels per side, and the frame has {width} × {height}"
    )]
    TooLarge { format: ImageFormat, limit: u32, width: u32, height: u32 },
    #[error("encoding failed: {0}")]
    Failed(String),
}

/// Checks whether `format` can hold `output`.
///
/// # Errors
/// [`EncodeError::Unsupported`], with the formats that can.
pub fn accepts(format: ImageFormat, output: Output) -> Result<(), EncodeError> {
    use ImageFormat::{Exr, Pfm, Png, Qoi, Raw, Webp};
    let (possible, accepted) = match output {
        Output::Color => (format != Pfm, "colour needs png, jpeg, webp, qoi, raw or exr"),
        Output::Depth => {
            (matches!(format, Png | Raw | Exr | Pfm), "depth needs png, raw, exr or pfm")
        }
        Output::Normal => (format != Pfm, "normals need png, jpeg, webp, qoi, raw or exr"),
        Output::Id => {
            (matches!(format, Png | Webp | Qoi | Raw | Exr), "ids need png, webp, qoi, raw or exr")
        }
    };
    if possible { Ok(()) } else { Err(EncodeError::Unsupported { format, output, accepted }) }
}

/// Encodes a frame. `quality` must be in 1..=100, and only JPEG uses it.
///
/// # Errors
/// The format cannot hold the image or its size, the number of pixels disagrees with the size, `quality` is out of range, the
/// frame is empty, or the encoder fails.
pub fn encode(
    image: &FrameImage,
    format: ImageFormat,
    quality: u8,
) -> Result<Encoded, EncodeError> {
    accepts(format, image.output())?;
    let (width, height) = image.size();
    let expected = u64::from(width) * u64::from(height);
    if expected == 0 {
        return Err(EncodeError::Failed(format!("an empty frame ({width} × {height})")));
    }
    if image.pixels() as u64 != expected {
        return Err(EncodeError::Failed(format!(
            "{} pixels do not make a frame of {width} × {height}",
            image.pixels()
        )));
    }
    if !(1..=100).contains(&quality) {
        return Err(EncodeError::Failed(format!("quality {quality} is not in 1..=100")));
    }
    match format {
        ImageFormat::Png => png::encode(image),
        ImageFormat::Jpeg => jpeg::encode(image, quality),
        ImageFormat::Webp => webp::encode(image),
        ImageFormat::Qoi => qoi::encode(image),
        ImageFormat::Raw => Ok(raw::encode(image)),
        ImageFormat::Exr => exr::encode(image),
        ImageFormat::Pfm => pfm::encode(image),
    }
}

/// The error of an encoder that is called with an image it cannot hold. [`encode`] calls [`accepts`] first, so this only occurs
/// when a format's own function is called directly.
fn unsupported(format: ImageFormat, image: &FrameImage) -> EncodeError {
    match accepts(format, image.output()) {
        Err(error) => error,
        Ok(()) => EncodeError::Failed(format!("{format:?} lacks an encoder for this image")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FORMATS: [ImageFormat; 7] = [
        ImageFormat::Png,
        ImageFormat::Jpeg,
        ImageFormat::Webp,
        ImageFormat::Qoi,
        ImageFormat::Raw,
        ImageFormat::Exr,
        ImageFormat::Pfm,
    ];

    fn samples() -> Vec<FrameImage> {
        let (width, height) = (5, 3);
        vec![
            FrameImage::Color { width, height, rgba: vec![[1, 2, 3, 255]; 15] },
            FrameImage::Depth { width, height, depth: vec![2.5; 15] },
            FrameImage::Normal { width, height, rgba: vec![[128, 128, 255, 255]; 15] },
            FrameImage::Id { width, height, id: vec![7; 15] },
        ]
    }

    #[test]
    fn what_is_accepted_encodes_and_what_is_not_says_why() {
        for image in samples() {
            for format in FORMATS {
                let result = encode(&image, format, 85);
                match accepts(format, image.output()) {
                    Ok(()) => {
                        let encoded = result.unwrap();
                        assert!(!encoded.bytes.is_empty());
                        assert!(encoded.content_type.contains('/'));
                    }
                    Err(reason) => {
                        assert_eq!(result.unwrap_err().to_string(), reason.to_string());
                        assert!(reason.to_string().contains("png"), "{reason}");
                    }
                }
            }
        }
        assert!(accepts(ImageFormat::Jpeg, Output::Depth).is_err());
        assert!(accepts(ImageFormat::Jpeg, Output::Id).is_err());
        assert!(accepts(ImageFormat::Pfm, Output::Color).is_err());
        assert!(accepts(ImageFormat::Qoi, Output::Depth).is_err());
    }

    #[test]
    fn sizes_that_lie_are_refused_by_every_format() {
        for format in FORMATS {
            let short = FrameImage::Depth { width: 4, height: 4, depth: vec![1.0; 15] };
            let empty = FrameImage::Color { width: 0, height: 4, rgba: vec![] };
            assert!(encode(&short, format, 85).is_err());
            assert!(encode(&empty, format, 85).is_err());
        }
        let image = &samples()[0];
        assert!(encode(image, ImageFormat::Jpeg, 0).is_err());
        assert!(encode(image, ImageFormat::Jpeg, 101).is_err());
    }
}
