//! Limits the number of streams, in total and per client, and tells streams that the server stops.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;

use crate::engine::Client;
use crate::http::App;
use crate::http::headcount::Headcount;

/// Limits of streams.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StreamLimits {
    /// Largest number at the same time.
    pub most: usize,
    /// Largest number per client.
    pub most_per_client: usize,
    /// Longest time without a message from the client or, for a film, without the client reading any of it.
    pub idle: Duration,
}

/// Counts the open streams.
#[derive(Default)]
pub struct Streams {
    count: Headcount,
    draining: watch::Sender<bool>,
}

/// A stream's place; dropping it frees the place.
pub struct Place {
    app: Arc<App>,
    client: Client,
}

impl Streams {
    /// Tells all streams to end.
    pub fn drain(&self) {
        self.draining.send_replace(true);
    }

    /// Becomes true when the server stops.
    pub fn draining(&self) -> watch::Receiver<bool> {
        self.draining.subscribe()
    }

    /// Waits until no stream is open.
    pub async fn closed(&self) {
        // `self` holds the sender, so it cannot be gone.
        let _ = self.count.open().wait_for(|open| *open == 0).await;
    }
}

impl Place {
    /// Returns `None` when the limit is reached.
    pub fn take(app: &Arc<App>, client: Client) -> Option<Place> {
        let StreamLimits { most, most_per_client, .. } = app.rules().bounds.streams;
        let own = app.quotas_of(client).streams.map_or(most_per_client, |own| own.min(most));
        app.streams.count.take(client, most, own).then(|| {
            app.metrics.streams_open.inc();
            Place { app: app.clone(), client }
        })
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.app.metrics.streams_open.dec();
        self.app.streams.count.give_back(self.client);
    }
}
