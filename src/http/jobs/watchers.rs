//! Answers that last as long as a job does: how many there may be, and for how long.

use std::sync::Arc;
use std::time::Duration;

use tokio::time::Instant;

use crate::engine::Client;
use crate::http::App;
use crate::http::headcount::Headcount;
use crate::http::problem::{Kind, Problem};

/// What watchers of jobs are allowed.
#[derive(Clone, Copy, Debug)]
pub struct WatchLimits {
    /// At the same time.
    pub most: usize,
    /// Of one client.
    pub most_per_client: usize,
    /// After so long one that waits is sent away, to come again.
    pub longest: Duration,
}

impl WatchLimits {
    pub fn headcount(&self) -> Headcount {
        Headcount::new(self.most, self.most_per_client)
    }
}

/// A watcher's place, free again when this is dropped.
pub struct Watcher {
    app: Arc<App>,
    client: Client,
    /// When it is over.
    pub until: Instant,
}

impl Watcher {
    /// # Errors
    /// 503 when there are as many as there may be.
    pub fn take(app: &Arc<App>, client: Client) -> Result<Watcher, Problem> {
        if !app.watchers.take(client) {
            return Err(Problem::new(Kind::Busy, "too many watch jobs").accepted(
                "fewer at a time: `max_watchers` and `max_watchers_per_client` in `jobs` of GET /v1/limits, or GET /v1/jobs/{id} now and then",
            ).retry_after(Duration::from_secs(1)));
        }
        let until = Instant::now() + app.settings.watches.longest;
        Ok(Watcher { app: app.clone(), client, until })
    }

    pub fn is_over(&self) -> bool {
        Instant::now() >= self.until
    }

    /// Why it is over.
    pub fn reason(&self) -> String {
        format!("this answer has lasted {} seconds", self.app.settings.watches.longest.as_secs())
    }
}

impl Drop for Watcher {
    fn drop(&mut self) {
        self.app.watchers.give_back(self.client);
    }
}
