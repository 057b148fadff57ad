//! Options that all drawing commands share: how a frame is drawn, whatever it shows.

use anyhow::{anyhow, ensure};
use clap::{Args, ValueEnum};
use glam::DVec3;

use super::local::ID;
use crate::encode::ImageFormat;
use crate::engine::{FrameRequest, Pose};
use crate::http::{DEFAULT_FOV_DEG, DEFAULT_QUALITY};
use crate::math::{Camera, Lens};
use crate::plan::{Given, Output, Settings, Wait};

/// Size and settings of frames.
#[derive(Args, Clone, Debug)]
pub struct DrawArgs {
    /// Width and height in pixels
    #[arg(long, value_name = "WxH", default_value = "1024x1024", value_parser = size)]
    size: (u32, u32),
    #[command(flatten)]
    settings: Given,
}

/// Size, settings and quality of frames.
#[derive(Args, Clone, Debug)]
pub struct FrameArgs {
    #[command(flatten)]
    draw: DrawArgs,
    /// Kind of image to draw
    #[arg(long, value_enum, default_value = "color")]
    output: Output,
    /// Quality of lossy formats
    #[arg(long, default_value_t = DEFAULT_QUALITY, value_parser = clap::value_parser!(u8).range(1..=100))]
    quality: u8,
}

/// Camera of a frame.
#[derive(Args, Clone, Debug)]
pub struct PoseArgs {
    /// Name of a camera in the scene [default: a camera that sees the whole scene]
    #[arg(long, value_name = "NAME", conflicts_with_all = ["eye", "target", "up", "fov", "ortho_height"])]
    camera: Option<String>,
    /// Position of the eye in world space
    #[arg(long, value_name = "X,Y,Z", value_parser = vector, allow_hyphen_values = true, requires = "target")]
    eye: Option<DVec3>,
    /// Point that the eye looks at, in world space
    #[arg(long, value_name = "X,Y,Z", value_parser = vector, allow_hyphen_values = true, requires = "eye")]
    target: Option<DVec3>,
    /// Vertical field of view in degrees [default: 40]
    #[arg(long, value_name = "DEG")]
    fov: Option<f64>,
    /// Height of the view in scene units: the projection is orthographic
    #[arg(long, value_name = "UNITS", conflicts_with = "fov")]
    ortho_height: Option<f64>,
}

impl PoseArgs {
    /// The pose, with `up` as its up direction, if there is one.
    pub fn pose(&self, up: Option<DVec3>) -> Pose {
        if let Some(name) = &self.camera {
            return Pose::Named(name.clone());
        }
        let lens = Lens::given(self.fov, self.ortho_height);
        let (Some(eye), Some(target)) = (self.eye, self.target) else {
            return Pose::Fit { up, lens };
        };
        let lens = lens.unwrap_or(Lens::Perspective { fov_deg: DEFAULT_FOV_DEG });
        match up {
            Some(up) => Pose::Camera(Camera { eye, target, up, lens }),
            None => Pose::Upright { eye, target, lens },
        }
    }
}

fn vector(text: &str) -> Result<DVec3, String> {
    let numbers: Vec<f64> = text
        .split(',')
        .map(|part| part.trim().parse::<f64>().ok().filter(|number| number.is_finite()))
        .collect::<Option<_>>()
        .ok_or("expected three numbers, as in 0,1.5,-3")?;
    let [x, y, z] = numbers[..] else {
        return Err(format!("expected three numbers, got {}", numbers.len()));
    };
    Ok(DVec3::new(x, y, z))
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(super) enum FormatChoice {
    Png,
    #[value(alias = "jpeg")]
    Jpg,
    Webp,
    Qoi,
    Exr,
    Pfm,
    Raw,
}

impl FormatChoice {
    pub fn format(self) -> ImageFormat {
        match self {
            FormatChoice::Png => ImageFormat::Png,
            FormatChoice::Jpg => ImageFormat::Jpeg,
            FormatChoice::Webp => ImageFormat::Webp,
            FormatChoice::Qoi => ImageFormat::Qoi,
            FormatChoice::Exr => ImageFormat::Exr,
            FormatChoice::Pfm => ImageFormat::Pfm,
            FormatChoice::Raw => ImageFormat::Raw,
        }
    }
}

pub(super) fn size(text: &str) -> Result<(u32, u32), String> {
    let sides = text
        .split_once(['x', 'X', '×'])
        .map(|(w, h)| (w.trim().parse::<u32>(), h.trim().parse::<u32>()));
    match sides {
        Some((Ok(width), Ok(height))) if width > 0 && height > 0 => Ok((width, height)),
        _ => Err("expected WIDTHxHEIGHT in pixels, as in 1920x1080".to_owned()),
    }
}

impl FrameArgs {
    /// The requested frame of the command's only scene.
    ///
    /// # Errors
    /// Options contradict each other.
    pub fn request(&self, pose: Pose, format: ImageFormat) -> anyhow::Result<FrameRequest> {
        let Self { output, quality, .. } = *self;
        Ok(FrameRequest { output, format, quality, ..self.draw.request(pose)? })
    }
}

impl DrawArgs {
    /// A colour frame of the command's only scene.
    ///
    /// # Errors
    /// Options contradict each other.
    pub fn request(&self, pose: Pose) -> anyhow::Result<FrameRequest> {
        let option = |name: &str| name.replace('_', "-");
        let settings = self.settings.resolve().map_err(|error| {
            let accepted = error.accepted(|name, value| format!("--{} {value}", option(name)));
            anyhow!("--{}: {}; accepted: {accepted}", option(error.setting), error.reason)
        })?;
        Ok(FrameRequest {
            scene: ID.to_owned(),
            pose,
            width: self.size.0,
            height: self.size.1,
            // A file is never replaced by a better frame later.
            settings: Settings { wait: Wait::Complete, ..settings },
            output: Output::Color,
            format: ImageFormat::Raw,
            quality: DEFAULT_QUALITY,
            deadline: None,
        })
    }

    /// A colour frame for a command that shifts the eye itself: what goes with a shifted eye may be given.
    ///
    /// # Errors
    /// Options contradict each other, or shift the eye.
    pub fn request_to_shift(&self, pose: Pose) -> anyhow::Result<FrameRequest> {
        ensure!(
            self.settings.eye_offset.is_none(),
            "--eye-offset: this command shifts the eyes itself; --eye-distance says how far"
        );
        let settings = Given { eye_offset: Some(1.0), ..self.settings };
        let shifted = Self { settings, ..*self }.request(pose)?;
        Ok(FrameRequest { settings: shifted.settings.shifted(0.0), ..shifted })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        args: FrameArgs,
    }

    fn request(line: &[&str]) -> anyhow::Result<FrameRequest> {
        let line = std::iter::once(&"render").chain(line);
        Line::parse_from(line).args.request(Pose::FIT, ImageFormat::Png)
    }

    #[test]
    fn sizes() {
        assert_eq!(size("640x480"), Ok((640, 480)));
        assert!(size("640").is_err() && size("0x4").is_err() && size("-1x4").is_err());
    }

    #[test]
    fn options_that_do_not_go_together_are_named() {
        let plain = request(&[]).unwrap();
        assert_eq!((plain.width, plain.height, plain.quality), (1024, 1024, 85));
        // A file is never provisional.
        assert_eq!(plain.settings, Settings { wait: Wait::Complete, ..Settings::default() });
        for (line, expected) in [
            (&["--color-by", "levels"][..], "--color-by: this setting applies to `lod=spt` only"),
            (
                &["--error-mode", "split"],
                "`--lod spt` and `--reconstruct splats`, `fuzzy`, `painted` or `auto`",
            ),
            (
                &["--lod", "spt", "--reconstruct", "points", "--error-mode", "split"],
                "--error-mode: points are selected by their size",
            ),
            (
                &["--lod", "full", "--max-error-px", "2"],
                "no value, or a value together with `--lod spt`",
            ),
            (&["--lod", "spt", "--max-error-px", "0"], "accepted: 0.05 to 64 pixels"),
            (
                &["--blur-samples", "64"],
                "--blur-samples: nothing is blurred, because there is neither an aperture nor an open shutter; accepted: `32`",
            ),
            (
                &["--reconstruct", "points", "--filter", "exact"],
                "--filter: this setting applies to splats only",
            ),
            (&["--reconstruct", "fuzzy", "--blend", "opaque"], "`--reconstruct splats` or `auto`"),
        ] {
            let refused = request(line).unwrap_err().to_string();
            assert!(refused.contains(expected), "{refused}");
        }
    }
}
