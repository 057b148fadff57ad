//! What a request may choose.

use serde::{Deserialize, Serialize};

/// The choices that trade accuracy for time.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema,
)]
pub struct Settings {
    pub lod: Lod,
    pub reconstruct: Reconstruct,
}

/// Level of detail.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum Lod {
    /// Every sample and triangle.
    #[default]
    Full,
}

/// How a surface is made of projected samples.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum Reconstruct {
    /// One pixel a sample.
    #[default]
    Points,
}

/// Which image of the frame is wanted.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum Output {
    /// Shaded sRGB, straight alpha.
    #[default]
    Color,
    /// Distance along the viewing axis in scene units; infinite where nothing is.
    Depth,
    /// World-space unit normals, `n · ½ + ½` in the colour channels.
    Normal,
    /// Which instance covers the pixel, see [`crate::encode::FrameImage::Id`].
    Id,
}
