//! Answers that clients have not read yet. Their bytes stay in memory, where a connection's library takes a whole image at once, so they are bounded: for
//! each client, and for all together.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

use axum::body::Body;
use bytes::Bytes;
use parking_lot::Mutex;

use super::problem::{Kind, Problem};
use crate::engine::Client;
use crate::memory::{Admission, Reservation};

/// Smaller answers are not counted.
const SMALL: usize = 16 << 10;
/// Least limits of a client and of all, in bytes.
const LEAST: u64 = 64 << 20;
const LEAST_OF_ALL: u64 = 256 << 20;
const RETRY: Duration = Duration::from_secs(1);

/// The answers under way.
pub struct Unread {
    most: u64,
    most_of_all: u64,
    held: Arc<Mutex<HashMap<Client, u64>>>,
}

impl Unread {
    /// Returns the limits for a budget of host memory: a quarter for all clients, and a quarter of that for each.
    pub fn new(budget: u64) -> Unread {
        let (most, most_of_all) = ((budget / 16).max(LEAST), (budget / 4).max(LEAST_OF_ALL));
        Unread { most, most_of_all, held: Arc::default() }
    }

    /// Makes a body of an answer. A client that holds no other one gets an answer of any size.
    ///
    /// # Errors
    /// The client has not read earlier answers, or all clients together have not.
    pub fn hold(&self, client: Client, bytes: Bytes, memory: &Admission) -> Result<Body, Problem> {
        let length = bytes.len() as u64;
        if bytes.len() <= SMALL {
            return Ok(Body::from(bytes));
        }
        {
            let mut held = self.held.lock();
            let own = held.get(&client).copied().unwrap_or_default();
            if own > 0 && own + length > self.most {
                let text = format!("this client has not yet read {own} bytes of earlier answers");
                return Err(Problem::new(Kind::TooManyRequests, text)
                    .accepted(format!("at most {} bytes for each client", self.most))
                    .retry_after(RETRY));
            }
            if held.values().sum::<u64>() + length > self.most_of_all {
                let text = "too many answers have not been read yet";
                return Err(Problem::new(Kind::Busy, text).retry_after(RETRY));
            }
            *held.entry(client).or_default() += length;
        }
        let share = Share { client, length, held: self.held.clone() };
        // Scenes may take the whole budget; frames of them are answered all the same.
        let memory = memory.grow("an answer", length).ok().map(|()| memory.keep(length));
        let owner = Owner { bytes, _share: share, _memory: memory };
        Ok(Body::from(Bytes::from_owner(owner)))
    }
}

/// A client's share, until it is dropped.
struct Share {
    client: Client,
    length: u64,
    held: Arc<Mutex<HashMap<Client, u64>>>,
}

impl Drop for Share {
    fn drop(&mut self) {
        let mut held = self.held.lock();
        if let Some(own) = held.get_mut(&self.client) {
            *own = own.saturating_sub(self.length);
            if *own == 0 {
                held.remove(&self.client);
            }
        }
    }
}

/// Bytes with what they hold. It is freed with the last part of them that a connection keeps.
struct Owner {
    bytes: Bytes,
    _share: Share,
    _memory: Option<Reservation>,
}

impl AsRef<[u8]> for Owner {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

#[cfg(test)]
mod tests {
    use axum::body::HttpBody;

    use super::*;
    use crate::memory::HostMemory;

    #[tokio::test]
    async fn answers_hold_memory_until_they_are_read() {
        let memory = HostMemory::new(1 << 30);
        let admission = || Admission::new(&memory);
        let unread = Unread::new(memory.budget());
        let (one, other) = (Client::Caller(1), Client::Caller(2));
        let image = || Bytes::from(vec![7_u8; 40 << 20]);
        let body = unread.hold(one, image(), &admission()).unwrap();
        assert_eq!(body.size_hint().exact(), Some(40 << 20));
        assert_eq!(memory.in_use(), 40 << 20);
        let refused = unread.hold(one, image(), &admission()).unwrap_err();
        assert_eq!(refused.kind, Kind::TooManyRequests);
        // Small answers, and those of others, go on.
        let _small = unread.hold(one, Bytes::from(vec![0; SMALL]), &admission()).unwrap();
        let read = axum::body::to_bytes(body, usize::MAX).await.unwrap();
        assert!(read.len() == 40 << 20 && read.iter().all(|byte| *byte == 7));
        drop(read);
        assert_eq!((memory.in_use(), unread.held.lock().len()), (0, 0));
        let bodies: Vec<Body> = (0..6)
            .map(|number| unread.hold(Client::Caller(number), image(), &admission()).unwrap())
            .collect();
        assert_eq!(
            unread.hold(Client::Caller(9), image(), &admission()).unwrap_err().kind,
            Kind::Busy
        );
        drop(bodies);
        // An answer above the limit, for a client that holds none.
        let large = Bytes::from(vec![0_u8; 100 << 20]);
        let body = unread.hold(other, large, &admission()).unwrap();
        drop(body);
        assert_eq!(memory.in_use(), 0);
    }

    #[test]
    fn a_full_memory_refuses_no_frame() {
        let memory = HostMemory::new(1 << 20);
        let unread = Unread::new(memory.budget());
        let image = Bytes::from(vec![0_u8; 2 << 20]);
        let body = unread.hold(Client::Unnamed, image, &Admission::new(&memory)).unwrap();
        assert_eq!((memory.in_use(), unread.held.lock().len()), (0, 1));
        drop(body);
        assert!(unread.held.lock().is_empty());
    }
}
