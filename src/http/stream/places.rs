//! How many streams there may be, in all and of one client, and how they are told that the server stops.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

use parking_lot::Mutex;
use tokio::sync::watch;

use crate::engine::Client;
use crate::http::App;

/// What streams are allowed.
#[derive(Clone, Copy, Debug)]
pub struct StreamLimits {
    /// At the same time.
    pub most: usize,
    /// Of one client.
    pub most_per_client: usize,
    /// Without a message from the client.
    pub idle: Duration,
}

/// The streams that are open.
pub struct Streams {
    limits: StreamLimits,
    by_client: Mutex<HashMap<Client, usize>>,
    open: watch::Sender<usize>,
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
            limits,
            by_client: Mutex::default(),
            open: watch::Sender::new(0),
            draining: watch::Sender::new(false),
        }
    }

    fn take(&self, client: Client) -> bool {
        let mut by_client = self.by_client.lock();
        let own = by_client.get(&client).copied().unwrap_or(0);
        if *self.open.borrow() >= self.limits.most || own >= self.limits.most_per_client {
            return false;
        }
        by_client.insert(client, own + 1);
        self.open.send_modify(|open| *open += 1);
        true
    }

    fn give_back(&self, client: Client) {
        let mut by_client = self.by_client.lock();
        if let Some(own) = by_client.get_mut(&client) {
            *own -= 1;
            if *own == 0 {
                by_client.remove(&client);
            }
        }
        self.open.send_modify(|open| *open -= 1);
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
        let _ = self.open.subscribe().wait_for(|open| *open == 0).await;
    }
}

impl Place {
    /// `None` when there are as many as there may be.
    pub fn take(app: &Arc<App>, client: Client) -> Option<Place> {
        app.streams.take(client).then(|| {
            app.metrics.streams_open.inc();
            Place { app: app.clone(), client }
        })
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.app.metrics.streams_open.dec();
        self.app.streams.give_back(self.client);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_of_all_and_of_each() {
        let idle = Duration::from_secs(1);
        let streams = Streams::new(StreamLimits { most: 3, most_per_client: 2, idle });
        let [a, b] = [1, 2].map(Client::Caller);
        assert!(streams.take(a) && streams.take(a) && !streams.take(a));
        assert!(streams.take(b) && !streams.take(b), "three in all");
        streams.give_back(a);
        assert!(streams.take(b) && !streams.take(a));
        for client in [a, b, b] {
            streams.give_back(client);
        }
        assert!(streams.by_client.lock().is_empty());
        assert_eq!(*streams.open.borrow(), 0);
    }
}
