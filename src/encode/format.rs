//! The image formats on offer.

use serde::{Deserialize, Serialize};

/// Encodings. Which outputs each can hold: see [`super::accepts`].
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema,
)]
#[serde(rename_all = "lowercase")]
pub enum ImageFormat {
    #[default]
    Png,
    Jpeg,
    Webp,
    Qoi,
    /// Pixels as they come: RGBA8, f32 depth, RGBA8 normals, u32 ids, all little-endian.
    Raw,
    Exr,
    Pfm,
}

impl ImageFormat {
    /// What files of it end in.
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
