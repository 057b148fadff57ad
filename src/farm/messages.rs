//! Messages between server and workers, with their subjects and names.
//!
//! | on | from | to | what |
//! |---|---|---|---|
//! | the stream's `pointillist.runs.KIND.FILM` | server, worker | one worker of the kind | [`Run`] |
//! | subject `pointillist.notes.FILM` | worker | server | [`Note`]; any of them may be lost |
//! | subject `pointillist.workers.KIND` | worker | servers | [`Beat`], every second |
//! | the store | both | both | see [`store`](super::store) |

use serde::{Deserialize, Serialize};

use crate::film::Wanted;
use crate::film::manifest::are_digits;
use crate::jobs::Spec;

/// Name of the broker's stream.
pub const STREAM: &str = "POINTILLIST";
/// Subjects of the stream.
pub const RUNS: &str = "pointillist.runs.>";
/// Subjects of all beats.
pub const BEATS: &str = "pointillist.workers.*";

/// Returns the subjects of all runs that workers of a kind can draw.
pub fn runs_of(kind: &str) -> String {
    format!("pointillist.runs.{kind}.>")
}

/// Returns the subject of a film's runs.
pub fn runs(kind: &str, film: &str) -> String {
    format!("pointillist.runs.{kind}.{film}")
}

/// Returns the subject of a film's notes.
pub fn notes(film: &str) -> String {
    format!("pointillist.notes.{film}")
}

/// Returns the subject of the beats of workers of a kind.
pub fn beats(kind: &str) -> String {
    format!("pointillist.workers.{kind}")
}

/// A scene's files in the store.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Bundle {
    /// Path of the scene file or asset file; like all paths here, below the server's root.
    pub main: String,
    /// Folder to which names in the scene file are relative; `None`: the file's own.
    pub base: Option<String>,
    pub up: Option<[f64; 3]>,
    pub files: Vec<BundledFile>,
}

/// One file of a scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BundledFile {
    pub path: String,
    pub bytes: u64,
    /// Hash of the content, and the name in the store.
    pub sha256: String,
}

/// A film: everything that its frames share.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FilmOrder {
    pub spec: Spec,
    pub scene: Bundle,
}

/// A few frames of a film, which one worker draws.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Run {
    pub film: String,
    /// Identifier of what queued the run, drawn at random for each time that a process begins or continues the film.
    pub generation: String,
    /// Number of the run in its generation. The single frames into which a run is split keep it.
    pub id: u64,
    pub frames: Vec<Wanted>,
}

impl Run {
    /// Returns whether the film has a name that a server gives. An empty name would be that of all films.
    pub fn is_sound(&self) -> bool {
        are_digits(&self.film, 32)
    }

    /// Returns the name under which the tries of these frames are counted.
    pub fn key(&self) -> String {
        let end = |frame: Option<&Wanted>| frame.map_or(0, |frame| frame.number);
        format!("{}-{}", end(self.frames.first()), end(self.frames.last()))
    }

    /// Returns the identifier by which the broker recognises a run that is queued twice. Run numbers restart in each generation,
    /// and the broker remembers the identifiers of runs that were purged.
    pub fn message_id(&self) -> String {
        format!("{}-{}-{}-{}", self.film, self.generation, self.id, self.key())
    }

    /// Returns the runs of one frame each.
    pub fn split(&self) -> impl Iterator<Item = Run> {
        let one = |frame: &Wanted| Run {
            film: self.film.clone(),
            generation: self.generation.clone(),
            id: self.id,
            frames: vec![frame.clone()],
        };
        self.frames.iter().map(one)
    }
}

/// A worker's report on a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Note {
    /// A frame is in the store.
    Drawn { run: u64, frame: u64 },
    /// A worker has drawn so many frames of a run in this time.
    Finished { run: u64, drawn: u64, elapsed_ns: u64 },
    /// A worker could not draw a run or a part of it, and another try follows.
    Failed { run: u64, frames: u64, reason: String },
    /// Nobody tries to draw a frame any more; the store says why.
    SetAside { run: u64, frame: u64 },
}

/// A worker's sign of life.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Beat {
    /// Unique name of the process.
    pub worker: String,
    /// The worker's kind.
    pub kind: String,
    /// Hash of what decides the pixels of its frames: the part of the kind that is not the store's.
    #[serde(default)]
    pub identity: String,
    pub adapter: String,
    pub version: String,
    /// The film and the run that it works on; `None`: it waits for work.
    pub busy: Option<(String, u64)>,
    /// Time for which it has waited, in milliseconds.
    pub idle_ms: u64,
    /// The worker failed at several runs in a row and pulls no run for a while.
    #[serde(default)]
    pub is_paused: bool,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_are_split_into_frames_that_keep_their_run() {
        let frames: Vec<Wanted> =
            (3..6).map(|number| Wanted { number, tag: format!("t{number}") }).collect();
        let run = Run { film: "f".to_owned(), generation: "g".to_owned(), id: 7, frames };
        let named = |film: &str| Run { film: film.to_owned(), ..run.clone() }.is_sound();
        assert!(named(&"0af9".repeat(8)));
        assert!(
            ["", "f", ".", &"0AF9".repeat(8), &"0af9".repeat(16)].iter().all(|film| !named(film))
        );
        assert_eq!(run.key(), "3-5");
        let split: Vec<Run> = run.split().collect();
        assert_eq!(split.iter().map(Run::key).collect::<Vec<_>>(), ["3-3", "4-4", "5-5"]);
        assert!(split.iter().all(|one| one.id == 7 && one.film == "f" && one.frames.len() == 1));
        // No two messages have the same id, not even in different generations.
        let later = Run { generation: "h".to_owned(), ..run.clone() };
        let ids = [&run, &later].map(|run| {
            let parts = run.split().map(|one| one.message_id()).collect::<Vec<_>>();
            [vec![run.message_id()], parts].concat()
        });
        assert_eq!(ids[0][..2], ["f-g-7-3-5", "f-g-7-3-3"]);
        let distinct: std::collections::BTreeSet<String> = ids.concat().into_iter().collect();
        assert_eq!(distinct.len(), 8);
        let text = serde_json::to_string(&split[1]).unwrap();
        assert_eq!(serde_json::from_str::<Run>(&text).unwrap(), split[1]);
    }
}
