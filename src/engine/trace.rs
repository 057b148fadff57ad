//! Under which name a frame is found in logs, receipts and answers, and the spans it goes through.
//!
//! ```text
//! request (http) ── frame ─┬─ queue      from its admission to its batch
//!                          └─ encode
//! batch (frames = their names) ── pass … pass (events, with their GPU times)
//! ```
//!
//! All are at debug level: disabled, a span costs a load and a comparison.

use std::fmt;
use std::hash::{BuildHasher, RandomState};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, LazyLock};

use serde::{Serialize, Serializer};
use tracing::Span;

use super::FrameRequest;
use super::queue::Client;
use crate::encode::ImageFormat;

/// The name of a request: what its sender calls it, or one that no other has.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct RequestId(Arc<str>);

impl RequestId {
    /// Characters of a name.
    pub const MOST: usize = 128;

    /// A name that was given: 1 to [`RequestId::MOST`] letters, digits and `-_.:/+=@~` of ASCII.
    pub fn parse(text: &str) -> Option<Self> {
        let is_fine = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.:/+=@~".contains(&byte);
        let fits = (1..=Self::MOST).contains(&text.len());
        (fits && text.bytes().all(is_fine)).then(|| Self(text.into()))
    }

    /// A new name: 16 hexadecimal digits.
    pub fn fresh() -> Self {
        static KEYS: LazyLock<RandomState> = LazyLock::new(RandomState::new);
        static COUNT: AtomicU64 = AtomicU64::new(0);
        let number = KEYS.hash_one(COUNT.fetch_add(1, Ordering::Relaxed));
        Self(format!("{number:016x}").into())
    }

    /// The name of one of several frames of this request.
    pub fn part(&self, number: u64) -> Self {
        Self(format!("{}/{number}", self.0).into())
    }

    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for RequestId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl Serialize for RequestId {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&self.0)
    }
}

/// The client that asks for a frame, and its name for the request.
#[derive(Clone, Debug)]
pub struct Origin {
    pub client: Client,
    pub request_id: RequestId,
}

impl From<Client> for Origin {
    fn from(client: Client) -> Self {
        Self { client, request_id: RequestId::fresh() }
    }
}

/// The spans of a frame, from its admission on.
pub struct FrameSpans {
    pub frame: Span,
    pub queue: Span,
}

impl FrameSpans {
    /// Within the span that the request is in.
    pub fn open(origin: &Origin, request: &FrameRequest, cost_ns: u64) -> Self {
        let frame = tracing::debug_span!(
            "frame",
            request_id = %origin.request_id,
            class = origin.client.class().name(),
            scene = request.scene,
            width = request.width,
            height = request.height,
        );
        let queue = Self::queue(&frame, &origin.request_id, cost_ns);
        Self { frame, queue }
    }

    /// The span of a wait in the queue. Formatters of logs write a span's own fields and not those of a parent on another thread: the
    /// name is in all.
    pub fn queue(frame: &Span, request_id: &RequestId, estimated_ns: u64) -> Span {
        tracing::debug_span!(parent: frame, "queue", %request_id, estimated_ns)
    }

    /// The span of the encoder's work.
    pub fn encode(frame: &Span, request_id: &RequestId, format: ImageFormat) -> Span {
        tracing::debug_span!(parent: frame, "encode", %request_id, ?format)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_short_and_plain() {
        let longest = "x".repeat(RequestId::MOST);
        for fine in ["a", "4bf92f35-77b3/1", "a_b.c:d+e=f@g~", &longest] {
            assert_eq!(RequestId::parse(fine).unwrap().as_str(), fine);
        }
        let too_long = format!("{longest}x");
        for bad in ["", " ", "a b", "a\"b", "a\nb", "é", "a,b", &too_long] {
            assert_eq!(RequestId::parse(bad), None, "{bad:?}");
        }
    }

    #[test]
    fn fresh_names_differ_and_could_have_been_given() {
        let names: std::collections::HashSet<RequestId> =
            (0..1000).map(|_| RequestId::fresh()).collect();
        assert_eq!(names.len(), 1000);
        assert!(names.iter().all(|name| RequestId::parse(name.as_str()).as_ref() == Some(name)));
        let name = RequestId::parse("a").unwrap();
        assert_eq!(name.part(7).to_string(), "a/7");
    }
}
