//! Runs `ffmpeg` as a process: raw frames go to its standard input, and its messages come from its standard error.

use std::ffi::OsStr;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::thread::JoinHandle;

use super::{Reel, Sink, VideoError};

/// Number of bytes kept of its messages: the last ones.
const MOST_SAID: usize = 2048;

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
pub struct Process {
    child: Child,
    input: Option<ChildStdin>,
    said: Option<JoinHandle<String>>,
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

impl Process {
    pub fn start(program: &Path, reel: &Reel, out: &Path) -> Result<Process, VideoError> {
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
        let input = child.stdin.take();
        let mut errors = child.stderr.take();
        // Read all the time: a long message would otherwise fill the pipe and block the process.
        let said = std::thread::spawn(move || {
            let mut last = Vec::new();
            let mut buffer = [0; 1024];
            while let Some(Ok(count)) = errors.as_mut().map(|errors| errors.read(&mut buffer))
                && count > 0
            {
                last.extend_from_slice(&buffer[..count]);
                let spare = last.len().saturating_sub(MOST_SAID);
                last.drain(..spare);
            }
            String::from_utf8_lossy(&last).trim().replace('\n', "; ")
        });
        Ok(Process { child, input, said: Some(said) })
    }

    /// Waits for the process to end; fails unless it succeeded.
    fn end(&mut self) -> Result<(), VideoError> {
        drop(self.input.take());
        let status = self.child.wait();
        let said = self.said.take().and_then(|said| said.join().ok()).unwrap_or_default();
        match status {
            Ok(status) if status.success() => Ok(()),
            Ok(status) => Err(VideoError::Ffmpeg { status: status.to_string(), said }),
            Err(error) => Err(VideoError::Ffmpeg { status: error.to_string(), said }),
        }
    }
}

impl Sink for Process {
    fn push(&mut self, rgb: &[u8]) -> Result<(), VideoError> {
        let written = match &mut self.input {
            Some(input) => input.write_all(rgb),
            None => Err(std::io::ErrorKind::BrokenPipe.into()),
        };
        // The process reads no more. Its last message says why.
        written.or_else(|error| {
            self.end()
                .and(Err(VideoError::Ffmpeg { status: error.to_string(), said: String::new() }))
        })
    }

    fn finish(mut self: Box<Self>) -> Result<(), VideoError> {
        self.end()
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if self.said.is_some() {
            let _ = self.child.kill();
            let _ = self.end();
        }
    }
}
