//! The stored specification of a job.

use std::sync::Arc;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::encode::ImageFormat;
use crate::engine::{FrameRequest, Pose};
use crate::film::manifest::digits;
use crate::plan::{Edl, Given, Output, Reconstruct, Settings, Wait};

/// A camera path of a scene, drawn frame by frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Spec {
    pub scene: String,
    pub path: PathChoice,
    /// Frames per second; `None` for the path's own rate.
    pub fps: Option<f64>,
    /// Numbers of the first and the last frame; `None` for the path's own.
    pub from: Option<u64>,
    pub to: Option<u64>,
    pub frame: FrameSpec,
    pub want: Want,
}

/// The path of a job.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PathChoice {
    /// A path of the scene by its name, as it is when a run of the job begins.
    Named(String),
    /// The text of a path file, shared by all readers of the job.
    Inline(Arc<str>),
}

/// Record of a finished job.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Want {
    pub frames: bool,
    pub video: bool,
    /// Bitrate of the video; `None` to choose it by the video's size.
    pub bitrate_kbps: Option<u32>,
}

/// A [`FrameRequest`] without scene, pose and deadline.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(from = "StoredFrame")]
pub struct FrameSpec {
    pub width: u32,
    pub height: u32,
    pub format: ImageFormat,
    pub quality: u8,
    pub output: Output,
    #[serde(flatten)]
    pub settings: Given,
}

/// A [`FrameSpec`] as any version stored it.
#[derive(Deserialize)]
struct StoredFrame {
    width: u32,
    height: u32,
    format: ImageFormat,
    quality: u8,
    output: Output,
    #[serde(flatten)]
    settings: Given,
}

impl From<StoredFrame> for FrameSpec {
    /// Earlier versions stored settings without effect. Where they stored no way of drawing samples, those are points, and where they stored
    /// nothing about eye-dome lighting, there is none.
    fn from(stored: StoredFrame) -> FrameSpec {
        let StoredFrame { width, height, format, quality, output, settings } = stored;
        let earlier = Settings { edl: Edl::Off, ..Settings::drawn_as(Reconstruct::Points) };
        // Earlier versions had no goals, and what a goal leaves open is not stored.
        let has_goal = Settings::from(settings).goal().is_some();
        let settings = if has_goal { settings } else { settings.or(&earlier.applied()) };
        let settings = Settings::from(settings).applied();
        FrameSpec { width, height, format, quality, output, settings }
    }
}

impl FrameSpec {
    pub fn new(request: &FrameRequest) -> FrameSpec {
        FrameSpec {
            width: request.width,
            height: request.height,
            format: request.format,
            quality: request.quality,
            output: request.output,
            settings: request.settings.applied(),
        }
    }
}

impl Spec {
    /// Builds the request that all frames share. Each frame then gets its own pose.
    pub fn request(&self) -> FrameRequest {
        let FrameSpec { width, height, format, quality, output, settings } = self.frame;
        // Frames of a job always wait for everything.
        let settings = Settings { wait: Wait::Whole, ..Settings::from(settings) };
        FrameRequest {
            scene: self.scene.clone(),
            pose: Pose::FIT,
            width,
            height,
            settings,
            output,
            format,
            quality,
            deadline: None,
        }
    }

    /// Hashes the specification. Equal specifications have equal fingerprints.
    pub fn fingerprint(&self) -> String {
        // Serialising strings and finite numbers cannot fail.
        digits(&Sha256::digest(serde_json::to_vec(self).unwrap_or_default()))
    }
}

#[cfg(test)]
pub mod tests;
