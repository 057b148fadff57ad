//! Draws a camera path as numbered frames into a folder, in as many runs as it takes (floor 6).
//!
//! ```text
//! path ──► shots ──► survey ──► draw ──► folder
//!          when,     what is    engine,  each file atomically,
//!          from      there and  many at  then its line of
//!          where     intact     once     the manifest
//! ```
//!
//! The folder's manifest, [`MANIFEST`], has a line for every finished frame: its file, the file's length and checksum, and the
//! frame's tag, a hash of everything that decides what the frame shows (the engine's entity tag: scene, pose, settings). A line
//! is written after its file is in place, so a run may end at any moment, by a signal, a power cut or an error. The next run
//! keeps the frames whose files match their lines and whose tags match the frames that are wanted now, and draws the others. At
//! its end the manifest is the same, byte for byte, as after a single run.
//!
//! A run draws one scene at one revision ([`crate::engine::SceneMark`]). It ends when it finds another scene in its place, even
//! one that was loaded under the same id. A frame's tag is computed when the frame is sent; before that, only frames in the
//! manifest need one.
//!
//! [`shots`], [`manifest`] and [`survey`] decide what to do, and are functions of what was found. Only [`folder`] touches files,
//! and only [`mod@run`] uses the engine. [`video`] turns the frames into one file.

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
pub use run::{
    Drawn, Elsewhere, Event, Film, Keep, MOST_PIXELS, Report, Wanted, bake, draw_wanted, run,
    unbaked,
};

use crate::engine::EngineError;
use crate::math::CameraError;

/// Name of the manifest in a folder of frames.
pub const MANIFEST: &str = "frames.jsonl";

/// Why a path cannot be drawn, or not to its end.
#[derive(Debug, thiserror::Error)]
pub enum FilmError {
    #[error("the path has no valid camera: {0}")]
    Path(CameraError),
    /// The path does not have these frames; `parameter` is `from`, `to` or `fps`.
    #[error("{parameter}: {reason}")]
    BadRange { parameter: &'static str, reason: String },
    #[error("{}: {error}", file.display())]
    Io { file: PathBuf, error: io::Error },
    /// The file with the manifest's name is not a manifest.
    #[error("{}: this is not a manifest of frames ({reason}); give another folder, or remove the file", file.display())]
    Foreign { file: PathBuf, reason: String },
    #[error("{}: another process is drawing into this folder; wait for it or give another folder", folder.display())]
    Locked { folder: PathBuf },
    #[error("the scene changed while frame {frame} was drawn")]
    SceneChanged { frame: u64 },
    /// This process would draw another frame than the one that is wanted: its scene or its settings differ.
    #[error(
        "frame {frame} would show something else here: the scene's files or the settings differ"
    )]
    OtherTag { frame: u64 },
    /// Frames could not be drawn elsewhere.
    #[error("{0}")]
    Elsewhere(String),
    #[error("frame {frame}: {error}")]
    Frame { frame: u64, error: EngineError },
    #[error(transparent)]
    Engine(#[from] EngineError),
}
