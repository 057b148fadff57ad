//! What is kept of a job: what it is to do, in which state it is, and what it has made.

use serde::{Deserialize, Serialize};

use super::book::{JobId, Limits};
use super::spec::Spec;

/// What has become of a job.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// Its turn comes, when what it waits for is there.
    Queued {
        waits_for: Option<String>,
    },
    Running,
    Done,
    Failed(Failure),
    Cancelled,
}

/// What kinds of failure there are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FailureKind {
    /// The scene was edited while its frames were drawn.
    SceneChanged,
    /// The scene was not there for as long as jobs wait.
    SceneGone,
    /// The path or a setting no longer fits the scene.
    Refused,
    /// Over the quota of all jobs.
    DiskQuota,
    /// A file that cannot be written or read.
    Storage,
    /// The engine gave up.
    Engine,
    /// The video could not be made.
    Video,
    /// The record of the job was lost and found again from its folder.
    Recovered,
    /// A defect.
    Internal,
}

/// Why a job failed, in words that a user can act on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Failure {
    pub kind: FailureKind,
    pub detail: String,
}

/// Who made a job under which name, so that asking twice makes one job.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Repeat {
    /// Whose names these are; two owners may use the same.
    pub owner: String,
    pub key: String,
    /// Of what was asked for.
    pub fingerprint: String,
}

/// What is known of what a job has made; of one that runs, of its last run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Made {
    /// Frames that are wanted, once that is known.
    pub total: Option<u64>,
    pub done: u64,
    /// Frames a second and size of the film.
    pub fps: Option<f64>,
    /// Of the manifest, once all frames are there.
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
    pub id: JobId,
    pub spec: Spec,
    /// Whose key made it; `None` where there were no keys.
    #[serde(default)]
    pub owner: Option<String>,
    /// What the request is called that made it.
    #[serde(default)]
    pub request_id: Option<String>,
    pub repeat: Option<Repeat>,
    pub state: State,
    pub made: Made,
    /// Milliseconds since 1970.
    pub created_ms: u64,
    /// When it came into its state.
    pub since_ms: u64,
    /// Place in the queue: the least is next.
    pub turn: u64,
    /// Frames drawn, in all runs together.
    pub drawn: u64,
}

impl Record {
    /// Whether nothing more happens by itself.
    pub fn has_ended(&self) -> bool {
        !matches!(self.state, State::Queued { .. } | State::Running)
    }

    /// When an ended job is forgotten, or one that waits for something fails; milliseconds since 1970.
    pub fn expires_ms(&self, limits: &Limits) -> Option<u64> {
        let expires =
            self.has_ended() || matches!(self.state, State::Queued { waits_for: Some(_) });
        expires.then(|| self.since_ms.saturating_add(limits.ttl_ms))
    }
}

impl State {
    /// As programs match on it.
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
