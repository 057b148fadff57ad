//! A counter with two limits: one in total and one per client.

use std::collections::HashMap;
use std::hash::Hash;

use parking_lot::Mutex;
use tokio::sync::watch;

use crate::engine::Client;

/// Counts open places, in total and per client.
pub struct Headcount<K = Client> {
    most: usize,
    most_per_client: usize,
    by_client: Mutex<HashMap<K, usize>>,
    open: watch::Sender<usize>,
}

impl<K: Copy + Eq + Hash> Headcount<K> {
    pub fn new(most: usize, most_per_client: usize) -> Self {
        Self {
            most,
            most_per_client,
            by_client: Mutex::new(HashMap::new()),
            open: watch::Sender::new(0),
        }
    }

    /// Counts one more place and returns true, unless a limit is reached.
    pub fn take(&self, client: K) -> bool {
        self.take_within(client, self.most_per_client)
    }

    /// As [`Headcount::take`], with a limit of this client's own.
    pub fn take_within(&self, client: K, most_per_client: usize) -> bool {
        let mut by_client = self.by_client.lock();
        let own = by_client.get(&client).copied().unwrap_or(0);
        if *self.open.borrow() >= self.most || own >= most_per_client {
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
        let places = Headcount::new(3, 2);
        let [a, b] = [1, 2].map(Client::Caller);
        assert!(places.take(a) && places.take(a) && !places.take(a));
        assert!(places.take(b) && !places.take(b), "three in all");
        places.give_back(a);
        assert!(places.take(b) && !places.take(a));
        places.give_back(b);
        assert!(!places.take_within(b, 1) && places.take_within(b, 2));
        for client in [a, b, b] {
            places.give_back(client);
        }
        assert!(places.by_client.lock().is_empty());
        assert_eq!(*places.open().borrow(), 0);
    }
}
