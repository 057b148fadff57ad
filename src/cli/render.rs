//! `pointillist render`: one frame through the same engine that serves many.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context;
use clap::Args;
use glam::DVec3;

use super::frame::{FormatChoice, FrameArgs};
use super::local::SceneArgs;
use super::out::say;
use crate::encode::ImageFormat;
use crate::engine::{EncodedFrame, Pose, Receipt};
use crate::math::Camera;

const DEFAULT_FOV_DEG: f64 = 40.0;

/// What to draw, from where, and where to.
#[derive(Args, Clone, Debug)]
pub struct RenderArgs {
    #[command(flatten)]
    scene: SceneArgs,
    /// Image to write, `-` for standard output; its extension picks the format: png, jpg, webp, qoi, exr, pfm, raw
    #[arg(short = 'o', long = "out", value_name = "FILE")]
    file: PathBuf,
    /// Format of the image [default: by the extension; png on standard output]
    #[arg(long, value_enum)]
    format: Option<FormatChoice>,
    /// Camera that the scene names [default: one that sees the whole scene]
    #[arg(long, value_name = "NAME", conflicts_with_all = ["eye", "target", "up", "fov"])]
    camera: Option<String>,
    /// Where the eye is, in world space
    #[arg(long, value_name = "X,Y,Z", value_parser = vector, allow_hyphen_values = true, requires = "target")]
    eye: Option<DVec3>,
    /// What the eye looks at
    #[arg(long, value_name = "X,Y,Z", value_parser = vector, allow_hyphen_values = true, requires = "eye")]
    target: Option<DVec3>,
    /// Vertical field of view in degrees [default: 40]
    #[arg(long, value_name = "DEG")]
    fov: Option<f64>,
    #[command(flatten)]
    frame: FrameArgs,
    /// Write the frame's receipt, as JSON
    #[arg(long, value_name = "FILE")]
    receipt: Option<PathBuf>,
    /// Draw the frame this many times; the receipt is the median one's
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    repeat: u32,
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

fn format_of(file: &Path) -> anyhow::Result<ImageFormat> {
    let extension = file.extension().unwrap_or_default().to_string_lossy();
    ImageFormat::named(&extension).with_context(|| {
        format!(
            "{}: no image format has the extension `{extension}`; there are png, jpg, webp, qoi, exr, pfm, raw; or name one with --format",
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

    fn pose(&self) -> Pose {
        if let Some(name) = &self.camera {
            return Pose::Named(name.clone());
        }
        let up = self.scene.up();
        let (Some(eye), Some(target)) = (self.eye, self.target) else {
            return Pose::Fit { up, fov_deg: self.fov };
        };
        let fov_deg = self.fov.unwrap_or(DEFAULT_FOV_DEG);
        match up {
            Some(up) => Pose::Camera(Camera { eye, target, up, fov_deg }),
            None => Pose::Upright { eye, target, fov_deg },
        }
    }
}

/// Draws and writes.
///
/// # Errors
/// A scene, pose or format that is refused, no GPU, a file that cannot be written.
pub fn run(args: RenderArgs) -> anyhow::Result<()> {
    super::local::init_log();
    let request = args.frame.request(args.pose(), args.format()?)?;
    let begin = Instant::now();
    let (engine, info) = args.scene.load(|_| ())?;
    for warning in &info.warnings {
        say!("warning: {warning}");
    }
    let loaded = begin.elapsed();
    let mut frames = Vec::with_capacity(args.repeat as usize);
    for _ in 0..args.repeat {
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
    if let Some(why) = median.receipt.hardly_visible() {
        say!("warning: {why}");
    }
    say!(
        "{}: {}, loaded in {:.2} s; {}",
        if args.is_to_stdout() { "standard output".into() } else { args.file.to_string_lossy() },
        contents(info.samples, info.triangles, info.instances),
        loaded.as_secs_f64(),
        summary(&median.receipt)
    );
    Ok(())
}

/// How many things a scene shows.
pub(super) fn contents(samples: u64, triangles: u64, instances: u64) -> String {
    let mut parts = Vec::new();
    for (count, one, many) in [
        (samples, "sample", "samples"),
        (triangles, "triangle", "triangles"),
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
    use super::*;
    use clap::Parser;

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
        assert_eq!(parse(&["-o", "a.png"]).unwrap().pose(), Pose::FIT);
        let args = parse(&["-o", "a.png", "--eye", "-1,2,3e2", "--target=0,0,0"]).unwrap();
        let eye = DVec3::new(-1.0, 2.0, 300.0);
        assert_eq!(args.pose(), Pose::Upright { eye, target: DVec3::ZERO, fov_deg: 40.0 });
        let args = parse(&[
            "-o", "a.png", "--eye", "1,0,0", "--target", "0,0,0", "--up", "0,0,1", "--fov", "9",
        ]);
        let Pose::Camera(camera) = args.unwrap().pose() else { panic!("not a camera") };
        assert_eq!((camera.up, camera.fov_deg), (DVec3::Z, 9.0));
        let upright = parse(&["-o", "a.png", "--up", "-z", "--fov", "30"]).unwrap().pose();
        assert_eq!(upright, Pose::Fit { up: Some(DVec3::NEG_Z), fov_deg: Some(30.0) });
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
        assert_eq!(contents(1, 0, 2), "1 sample, 2 instances");
        assert_eq!(contents(0, 0, 0), "nothing to draw");
    }
}
