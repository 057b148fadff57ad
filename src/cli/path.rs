//! `pointillist path`: draws a camera path as numbered frames or as a video, in as many runs as it takes.

use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use clap::Args;
use glam::DVec3;
use indicatif::{ProgressBar, ProgressStyle};

use super::frame::{FormatChoice, FrameArgs};
use super::local::{ID, SceneArgs, progress_bar};
use super::out::say;
use crate::engine::{Client, Engine, EngineError, FrameRequest, Pose, Receipt, SceneInfo};
use crate::film::video::{Coder, Reel, VideoError, encode};
use crate::film::{self, Event, Film, FilmError, Report, shots::Shots};
use crate::http::server::stop_signal;
use crate::plan::planner::PlanReceipt;
use crate::plan::{Settings, Wait};
use crate::scene::{CameraPath, SceneLimits, load_path};

/// Options of `pointillist path`.
#[derive(Args, Clone, Debug)]
pub struct PathArgs {
    #[command(flatten)]
    scene: SceneArgs,
    /// Name of a path in the scene, or a path file (.json)
    #[arg(long, value_name = "NAME_OR_FILE")]
    path: String,
    /// Folder for the frames (frame-00000.png, …) and their manifest (frames.jsonl), created if missing; or a video (.mp4), whose
    /// frames are kept in a folder beside it (.mp4.frames) until the video is finished
    #[arg(short = 'o', long = "out", value_name = "FOLDER_OR_MP4")]
    out: PathBuf,
    /// Keep the frames after the video is finished
    #[arg(long)]
    keep_frames: bool,
    /// Bit rate of the video in kilobits per second [default: from its size and frame rate]
    #[arg(long, value_name = "N")]
    bitrate_kbps: Option<u32>,
    /// Image format of the frames
    #[arg(long, value_enum, default_value = "png")]
    format: FormatChoice,
    /// Frames per second [default: the path's own]
    #[arg(long, value_name = "N")]
    fps: Option<f64>,
    /// Number of the first frame to draw [default: 0]
    #[arg(long, value_name = "FRAME")]
    from: Option<u64>,
    /// Number of the last frame to draw [default: the path's last]
    #[arg(long, value_name = "FRAME")]
    to: Option<u64>,
    #[command(flatten)]
    frame: FrameArgs,
}

/// Draws the missing frames, with a progress bar on a terminal and a line every few seconds elsewhere.
///
/// # Errors
/// The scene, path or a setting is refused, there is no GPU, the folder cannot be written, or a signal stops the run before the
/// last frame.
pub fn run(args: PathArgs) -> anyhow::Result<()> {
    super::local::init_log();
    args.scene.check_up()?;
    // The pose is replaced in each frame.
    let mut request = args.frame.request(Pose::FIT, args.format.format())?;
    request.settings.wait = Wait::Whole;
    let target = Target::new(&args)?;
    let (engine, info) = args.scene.load_and_warn()?;
    let mark = engine.scene_mark(ID).context("the scene is gone")?;
    let shots = shots(&engine, &info, &args.path, args.fps, args.from, args.to)?;
    let reel = Reel::new(&request, &shots, args.bitrate_kbps);
    if let Some(video) = &target.video {
        reel.check(&video.coder).map_err(named)?;
    }
    bake(&engine, &request)?;
    let stop = stop_when_told()?;
    let film = Film {
        engine: &engine,
        request,
        shots,
        mark,
        folder: &target.folder,
        origin: Client::Unnamed.into(),
        most_pixels: film::MOST_PIXELS,
        elsewhere: None,
    };
    let began = Instant::now();
    let mut telling = Telling::new();
    let report = film::run(&film, &stop, |event| telling.hear(&event));
    telling.bar.finish_and_clear();
    let report = report?;
    say!("{}: {}", target.folder.display(), telling.summary(&report, began.elapsed()));
    if let Some(first) = report.left_over.first() {
        say!(
            "warning: {} files of earlier runs do not belong to this path as drawn now, for example {first}; \
             {} does not list them",
            report.left_over.len(),
            film::MANIFEST
        );
    }
    if report.missing > 0 {
        bail!(
            "stopped by a signal, {} frames are missing; run the same command again to continue",
            report.missing
        );
    }
    match &target.video {
        None => Ok(()),
        Some(video) => {
            make(video, &reel, &film, &stop)?;
            if args.keep_frames { Ok(()) } else { remove_frames(&target.folder) }
        }
    }
}

/// The folder of the frames, and the video if there is one.
struct Target {
    folder: PathBuf,
    video: Option<VideoFile>,
}

struct VideoFile {
    out: PathBuf,
    coder: Coder,
}

impl Target {
    fn new(args: &PathArgs) -> anyhow::Result<Target> {
        if !is_video(&args.out) {
            const VIDEOS: [&str; 8] = ["avi", "mkv", "mov", "webm", "m4v", "mpg", "gif", "ogv"];
            let extension = args.out.extension().and_then(|extension| extension.to_str());
            if let Some(other) =
                extension.filter(|own| VIDEOS.contains(&own.to_ascii_lowercase().as_str()))
            {
                bail!(
                    "-o {}: cannot write .{other} videos; give a name that ends in .mp4, or a folder",
                    args.out.display()
                );
            }
            if args.keep_frames || args.bitrate_kbps.is_some() {
                bail!("--keep-frames and --bitrate-kbps need a video as output, as in -o film.mp4");
            }
            if args.out.exists() && !args.out.is_dir() {
                bail!(
                    "-o {}: this is an existing file; give a folder for frames, or a name that ends in .mp4 for a video",
                    args.out.display()
                );
            }
            return Ok(Target { folder: args.out.clone(), video: None });
        }
        let coder = Coder::find()?;
        let mut folder = args.out.clone().into_os_string();
        folder.push(".frames");
        let folder = PathBuf::from(folder);
        if folder.exists() && !folder.is_dir() {
            bail!(
                "-o {}: the frames of the video need the folder {}, but a file has that name",
                args.out.display(),
                folder.display()
            );
        }
        Ok(Target { folder, video: Some(VideoFile { out: args.out.clone(), coder }) })
    }
}

/// Whether the output is a video rather than a folder.
fn is_video(out: &Path) -> bool {
    out.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("mp4")) && !out.is_dir()
}

/// Names the option instead of the parameter in an error.
fn named(error: VideoError) -> anyhow::Error {
    match error {
        VideoError::Unfit { parameter, reason } => {
            let option = match parameter {
                "w" | "h" => "size".to_owned(),
                other => other.replace('_', "-"),
            };
            anyhow::anyhow!("--{option}: {reason}")
        }
        other => other.into(),
    }
}

/// Codes the video when all frames are finished.
fn make(video: &VideoFile, reel: &Reel, film: &Film<'_>, stop: &AtomicBool) -> anyhow::Result<()> {
    let bar = progress_bar();
    bar.set_length(reel.frames);
    bar.set_message("coding");
    let records = film::records(film.folder)?;
    let wanted = records.range(film.shots.wanted()).map(|(_, record)| record.as_ref());
    let began = Instant::now();
    let made = encode(&video.coder, reel, film.folder, wanted, &video.out, stop, |coded| {
        bar.set_position(coded)
    });
    bar.finish_and_clear();
    made.map_err(named)
        .context("the frames are all there; the same command makes the video of them")?;
    let bytes = std::fs::metadata(&video.out).map_or(0, |found| found.len());
    let seconds = began.elapsed().as_secs_f64();
    let length_s = reel.frames as f64 / reel.fps;
    say!(
        "{}: {}, {length_s:.2} s, {bytes} bytes, coded in {seconds:.2} s",
        video.out.display(),
        frames(reel.frames)
    );
    Ok(())
}

/// Removes the frames and manifest that a video was made of, and their folder if nothing else is in it.
fn remove_frames(folder: &Path) -> anyhow::Result<()> {
    film::remove(folder)?;
    // The folder stays if it has other files.
    let _ = std::fs::remove_dir(folder);
    Ok(())
}

/// The frames of the scene's path of this name, or else of the path in the file of this name.
///
/// # Errors
/// There is no such path, or it does not have these frames; the error names the option.
pub(super) fn shots(
    engine: &Engine,
    info: &SceneInfo,
    name: &str,
    fps: Option<f64>,
    from: Option<u64>,
    to: Option<u64>,
) -> anyhow::Result<Shots> {
    let path = find(engine, info, name)?;
    Shots::new(&path, fps, from, to).map_err(|error| match error {
        FilmError::BadRange { parameter, reason } => anyhow::anyhow!("--{parameter}: {reason}"),
        other => anyhow::anyhow!("--path {name}: {other}"),
    })
}

/// The scene's path of this name, or else the path in the file of this name.
fn find(engine: &Engine, info: &SceneInfo, name: &str) -> anyhow::Result<CameraPath> {
    if info.paths.iter().any(|known| known == name) {
        return Ok(engine.camera_path(ID, name)?);
    }
    let file = Path::new(name);
    if file.exists() || file.extension().is_some_and(|extension| extension == "json") {
        // On a single line: the error of an unreadable file already contains the system's message.
        return load_path(file, DVec3::from_array(info.up), &SceneLimits::default())
            .map_err(|error| anyhow::anyhow!("--path {error}"));
    }
    match info.paths.as_slice() {
        [] => bail!("--path {name}: there is no such file, and the scene has no paths"),
        known => bail!(
            "--path {name}: there is no such file, and the scene's paths are {}",
            known.join(", ")
        ),
    }
}

/// The settings that all frames of an image share: those of the request, or those that are chosen for its goal. Says so where the goal is not promised.
///
/// # Errors
/// Any error of a frame.
pub(super) fn settings_for_all(
    engine: &Engine,
    frames: &[FrameRequest],
    own: Settings,
) -> Result<Settings, EngineError> {
    let Some((settings, plan)) = engine.settings_for_all(frames)? else { return Ok(own) };
    if let Some(why) = plan.unpromised() {
        say!("warning: {why}");
    }
    Ok(settings)
}

/// Bakes what the frames need, with a bar: point trees, or normals and kernels of large clouds.
pub(super) fn bake(engine: &Engine, request: &FrameRequest) -> anyhow::Result<()> {
    let Some(mut ticket) = engine.begin_bake(request)? else { return Ok(()) };
    let bar = progress_bar();
    bar.set_message("baking");
    let baked = ticket.wait_while(|done| {
        bar.set_position((done * 1000.0) as u64);
        true
    });
    bar.finish_and_clear();
    Ok(baked.unwrap_or(Ok(()))?)
}

/// Returns a flag that the first signal sets. The program then stops by itself; a second signal ends it at once.
pub(super) fn stop_when_told() -> anyhow::Result<Arc<AtomicBool>> {
    /// Exit code of a process that SIGINT ended, by convention of shells.
    const INTERRUPTED: i32 = 130;
    let stop = Arc::new(AtomicBool::new(false));
    let told = stop.clone();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let first = {
        let _inside = runtime.enter();
        stop_signal()?
    };
    std::thread::Builder::new()
        .name("signals".into())
        .spawn(move || {
            runtime.block_on(async {
                let signal = first.await;
                say!("{signal}: stopping after the frame at hand");
                told.store(true, Ordering::Relaxed);
                if let Ok(next) = stop_signal() {
                    next.await;
                    std::process::exit(INTERRUPTED);
                }
            });
        })
        .context("no thread for signals")?;
    Ok(stop)
}

/// Interval between lines of progress where there is no terminal.
pub(super) const LINE_EVERY: Duration = Duration::from_secs(5);

/// Shows the progress of drawing.
struct Telling {
    bar: ProgressBar,
    lines: bool,
    total: u64,
    done: u64,
    drawn: u64,
    gpu_ns: Option<u64>,
    /// Sum over all drawn frames of the number of views in the frame's dispatch.
    views: u64,
    began: Instant,
    told: Instant,
}

impl Telling {
    fn new() -> Telling {
        let bar = progress_bar();
        let template = "{msg} {wide_bar} {pos}/{len} · {per_sec} · {eta} left";
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style);
        }
        bar.set_message("looking at what is there");
        Telling {
            bar,
            lines: !std::io::stderr().is_terminal(),
            total: 0,
            done: 0,
            drawn: 0,
            gpu_ns: Some(0),
            views: 0,
            began: Instant::now(),
            told: Instant::now(),
        }
    }

    fn hear(&mut self, event: &Event<'_>) {
        match event {
            Event::Surveyed { kept, to_draw, planned, .. } => {
                if let Some(why) = planned.and_then(PlanReceipt::unpromised) {
                    self.bar.suspend(|| say!("warning: {why}"));
                }
                (self.total, self.done) = (kept + to_draw, *kept);
                self.began = Instant::now();
                self.told = self.began;
                self.bar.set_length(self.total);
                self.bar.set_position(*kept);
                self.bar.set_message("drawing");
                // Frames that existed already took no time.
                self.bar.reset_eta();
                if self.lines && *kept > 0 {
                    say!("{kept} of {} frames are there already", self.total);
                }
            }
            Event::Drawn { receipt, .. } => receipt.iter().for_each(|receipt| self.count(receipt)),
        }
    }

    fn count(&mut self, receipt: &Receipt) {
        (self.done, self.drawn) = (self.done + 1, self.drawn + 1);
        self.views += u64::from(receipt.views);
        self.gpu_ns = self.gpu_ns.zip(receipt.gpu_share_ns()).map(|(sum, ns)| sum + ns);
        self.bar.inc(1);
        if self.lines && (self.told.elapsed() >= LINE_EVERY || self.done == self.total) {
            self.told = Instant::now();
            let rate = self.drawn as f64 / self.began.elapsed().as_secs_f64().max(1e-9);
            let left_s = (self.total - self.done) as f64 / rate;
            say!("{} of {} frames, {rate:.1} a second, {left_s:.0} s left", self.done, self.total);
        }
    }

    fn summary(&self, report: &Report, elapsed: Duration) -> String {
        let mut text = format!("{} drawn", frames(report.drawn));
        if report.drawn > 0 {
            let seconds = elapsed.as_secs_f64();
            let rate = report.drawn as f64 / seconds.max(1e-9);
            text += &format!(" in {seconds:.2} s ({rate:.1} a second");
            if let Some(ns) = self.gpu_ns {
                text += &format!(", GPU {:.2} s", ns as f64 / 1e9);
            }
            text += &format!(", {:.1} at a time)", self.views as f64 / report.drawn as f64);
        }
        format!("{text}, {} kept", report.kept)
    }
}

fn frames(count: u64) -> String {
    if count == 1 { "1 frame".to_owned() } else { format!("{count} frames") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::encode::ImageFormat;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        args: PathArgs,
    }

    #[test]
    fn options() {
        let line =
            ["path", "s.json", "--path", "fly", "-o", "frames", "--format", "jpeg", "--from", "3"];
        let args = Line::parse_from(line).args;
        assert_eq!((args.format.format(), args.from, args.to), (ImageFormat::Jpeg, Some(3), None));
        assert_eq!(args.out, Path::new("frames"));
        assert!(Line::try_parse_from(["path", "s.json", "-o", "frames"]).is_err());
    }

    #[test]
    fn summaries() {
        let mut telling = Telling::new();
        let receipt = Receipt { views: 4, gpu_ns: Some(8_000_000_000), ..Receipt::default() };
        let records = &film::Records::new();
        telling.hear(&Event::Surveyed { kept: 3, to_draw: 2, records, planned: None });
        (0..2).for_each(|_| telling.count(&receipt));
        let report = Report { kept: 3, drawn: 2, ..Report::default() };
        let text = telling.summary(&report, Duration::from_secs(4));
        assert_eq!(
            text,
            "2 frames drawn in 4.00 s (0.5 a second, GPU 4.00 s, 4.0 at a time), 3 kept"
        );
        let nothing = telling.summary(&Report { kept: 5, ..Report::default() }, Duration::ZERO);
        assert_eq!(nothing, "0 frames drawn, 5 kept");
    }
}
