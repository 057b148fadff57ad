//! Under which name a request is found in logs, receipts and problems: what `X-Request-Id` calls it, or one that no other has.

use std::future::Future;

use axum::http::{HeaderMap, HeaderName, HeaderValue};

use crate::engine::RequestId;

pub const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");

tokio::task_local! {
    /// Of the request that this task answers.
    static CURRENT: RequestId;
}

/// What a request is called. A name that cannot be used (see [`RequestId::parse`]) is replaced: the answer tells by what.
pub fn of(headers: &HeaderMap) -> RequestId {
    let given = headers.get(&REQUEST_ID).and_then(|value| value.to_str().ok());
    given.and_then(RequestId::parse).unwrap_or_else(RequestId::fresh)
}

/// Has all that `work` says be about the request `id`.
pub async fn within<T>(id: RequestId, work: impl Future<Output = T>) -> T {
    CURRENT.scope(id, work).await
}

/// The request that is being answered, if this is a part of that.
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
