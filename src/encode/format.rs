//! The image formats.

use serde::{Deserialize, Serialize};

/// Encodings. Which outputs each can hold: see [`super::accepts`].
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema,
)]
#[serde(rename_all = "lowercase")]
pub enum ImageFormat {
    #[default]
    Png,
    /// `jpg` means the same.
    #[serde(alias = "jpg")]
    Jpeg,
    Webp,
    Qoi,
    /// Pixels as they come: RGBA8, f32 depth, RGBA8 normals, u32 ids, all little-endian.
    Raw,
    Exr,
    Pfm,
}

impl ImageFormat {
    /// Finds a format by a name or a file extension, ignoring case.
    pub fn named(name: &str) -> Option<ImageFormat> {
        Some(match name.to_ascii_lowercase().as_str() {
            "png" => ImageFormat::Png,
            "jpg" | "jpeg" => ImageFormat::Jpeg,
            "webp" => ImageFormat::Webp,
            "qoi" => ImageFormat::Qoi,
            "raw" | "bin" => ImageFormat::Raw,
            "exr" => ImageFormat::Exr,
            "pfm" => ImageFormat::Pfm,
            _ => return None,
        })
    }

    /// The extension of files in this format.
    pub fn extension(self) -> &'static str {
        match self {
            ImageFormat::Png => "png",
            ImageFormat::Jpeg => "jpg",
            ImageFormat::Webp => "webp",
            ImageFormat::Qoi => "qoi",
            ImageFormat::Raw => "raw",
            ImageFormat::Exr => "exr",
            ImageFormat::Pfm => "pfm",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn jpg_and_jpeg_are_one_format() {
        for name in ["jpg", "jpeg"] {
            let read: ImageFormat = serde_json::from_value(name.into()).unwrap();
            assert_eq!((read, ImageFormat::named(name)), (ImageFormat::Jpeg, Some(read)));
        }
        assert_eq!(ImageFormat::named("JPG"), Some(ImageFormat::Jpeg));
        assert_eq!(ImageFormat::named("tiff"), None);
    }
}
