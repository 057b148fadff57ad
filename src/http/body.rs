//! Request bodies, limited in size and in the time spent waiting for them.

use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use axum::body::{Body, BodyDataStream};
use axum::http::{HeaderMap, header};
use bytes::Bytes;
use futures::{Stream, StreamExt};
use parking_lot::Mutex;
use serde::de::DeserializeOwned;
use serde_path_to_error::Segment;

use super::problem::{Kind, Problem};
use crate::engine::EngineError;
use crate::json::{self, Limits};
use crate::memory::Admission;
use crate::scene::check_keys;

/// Lowest rate of a body in bytes per second, averaged over the time spent waiting for it.
pub const LEAST_RATE: u64 = 1024;

/// Time limits of a body: `gap` for its next piece, and for the whole body the longer of `gap` and the time that it takes at
/// [`LEAST_RATE`]. Only waiting counts; the time to store a piece does not.
pub struct Patience {
    gap: Duration,
    waited: Duration,
    bytes: u64,
}

impl Patience {
    pub fn new(gap: Duration) -> Self {
        Self { gap, waited: Duration::ZERO, bytes: 0 }
    }

    /// Waits for the next event of the body within the time limits.
    ///
    /// # Errors
    /// 408 when the wait exceeds a limit.
    pub async fn wait<T>(&mut self, next: impl Future<Output = T>) -> Result<T, Problem> {
        let whole =
            self.gap.max(Duration::from_millis(self.bytes.saturating_mul(1000) / LEAST_RATE));
        let left = whole.saturating_sub(self.waited);
        let began = tokio::time::Instant::now();
        let result = tokio::time::timeout(self.gap.min(left), next).await;
        self.waited += began.elapsed();
        result.map_err(|_| if left < self.gap { self.too_slow() } else { self.stalled() })
    }

    /// Returns the next piece of a body, or `None` at its end.
    ///
    /// # Errors
    /// 408 when nothing arrives or the body arrives too slowly; 422 when the client broke off.
    pub async fn next_chunk<E: std::fmt::Display>(
        &mut self,
        stream: &mut (impl Stream<Item = Result<Bytes, E>> + Unpin),
    ) -> Result<Option<Bytes>, Problem> {
        match self.wait(stream.next()).await? {
            None => Ok(None),
            Some(Ok(chunk)) => {
                self.bytes += chunk.len() as u64;
                Ok(Some(chunk))
            }
            Some(Err(error)) => Err(Problem::new(
                Kind::BadBody,
                format!("the connection ended before the body was complete: {error}"),
            )),
        }
    }

    fn stalled(&self) -> Problem {
        let seconds = self.gap.as_secs();
        Problem::new(Kind::RequestTimeout, format!("nothing was received for {seconds} seconds"))
    }

    fn too_slow(&self) -> Problem {
        let (bytes, seconds) = (self.bytes, self.waited.as_secs());
        Problem::new(
            Kind::RequestTimeout,
            format!("only {bytes} bytes of the body arrived in {seconds} seconds"),
        )
        .accepted(format!("at least {LEAST_RATE} bytes per second"))
    }
}

pub fn too_large(limit: u64) -> Problem {
    Problem::new(Kind::BodyTooLarge, format!("the body is larger than the limit of {limit} bytes"))
        .accepted(format!("at most {limit} bytes"))
}

/// Refuses a body whose announced length is over `limit`.
pub fn check_length(headers: &HeaderMap, limit: u64) -> Result<(), Problem> {
    let announced = headers
        .get(header::CONTENT_LENGTH)
        .and_then(|value| value.to_str().ok())
        .and_then(|value| value.parse::<u64>().ok());
    match announced {
        Some(length) if length > limit => Err(too_large(limit)),
        _ => Ok(()),
    }
}

/// Limits of a JSON body: ten thousand poses with all fields set.
const JSON_LIMITS: Limits =
    Limits { nodes: u64::MAX, objects: 20_000, values: 1_000_000, string_bytes: 64 << 10 };
/// Bytes of an object in memory, including its keys.
const OBJECT_BYTES: usize = 512;
/// Copies of an object in memory: a parser keeps one while it does not know the object's type.
const COPIES: u64 = 3;

/// Reads a JSON body of at most `limit` bytes. The admission reserves the memory that it takes.
///
/// # Errors
/// 415 for another content type, 413, 408, 507, and 422 with the place in the document.
pub async fn json<T: DeserializeOwned>(
    headers: &HeaderMap,
    body: Body,
    limit: u64,
    read_timeout: Duration,
    admission: &Admission,
) -> Result<T, Problem> {
    if !is_json(&media_type(headers)) {
        return Err(Problem::new(Kind::UnsupportedMediaType, "the body must be JSON")
            .at("Content-Type")
            .accepted("application/json"));
    }
    check_length(headers, limit)?;
    let mut bytes = Vec::new();
    let mut stream = body.into_data_stream();
    let mut patience = Patience::new(read_timeout);
    while let Some(chunk) = patience.next_chunk(&mut stream).await? {
        if (bytes.len() + chunk.len()) as u64 > limit {
            return Err(too_large(limit));
        }
        let held = 2 * chunk.len() as u64;
        admission.grow("the request's body", held).map_err(EngineError::from)?;
        bytes.extend_from_slice(&chunk);
    }
    let census = json::count(&bytes, &JSON_LIMITS).map_err(|excess| {
        let json::Excess { what, limit, .. } = excess;
        Problem::new(Kind::BadBody, format!("the body has more than {limit} {what}"))
            .accepted(format!("at most {limit} {what}"))
    })?;
    let needed = census.bytes(OBJECT_BYTES).saturating_mul(COPIES);
    admission.grow("the request's JSON", needed).map_err(EngineError::from)?;
    parse_json(&bytes)
}

/// Parses JSON. The error names the value that is wrong, where it has a name, and its line and column.
pub(super) fn parse_json<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, Problem> {
    check_keys(bytes)
        .map_err(|found| Problem::new(Kind::BadBody, found.to_string()).at(found.path))?;
    let mut deserializer = serde_json::Deserializer::from_slice(bytes);
    let value = serde_path_to_error::deserialize(&mut deserializer).map_err(|error| {
        // A text that ends early has no name for what is missing.
        if error.path().iter().any(|segment| matches!(segment, Segment::Unknown)) {
            return Problem::new(Kind::BadBody, error.inner().to_string());
        }
        let path = error.path().to_string();
        let told = json::plain(&error.inner().to_string());
        if path == "." {
            return Problem::new(Kind::BadBody, told);
        }
        Problem::new(Kind::BadBody, format!("{path}: {told}")).at(path)
    })?;
    deserializer.end().map_err(|error| Problem::new(Kind::BadBody, error.to_string()))?;
    Ok(value)
}

/// Returns the media type without parameters, in lower case; empty when there is none.
pub fn media_type(headers: &HeaderMap) -> String {
    headers
        .get(header::CONTENT_TYPE)
        .and_then(|value| value.to_str().ok())
        .and_then(|value| value.split(';').next())
        .map(|value| value.trim().to_ascii_lowercase())
        .unwrap_or_default()
}

/// Returns whether a media type is `application/json` or ends in `+json`.
pub fn is_json(media_type: &str) -> bool {
    media_type == "application/json"
        || (media_type.starts_with("application/") && media_type.ends_with("+json"))
}

/// The part of a request's body that its handler has not read.
pub struct Rest(Arc<Mutex<Option<BodyDataStream>>>);

/// Splits `body` into a body for the handler and the rest that the handler leaves unread.
pub fn share(body: Body) -> (Body, Rest) {
    let shared = Arc::new(Mutex::new(Some(body.into_data_stream())));
    let rest = Rest(shared.clone());
    (
        Body::from_stream(futures::stream::poll_fn(move |context| poll_shared(&shared, context))),
        rest,
    )
}

fn poll_shared(
    shared: &Mutex<Option<BodyDataStream>>,
    context: &mut Context<'_>,
) -> Poll<Option<Result<Bytes, axum::Error>>> {
    let mut slot = shared.lock();
    let Some(stream) = slot.as_mut() else { return Poll::Ready(None) };
    let next = stream.poll_next_unpin(context);
    if !matches!(next, Poll::Pending | Poll::Ready(Some(Ok(_)))) {
        *slot = None;
    }
    next
}

impl Rest {
    /// Goes on reading briefly after a refusal. If a connection closes while its client still sends, the
    /// client gets a reset and never sees the reason.
    pub async fn linger(self) {
        const MAX_BYTES: usize = 16 << 20;
        const MAX_TIME: Duration = Duration::from_secs(2);
        let drain = async {
            let mut left = MAX_BYTES;
            while let Some(Ok(chunk)) =
                std::future::poll_fn(|context| poll_shared(&self.0, context)).await
            {
                match left.checked_sub(chunk.len()) {
                    Some(rest) => left = rest,
                    None => break,
                }
            }
        };
        // The timeout discards anything that has not arrived yet.
        let _ = tokio::time::timeout(MAX_TIME, drain).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::HeaderValue;

    fn run<T>(future: impl Future<Output = T>) -> T {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
        runtime.block_on(future)
    }

    fn read(content_type: &'static str, body: &'static str) -> Result<[u32; 2], Problem> {
        let mut headers = HeaderMap::new();
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(content_type));
        run(json(&headers, Body::from(body), 16, Duration::from_secs(1), &Admission::default()))
    }

    #[test]
    fn json_bodies() {
        assert_eq!(read("application/json; charset=utf-8", "[1, 2]").unwrap(), [1, 2]);
        assert_eq!(read("application/merge-patch+json", "[1, 2]").unwrap(), [1, 2]);
        assert_eq!(read("text/plain", "[1, 2]").unwrap_err().status(), 415);
        for (broken, parameter) in
            [("[1, 2", None), ("[1, ", None), ("", None), ("[1, }", Some("[1]"))]
        {
            let problem = read("application/json", broken).unwrap_err();
            assert_eq!(
                (problem.status(), problem.parameter.as_deref()),
                (422, parameter),
                "{broken}"
            );
            assert!(problem.detail.contains("line 1 column"), "{}", problem.detail);
        }
        for (broken, parameter) in
            [(r#"{"fov": 2"#, None), (r#"{"a": {"b": 1"#, None), (r#"{"fov": 1e999}"#, Some("fov"))]
        {
            let problem = parse_json::<serde_json::Value>(broken.as_bytes()).unwrap_err();
            assert_eq!(problem.parameter.as_deref(), parameter, "{broken}");
            assert!(problem.detail.contains("line 1 column"), "{}", problem.detail);
        }
        assert_eq!(read("application/json", "[1, 2] 3").unwrap_err().status(), 422);
        let wrong = read("application/json", "[1, \"x\"]").unwrap_err();
        assert_eq!((wrong.status(), wrong.parameter.as_deref()), (422, Some("[1]")));
        assert_eq!(read("application/json", "[1,         2       ]").unwrap_err().status(), 413);
    }

    #[test]
    fn what_is_left_is_read_to_its_end() {
        let chunks = ["a", "b", "c"].map(|chunk| Ok::<_, std::io::Error>(Bytes::from(chunk)));
        let (body, rest) = share(Body::from_stream(futures::stream::iter(chunks)));
        let mut stream = body.into_data_stream();
        let mut patience = Patience::new(Duration::from_secs(1));
        assert_eq!(run(patience.next_chunk(&mut stream)).unwrap().unwrap(), "a");
        run(rest.linger());
        assert!(run(patience.next_chunk(&mut stream)).unwrap().is_none());
    }

    #[test]
    fn a_stalled_body_is_given_up() {
        let mut stream = futures::stream::pending::<Result<Bytes, String>>();
        let mut patience = Patience::new(Duration::from_millis(5));
        let problem = run(patience.next_chunk(&mut stream)).unwrap_err();
        assert_eq!(problem.status(), 408);
        assert!(problem.detail.starts_with("nothing"), "{}", problem.detail);
    }

    /// Reads pieces that arrive every 20 ms, with a gap of 100 ms. Returns the bytes read, and the problem if any.
    fn trickle(piece_bytes: usize, pieces: usize) -> (usize, Option<Problem>) {
        run(async {
            let source = futures::stream::iter(0..pieces).then(|_| async move {
                tokio::time::sleep(Duration::from_millis(20)).await;
                Ok::<_, std::io::Error>(Bytes::from(vec![b' '; piece_bytes]))
            });
            let mut source = std::pin::pin!(source);
            let mut patience = Patience::new(Duration::from_millis(100));
            let mut read = 0;
            loop {
                match patience.next_chunk(&mut source).await {
                    Ok(Some(chunk)) => read += chunk.len(),
                    Ok(None) => return (read, None),
                    Err(problem) => return (read, Some(problem)),
                }
            }
        })
    }

    #[test]
    fn a_body_that_trickles_is_given_up() {
        let (read, problem) = trickle(1, 100);
        let problem = problem.unwrap();
        assert_eq!(problem.status(), 408);
        assert!(problem.accepted.is_some() && read < 10, "{read}: {}", problem.detail);
        // The rate is ten times the lowest rate, for much longer than the gap.
        let (read, problem) = trickle(200, 20);
        assert!(problem.is_none() && read == 4000, "{read}");
    }
}
