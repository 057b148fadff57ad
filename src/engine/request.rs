//! What a caller asks for.

use std::time::Instant;

use glam::DVec3;

use crate::encode::ImageFormat;
use crate::math::{Camera, View};
use crate::plan::{Output, Settings};

/// One frame of one scene.
#[derive(Clone, Debug)]
pub struct FrameRequest {
    pub scene: String,
    pub pose: Pose,
    pub width: u32,
    pub height: u32,
    pub settings: Settings,
    pub output: Output,
    pub format: ImageFormat,
    /// 1..=100, for the lossy formats.
    pub quality: u8,
    /// Work not begun by then is dropped with [`super::EngineError::DeadlineExceeded`]; what cannot be had by then, by what is
    /// queued before it, is refused with the same at once.
    pub deadline: Option<Instant>,
}

/// Where a frame is seen from.
#[derive(Clone, Debug, PartialEq)]
pub enum Pose {
    /// A camera that the scene names.
    Named(String),
    Camera(Camera),
    /// As [`Pose::Camera`], upright as the scene is.
    Upright {
        eye: DVec3,
        target: DVec3,
        fov_deg: f64,
    },
    /// Already resolved, from explicit matrices.
    View(View),
    /// The whole scene, as it is seen at first: from its front and slightly above, or as the sensor that took its points saw it.
    Fit {
        /// Up instead of the scene's own.
        up: Option<DVec3>,
        /// Vertical field of view instead of the view's own.
        fov_deg: Option<f64>,
    },
}

impl Pose {
    /// The whole scene, as the scene itself has it.
    pub const FIT: Pose = Pose::Fit { up: None, fov_deg: None };
}
