//! What the commands that draw have in common: how a frame is drawn, whatever it shows.

use anyhow::{Context, bail};
use clap::{Args, ValueEnum};

use super::local::ID;
use crate::encode::ImageFormat;
use crate::engine::{FrameRequest, Pose};
use crate::plan::{ErrorMode, Lod, MaxError, Output, Paint, Reconstruct, Settings, Wait};
use crate::scene::{Blend, Filter, Shading};

/// Size, settings and quality of frames.
#[derive(Args, Clone, Debug)]
pub struct FrameArgs {
    /// Width and height in pixels
    #[arg(long, value_name = "WxH", default_value = "1024x1024", value_parser = size)]
    size: (u32, u32),
    /// Level of detail
    #[arg(long, value_enum, default_value = "full")]
    lod: LodChoice,
    /// What --lod spt may be wrong by, in pixels [default: 1]
    #[arg(long, value_name = "PX")]
    max_error_px: Option<f32>,
    /// How splats of --lod spt measure that
    #[arg(long, value_enum, default_value = "unified")]
    error_mode: ErrorModeChoice,
    /// Colours tell how high in its tree each node stands; goes with --lod spt
    #[arg(long)]
    levels: bool,
    /// What samples are drawn as
    #[arg(long, value_enum, default_value = "auto")]
    reconstruct: ReconstructChoice,
    /// How splats are taken to the image [default: as the scene has it]
    #[arg(long, value_enum)]
    filter: Option<Filter>,
    /// Whether splats are convolved with a low-pass filter of the image [default: as the scene has it]
    #[arg(long, value_name = "BOOL")]
    prefilter: Option<bool>,
    /// What happens where splats overlap [default: as the scene has it]
    #[arg(long, value_enum)]
    blend: Option<Blend>,
    /// When splats are lit [default: as the scene has it]
    #[arg(long, value_enum)]
    shading: Option<Shading>,
    /// Which image of the frame
    #[arg(long, value_enum, default_value = "color")]
    output: OutputChoice,
    /// Quality of lossy formats
    #[arg(long, default_value_t = 85, value_parser = clap::value_parser!(u8).range(1..=100))]
    quality: u8,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum LodChoice {
    /// Every sample and triangle
    Full,
    /// What --max-error-px asks for, from sequential point trees (Dachsbacher et al. 2003)
    Spt,
}

#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum ErrorModeChoice {
    /// As large as from any side
    Unified,
    /// By the angle to the surface: fewer nodes, and ends of surfaces up to twice as far off where they are seen at an angle
    Split,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum ReconstructChoice {
    /// Points where samples are denser than pixels, splats where they are not
    Auto,
    /// One pixel a sample
    Points,
    /// A closed surface of elliptical Gaussians
    Splats,
    /// Splats in a single pass: faster, coarser
    Fuzzy,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum OutputChoice {
    Color,
    Depth,
    Normal,
    Id,
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
    /// The frame asked for, of the command's only scene.
    ///
    /// # Errors
    /// Options that do not go together.
    pub fn request(&self, pose: Pose, format: ImageFormat) -> anyhow::Result<FrameRequest> {
        let lod = match self.lod {
            LodChoice::Full => Lod::Full,
            LodChoice::Spt => Lod::Spt,
        };
        if self.levels && lod == Lod::Full {
            bail!("--levels goes with --lod spt");
        }
        let max_error = match self.max_error_px {
            None => MaxError::default(),
            Some(_) if lod == Lod::Full => bail!("--max-error-px goes with --lod spt"),
            Some(px) => {
                let [least, most] = MaxError::RANGE_PX;
                MaxError::new(px)
                    .with_context(|| format!("--max-error-px: {px} is not in {least} to {most}"))?
            }
        };
        let reconstruct = match self.reconstruct {
            ReconstructChoice::Auto => Reconstruct::Auto,
            ReconstructChoice::Points => Reconstruct::Points,
            ReconstructChoice::Splats => Reconstruct::Splats,
            ReconstructChoice::Fuzzy => Reconstruct::Fuzzy,
        };
        let error_mode = match self.error_mode {
            ErrorModeChoice::Unified => ErrorMode::Unified,
            ErrorModeChoice::Split if lod == Lod::Full || reconstruct == Reconstruct::Points => {
                bail!("--error-mode split goes with --lod spt and not with --reconstruct points")
            }
            ErrorModeChoice::Split => ErrorMode::Split,
        };
        let of_kernels = self.filter.is_some() || self.prefilter.is_some();
        if of_kernels && reconstruct == Reconstruct::Points {
            bail!(
                "--filter and --prefilter do not go with --reconstruct points: only splats have them"
            );
        }
        let of_passes = self.blend.is_some() || self.shading.is_some();
        if of_passes && matches!(reconstruct, Reconstruct::Points | Reconstruct::Fuzzy) {
            bail!("--blend and --shading go with --reconstruct auto or splats");
        }
        Ok(FrameRequest {
            scene: ID.to_owned(),
            pose,
            width: self.size.0,
            height: self.size.1,
            settings: Settings {
                lod,
                max_error,
                error_mode,
                paint: if self.levels { Paint::Levels } else { Paint::Colors },
                reconstruct,
                decide_for: None,
                filter: self.filter,
                prefilter: self.prefilter,
                blend: self.blend,
                shading: self.shading,
                // A file has no second picture.
                wait: Wait::Complete,
            },
            output: match self.output {
                OutputChoice::Color => Output::Color,
                OutputChoice::Depth => Output::Depth,
                OutputChoice::Normal => Output::Normal,
                OutputChoice::Id => Output::Id,
            },
            format,
            quality: self.quality,
            deadline: None,
        })
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
        // A picture on the disk is not provisional.
        assert_eq!(plain.settings, Settings { wait: Wait::Complete, ..Settings::default() });
        for (line, expected) in [
            (&["--levels"][..], "--levels goes with"),
            (&["--error-mode", "split"], "--error-mode split goes with"),
            (
                &["--lod", "spt", "--reconstruct", "points", "--error-mode", "split"],
                "--error-mode split goes with",
            ),
            (&["--max-error-px", "2"], "--max-error-px goes with"),
            (&["--lod", "spt", "--max-error-px", "0"], "--max-error-px: 0 is not in"),
            (
                &["--reconstruct", "points", "--filter", "exact"],
                "--filter and --prefilter do not go with",
            ),
            (&["--reconstruct", "fuzzy", "--blend", "opaque"], "--blend and --shading go with"),
        ] {
            let refused = request(line).unwrap_err().to_string();
            assert!(refused.contains(expected), "{refused}");
        }
    }
}
