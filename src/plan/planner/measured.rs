//! Measured frames of a scene, as they are kept.

use serde::{Deserialize, Serialize};

use super::Point;
use crate::math::{Camera, Lens};
use crate::plan::Given;

/// Measured frames: each setting at each pose.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    pub poses: Vec<MeasuredPose>,
    pub rows: Vec<MeasuredRow>,
}

/// A camera and the size of its frames.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeasuredPose {
    pub eye: [f64; 3],
    pub target: [f64; 3],
    pub up: [f64; 3],
    pub fov_deg: Option<f64>,
    pub ortho_height: Option<f64>,
    pub size: [u32; 2],
}

/// A setting with its frames, one for each pose; `None` where it was not drawn.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeasuredRow {
    pub label: String,
    pub given: Given,
    /// Width and height of the drawn frames as a share of those that they are shown at. Errors are those of the enlarged frames.
    pub scale: f64,
    pub points: Vec<Option<Point>>,
}

impl MeasuredPose {
    /// The camera; `None` for one without a lens, which no measurement has.
    pub fn camera(&self) -> Option<Camera> {
        let lens = Lens::given(self.fov_deg, self.ortho_height)?;
        let [eye, target, up] = [self.eye, self.target, self.up].map(glam::DVec3::from);
        Some(Camera { eye, target, up, lens })
    }
}
