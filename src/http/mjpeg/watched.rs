//! Ends a film that its client does not read, so that its place is free for others.
//!
//! The server polls a body only when the client reads, so code inside the body cannot notice that reading stopped. The film is
//! therefore shared with a watcher task that can drop it.

use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use bytes::Bytes;
use futures::Stream;
use parking_lot::Mutex;
use tokio::task::JoinHandle;

/// State shared by the watcher and the body.
struct Shared<S> {
    /// `None` once the watcher has dropped the film.
    film: Option<Pin<Box<S>>>,
    /// When the last piece was handed over, if the next one has not been asked for.
    handed_at: Option<Instant>,
}

/// A body that ends when its next piece has not been asked for in too long a time.
pub struct Watched<S> {
    shared: Arc<Mutex<Shared<S>>>,
    watcher: JoinHandle<()>,
}

impl<S: Send + 'static> Watched<S> {
    /// Needs a runtime. `patience` is the longest time between handing over a piece and the request for the next one.
    pub fn new(film: S, patience: Duration) -> Self {
        let handed_at = Some(Instant::now());
        let shared = Arc::new(Mutex::new(Shared { film: Some(Box::pin(film)), handed_at }));
        Self { watcher: tokio::spawn(watch(shared.clone(), patience)), shared }
    }
}

impl<S> Drop for Watched<S> {
    fn drop(&mut self) {
        self.watcher.abort();
        // Drop the film here rather than when the watcher ends, so that its place is free at once.
        self.shared.lock().film = None;
    }
}

impl<S: Stream<Item = Bytes> + Send + 'static> Stream for Watched<S> {
    type Item = std::io::Result<Bytes>;

    fn poll_next(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        let mut shared = self.shared.lock();
        let Some(film) = &mut shared.film else {
            // Return an error, so that the connection breaks: a clean end would look like the whole film.
            return Poll::Ready(Some(Err(std::io::ErrorKind::TimedOut.into())));
        };
        let piece = film.as_mut().poll_next(context);
        shared.handed_at = piece.is_ready().then(Instant::now);
        piece.map(|piece| piece.map(Ok))
    }
}

async fn watch<S>(shared: Arc<Mutex<Shared<S>>>, patience: Duration) {
    loop {
        let handed_at = shared.lock().handed_at;
        // While a piece is being waited for, the deadline of the next one counts from now.
        let due = handed_at.unwrap_or_else(Instant::now) + patience;
        tokio::time::sleep_until(due.into()).await;
        let mut shared = shared.lock();
        if handed_at.is_some() && shared.handed_at == handed_at {
            shared.film = None;
            tracing::debug!("closed a film that the client did not read");
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use futures::StreamExt;

    const PATIENCE: Duration = Duration::from_millis(200);

    /// Builds a film whose pieces come `after` apart, and an `Arc` that shows whether the film still exists.
    fn film(after: Duration) -> (Watched<impl Stream<Item = Bytes> + Send>, Arc<()>) {
        let place = Arc::new(());
        let held = place.clone();
        let pieces = async_stream::stream! {
            let _held = held;
            loop {
                tokio::time::sleep(after).await;
                yield Bytes::from_static(b"piece");
            }
        };
        (Watched::new(pieces, PATIENCE), place)
    }

    fn is_held(place: &Arc<()>) -> bool {
        Arc::strong_count(place) > 1
    }

    #[tokio::test]
    async fn what_is_read_goes_on_however_long_its_pieces_take() {
        let (mut film, place) = film(PATIENCE * 2);
        for _ in 0..3 {
            assert_eq!(film.next().await.unwrap().unwrap(), "piece");
        }
        assert!(is_held(&place));
        drop(film);
        assert!(!is_held(&place), "who goes frees the place at once");
    }

    #[tokio::test]
    async fn what_is_not_read_is_taken_away() {
        let (mut film, place) = film(Duration::ZERO);
        film.next().await.unwrap().unwrap();
        tokio::time::sleep(PATIENCE / 2).await;
        assert!(is_held(&place), "not yet");
        tokio::time::sleep(PATIENCE * 2).await;
        assert!(!is_held(&place));
        let error = film.next().await.unwrap().unwrap_err();
        assert_eq!(error.kind(), std::io::ErrorKind::TimedOut);
    }
}
