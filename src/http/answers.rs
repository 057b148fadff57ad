//! Answers under way on a connection, and since when its client has taken nothing of each. An HTTP/2 client takes as much of each answer as it likes, and
//! keeps the connection alive meanwhile, so what a connection writes says nothing about an answer that nobody reads. The requests under way are counted as
//! well, since an HTTP/2 client that only pings would keep its connection for ever.

use std::pin::Pin;
use std::sync::{Arc, Weak};
use std::task::{Context, Poll, ready};
use std::time::Duration;

use axum::body::{Body, HttpBody};
use axum::response::Response;
use bytes::Bytes;
use futures::future::BoxFuture;
use hyper::body::{Frame, SizeHint};
use parking_lot::Mutex;
use tokio::time::{Instant, Sleep};

/// Longest time for which a client may take nothing of an answer.
pub const STALLED: Duration = Duration::from_secs(60);
/// Bytes of an answer that a connection is given at a time, and that a client must take within that time.
pub const PART: usize = 16 << 10;
/// Time without a request after which an HTTP/2 connection ends. Long, because a client may send a request at the very moment at which it ends.
const IDLE: Duration = Duration::from_secs(300);

/// The answers of one connection, and its requests under way.
#[derive(Clone, Default)]
pub struct Answers {
    under_way: Arc<Mutex<Vec<Weak<Answer>>>>,
    requests: Arc<Mutex<Requests>>,
}

/// Number of requests under way, and when the last one ended, or the connection began.
struct Requests {
    count: usize,
    since: Instant,
}

impl Default for Requests {
    fn default() -> Self {
        Requests { count: 0, since: Instant::now() }
    }
}

/// A request under way, until its answer is written.
struct Request(Arc<Mutex<Requests>>);

impl Drop for Request {
    fn drop(&mut self) {
        let mut requests = self.0.lock();
        requests.count -= 1;
        requests.since = Instant::now();
    }
}

/// An answer under way.
struct Answer {
    /// Since when the client has taken nothing of it; `None` while there is nothing to take.
    since: Mutex<Option<Instant>>,
    _request: Request,
}

impl Answers {
    /// Wraps a service, so that its answers are watched.
    pub fn of<S>(&self, service: S) -> Watched<S> {
        Watched { service, answers: self.clone() }
    }

    fn begin(&self) -> Request {
        self.requests.lock().count += 1;
        Request(self.requests.clone())
    }

    fn watch(&self, body: Body, request: Request) -> Body {
        if body.is_end_stream() {
            return body;
        }
        let since = Mutex::new(Some(Instant::now()));
        let answer = Arc::new(Answer { since, _request: request });
        let mut all = self.under_way.lock();
        all.retain(|answer| answer.strong_count() > 0);
        all.push(Arc::downgrade(&answer));
        Body::new(Parts { body, rest: Bytes::new(), answer })
    }

    /// Returns since when the client has taken nothing of the answer for which that is longest.
    fn waiting_since(&self) -> Option<Instant> {
        let all = self.under_way.lock();
        all.iter().filter_map(|answer| *answer.upgrade()?.since.lock()).min()
    }

    /// Returns since when no request is under way.
    fn idle_since(&self) -> Option<Instant> {
        let requests = self.requests.lock();
        (requests.count == 0).then_some(requests.since)
    }
}

/// A service whose answers are watched.
#[derive(Clone)]
pub struct Watched<S> {
    service: S,
    answers: Answers,
}

impl<S, R> tower::Service<R> for Watched<S>
where
    S: tower::Service<R, Response = Response>,
    S::Future: Send + 'static,
{
    type Response = Response;
    type Error = S::Error;
    type Future = BoxFuture<'static, Result<Response, S::Error>>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), S::Error>> {
        self.service.poll_ready(context)
    }

    fn call(&mut self, request: R) -> Self::Future {
        let (answers, under_way) = (self.answers.clone(), self.answers.begin());
        let answer = self.service.call(request);
        Box::pin(async move { Ok(answer.await?.map(|body| answers.watch(body, under_way))) })
    }
}

/// How long a connection still waits for its client.
pub struct Patience {
    answers: Answers,
    until: Pin<Box<Sleep>>,
}

impl Patience {
    pub fn new(answers: Answers) -> Patience {
        Patience { answers, until: Box::pin(tokio::time::sleep(STALLED)) }
    }

    /// Returns whether the client has taken nothing of an answer for [`STALLED`], or has sent no request over HTTP/2 for [`IDLE`]. Otherwise the task is
    /// woken when it has to ask again. The end of a request does not wake it, but the server's own pings over HTTP/2 do.
    pub fn is_over(&mut self, context: &mut Context<'_>, is_http2: bool) -> bool {
        let stalled = self.answers.waiting_since().map(|since| since + STALLED);
        let idle = self.answers.idle_since().filter(|_| is_http2).map(|since| since + IDLE);
        let Some(until) = stalled.into_iter().chain(idle).min() else { return false };
        if self.until.deadline() != until {
            self.until.as_mut().reset(until);
        }
        self.until.as_mut().poll(context).is_ready()
    }
}

/// The body of an answer, in parts.
struct Parts {
    body: Body,
    /// Bytes that the body has given and that the connection has not taken yet.
    rest: Bytes,
    answer: Arc<Answer>,
}

impl HttpBody for Parts {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        if self.rest.is_empty() {
            let next = Pin::new(&mut self.body).poll_frame(context);
            // While the server has nothing to send, nobody waits for the client.
            *self.answer.since.lock() = next.is_ready().then(Instant::now);
            match ready!(next) {
                Some(Ok(frame)) => match frame.into_data() {
                    Ok(data) => self.rest = data,
                    Err(other) => return Poll::Ready(Some(Ok(other))),
                },
                end => return Poll::Ready(end),
            }
        }
        *self.answer.since.lock() = Some(Instant::now());
        let length = self.rest.len().min(PART);
        let part = Part { bytes: self.rest.split_to(length), answer: self.answer.clone() };
        Poll::Ready(Some(Ok(Frame::data(Bytes::from_owner(part)))))
    }

    fn is_end_stream(&self) -> bool {
        self.rest.is_empty() && self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        let (mut hint, rest) = (self.body.size_hint(), self.rest.len() as u64);
        if let Some(upper) = hint.upper() {
            hint.set_upper(upper + rest);
        }
        hint.set_lower(hint.lower() + rest);
        hint
    }
}

/// A part of an answer, until the connection has written it.
struct Part {
    bytes: Bytes,
    answer: Arc<Answer>,
}

impl AsRef<[u8]> for Part {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

impl Drop for Part {
    fn drop(&mut self) {
        if let Some(since) = &mut *self.answer.since.lock() {
            *since = Instant::now();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::task::Waker;

    use super::*;

    #[tokio::test(start_paused = true)]
    async fn a_client_must_take_a_part_of_each_answer_in_time() {
        let answers = Answers::default();
        let mut patience = Patience::new(answers.clone());
        let mut is_over = || patience.is_over(&mut Context::from_waker(Waker::noop()), false);
        let later = |seconds| tokio::time::advance(Duration::from_secs(seconds));
        assert!(!is_over());
        let mut body = answers.watch(Body::from(vec![7; 2 * PART + 1]), answers.begin());
        assert_eq!(body.size_hint().exact(), Some(2 * PART as u64 + 1));
        let next = async |body: &mut Body| {
            let frame = std::future::poll_fn(|context| Pin::new(&mut *body).poll_frame(context));
            frame.await.unwrap().unwrap().into_data().unwrap()
        };
        later(59).await;
        assert!(!is_over());
        let part = next(&mut body).await;
        assert_eq!((part.len(), body.size_hint().exact()), (PART, Some(PART as u64 + 1)));
        later(59).await;
        assert!(!is_over());
        // A part that is written counts, one that waits to be written does not.
        drop(part);
        later(59).await;
        assert!(!is_over());
        // Another answer, which is read, does not stand in for this one.
        let mut other = answers.watch(Body::from("other"), answers.begin());
        assert_eq!(next(&mut other).await, "other");
        later(1).await;
        assert!(is_over());
        let [second, last] = [next(&mut body).await, next(&mut body).await];
        assert_eq!((second.len(), last.len(), body.is_end_stream()), (PART, 1, true));
        drop((body, other));
        later(59).await;
        assert!(!is_over());
        later(1).await;
        assert!(is_over(), "the last parts are not written");
        drop((second, last));
        assert!(!is_over());
    }

    #[tokio::test(start_paused = true)]
    async fn nobody_waits_for_a_client_while_there_is_nothing_to_send() {
        let answers = Answers::default();
        let mut patience = Patience::new(answers.clone());
        let (mut sender, receiver) =
            futures::channel::mpsc::channel::<Result<Bytes, axum::Error>>(1);
        let mut body = answers.watch(Body::from_stream(receiver), answers.begin());
        let mut context = Context::from_waker(Waker::noop());
        assert!(Pin::new(&mut body).poll_frame(&mut context).is_pending());
        tokio::time::advance(Duration::from_secs(3600)).await;
        assert!(!patience.is_over(&mut context, false));
        sender.try_send(Ok(Bytes::from_static(b"news"))).unwrap();
        assert!(Pin::new(&mut body).poll_frame(&mut context).is_ready());
        assert!(!patience.is_over(&mut context, false));
        tokio::time::advance(STALLED).await;
        assert!(patience.is_over(&mut context, false));
    }

    #[tokio::test(start_paused = true)]
    async fn a_connection_over_http2_needs_a_request_now_and_then() {
        let answers = Answers::default();
        let mut patience = Patience::new(answers.clone());
        let mut context = Context::from_waker(Waker::noop());
        let mut is_over = |is_http2| patience.is_over(&mut context, is_http2);
        let short = IDLE - Duration::from_secs(1);
        tokio::time::advance(short).await;
        assert!(!is_over(true));
        // While the server works on a request, and while its answer is under way, the connection is in use.
        let request = answers.begin();
        tokio::time::advance(2 * IDLE).await;
        assert!(!is_over(true));
        let (sender, receiver) = futures::channel::mpsc::channel::<Result<Bytes, axum::Error>>(1);
        let mut body = answers.watch(Body::from_stream(receiver), request);
        let waits = Pin::new(&mut body).poll_frame(&mut Context::from_waker(Waker::noop()));
        assert!(waits.is_pending());
        tokio::time::advance(2 * IDLE).await;
        assert!(!is_over(true));
        drop((body, sender));
        tokio::time::advance(short).await;
        assert!(!is_over(true));
        // An answer without a body ends its request at once.
        drop(answers.watch(Body::empty(), answers.begin()));
        tokio::time::advance(short).await;
        assert!(!is_over(true));
        tokio::time::advance(Duration::from_secs(1)).await;
        // HTTP/1 has limits of its own, and its connections may have become WebSockets.
        assert!(!is_over(false));
        assert!(is_over(true));
    }
}
