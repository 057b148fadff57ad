//! Pixels → bytes (floor 5).
mod format;
mod image;

pub use format::ImageFormat;
pub use image::FrameImage;

use crate::plan::Output;

/// An encoded image.
#[derive(Clone, Debug)]
pub struct Encoded {
    pub bytes: Vec<u8>,
    pub content_type: &'static str,
}

/// A combination of image and format that cannot be.
#[derive(Debug, thiserror::Error)]
pub enum EncodeError {
    #[error("{format:?} cannot hold {output:?}: {accepted}")]
    Unsupported { format: ImageFormat, output: Output, accepted: &'static str },
    #[error("encoding failed: {0}")]
    Failed(String),
}

/// Whether `format` can hold `output`; the error says which formats can.
pub fn accepts(format: ImageFormat, output: Output) -> Result<(), EncodeError> {
    let _ = (format, output);
    Ok(())
}

/// Encodes a frame. `quality` is 1..=100 and matters to JPEG alone.
pub fn encode(
    image: &FrameImage,
    format: ImageFormat,
    quality: u8,
) -> Result<Encoded, EncodeError> {
    let _ = (image, format, quality);
    Err(EncodeError::Failed("no encoder yet".into()))
}
