//! What a request may choose.

use serde::{Deserialize, Serialize};

use crate::scene::{Blend, Filter, Shading, Splats};

/// The choices that trade accuracy for time. What is `None` is as the scene has it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Settings {
    pub lod: Lod,
    pub reconstruct: Reconstruct,
    pub filter: Option<Filter>,
    pub prefilter: Option<bool>,
    pub blend: Option<Blend>,
    pub shading: Option<Shading>,
}

impl Settings {
    /// How samples are drawn as splats, if they are; `scene`: what the scene says.
    pub fn splats(&self, scene: &Splats) -> Option<Splats> {
        (self.reconstruct == Reconstruct::Splats).then(|| Splats {
            filter: self.filter.unwrap_or(scene.filter),
            prefilter: self.prefilter.unwrap_or(scene.prefilter),
            blend: self.blend.unwrap_or(scene.blend),
            shading: self.shading.unwrap_or(scene.shading),
            ..*scene
        })
    }
}

/// Settings as a frame was drawn with them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, utoipa::ToSchema)]
pub struct UsedSettings {
    pub lod: Lod,
    pub reconstruct: Reconstruct,
    /// Only where samples are drawn as splats.
    #[serde(flatten)]
    pub splats: Option<Splats>,
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
    /// Elliptical Gaussians in the samples' tangent planes (Zwicker et al. 2004).
    Splats,
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
