//! Runs `ffmpeg` as a process: raw frames go to its standard input, and its messages come from its standard error.
//!
//! A process that hangs holds up nobody who asks for a stop. Threads of their own write and read its pipes, and everything that
//! waits for it looks at the stop from time to time. A process that makes no progress for [`LIMIT`] is killed: it takes no frame,
//! and the file that it writes stays as it is.

use std::ffi::OsStr;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, ChildStdin, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime};

use flume::{Receiver, SendTimeoutError, Sender};

use super::{Reel, Sink, VideoError};

/// Number of bytes kept of its messages: the last ones.
const MOST_SAID: usize = 2048;
/// Interval at which whoever waits for the process looks at it and at the stop.
const LOOK_EVERY: Duration = Duration::from_millis(10);
/// Time without progress after which the process is killed. At the end it may code dozens of frames and move the whole file.
const LIMIT: Duration = Duration::from_secs(600);

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
    /// File that it writes.
    out: PathBuf,
    now: fn() -> Instant,
    has_ended: bool,
}

/// A wait for the process.
struct Wait {
    /// Length and time of the file at `since`.
    file: FileState,
    since: Instant,
}

type FileState = Option<(u64, Option<SystemTime>)>;

impl Wait {
    /// Returns whether the file has stayed as it was for [`LIMIT`]. Looks at the file at most that often, because its disk may be slow.
    fn is_in_vain(&mut self, now: Instant, file: impl FnOnce() -> FileState) -> bool {
        if now.duration_since(self.since) < LIMIT {
            return false;
        }
        let before = std::mem::replace(self, Wait { file: file(), since: now });
        self.file == before.file
    }
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
        now: fn() -> Instant,
    ) -> Result<Process<'a>, VideoError> {
        let failed = |error| VideoError::Io { file: program.to_owned(), error };
        // An absolute path, so that a name that begins with a dash is not taken for an option.
        let out = std::path::absolute(out).map_err(failed)?;
        let mut child = Command::new(program)
            .args(arguments(reel))
            .arg(&out)
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
        let input = Some(input);
        Ok(Process { child, input, written, said, stop, out, now, has_ended: false })
    }

    fn file_state(&self) -> FileState {
        let found = self.out.metadata().ok()?;
        Some((found.len(), found.modified().ok()))
    }

    fn begin_wait(&self) -> Wait {
        Wait { file: self.file_state(), since: (self.now)() }
    }

    /// Checks whether the wait may go on.
    ///
    /// # Errors
    /// [`VideoError::Stopped`]; [`VideoError::Coder`] if the process makes no progress.
    fn check(&self, wait: &mut Wait) -> Result<(), VideoError> {
        if self.stop.load(Ordering::Relaxed) {
            return Err(VideoError::Stopped);
        }
        if !wait.is_in_vain((self.now)(), || self.file_state()) {
            return Ok(());
        }
        let name = self.out.file_name().unwrap_or_default().to_string_lossy();
        let limit = LIMIT.as_secs();
        Err(VideoError::Coder(format!(
            "ffmpeg took no frame and wrote nothing to {name} for {limit} seconds, and was killed; check the disk and try again"
        )))
    }

    /// Looks until something is there.
    ///
    /// # Errors
    /// Those of [`Process::check`].
    fn wait<T>(&mut self, look: impl Fn(&mut Self) -> Option<T>) -> Result<T, VideoError> {
        let mut wait = self.begin_wait();
        loop {
            if let Some(found) = look(self) {
                return Ok(found);
            }
            self.check(&mut wait)?;
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
        let mut wait = self.begin_wait();
        while let Some(input) = &self.input {
            match input.send_timeout(rgb, LOOK_EVERY) {
                Ok(()) => return Ok(()),
                Err(SendTimeoutError::Disconnected(_)) => break,
                Err(SendTimeoutError::Timeout(back)) => rgb = back,
            }
            self.check(&mut wait)?;
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wait_goes_on_while_the_file_changes() {
        let begin = Instant::now();
        let file = |bytes: u64| Some((bytes, Some(SystemTime::UNIX_EPOCH)));
        let mut wait = Wait { file: None, since: begin };
        let soon = begin + LIMIT / 2;
        assert!(!wait.is_in_vain(soon, || unreachable!("the limit is not over")));
        for times in 1..9u32 {
            assert!(!wait.is_in_vain(begin + LIMIT * times, || file(times.into())));
        }
        // The file was moved within itself.
        let moved = Some((8, Some(SystemTime::UNIX_EPOCH + LIMIT)));
        assert!(!wait.is_in_vain(begin + LIMIT * 9, || moved));
        assert!(wait.is_in_vain(begin + LIMIT * 10, || moved));
    }
}
