//! Codes the frames of a folder as one H.264 video in an MP4 file.
//!
//! ```text
//! manifest ──► frame by frame: read, check, decode to RGB ──► coder ──► OUT.part ──► count samples ──► OUT
//!                                                             │
//!                                                  built in (feature `video`): openh264 and muxide
//!                                                  otherwise `ffmpeg`, a process that gets raw pixels
//! ```
//!
//! All frames are drawn before coding begins, so that no frame is drawn twice because of the video, and a failure of the coder
//! leaves the frames as they are. The file is put in place when it is complete, and only if it has as many samples as there are
//! frames.
//!
//! H.264 as every player supports it has one chroma sample for 2 × 2 pixels. Sides must therefore be even, which is checked
//! before anything is drawn.

mod ffmpeg;
#[cfg(feature = "video")]
mod h264;
pub mod mp4;
mod pixels;

#[cfg(test)]
mod tests;

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use super::manifest::Record;
use super::shots::Shots;
use crate::encode::ImageFormat;
use crate::plan::Output;

/// Default number of bits per pixel of a frame.
const BITS_PER_PIXEL: f64 = 0.2;
/// Range of bitrates, in kilobits per second.
pub const KBPS_RANGE: [u32; 2] = [50, 500_000];
/// Largest longer and shorter side of the built-in coder, and smallest side.
const BUILT_IN_SIDES: [u32; 2] = [3840, 2160];
const LEAST_SIDE: u32 = 16;

/// Why there is no video.
#[derive(Debug, thiserror::Error)]
pub enum VideoError {
    #[error(
        "this build has no H.264 coder and there is no `ffmpeg` on the PATH: build with `--features video` (needs a C++ compiler), \
         or install ffmpeg"
    )]
    NoCoder,
    /// No video can be made with this choice; `parameter` is `w`, `h`, `output`, `format`, `bitrate_kbps` or `to`.
    #[error("{parameter}: {reason}")]
    Unfit { parameter: &'static str, reason: String },
    #[error("{}: {error}", file.display())]
    Io { file: PathBuf, error: io::Error },
    /// A frame's file does not match the manifest.
    #[error("{}: {reason}; draw the frames again", file.display())]
    Frame { file: PathBuf, reason: String },
    #[error("the H.264 coder failed: {0}")]
    Coder(String),
    #[error("ffmpeg failed ({status}): {said}")]
    Ffmpeg { status: String, said: String },
    /// The file has another number of frames than were coded.
    #[error("the video holds {found} frames instead of {frames}")]
    Miscounted { found: String, frames: u64 },
    #[error("the video was stopped before it was finished")]
    Stopped,
}

/// The program that codes the video.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Coder {
    /// openh264, part of this program.
    #[cfg(feature = "video")]
    BuiltIn,
    /// The `ffmpeg` program at this path.
    Ffmpeg(PathBuf),
}

impl Coder {
    /// The coder to use: the built-in one, or else `ffmpeg`.
    ///
    /// # Errors
    /// [`VideoError::NoCoder`].
    pub fn find() -> Result<Coder, VideoError> {
        #[cfg(feature = "video")]
        return Ok(Coder::BuiltIn);
        #[cfg(not(feature = "video"))]
        ffmpeg::find(std::env::var_os("PATH").as_deref())
            .map(Coder::Ffmpeg)
            .ok_or(VideoError::NoCoder)
    }
}

/// The properties of a video.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reel {
    pub width: u32,
    pub height: u32,
    pub fps: f64,
    pub output: Output,
    pub format: ImageFormat,
    /// Number of frames of the video.
    pub frames: u64,
    /// Bitrate; `None` to choose it by size and frame rate.
    pub bitrate_kbps: Option<u32>,
}

impl Reel {
    /// The reel of the wanted frames of a path.
    pub fn new(
        request: &crate::engine::FrameRequest,
        shots: &Shots,
        bitrate_kbps: Option<u32>,
    ) -> Reel {
        Reel {
            width: request.width,
            height: request.height,
            fps: shots.fps(),
            output: request.output,
            format: request.format,
            frames: shots.wanted().count() as u64,
            bitrate_kbps,
        }
    }

    /// The bitrate that the coder aims at, in bits per second.
    pub fn bits_per_second(&self) -> u32 {
        let [least, most] = KBPS_RANGE.map(|kbps| f64::from(kbps) * 1000.0);
        let by_size = f64::from(self.width) * f64::from(self.height) * self.fps * BITS_PER_PIXEL;
        let asked = self.bitrate_kbps.map(|kbps| f64::from(kbps) * 1000.0);
        asked.unwrap_or(by_size).clamp(least, most) as u32
    }

    /// Estimates the size of the video in bytes.
    pub fn expected_bytes(&self) -> u64 {
        (f64::from(self.bits_per_second()) / 8.0 * self.frames as f64 / self.fps) as u64
    }

    /// Checks whether a video can be made of these frames, before they are drawn.
    ///
    /// # Errors
    /// [`VideoError::Unfit`] with the name of the parameter.
    pub fn check(&self, coder: &Coder) -> Result<(), VideoError> {
        let unfit = |parameter, reason: String| Err(VideoError::Unfit { parameter, reason });
        for (parameter, side) in [("w", self.width), ("h", self.height)] {
            if side % 2 == 1 {
                let near = [side - 1, side + 1];
                let reason = format!(
                    "{side} is odd, and H.264 (4:2:0) needs even sides; use {} or {}",
                    near[0], near[1]
                );
                return unfit(parameter, reason);
            }
            if side < LEAST_SIDE {
                return unfit(
                    parameter,
                    format!("{side} is too small; a video needs at least {LEAST_SIDE}"),
                );
            }
        }
        #[cfg(feature = "video")]
        if *coder == Coder::BuiltIn {
            let [longest, shortest] = BUILT_IN_SIDES;
            let (long, short) = (self.width.max(self.height), self.width.min(self.height));
            if long > longest || short > shortest {
                let parameter = if self.width == long && long > longest { "w" } else { "h" };
                let reason = format!(
                    "{} × {} is too large; a video has at most {longest} × {shortest}",
                    self.width, self.height
                );
                return unfit(parameter, reason);
            }
        }
        #[cfg(not(feature = "video"))]
        let _ = (coder, BUILT_IN_SIDES);
        if !matches!(self.output, Output::Color | Output::Normal) {
            return unfit("output", "a video needs the output color or normal".to_owned());
        }
        if matches!(self.format, ImageFormat::Exr | ImageFormat::Pfm) {
            return unfit(
                "format",
                "a video needs frames in png, jpeg, webp, qoi or raw".to_owned(),
            );
        }
        if self.frames < 2 {
            let text = "a video needs at least two frames, but only one was requested; give a path with several keys, or a larger range of frames";
            return unfit("to", text.to_owned());
        }
        let [least, most] = KBPS_RANGE;
        match self.bitrate_kbps {
            Some(kbps) if !(least..=most).contains(&kbps) => unfit(
                "bitrate_kbps",
                format!("{kbps} is out of range; accepted: {least} to {most}"),
            ),
            _ => Ok(()),
        }
    }
}

/// Receives the frames in order, as RGB8 pixels of the reel's size.
trait Sink {
    fn push(&mut self, rgb: Vec<u8>) -> Result<(), VideoError>;
    /// Completes the file.
    fn finish(self: Box<Self>) -> Result<(), VideoError>;
}

/// Codes the frames of `records` in `folder`, in their order, into the video `out`. Calls `tell` with the number of coded frames.
///
/// # Errors
/// [`Reel::check`] fails, a frame is missing or damaged, the coder fails, or a file cannot be written. [`VideoError::Stopped`] if
/// `stop` becomes true. `out` is then as it was before.
pub fn encode<'a>(
    coder: &Coder,
    reel: &Reel,
    folder: &Path,
    records: impl IntoIterator<Item = &'a Record>,
    out: &Path,
    stop: &AtomicBool,
    mut tell: impl FnMut(u64),
) -> Result<(), VideoError> {
    reel.check(coder)?;
    let part = part_of(out);
    // The ffmpeg of a killed process may still write into its file. Without a name, that file is no other coder's.
    let _ = fs::remove_file(&part);
    // An unfinished file is removed on return.
    let _unfinished = Unfinished(&part);
    let mut sink: Box<dyn Sink + '_> = match coder {
        #[cfg(feature = "video")]
        Coder::BuiltIn => Box::new(h264::Writer::new(reel, &part)?),
        Coder::Ffmpeg(program) => {
            Box::new(ffmpeg::Process::start(program, reel, &part, stop, std::time::Instant::now)?)
        }
    };
    let mut coded = 0;
    for record in records {
        if stop.load(Ordering::Relaxed) {
            return Err(VideoError::Stopped);
        }
        sink.push(pixels::read(folder, record, reel)?)?;
        coded += 1;
        tell(coded);
    }
    sink.finish()?;
    let failed = |error| VideoError::Io { file: out.to_owned(), error };
    let found = mp4::Summary::read(&part).map_err(failed)?;
    if coded != reel.frames || found.as_ref().is_none_or(|found| found.frames != coded) {
        let found = found
            .map_or_else(|| "no readable number of".to_owned(), |found| found.frames.to_string());
        return Err(VideoError::Miscounted { found, frames: reel.frames });
    }
    fs::File::open(&part).and_then(|file| file.sync_all()).map_err(failed)?;
    fs::rename(&part, out).map_err(failed)
}

/// The name of a video while it is being written.
pub fn part_of(out: &Path) -> PathBuf {
    let mut name = out.as_os_str().to_owned();
    name.push(".part");
    PathBuf::from(name)
}

struct Unfinished<'a>(&'a Path);

impl Drop for Unfinished<'_> {
    fn drop(&mut self) {
        // After a successful rename this file no longer exists.
        let _ = fs::remove_file(self.0);
    }
}
