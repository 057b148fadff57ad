//! A camera path to numbered frames in a folder, in as many runs as it takes (floor 6).
//!
//! ```text
//! path ──► shots ──► survey ──► draw ──► folder
//!          when,     what is    engine,  file by file, each whole or not there;
//!          from      there and  many at  then a line of the manifest
//!          where     still good once
//! ```
//!
//! The folder's manifest, [`MANIFEST`], has a line for every frame that is finished: its file, how long that is, its checksum, and the
//! frame's tag, a hash of all that decides what the frame shows (the engine's entity tag: scene, pose, settings). A line is written
//! after the file that it tells of is in its place. So a run may end at any moment, by a signal, a power cut or an error: the next one
//! keeps the frames whose files are as their lines say and whose tags are those of the frames that are wanted now, draws the
//! others, and at its end the manifest is the same, byte for byte, as if there had been a single run.
//!
//! A run draws one scene at one revision ([`crate::engine::SceneMark`]) and ends when it finds another in its place, also one that was
//! loaded under the same id. A frame's tag is told when it is sent; before that only frames that the manifest tells of need one.
//!
//! What to do is decided by functions of what was found ([`shots`], [`manifest`], [`survey`]); [`folder`] alone touches files, and
//! [`mod@run`] the engine. [`video`] makes one file of the frames.

pub mod folder;
pub mod manifest;
pub mod run;
pub mod shots;
pub mod survey;
pub mod video;

use std::io;
use std::path::PathBuf;

pub use folder::{records, remove};
pub use manifest::{Header, Record, Records};
pub use run::{Event, Film, MOST_PIXELS, Report, run};

use crate::engine::EngineError;
use crate::math::CameraError;

/// Name of the manifest in a folder of frames.
pub const MANIFEST: &str = "frames.jsonl";

/// Why a path cannot be drawn, or not to its end.
#[derive(Debug, thiserror::Error)]
pub enum FilmError {
    #[error("the path cannot be followed: {0}")]
    Path(CameraError),
    /// A choice of frames that the path does not have; `parameter` is `from`, `to` or `fps`.
    #[error("{parameter}: {reason}")]
    BadRange { parameter: &'static str, reason: String },
    #[error("{}: {error}", file.display())]
    Io { file: PathBuf, error: io::Error },
    /// Some other file has the manifest's name.
    #[error("{}: not a manifest of frames: {reason}", file.display())]
    Foreign { file: PathBuf, reason: String },
    #[error("{}: another process is drawing into this folder", folder.display())]
    Locked { folder: PathBuf },
    #[error("the scene was changed while frame {frame} was drawn")]
    SceneChanged { frame: u64 },
    #[error("frame {frame}: {error}")]
    Frame { frame: u64, error: EngineError },
    #[error(transparent)]
    Engine(#[from] EngineError),
}
