//! The body of a form, as the library that splits it reads it. The library keeps what comes before a part's content until it is complete, whatever its
//! length, so the body ends with an error where that is too long.

use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::task::{Context, Poll};

use axum::BoxError;
use bytes::Bytes;
use futures::Stream;

/// Bytes that are read without any of a part's content.
const MOST_HEAD: usize = 1 << 20;
/// Bytes after which the library looks at what it has.
const BURST: usize = 256 << 10;

/// Counts the bytes that were read since the latest content; clones share the count.
#[derive(Clone, Default)]
pub struct Progress(Arc<AtomicUsize>);

impl Progress {
    /// A part began, or some of its content arrived.
    pub fn reset(&self) {
        self.0.store(0, Ordering::Relaxed);
    }

    /// Whether the body was ended.
    pub fn is_over(&self) -> bool {
        self.0.load(Ordering::Relaxed) > MOST_HEAD
    }
}

/// Why the body was ended.
pub fn too_long() -> String {
    format!("the form's preamble, or the header of a part, is longer than {MOST_HEAD} bytes")
}

/// A body with a limit.
pub struct Limited<S> {
    body: S,
    progress: Progress,
    burst: usize,
}

impl<S> Limited<S> {
    pub fn new(body: S, progress: Progress) -> Limited<S> {
        Limited { body, progress, burst: 0 }
    }
}

impl<S: Stream<Item = Result<Bytes, axum::Error>> + Unpin> Stream for Limited<S> {
    type Item = Result<Bytes, BoxError>;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        if self.burst >= BURST {
            // The library reads as long as there is something.
            self.burst = 0;
            context.waker().wake_by_ref();
            return Poll::Pending;
        }
        let chunk = std::task::ready!(Pin::new(&mut self.body).poll_next(context));
        Poll::Ready(match chunk {
            Some(Ok(bytes)) => {
                self.burst += bytes.len();
                let before = self.progress.0.fetch_add(bytes.len(), Ordering::Relaxed);
                Some(if before + bytes.len() > MOST_HEAD {
                    Err(too_long().into())
                } else {
                    Ok(bytes)
                })
            }
            Some(Err(error)) => Some(Err(error.into())),
            None => None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::body::Body;
    use futures::StreamExt;

    fn limited(chunks: usize, progress: &Progress) -> Limited<axum::body::BodyDataStream> {
        let chunk = Bytes::from(vec![0_u8; 64 << 10]);
        let chunks =
            futures::stream::iter((0..chunks).map(move |_| Ok::<_, BoxError>(chunk.clone())));
        Limited::new(Body::from_stream(chunks).into_data_stream(), progress.clone())
    }

    #[tokio::test]
    async fn heads_end_and_contents_do_not() {
        let progress = Progress::default();
        let mut body = limited(64, &progress);
        let mut read = 0;
        let error = loop {
            match body.next().await.unwrap() {
                Ok(bytes) => read += bytes.len(),
                Err(error) => break error,
            }
        };
        assert!(read == MOST_HEAD && progress.is_over(), "{read}");
        assert!(error.to_string().contains("longer than"), "{error}");
        let progress = Progress::default();
        let mut body = limited(64, &progress);
        let mut read = 0;
        while let Some(bytes) = body.next().await {
            read += bytes.unwrap().len();
            progress.reset();
        }
        assert!(read == 4 << 20 && !progress.is_over());
    }
}
