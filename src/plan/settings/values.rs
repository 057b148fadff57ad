//! Values of settings, and what they mean for a frame.

use serde::{Deserialize, Serialize};

use super::{Given, SettingKind, Settings};
use crate::scene::{Blend, Shading, Splats};

/// What a frame waits for whose samples lack normals or kernels, where it is left open how they are drawn.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum Wait {
    /// Nothing: it shows points, and its receipt says that this is provisional.
    #[default]
    Ready,
    /// All that this frame needs.
    Complete,
    /// All that any frame of the scene may need, so that frames of a film are drawn alike.
    #[serde(skip)]
    Whole,
}

/// A still frame, which frames of a moving pose stand in for: all of them are drawn alike.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct StillFrame {
    pub height: u32,
    pub max_error: MaxError,
}

impl Settings {
    /// The defaults, with samples drawn in a given way.
    pub fn drawn_as(reconstruct: Reconstruct) -> Settings {
        Settings { reconstruct, ..Settings::default() }
    }

    /// How samples are drawn as splats, if they are; `scene`: what the scene says.
    pub fn splats(&self, scene: &Splats) -> Option<Splats> {
        let of_kernels = Splats {
            filter: self.filter.unwrap_or(scene.filter),
            prefilter: self.prefilter.unwrap_or(scene.prefilter),
            ..*scene
        };
        match self.reconstruct {
            // `auto` has been decided before it comes to this.
            Reconstruct::Points | Reconstruct::Auto => None,
            Reconstruct::Splats => Some(Splats {
                blend: self.blend.unwrap_or(scene.blend),
                shading: self.shading.unwrap_or(scene.shading),
                ..of_kernels
            }),
            // What is added up cannot be lit any more.
            Reconstruct::Fuzzy => {
                Some(Splats { blend: Blend::Interleaved, shading: Shading::Splat, ..of_kernels })
            }
        }
    }

    /// The settings with what a scene has where they leave it open.
    #[must_use]
    pub fn settled(&self, splats: Option<&Splats>) -> Settings {
        splats.map_or(*self, |splats| Settings {
            filter: Some(splats.filter),
            prefilter: Some(splats.prefilter),
            blend: Some(splats.blend),
            shading: Some(splats.shading),
            ..*self
        })
    }

    /// What is drawn where a single pass will not do.
    pub fn in_three_passes(&self) -> Settings {
        Settings {
            reconstruct: Reconstruct::Splats,
            blend: Some(Blend::Weighted),
            shading: Some(Shading::Splat),
            ..*self
        }
    }
}

/// An error that may be accepted, in pixels: 1 unless said otherwise.
#[derive(Clone, Copy, Debug, Serialize)]
#[serde(transparent)]
pub struct MaxError {
    px: f32,
}

impl MaxError {
    /// Least and most that can be asked for.
    pub const RANGE_PX: [f32; 2] = [0.05, 64.0];

    /// `None` for what is out of [`MaxError::RANGE_PX`].
    pub fn new(px: f32) -> Option<MaxError> {
        let [least, most] = MaxError::RANGE_PX;
        (least..=most).contains(&px).then_some(MaxError { px })
    }

    pub fn px(self) -> f32 {
        self.px
    }

    pub(super) fn kind() -> SettingKind {
        let [least, most] = MaxError::RANGE_PX.map(exact);
        SettingKind::Number { least, most, default: exact(MaxError::default().px), unit: "pixels" }
    }
}

/// The number that is written like this one, not the nearest to its bits: 0.05 and not 0.05000000074505806.
fn exact(number: f32) -> f64 {
    number.to_string().parse().unwrap_or(f64::from(number))
}

impl From<f32> for MaxError {
    /// The default for a number that [`MaxError::new`] refuses; [`Given::check`] has told of it before.
    fn from(px: f32) -> Self {
        MaxError::new(px).unwrap_or_default()
    }
}

impl Default for MaxError {
    fn default() -> Self {
        MaxError { px: 1.0 }
    }
}

impl PartialEq for MaxError {
    fn eq(&self, other: &Self) -> bool {
        self.px.to_bits() == other.px.to_bits()
    }
}

impl Eq for MaxError {}

impl std::hash::Hash for MaxError {
    fn hash<H: std::hash::Hasher>(&self, state: &mut H) {
        self.px.to_bits().hash(state);
    }
}

/// Settings as a frame was drawn with them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, utoipa::ToSchema)]
pub struct UsedSettings {
    /// Settings that had a say in the frame.
    #[serde(flatten)]
    pub applied: Given,
    /// Why the same request will be answered by another frame in a while: normals and kernels are being estimated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub provisional: Option<String>,
    /// Choice that was asked for, where it was `auto`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub asked: Option<Reconstruct>,
    /// Why `auto` chose this, with figures.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub because: Option<String>,
    /// Distance between neighbouring samples, in pixels, that 90 % of what samples cover does not exceed, where `auto` looked at it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spacing_px: Option<f64>,
    /// Why that is not what was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub instead_because: Option<&'static str>,
    /// Only where samples are drawn as splats.
    #[serde(flatten)]
    pub splats: Option<Splats>,
}

/// Level of detail.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    Eq,
    Hash,
    Serialize,
    Deserialize,
    utoipa::ToSchema,
    clap::ValueEnum,
)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum Lod {
    /// Every sample and triangle.
    #[default]
    Full,
    /// What the accepted error asks for, from sequential point trees (Dachsbacher et al. 2003).
    Spt,
}

/// How the error of a point tree's node is seen (Dachsbacher et al. 2003, §3.4).
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    Eq,
    Hash,
    Serialize,
    Deserialize,
    utoipa::ToSchema,
    clap::ValueEnum,
)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum ErrorMode {
    /// As large as from any side: what is accepted is kept everywhere.
    #[default]
    Unified,
    /// By the angle to the surface: fewer nodes. Where a surface ends and is seen at an angle, it may reach sideways up to twice as
    /// far beyond its end as is accepted.
    Split,
}

/// What the colours of samples show.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    Eq,
    Hash,
    Serialize,
    Deserialize,
    utoipa::ToSchema,
    clap::ValueEnum,
)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum Paint {
    /// The surface's own.
    #[default]
    Colors,
    /// How high above the leaves of its tree each node stands (Dachsbacher et al. 2003, Fig. 1).
    Levels,
}

/// How a surface is made of projected samples.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    Eq,
    Hash,
    Serialize,
    Deserialize,
    utoipa::ToSchema,
    clap::ValueEnum,
)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum Reconstruct {
    /// Points where samples are denser than pixels, splats where they are not.
    #[default]
    Auto = 3,
    /// One pixel a sample.
    Points = 0,
    /// Elliptical Gaussians in the samples' tangent planes (Zwicker et al. 2004).
    Splats = 1,
    /// Splats that are blended and depth-tested in a single pass (Dachsbacher et al. 2003, §5): faster, coarser in weights and depths.
    Fuzzy = 2,
}

/// Which image of the frame is wanted.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    Eq,
    Hash,
    Serialize,
    Deserialize,
    utoipa::ToSchema,
    clap::ValueEnum,
)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
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
