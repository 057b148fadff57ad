//! What a job is to do, as it is kept from one process to the next.

use std::sync::Arc;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::encode::ImageFormat;
use crate::engine::{FrameRequest, Pose};
use crate::film::manifest::digits;
use crate::plan::{ErrorMode, Lod, MaxError, Output, Paint, Reconstruct, Settings, Wait};
use crate::scene::{Blend, Filter, Shading};

/// A camera path of a scene, drawn frame by frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Spec {
    pub scene: String,
    pub path: PathChoice,
    /// Frames a second; `None`: as the path has it.
    pub fps: Option<f64>,
    /// Numbers of the first and the last frame; `None`: the path's.
    pub from: Option<u64>,
    pub to: Option<u64>,
    pub frame: FrameSpec,
    pub want: Want,
}

/// Which path.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PathChoice {
    /// One that the scene names, as the scene has it when a run of the job begins.
    Named(String),
    /// The text of a path file, shared by all who look at the job.
    Inline(Arc<str>),
}

/// What is kept when all is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Want {
    pub frames: bool,
    pub video: bool,
    /// Of the video; `None`: by its size.
    pub bitrate_kbps: Option<u32>,
}

/// A [`FrameRequest`] without scene, pose and deadline.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameSpec {
    pub width: u32,
    pub height: u32,
    pub format: ImageFormat,
    pub quality: u8,
    pub output: Output,
    pub lod: Lod,
    pub max_error_px: f32,
    /// Jobs of earlier versions have none.
    #[serde(default)]
    pub error_mode: ErrorMode,
    pub paint: Paint,
    /// Jobs of earlier versions that name none are drawn as points.
    #[serde(default = "points")]
    pub reconstruct: Reconstruct,
    pub filter: Option<Filter>,
    pub prefilter: Option<bool>,
    pub blend: Option<Blend>,
    pub shading: Option<Shading>,
}

fn points() -> Reconstruct {
    Reconstruct::Points
}

impl FrameSpec {
    pub fn new(request: &FrameRequest) -> FrameSpec {
        let Settings {
            lod,
            max_error,
            error_mode,
            paint,
            reconstruct,
            // Frames of films are all still.
            decide_for: _,
            filter,
            prefilter,
            blend,
            shading,
            // Frames of a job always wait for everything.
            wait: _,
        } = request.settings;
        FrameSpec {
            width: request.width,
            height: request.height,
            format: request.format,
            quality: request.quality,
            output: request.output,
            lod,
            max_error_px: max_error.px(),
            error_mode,
            paint,
            reconstruct,
            filter,
            prefilter,
            blend,
            shading,
        }
    }
}

impl Spec {
    /// The request that all frames have in common; each has a pose of its own.
    pub fn request(&self) -> FrameRequest {
        let FrameSpec {
            lod,
            error_mode,
            paint,
            reconstruct,
            filter,
            prefilter,
            blend,
            shading,
            ..
        } = self.frame;
        // Was checked when the job was made.
        let max_error = MaxError::new(self.frame.max_error_px).unwrap_or_default();
        FrameRequest {
            scene: self.scene.clone(),
            pose: Pose::FIT,
            width: self.frame.width,
            height: self.frame.height,
            settings: Settings {
                lod,
                max_error,
                error_mode,
                paint,
                reconstruct,
                decide_for: None,
                filter,
                prefilter,
                blend,
                shading,
                wait: Wait::Whole,
            },
            output: self.frame.output,
            format: self.frame.format,
            quality: self.frame.quality,
            deadline: None,
        }
    }

    /// Of two specs that ask for the same, the same.
    pub fn fingerprint(&self) -> String {
        // Cannot fail for strings and finite numbers; what fails has no twin.
        digits(&Sha256::digest(serde_json::to_vec(self).unwrap_or_default()))
    }
}

#[cfg(test)]
pub mod tests {
    use super::*;

    pub fn spec(scene: &str) -> Spec {
        let request = FrameRequest {
            scene: scene.to_owned(),
            pose: Pose::FIT,
            width: 64,
            height: 48,
            settings: Settings {
                lod: Lod::Spt,
                max_error: MaxError::new(2.5).unwrap(),
                ..Settings::default()
            },
            output: Output::Color,
            format: ImageFormat::Png,
            quality: 85,
            deadline: None,
        };
        Spec {
            scene: scene.to_owned(),
            path: PathChoice::Named("fly".to_owned()),
            fps: None,
            from: None,
            to: Some(9),
            frame: FrameSpec::new(&request),
            want: Want { frames: true, video: false, bitrate_kbps: None },
        }
    }

    #[test]
    fn jobs_that_name_no_reconstruction_are_drawn_as_points() {
        let mut kept = serde_json::to_value(spec("s")).unwrap();
        assert_eq!(kept["frame"]["reconstruct"], "auto");
        kept["frame"].as_object_mut().unwrap().remove("reconstruct");
        let kept: Spec = serde_json::from_value(kept).unwrap();
        assert_eq!(kept.request().settings.reconstruct, Reconstruct::Points);
    }

    #[test]
    fn what_is_kept_is_what_was_asked_for() {
        let one = spec("s");
        let kept: Spec = serde_json::from_slice(&serde_json::to_vec(&one).unwrap()).unwrap();
        assert_eq!(kept, one);
        assert_eq!(FrameSpec::new(&kept.request()), one.frame);
        assert_eq!(kept.fingerprint(), one.fingerprint());
        assert_ne!(spec("t").fingerprint(), one.fingerprint());
    }
}
