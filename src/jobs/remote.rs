//! The interface to a service that draws frames of jobs in other processes.

use std::sync::atomic::AtomicBool;

use super::book::JobId;
use super::spec::Spec;
use crate::engine::{Engine, SceneFiles};
use crate::film::{FilmError, Keep, Wanted};

/// Frames of a job that are to be drawn.
pub struct Order<'a> {
    pub engine: &'a Engine,
    pub job: JobId,
    /// The job's specification, with everything decided that depends on more than one frame.
    pub spec: Spec,
    pub files: SceneFiles,
    pub frames: Vec<Wanted>,
    /// Returns whether the stop is a pause, after which the next process continues the job.
    pub is_pause: &'a dyn Fn() -> bool,
}

/// Numbers that tell how many workers are needed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Load {
    /// There is a connection to what hands frames to workers.
    pub is_connected: bool,
    /// Workers that can draw this server's frames, and others.
    pub workers: u64,
    /// The part of `workers` that pause because they failed at several frames in a row.
    pub paused_workers: u64,
    pub other_workers: u64,
    /// `None` while the queue does not answer.
    pub queued: Option<Queued>,
    /// Frames that were set aside since the start of the process.
    pub set_aside: u64,
    /// Frames that were tried again since then, each as often as it was.
    pub retried: u64,
}

/// Numbers of runs in the queue.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Queued {
    /// Runs that no worker has.
    pub pending: u64,
    /// Runs that workers have.
    pub drawing: u64,
    /// Runs that workers have and that were delivered more than once.
    pub redelivered: u64,
}

/// Draws frames in other processes.
pub trait Remote: Send + Sync {
    /// Draws the frames of an order, and hands each to `keep` as soon as it is there, in any order. Blocks until all frames are
    /// there or `stop` becomes true. After a pause, frames that were drawn elsewhere and not handed over yet are kept for the next process. `tell` is called with what the frames wait for, and with `None` when they go on.
    ///
    /// # Errors
    /// An error of `keep`; [`FilmError::Elsewhere`] if frames cannot be drawn. The other frames are drawn first.
    fn draw(
        &self,
        order: Order<'_>,
        stop: &AtomicBool,
        keep: &mut Keep<'_>,
        tell: &dyn Fn(Option<String>),
    ) -> Result<(), FilmError>;

    /// Returns the latest numbers; at most a few seconds old.
    fn load(&self) -> Load;
}
