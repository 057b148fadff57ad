//! Limits on answers that last as long as a job: how many there may be, and for how long.

use std::sync::Arc;
use std::time::{Duration, SystemTime};

use tokio::sync::watch;
use tokio::time::Instant;

use crate::engine::Client;
use crate::http::App;
use crate::http::access::signed::Caps;
use crate::http::limits::{LONGEST_PAUSE, Standing};
use crate::http::problem::{Kind, Problem};

/// Limits of job watchers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WatchLimits {
    /// Largest number at the same time.
    pub most: usize,
    /// Largest number per client.
    pub most_per_client: usize,
    /// Longest duration of one answer; the client then has to reconnect.
    pub longest: Duration,
}

/// A watcher's place; dropping it frees the place.
pub struct Watcher {
    app: Arc<App>,
    client: Client,
    caps: Caps,
    /// End of the answer.
    until: Instant,
    longest: Duration,
}

impl Watcher {
    /// # Errors
    /// 503 when the limit is reached.
    pub fn take(app: &Arc<App>, client: Client, caps: &Caps) -> Result<Watcher, Problem> {
        let WatchLimits { most, most_per_client, longest } = app.rules().bounds.watches;
        if !app.watchers.take(client, most, most_per_client) {
            return Err(Problem::new(Kind::Busy, "too many clients follow jobs").accepted(
                "fewer at a time: see `max_watchers` and `max_watchers_per_client` in `jobs` of GET /v1/limits; or poll GET /v1/jobs/{id}",
            ).retry_after(Duration::from_secs(1)));
        }
        let left = caps.until.map(|end| end.duration_since(SystemTime::now()).unwrap_or_default());
        let until = Instant::now() + left.map_or(longest, |left| left.min(longest));
        Ok(Watcher { app: app.clone(), client, caps: *caps, until, longest })
    }

    /// Waits for a change of the job, or for the end of the answer.
    pub async fn changed(&self, changes: &mut watch::Receiver<u64>) {
        while !self.is_over() {
            // A key that is removed changes no job.
            let look = self.until.min(Instant::now() + LONGEST_PAUSE);
            // An error of the receiver means that the job was removed; the next look finds out.
            if tokio::time::timeout_at(look, changes.changed()).await.is_ok() {
                return;
            }
        }
    }

    pub fn is_over(&self) -> bool {
        Instant::now() >= self.until || self.has_lost_key()
    }

    fn has_lost_key(&self) -> bool {
        self.app.standing(self.client, &self.caps) == Standing::Gone
    }

    /// Returns the reason for ending the answer.
    pub fn reason(&self) -> String {
        if self.has_lost_key() {
            return "the key was removed or has expired".to_owned();
        }
        format!("this answer reached its limit of {} seconds", self.longest.as_secs())
    }
}

impl Drop for Watcher {
    fn drop(&mut self) {
        self.app.watchers.give_back(self.client);
    }
}
