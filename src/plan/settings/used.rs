//! Settings as receipts have them.

use serde::Serialize;

use super::{Given, Reconstruct};
use crate::plan::Reconstruction;
use crate::scene::Splats;

/// Settings as a frame was drawn with them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, utoipa::ToSchema)]
pub struct UsedSettings {
    /// Settings that affected the frame.
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
    /// Reason why the frame was drawn in another way than requested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub instead_because: Option<&'static str>,
    /// Why a frame with `lod=spt` was drawn at full detail.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub full_because: Option<String>,
    /// Parameters of splats; absent for other reconstructions.
    #[serde(flatten)]
    pub splats: Option<UsedSplats>,
}

/// Parameters of splats that the scene gives.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, utoipa::ToSchema)]
#[schema(as = Splats)]
pub struct UsedSplats {
    /// Standard deviation of the low-pass filter, in pixels.
    pub lowpass_px: f32,
    /// Where kernels end, in their standard deviations.
    pub cutoff: f32,
    /// Multiplies every kernel's axes.
    pub width: f32,
    /// How far behind the nearest surface splats still count, in radii of the nearest splat.
    pub depth_offset: f32,
}

impl UsedSplats {
    /// Returns the parameters of splats; `None` where samples are drawn otherwise.
    pub fn of(reconstruction: &Reconstruction) -> Option<UsedSplats> {
        if reconstruction.pull_push().is_some() {
            return None;
        }
        let &Splats { lowpass_px, cutoff, width, depth_offset, .. } = reconstruction.splats()?;
        Some(UsedSplats { lowpass_px, cutoff, width, depth_offset })
    }
}
