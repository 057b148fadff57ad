//! The stored record of a job: its specification, state and results.

use serde::de::{Error, Unexpected};
use serde::{Deserialize, Deserializer, Serialize};

use super::spec::Spec;

/// A job's number.
pub type JobId = u64;

/// Largest number that a stored job may have counted to. No server gets there, and one can still be added to it.
pub const LARGEST_COUNT: u64 = u64::MAX >> 1;

/// Reads a number that is counted on from.
fn count<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u64, D::Error> {
    let number = u64::deserialize(deserializer)?;
    if number <= LARGEST_COUNT {
        return Ok(number);
    }
    let expected = "a whole number up to 9223372036854775807";
    Err(D::Error::invalid_value(Unexpected::Unsigned(number), &expected))
}

/// State of a job.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// The job waits for its turn, and for the input in `waits_for`.
    Queued {
        waits_for: Option<String>,
    },
    Running,
    Done,
    Failed(Failure),
    Cancelled,
}

/// Kinds of failure.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FailureKind {
    /// The scene was edited while its frames were drawn.
    SceneChanged,
    /// The scene was missing for longer than jobs wait.
    SceneGone,
    /// The path or a setting no longer fits the scene.
    Refused,
    /// The quota of all jobs was exceeded.
    DiskQuota,
    /// A file could not be written or read.
    Storage,
    /// The engine gave up.
    Engine,
    /// The video could not be made.
    Video,
    /// The record of the job was lost and found again from its folder.
    Recovered,
    /// A defect of the program.
    Internal,
}

/// Why a job failed, in words that a user can act on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Failure {
    pub kind: FailureKind,
    pub detail: String,
}

/// Identifies a request by owner and key, so that repeating it creates no second job.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Repeat {
    /// Owner of the key; two owners may use the same key.
    pub owner: String,
    pub key: String,
    /// Fingerprint of the request.
    pub fingerprint: String,
}

/// Results of a job; for a running job, those of its last run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Made {
    /// Number of all frames, once it is known.
    pub total: Option<u64>,
    pub done: u64,
    /// Frames per second of the film.
    pub fps: Option<f64>,
    /// Checksum of the manifest, once all frames are there.
    pub manifest_sha256: Option<String>,
    pub video: Option<Video>,
}

/// A finished video file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Video {
    pub bytes: u64,
    pub sha256: String,
}

/// A job.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    #[serde(deserialize_with = "count")]
    pub id: JobId,
    pub spec: Spec,
    /// Key that created it; `None` where there were no keys.
    #[serde(default)]
    pub owner: Option<String>,
    /// Id of the request that created it.
    #[serde(default)]
    pub request_id: Option<String>,
    pub repeat: Option<Repeat>,
    pub state: State,
    pub made: Made,
    /// Milliseconds since 1970.
    pub created_ms: u64,
    /// Time when it entered its state.
    pub since_ms: u64,
    /// Place in the queue: the smallest is next.
    #[serde(deserialize_with = "count")]
    pub turn: u64,
    /// Frames drawn, in all runs together.
    #[serde(deserialize_with = "count")]
    pub drawn: u64,
}

impl Record {
    /// Returns whether the job has ended.
    pub fn has_ended(&self) -> bool {
        !matches!(self.state, State::Queued { .. } | State::Running)
    }

    /// Returns when an ended job is forgotten, or a waiting one fails; milliseconds since 1970. `ttl_ms`:
    /// [`super::book::Limits::ttl_ms`].
    pub fn expires_ms(&self, ttl_ms: u64) -> Option<u64> {
        let expires =
            self.has_ended() || matches!(self.state, State::Queued { waits_for: Some(_) });
        expires.then(|| self.since_ms.saturating_add(ttl_ms))
    }
}

impl State {
    /// Returns the stable name for programs.
    pub fn name(&self) -> &'static str {
        match self {
            State::Queued { .. } => "queued",
            State::Running => "running",
            State::Done => "done",
            State::Failed(_) => "failed",
            State::Cancelled => "cancelled",
        }
    }
}
