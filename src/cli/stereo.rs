//! `pointillist stereo`: draws what two eyes see, as one image.

use std::path::PathBuf;

use anyhow::Context;
use clap::{Args, ValueEnum};

use super::frame::{DrawArgs, PoseArgs};
use super::local::SceneArgs;
use super::out::say;
use crate::encode::{FrameImage, encode};
use crate::engine::{Engine, FrameRequest};
use crate::plan::Output;
use crate::scene::color::{linear_from_srgb, srgb_from_linear};

/// Options of `pointillist stereo`.
#[derive(Args, Clone, Debug)]
pub struct StereoArgs {
    #[command(flatten)]
    scene: SceneArgs,
    /// Image to write; its extension picks the format: png, jpg, webp or qoi
    #[arg(short = 'o', long = "out", value_name = "FILE")]
    file: PathBuf,
    /// Distance between the eyes, in scene units [default: a thirtieth of the distance of what is near]
    #[arg(long, value_name = "UNITS", value_parser = positive)]
    eye_distance: Option<f64>,
    /// How the images of both eyes make one
    #[arg(long, value_enum, default_value = "side-by-side")]
    layout: Layout,
    #[command(flatten)]
    pose: PoseArgs,
    #[command(flatten)]
    draw: DrawArgs,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Layout {
    /// The left eye's image on the left, the right eye's beside it
    SideBySide,
    /// The left eye's image above the right eye's
    OverUnder,
    /// One image for glasses with a red filter on the left and a cyan one on the right; red is that of the left eye's luminance
    Anaglyph,
}

fn positive(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number: &f64| number.is_finite() && *number > 0.0);
    number.ok_or_else(|| "expected a number above 0".to_owned())
}

/// Default distance between the eyes, as a fraction of the near distance (the 1/30 rule of stereo photography).
const APART: f64 = 1.0 / 30.0;
/// Share of the pixels that show something which is nearer than what counts as near.
const NEAR_SHARE: f64 = 0.02;

/// Draws both images and writes one.
///
/// # Errors
/// The scene, pose or format is refused, there is no GPU, or the file cannot be written.
pub fn run(args: StereoArgs) -> anyhow::Result<()> {
    super::local::init_log();
    let format = super::render::format_of(&args.file)?;
    super::out::check_place(&args.file)?;
    let request = args.draw.request_to_shift(args.pose.pose(args.scene.up()))?;
    let (engine, _) = args.scene.load_and_warn()?;
    let (distance, apart) = distances(&engine, &request, args.eye_distance)?;
    let eyes = |request: &FrameRequest| {
        [-0.5, 0.5].map(|side| {
            let settings = request.settings.shifted(side * apart).stereo_from(distance);
            FrameRequest { settings, ..request.clone() }
        })
    };
    // Settings for a goal are chosen once, so that both eyes see the same.
    let settings = super::path::settings_for_all(&engine, &eyes(&request), request.settings)?;
    let request = FrameRequest { settings, ..request };
    super::path::bake(&engine, &request)?;
    let [left, right] = eyes(&request).map(|request| engine.submit(request));
    let [left, right] = [left?.wait()?, right?.wait()?];
    let [left, right] = [&left, &right].map(|frame| frame.bytes.as_chunks::<4>().0);
    let image = joined(args.layout, [request.width, request.height], left, right);
    let encoded = encode(&image, format, request.quality)?;
    std::fs::write(&args.file, &encoded.bytes)
        .with_context(|| format!("{} cannot be written", args.file.display()))?;
    say!(
        "{}: eyes {apart:.4} apart; what is {distance:.4} away lies in the plane of the image",
        args.file.display()
    );
    Ok(())
}

/// Returns the distance of what both images show in the same place, and that between the eyes.
fn distances(
    engine: &Engine,
    request: &FrameRequest,
    apart: Option<f64>,
) -> anyhow::Result<(f64, f64)> {
    // A shift of any size finds the distance: the given one, or that of the target.
    let probe = request.settings.shifted(f64::from(f32::MIN_POSITIVE));
    let probe = engine.resolve_blocking(FrameRequest { settings: probe, ..request.clone() })?;
    let distance = probe.settings().stereo_at().context("the image plane has no distance")?;
    let apart = match apart {
        Some(apart) => apart,
        None => APART * near(engine, request)?.unwrap_or(distance).min(distance),
    };
    Ok((distance, apart))
}

/// Returns the distance along the viewing axis of what is near; `None` where nothing can be seen.
fn near(engine: &Engine, request: &FrameRequest) -> anyhow::Result<Option<f64>> {
    let frame = engine.submit(FrameRequest { output: Output::Depth, ..request.clone() })?.wait()?;
    let (words, _) = frame.bytes.as_chunks::<4>();
    let depths = words.iter().map(|word| f32::from_le_bytes(*word));
    let mut seen: Vec<f32> = depths.filter(|depth| depth.is_finite() && *depth > 0.0).collect();
    if seen.is_empty() {
        return Ok(None);
    }
    let rank = (NEAR_SHARE * seen.len() as f64) as usize;
    let (_, depth, _) = seen.select_nth_unstable_by(rank, f32::total_cmp);
    Ok(Some(f64::from(*depth)))
}

/// Joins the images of both eyes.
fn joined(
    layout: Layout,
    [width, height]: [u32; 2],
    left: &[[u8; 4]],
    right: &[[u8; 4]],
) -> FrameImage {
    let rows =
        |image: &'_ [[u8; 4]]| image.chunks_exact(width as usize).map(<[_]>::to_vec).collect();
    let [left_rows, right_rows]: [Vec<Vec<[u8; 4]>>; 2] = [rows(left), rows(right)];
    match layout {
        Layout::SideBySide => {
            let both = left_rows.into_iter().zip(right_rows).flat_map(|(a, b)| [a, b]);
            FrameImage::Color { width: 2 * width, height, rgba: both.flatten().collect() }
        }
        Layout::OverUnder => {
            let both = left_rows.into_iter().chain(right_rows);
            FrameImage::Color { width, height: 2 * height, rgba: both.flatten().collect() }
        }
        Layout::Anaglyph => {
            let rgba = left.iter().zip(right).map(|(left, right)| anaglyph(*left, *right));
            FrameImage::Color { width, height, rgba: rgba.collect() }
        }
    }
}

/// A pixel for red and cyan glasses: the luminance of the left image (ITU-R BT.709) in red, the right image's green and blue. A "half-colour"
/// anaglyph (E. Dubois, *A Projection Method to Generate Anaglyph Stereo Images*, ICASSP 2001, compares it with others).
fn anaglyph(left: [u8; 4], right: [u8; 4]) -> [u8; 4] {
    let [r, g, b] =
        [0, 1, 2].map(|channel: usize| linear_from_srgb(f64::from(left[channel]) / 255.0));
    let luminance = 0.2126 * r + 0.7152 * g + 0.0722 * b;
    let red = (255.0 * srgb_from_linear(luminance)).round() as u8;
    [red, right[1], right[2], left[3].max(right[3])]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_are_joined_by_rows() {
        let image = |first: u8| [0, 1, 2, 3].map(|n| [first + n, 0, 0, 255]);
        let (left, right) = (image(10), image(20));
        let reds = |layout| match joined(layout, [2, 2], &left, &right) {
            FrameImage::Color { width, height, rgba } => {
                (width, height, rgba.iter().map(|pixel| pixel[0]).collect::<Vec<u8>>())
            }
            _ => panic!("no colours"),
        };
        assert_eq!(reds(Layout::SideBySide), (4, 2, vec![10, 11, 20, 21, 12, 13, 22, 23]));
        assert_eq!(reds(Layout::OverUnder), (2, 4, vec![10, 11, 12, 13, 20, 21, 22, 23]));
    }

    #[test]
    fn each_filter_sees_its_eye() {
        assert_eq!(anaglyph([255, 255, 255, 255], [0, 0, 0, 255]), [255, 0, 0, 255]);
        assert_eq!(anaglyph([0, 0, 0, 0], [9, 200, 100, 255]), [0, 200, 100, 255]);
        let [red, ..] = anaglyph([128, 128, 128, 255], [0; 4]);
        assert_eq!(red, 128);
    }

    #[test]
    fn distances_are_above_zero() {
        assert_eq!(positive("0.065"), Ok(0.065));
        assert!(positive("0").is_err() && positive("nan").is_err() && positive("-1").is_err());
    }
}
