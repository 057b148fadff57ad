//! How many streams there may be, in all and of one client, and how they are told that the server stops.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;

use crate::engine::Client;
use crate::http::App;
use crate::http::headcount::Headcount;

/// What streams are allowed.
#[derive(Clone, Copy, Debug)]
pub struct StreamLimits {
    /// At the same time.
    pub most: usize,
    /// Of one client.
    pub most_per_client: usize,
    /// Without a message from the client, or, of a film, without any of it being taken.
    pub idle: Duration,
}

/// The streams that are open.
pub struct Streams {
    count: Headcount,
    draining: watch::Sender<bool>,
}

/// A stream's place, free again when this is dropped.
pub struct Place {
    app: Arc<App>,
    client: Client,
}

impl Streams {
    pub fn new(limits: StreamLimits) -> Self {
        Self {
            count: Headcount::new(limits.most, limits.most_per_client),
            draining: watch::Sender::new(false),
        }
    }

    /// Tells all streams to end.
    pub fn drain(&self) {
        self.draining.send_replace(true);
    }

    /// Becomes true when the server stops.
    pub fn draining(&self) -> watch::Receiver<bool> {
        self.draining.subscribe()
    }

    /// Waits until there is no stream.
    pub async fn closed(&self) {
        // The sender is ours, so it cannot be gone.
        let _ = self.count.open().wait_for(|open| *open == 0).await;
    }
}

impl Place {
    /// `None` when there are as many as there may be.
    pub fn take(app: &Arc<App>, client: Client) -> Option<Place> {
        app.streams.count.take(client).then(|| {
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
