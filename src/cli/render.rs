//! `pointillist render`: draws one frame with the engine that the server uses.

use std::path::{Path, PathBuf};
use std::sync::mpsc;
use std::time::{Duration, Instant};

use anyhow::Context;
use clap::Args;

use super::frame::{FormatChoice, FrameArgs, PoseArgs};
use super::local::SceneArgs;
use super::out::say;
use crate::encode::ImageFormat;
use crate::engine::{EncodedFrame, Receipt};

/// Options of `pointillist render`.
#[derive(Args, Clone, Debug)]
pub struct RenderArgs {
    #[command(flatten)]
    scene: SceneArgs,
    /// Image to write, `-` for standard output; its extension picks the format: png, jpg, webp, qoi, exr, pfm, raw
    #[arg(short = 'o', long = "out", value_name = "FILE")]
    file: PathBuf,
    /// Format of the image [default: from the extension; png on standard output]
    #[arg(long, value_enum)]
    format: Option<FormatChoice>,
    #[command(flatten)]
    pose: PoseArgs,
    #[command(flatten)]
    frame: FrameArgs,
    /// Write the frame's receipt to this file, as JSON
    #[arg(long, value_name = "FILE")]
    receipt: Option<PathBuf>,
    /// Draw the frame this many times; the receipt is that of the run with the median time
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    repeat: u32,
}

/// Time of a frame, in ns, that may be one of compiling: lavapipe compiles when it draws.
const LONG_NS: u64 = 4_000_000_000;
/// Time of a bake that is told.
const LONG_BAKE: Duration = Duration::from_millis(500);
/// Wait after which a word tells why.
const LONG_WAIT: Duration = Duration::from_secs(5);

pub(super) fn format_of(file: &Path) -> anyhow::Result<ImageFormat> {
    let extension = file.extension().unwrap_or_default().to_string_lossy();
    ImageFormat::named(&extension).with_context(|| {
        format!(
            "{}: no image format has the extension `{extension}`; use png, jpg, webp, qoi, exr, pfm or raw, or name a format with --format",
            file.display()
        )
    })
}

impl RenderArgs {
    fn is_to_stdout(&self) -> bool {
        self.file.as_os_str() == "-"
    }

    fn format(&self) -> anyhow::Result<ImageFormat> {
        match self.format {
            Some(choice) => Ok(choice.format()),
            None if self.is_to_stdout() => Ok(ImageFormat::Png),
            None => format_of(&self.file),
        }
    }
}

/// Draws the frame and writes it.
///
/// # Errors
/// The scene, pose or format is refused, there is no GPU, or the file cannot be written.
pub fn run(args: RenderArgs) -> anyhow::Result<()> {
    super::local::init_log();
    let request = args.frame.request(args.pose.pose(args.scene.up()), args.format()?)?;
    let image = Some(&args.file).filter(|_| !args.is_to_stdout());
    image.into_iter().chain(&args.receipt).try_for_each(|file| super::out::check_place(file))?;
    let begin = Instant::now();
    let (engine, info) = args.scene.load_and_warn()?;
    let loaded = begin.elapsed();
    super::path::bake(&engine, &request)?;
    let baked = begin.elapsed() - loaded;
    // Only the first frame waits for the driver's compiler.
    let drawn = tell_of_long_waits();
    let mut frames = vec![engine.submit(request.clone())?.wait()?];
    drop(drawn);
    for _ in 1..args.repeat {
        frames.push(engine.submit(request.clone())?.wait()?);
    }
    frames.sort_by_key(|frame| frame.receipt.total_ns);
    let median: &EncodedFrame = &frames[(frames.len() - 1) / 2];
    if args.is_to_stdout() {
        super::out::print_bytes(&median.bytes)?;
    } else {
        write(&args.file, &median.bytes)?;
    }
    if let Some(file) = &args.receipt {
        write(file, &serde_json::to_vec_pretty(&median.receipt)?)?;
    }
    for why in median.receipt.warnings() {
        say!("warning: {why}");
    }
    say!(
        "{}: {}, loaded in {:.2} s; {}",
        if args.is_to_stdout() { "standard output".into() } else { args.file.to_string_lossy() },
        contents([info.samples, info.triangles, info.segments], info.instances),
        loaded.as_secs_f64(),
        summary(&median.receipt)
    );
    if baked > LONG_BAKE {
        say!("{:.1} s before that for normals, kernels or point trees", baked.as_secs_f64());
    }
    if args.repeat == 1 && median.receipt.gpu_ns.is_some_and(|ns| ns > LONG_NS) {
        say!(
            "the driver may have compiled shaders meanwhile, which it does once; --repeat 3 tells the time without that"
        );
    }
    Ok(())
}

/// Says once why a frame takes long, unless the result is dropped before.
fn tell_of_long_waits() -> mpsc::SyncSender<()> {
    let (drawn, waits) = mpsc::sync_channel(0);
    std::thread::spawn(move || {
        if waits.recv_timeout(LONG_WAIT) == Err(mpsc::RecvTimeoutError::Timeout) {
            say!(
                "drawing; a driver compiles shaders that it has not seen before, which can take half a minute once"
            );
        }
    });
    drawn
}

/// The numbers of samples, triangles, segments and instances, in words.
pub(super) fn contents([samples, triangles, segments]: [u64; 3], instances: u64) -> String {
    let mut parts = Vec::new();
    for (count, one, many) in [
        (samples, "sample", "samples"),
        (triangles, "triangle", "triangles"),
        (segments, "segment", "segments"),
        (instances, "instance", "instances"),
    ] {
        if count > 0 {
            parts.push(format!("{count} {}", if count == 1 { one } else { many }));
        }
    }
    if parts.is_empty() { "nothing to draw".to_owned() } else { parts.join(", ") }
}

fn summary(receipt: &Receipt) -> String {
    let ms = |ns: u64| ns as f64 / 1e6;
    let gpu = receipt.gpu_ns.map_or("untimed GPU".to_owned(), |ns| format!("GPU {:.2} ms", ms(ns)));
    format!(
        "{gpu}, encoding {:.2} ms, {:.2} ms in all on {}",
        ms(receipt.encode_ns),
        ms(receipt.total_ns),
        receipt.adapter
    )
}

fn write(file: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    std::fs::write(file, bytes).with_context(|| format!("{} cannot be written", file.display()))
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use glam::DVec3;

    use super::*;
    use crate::engine::Pose;
    use crate::math::Lens;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        args: RenderArgs,
    }

    fn parse(line: &[&str]) -> Result<RenderArgs, String> {
        let line = ["render", "scene.json"].iter().chain(line);
        Line::try_parse_from(line).map(|line| line.args).map_err(|error| error.to_string())
    }

    #[test]
    fn poses() {
        let pose = |args: RenderArgs| args.pose.pose(args.scene.up());
        assert_eq!(pose(parse(&["-o", "a.png"]).unwrap()), Pose::FIT);
        let args = parse(&["-o", "a.png", "--eye", "-1,2,3e2", "--target=0,0,0"]).unwrap();
        let eye = DVec3::new(-1.0, 2.0, 300.0);
        assert_eq!(
            pose(args),
            Pose::Upright { eye, target: DVec3::ZERO, lens: Lens::Perspective { fov_deg: 40.0 } }
        );
        let args = parse(&[
            "-o", "a.png", "--eye", "1,0,0", "--target", "0,0,0", "--up", "0,0,1", "--fov", "9",
        ]);
        let Pose::Camera(camera) = pose(args.unwrap()) else { panic!("not a camera") };
        assert_eq!((camera.up, camera.lens.fov_deg()), (DVec3::Z, Some(9.0)));
        let upright = pose(parse(&["-o", "a.png", "--up", "-z", "--fov", "30"]).unwrap());
        assert_eq!(
            upright,
            Pose::Fit { up: Some(DVec3::NEG_Z), lens: Some(Lens::Perspective { fov_deg: 30.0 }) }
        );
        assert!(parse(&["-o", "a.png", "--up", "w"]).unwrap_err().contains("x, y, z, -x"));
        assert!(parse(&["-o", "a.png", "--camera", "x", "--up", "z"]).is_err());
        assert!(parse(&["-o", "a.png", "--camera", "x", "--fov", "9"]).is_err());
        assert!(parse(&["-o", "a.png", "--eye", "1,0,0"]).unwrap_err().contains("--target"));
        assert!(
            parse(&["-o", "a.png", "--eye", "1,0", "--target", "0,0,0"])
                .unwrap_err()
                .contains("three numbers")
        );
    }

    #[test]
    fn formats() {
        assert_eq!(format_of(Path::new("a/b.JPG")).unwrap(), ImageFormat::Jpeg);
        assert!(format_of(Path::new("a.tiff")).unwrap_err().to_string().contains("tiff"));
        assert!(format_of(Path::new("a")).is_err());
        let format = |line: &[&str]| parse(line).unwrap().format().unwrap();
        assert_eq!(format(&["-o", "-"]), ImageFormat::Png);
        for name in ["jpg", "jpeg"] {
            assert_eq!(format(&["-o", "-", "--format", name]), ImageFormat::Jpeg);
        }
        assert_eq!(format(&["-o", "a.png", "--format", "raw"]), ImageFormat::Raw);
    }

    #[test]
    fn contents_in_words() {
        assert_eq!(contents([1, 0, 7], 2), "1 sample, 7 segments, 2 instances");
        assert_eq!(contents([0; 3], 0), "nothing to draw");
    }
}
