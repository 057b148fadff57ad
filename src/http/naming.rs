//! The request's id, which appears in logs, receipts and problems: the one in `X-Request-Id`, or a new unique one.

use std::future::Future;

use axum::http::{HeaderMap, HeaderName, HeaderValue};

use crate::engine::RequestId;

pub const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");

tokio::task_local! {
    /// Id of the request that this task answers.
    static CURRENT: RequestId;
}

/// Returns the request's id. An unusable `X-Request-Id` (see [`RequestId::parse`]) is replaced; the answer carries the new one.
pub fn of(headers: &HeaderMap) -> RequestId {
    let given = headers.get(&REQUEST_ID).and_then(|value| value.to_str().ok());
    given.and_then(RequestId::parse).unwrap_or_else(RequestId::fresh)
}

/// Runs `work` under the request id `id`.
pub async fn within<T>(id: RequestId, work: impl Future<Output = T>) -> T {
    CURRENT.scope(id, work).await
}

/// Returns the id of the request that this task answers, if there is one.
pub fn current() -> Option<RequestId> {
    CURRENT.try_with(Clone::clone).ok()
}

pub fn header(id: &RequestId) -> Option<HeaderValue> {
    HeaderValue::from_str(id.as_str()).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_kept_or_replaced() {
        let named = |name: &'static str| {
            let mut headers = HeaderMap::new();
            headers.insert(REQUEST_ID, HeaderValue::from_static(name));
            of(&headers).to_string()
        };
        assert_eq!(named("4bf92f35-77b3"), "4bf92f35-77b3");
        for bad in ["", "a b", "a\"b", "{}"] {
            assert_eq!(named(bad).len(), 16, "{bad}");
        }
        assert_ne!(of(&HeaderMap::new()), of(&HeaderMap::new()));
        assert!(current().is_none());
    }
}
