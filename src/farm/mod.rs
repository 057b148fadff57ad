//! Films over several machines (floor 6): a server's jobs, drawn by worker processes that share a NATS server and a store.
//!
//! ```text
//! jobs ──► server ──runs──► broker ──runs──► worker ──► film, engine
//!             ▲  ▲                             │ │
//!             │  └────────────notes────────────┘ │
//!             └──────────frames── store ◄────────┘
//! ```
//!
//! The server keeps a job as it does without workers: it names the frames, collects them into the job's folder, serves them and codes the
//! video. Only the drawing is elsewhere, behind [`jobs::Remote`](crate::jobs::Remote). A **run** is a few frames that one worker draws; it is
//! a message of a JetStream work queue. A worker pulls one run at a time and reports progress while it draws, so that the server delivers
//! the run of a killed worker to another one. It stores each frame under the frame's entity tag. If the run was begun before, it draws no frame that is already there.
//!
//! Frames of different adapters, drivers or builds never meet in a film. The hash of these three ([`Engine::identity`](crate::engine::Engine::identity))
//! and the store's mark are a worker's **kind**; the queue delivers a run only to workers of the server's kind, and a worker draws a
//! frame only if it computes the tag that the server expects.
//!
//! Whatever is killed, nothing is lost: runs are in the broker's files, frames in the store, the job on the server's disk. Notes may get
//! lost; the server also looks into the store. It queues runs again that no worker seems to have ([`desk`]). A run that was begun and not
//! finished is split into single frames. A frame is set aside when [`pacing::MOST_TRIES`] workers ended while they drew it, or when
//! different workers failed at it ([`tries`]); its job fails when all other frames are there. A worker that fails at several runs in a row
//! pauses, so that the other workers get the runs.
//!
//! [`pacing`], [`desk`], [`roster`] and [`tries`] are pure.

pub mod broker;
pub(crate) mod bundle;
mod cleaning;
mod daemon;
pub mod desk;
pub mod messages;
pub mod pacing;
pub mod roster;
mod store;
pub mod tries;
mod worker;

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

pub use broker::{Address, BrokerError};
pub use daemon::Farm;
pub use store::{Store, StoreError};
pub use worker::Worker;

use parking_lot::Mutex;

use crate::engine::RequestId;

/// Interval at which a task looks whether it is to stop.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// Interval at which the log repeats a failure that lasts.
const SAY_AGAIN: Duration = Duration::from_secs(60);

/// Time that a worker has to finish its frames after it was told to stop. Less than service managers give it (120 s), so that it can still return its run.
const PARTING: Duration = Duration::from_secs(100);

/// Returns the lasting name of a server, which is kept in its state folder.
///
/// # Errors
/// The file cannot be read or written.
pub fn daemon_name(state: &Path) -> std::io::Result<String> {
    let file = state.join("farm-name");
    match std::fs::read_to_string(&file) {
        Ok(name) if !name.is_empty() => return Ok(name),
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    let name = RequestId::fresh().to_string();
    let fresh = file.with_extension("new");
    std::fs::write(&fresh, &name)?;
    std::fs::rename(fresh, file)?;
    Ok(name)
}

/// Returns the kind of workers that draw frames of an identity and share a store with this mark.
fn kind_of(identity: &str, mark: &str) -> String {
    format!("{identity}-{mark}")
}

/// A text that the log repeats only after a while.
#[derive(Default)]
struct Said(Mutex<Option<(String, Instant)>>);

impl Said {
    /// Returns whether the text is new, or was last logged long ago.
    fn is_due(&self, text: &str) -> bool {
        let mut said = self.0.lock();
        let is_known = |(known, at): &(String, Instant)| known == text && at.elapsed() < SAY_AGAIN;
        if said.as_ref().is_some_and(is_known) {
            return false;
        }
        *said = Some((text.to_owned(), Instant::now()));
        true
    }

    fn forget(&self) {
        *self.0.lock() = None;
    }
}

/// Waits until `stop` is true.
async fn stopped(stop: &AtomicBool) {
    while !stop.load(Ordering::Relaxed) {
        tokio::time::sleep(LOOK_EVERY).await;
    }
}

/// Waits until `stop` has been true for [`PARTING`].
async fn out_of_time(stop: &AtomicBool) {
    stopped(stop).await;
    tokio::time::sleep(PARTING).await;
    tracing::warn!(
        "no frame came from the GPU within {} seconds after the worker was told to stop; its run goes to another worker",
        PARTING.as_secs()
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_lasts_is_said_once() {
        let said = Said::default();
        assert!(said.is_due("a") && !said.is_due("a") && said.is_due("b") && said.is_due("a"));
        said.forget();
        assert!(said.is_due("a"));
    }

    #[test]
    fn daemons_keep_their_names() {
        let [one, other] = [(); 2].map(|()| tempfile::tempdir().unwrap());
        let name = daemon_name(one.path()).unwrap();
        assert_eq!(daemon_name(one.path()).unwrap(), name);
        assert_ne!(daemon_name(other.path()).unwrap(), name);
        std::fs::write(one.path().join("farm-name"), "").unwrap();
        assert!(!daemon_name(one.path()).unwrap().is_empty());
        assert!(daemon_name(Path::new("/no/such/folder")).is_err());
    }

    #[tokio::test(start_paused = true)]
    async fn frames_have_a_limited_time_after_a_stop() {
        let stop = AtomicBool::new(false);
        let is_over = async |limit| tokio::time::timeout(limit, out_of_time(&stop)).await.is_ok();
        assert!(!is_over(10 * PARTING).await);
        stop.store(true, Ordering::Relaxed);
        assert!(!is_over(PARTING - LOOK_EVERY).await);
        // The run is returned before the service manager kills the worker.
        let unit = include_str!("../../deploy/pointillist-worker.service");
        let (_, seconds) = unit.split_once("TimeoutStopSec=").unwrap();
        let (seconds, _) = seconds.split_once('\n').unwrap();
        assert!(is_over(Duration::from_secs(seconds.parse::<u64>().unwrap() - 15)).await);
    }
}
