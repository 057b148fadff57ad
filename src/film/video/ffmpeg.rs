//! Runs `ffmpeg` as a process: raw frames go to its standard input, and its messages come from its standard error.
//!
//! A process that hangs holds up nobody who asks for a stop. Threads of their own write and read its pipes, and everything that
//! waits for it looks at the stop from time to time.

use std::ffi::OsStr;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, ChildStdin, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use flume::{Receiver, SendTimeoutError, Sender};

use super::{Reel, Sink, VideoError};

/// Number of bytes kept of its messages: the last ones.
const MOST_SAID: usize = 2048;
/// Interval at which whoever waits for the process looks at it and at the stop.
const LOOK_EVERY: Duration = Duration::from_millis(10);

/// Finds the program `ffmpeg` in one of the folders of a `PATH`.
#[cfg_attr(
    feature = "video",
    allow(dead_code, reason = "the built-in coder is taken where there is one")
)]
pub fn find(path: Option<&OsStr>) -> Option<PathBuf> {
    let name = if cfg!(windows) { "ffmpeg.exe" } else { "ffmpeg" };
    std::env::split_paths(path?).map(|folder| folder.join(name)).find(|file| is_program(file))
}

#[cfg(unix)]
fn is_program(file: &Path) -> bool {
    use std::os::unix::fs::PermissionsExt;
    file.metadata().is_ok_and(|found| found.is_file() && found.permissions().mode() & 0o111 != 0)
}

#[cfg(not(unix))]
fn is_program(file: &Path) -> bool {
    file.is_file()
}

/// A running process. Dropping it before it has finished kills the process.
pub struct Process<'a> {
    child: Child,
    /// Takes frames to the thread that writes them, at most one ahead.
    input: Option<Sender<Vec<u8>>>,
    written: Option<JoinHandle<io::Result<()>>>,
    said: Option<JoinHandle<String>>,
    stop: &'a AtomicBool,
    has_ended: bool,
}

/// The arguments of `ffmpeg`.
fn arguments(reel: &Reel) -> Vec<String> {
    let size = format!("{}x{}", reel.width, reel.height);
    let fps = reel.fps.to_string();
    let mut line: Vec<String> =
        ["-hide_banner", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"]
            .map(str::to_owned)
            .to_vec();
    line.extend(
        ["-video_size", &size, "-framerate", &fps, "-i", "pipe:0", "-an"].map(str::to_owned),
    );
    // Primaries and transfer of sRGB in video, the matrix of HD video, and tags in the file that say so.
    let filter = "scale=out_color_matrix=bt709:out_range=tv,\
        setparams=color_primaries=bt709:color_trc=bt709:colorspace=bt709";
    line.extend(["-vf", filter, "-c:v", "libx264", "-pix_fmt", "yuv420p"].map(str::to_owned));
    match reel.bitrate_kbps {
        Some(kbps) => line.extend(["-b:v".to_owned(), format!("{kbps}k")]),
        None => line.extend(["-crf", "18"].map(str::to_owned)),
    }
    line.extend(["-movflags", "+faststart", "-f", "mp4", "-y"].map(str::to_owned));
    line
}

/// Writes frames until there are no more.
fn write(frames: &Receiver<Vec<u8>>, mut input: ChildStdin) -> io::Result<()> {
    frames.iter().try_for_each(|frame| input.write_all(&frame))
}

/// Reads the messages of a process until its end, and returns the last ones.
fn read(mut errors: ChildStderr) -> String {
    let mut last = Vec::new();
    let mut buffer = [0; 1024];
    while let Ok(count) = errors.read(&mut buffer)
        && count > 0
    {
        last.extend_from_slice(&buffer[..count]);
        let spare = last.len().saturating_sub(MOST_SAID);
        last.drain(..spare);
    }
    String::from_utf8_lossy(&last).trim().replace('\n', "; ")
}

impl<'a> Process<'a> {
    pub fn start(
        program: &Path,
        reel: &Reel,
        out: &Path,
        stop: &'a AtomicBool,
    ) -> Result<Process<'a>, VideoError> {
        let failed = |error| VideoError::Io { file: program.to_owned(), error };
        let mut child = Command::new(program)
            .args(arguments(reel))
            // An absolute path, so that a name that begins with a dash is not taken for an option.
            .arg(std::path::absolute(out).map_err(failed)?)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(failed)?;
        let (input, frames) = flume::bounded(1);
        let stdin = child.stdin.take();
        let written = stdin.map(|stdin| std::thread::spawn(move || write(&frames, stdin)));
        // Read all the time: a long message would otherwise fill the pipe and block the process.
        let said = child.stderr.take().map(|errors| std::thread::spawn(move || read(errors)));
        Ok(Process { child, input: Some(input), written, said, stop, has_ended: false })
    }

    /// Looks until something is there.
    ///
    /// # Errors
    /// [`VideoError::Stopped`].
    fn wait<T>(&mut self, look: impl Fn(&mut Self) -> Option<T>) -> Result<T, VideoError> {
        loop {
            if let Some(found) = look(self) {
                return Ok(found);
            }
            if self.stop.load(Ordering::Relaxed) {
                return Err(VideoError::Stopped);
            }
            std::thread::sleep(LOOK_EVERY);
        }
    }

    /// Waits for the process to end; fails unless it succeeded and took all frames.
    fn end(&mut self) -> Result<(), VideoError> {
        drop(self.input.take());
        let status: io::Result<ExitStatus> = self.wait(|this| this.child.try_wait().transpose())?;
        self.has_ended = status.is_ok();
        // A process that it started may still have its pipes.
        let is_over = |this: &mut Self| {
            let is_read = this.said.as_ref().is_none_or(JoinHandle::is_finished);
            (is_read && this.written.as_ref().is_none_or(JoinHandle::is_finished)).then_some(())
        };
        self.wait(is_over)?;
        let said = self.said.take().and_then(|said| said.join().ok()).unwrap_or_default();
        let written = self.written.take().and_then(|written| written.join().ok());
        let status = match (status, written.unwrap_or(Ok(()))) {
            (Ok(status), Ok(())) if status.success() => return Ok(()),
            // The process reads no more, and its last message says why.
            (Ok(status), Err(error)) if status.success() => error.to_string(),
            (Ok(status), _) => status.to_string(),
            (Err(error), _) => error.to_string(),
        };
        Err(VideoError::Ffmpeg { status, said })
    }
}

impl Sink for Process<'_> {
    fn push(&mut self, mut rgb: Vec<u8>) -> Result<(), VideoError> {
        while let Some(input) = &self.input {
            match input.send_timeout(rgb, LOOK_EVERY) {
                Ok(()) => return Ok(()),
                Err(SendTimeoutError::Disconnected(_)) => break,
                Err(SendTimeoutError::Timeout(back)) => rgb = back,
            }
            if self.stop.load(Ordering::Relaxed) {
                return Err(VideoError::Stopped);
            }
        }
        let status = io::Error::from(io::ErrorKind::BrokenPipe).to_string();
        self.end().and(Err(VideoError::Ffmpeg { status, said: String::new() }))
    }

    fn finish(mut self: Box<Self>) -> Result<(), VideoError> {
        self.end()
    }
}

impl Drop for Process<'_> {
    fn drop(&mut self) {
        if !self.has_ended {
            // The threads end when the pipes close, which nobody waits for.
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }
}
