//! Requests of the engine's callers.

use std::sync::Arc;
use std::time::Instant;

use glam::DVec3;

use crate::encode::ImageFormat;
use crate::math::{Camera, Lens, View};
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
    /// Work not begun by this time is dropped with [`super::EngineError::DeadlineExceeded`]. A frame that cannot be ready by
    /// then, given what is queued before it, is refused at once with the same error.
    pub deadline: Option<Instant>,
}

impl FrameRequest {
    /// The request with antialiasing decided, which depends on the output.
    #[must_use]
    pub fn with_antialias_decided(self) -> FrameRequest {
        FrameRequest { settings: self.settings.with_antialias_decided(self.output), ..self }
    }

    /// The request with blur decided, which depends on the output and on whether the camera moves.
    #[must_use]
    pub fn with_blur_decided(self) -> FrameRequest {
        let moves = matches!(self.pose, Pose::Moving { .. });
        FrameRequest { settings: self.settings.with_blur_decided(self.output, moves), ..self }
    }
}

/// Camera of a frame.
#[derive(Clone, Debug, PartialEq)]
pub enum Pose {
    /// A camera named in the scene.
    Named(String),
    Camera(Camera),
    /// A camera that moves while the shutter is open.
    Moving {
        /// The camera at the frame's time.
        camera: Camera,
        /// The camera at the time of each exposure; at least one.
        exposed: Arc<[Camera]>,
    },
    /// Like [`Pose::Camera`], with the scene's up direction.
    Upright {
        eye: DVec3,
        target: DVec3,
        lens: Lens,
    },
    /// A resolved view, from explicit matrices.
    View(View),
    /// The scene's default view: from its front and slightly above, or from the sensor that took its points.
    Fit {
        /// Up direction in place of the scene's own.
        up: Option<DVec3>,
        /// Field of view, or height of the view, in place of the view's own.
        lens: Option<Lens>,
    },
}

impl Pose {
    /// The default view with the scene's own settings.
    pub const FIT: Pose = Pose::Fit { up: None, lens: None };
}
