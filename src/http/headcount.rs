//! A counter of places, in total and per client.

use std::collections::HashMap;
use std::hash::Hash;

use parking_lot::Mutex;
use tokio::sync::watch;

use crate::engine::Client;

/// Counts open places, in total and per client. Limits come with each request for a place, since a reload may change them.
pub struct Headcount<K = Client> {
    by_client: Mutex<HashMap<K, usize>>,
    open: watch::Sender<usize>,
}

impl<K> Default for Headcount<K> {
    fn default() -> Self {
        Self { by_client: Mutex::new(HashMap::new()), open: watch::Sender::new(0) }
    }
}

impl<K: Copy + Eq + Hash> Headcount<K> {
    /// Counts one more place and returns true, unless there are `most` in all or the client has `most_per_client`.
    pub fn take(&self, client: K, most: usize, most_per_client: usize) -> bool {
        let mut by_client = self.by_client.lock();
        let own = by_client.get(&client).copied().unwrap_or(0);
        if *self.open.borrow() >= most || own >= most_per_client {
            return false;
        }
        by_client.insert(client, own + 1);
        self.open.send_modify(|open| *open += 1);
        true
    }

    pub fn give_back(&self, client: K) {
        let mut by_client = self.by_client.lock();
        if let Some(own) = by_client.get_mut(&client) {
            *own -= 1;
            if *own == 0 {
                by_client.remove(&client);
            }
        }
        self.open.send_modify(|open| *open -= 1);
    }

    /// Returns the number of open places, as a watched value.
    pub fn open(&self) -> watch::Receiver<usize> {
        self.open.subscribe()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_of_all_and_of_each() {
        let places = Headcount::default();
        let take = |client| places.take(client, 3, 2);
        let [a, b] = [1, 2].map(Client::Caller);
        assert!(take(a) && take(a) && !take(a));
        assert!(take(b) && !take(b), "three in all");
        places.give_back(a);
        assert!(take(b) && !take(a));
        places.give_back(b);
        assert!(!places.take(b, 3, 1) && places.take(b, 3, 2));
        for client in [a, b, b] {
            places.give_back(client);
        }
        assert!(places.by_client.lock().is_empty());
        assert_eq!(*places.open().borrow(), 0);
    }
}
