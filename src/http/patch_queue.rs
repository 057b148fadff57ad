//! The queue of changes of nodes. The process makes one change at a time, and each client has at most one change at the head of the
//! queue, so that a client waits for one change of each other client at most.
//!
//! A request waits in its handler and not on a thread: a request whose client goes away leaves the queue.

use std::collections::HashMap;
use std::hash::Hash;
use std::sync::Arc;
use std::time::Duration;

use parking_lot::Mutex;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::problem::{Kind, Problem};
use crate::engine::Client;

/// Largest number of changes that wait or are being made.
const MOST: usize = 256;
/// Largest number of them of one client.
const MOST_PER_CLIENT: usize = 32;
/// Time after which a refused client may try again.
const RETRY_AFTER: Duration = Duration::from_secs(1);

/// The queue; clones share it.
#[derive(Clone)]
pub struct PatchQueue<K: Eq + Hash = Client> {
    lines: Arc<Mutex<HashMap<K, Line>>>,
    turn: Arc<Semaphore>,
}

/// The requests of one client.
struct Line {
    places: usize,
    turn: Arc<Semaphore>,
}

/// A place in the queue.
struct Place<K: Eq + Hash> {
    lines: Arc<Mutex<HashMap<K, Line>>>,
    client: K,
}

/// The right to make one change. Dropping the turn gives it to the next client.
pub struct Turn<K: Eq + Hash = Client> {
    _of_all: OwnedSemaphorePermit,
    _of_client: OwnedSemaphorePermit,
    _place: Place<K>,
}

impl<K: Eq + Hash> Default for PatchQueue<K> {
    fn default() -> Self {
        Self { lines: Arc::default(), turn: Arc::new(Semaphore::new(1)) }
    }
}

impl<K: Copy + Eq + Hash> PatchQueue<K> {
    /// Waits until it is the client's turn. Dropping the future leaves the queue.
    ///
    /// # Errors
    /// 429 when too many changes wait.
    pub async fn turn(&self, client: K) -> Result<Turn<K>, Problem> {
        let (place, turn) = self.place(client)?;
        let of_client = turn.acquire_owned().await.map_err(Problem::internal)?;
        let of_all = self.turn.clone().acquire_owned().await.map_err(Problem::internal)?;
        Ok(Turn { _of_all: of_all, _of_client: of_client, _place: place })
    }

    fn place(&self, client: K) -> Result<(Place<K>, Arc<Semaphore>), Problem> {
        let mut lines = self.lines.lock();
        let all: usize = lines.values().map(|line| line.places).sum();
        let own = lines.get(&client).map_or(0, |line| line.places);
        let (found, limit, whose) = match own >= MOST_PER_CLIENT {
            true => (own, MOST_PER_CLIENT, " of this client"),
            false => (all, MOST, ""),
        };
        if found >= limit {
            let detail =
                format!("{found} changes of nodes{whose} are waiting; the limit is {limit}");
            return Err(Problem::new(Kind::TooManyRequests, detail)
                .accepted("the request after the time in Retry-After")
                .retry_after(RETRY_AFTER));
        }
        let new = || Line { places: 0, turn: Arc::new(Semaphore::new(1)) };
        let line = lines.entry(client).or_insert_with(new);
        line.places += 1;
        Ok((Place { lines: self.lines.clone(), client }, line.turn.clone()))
    }
}

impl<K: Eq + Hash> Drop for Place<K> {
    fn drop(&mut self) {
        let mut lines = self.lines.lock();
        let Some(line) = lines.get_mut(&self.client) else { return };
        line.places -= 1;
        if line.places == 0 {
            lines.remove(&self.client);
        }
    }
}

#[cfg(test)]
mod tests {
    use futures::FutureExt;
    use futures::future::BoxFuture;

    use super::*;

    fn ask(queue: &PatchQueue<u32>, client: u32) -> BoxFuture<'static, Result<Turn<u32>, Problem>> {
        let queue = queue.clone();
        async move { queue.turn(client).await }.boxed()
    }

    #[test]
    fn clients_take_turns() {
        let queue = PatchQueue::default();
        let first = ask(&queue, 1).now_or_never().unwrap().unwrap();
        let mut more: Vec<_> = (0..5).map(|_| ask(&queue, 1)).collect();
        assert!(more.iter_mut().all(|more| more.now_or_never().is_none()));
        let mut other = ask(&queue, 2);
        assert!((&mut other).now_or_never().is_none());
        drop(first);
        assert!(more[0].as_mut().now_or_never().is_none(), "the other client comes first");
        let turn = other.now_or_never().unwrap().unwrap();
        drop(turn);
        assert!(more.remove(0).now_or_never().unwrap().is_ok());
        // A request that is dropped leaves the queue.
        let last = more.pop();
        drop(more);
        assert!(last.unwrap().now_or_never().unwrap().is_ok());
        assert!(queue.lines.lock().is_empty());
    }

    #[test]
    fn few_changes_wait() {
        let queue = PatchQueue::default();
        let mut waiting: Vec<_> = Vec::new();
        let mut refused = |client: u32| {
            let mut asked = ask(&queue, client);
            match (&mut asked).now_or_never() {
                Some(Err(problem)) => Some((problem.status(), problem.detail)),
                Some(Ok(turn)) => {
                    waiting.push((asked, Some(turn)));
                    None
                }
                None => {
                    waiting.push((asked, None));
                    None
                }
            }
        };
        assert!((0..MOST_PER_CLIENT).all(|_| refused(1).is_none()));
        let (status, detail) = refused(1).unwrap();
        assert!(status == 429 && detail.contains("32 changes of nodes of this client"), "{detail}");
        let clients = (MOST / MOST_PER_CLIENT) as u32;
        assert!((MOST_PER_CLIENT..MOST).all(|n| refused(2 + n as u32 % (clients - 1)).is_none()));
        let (status, detail) = refused(0).unwrap();
        assert!(status == 429 && detail.contains("the limit is 256"), "{detail}");
        drop(waiting);
        assert!(queue.lines.lock().is_empty());
    }
}
