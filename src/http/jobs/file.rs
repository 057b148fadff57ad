//! Files as answers, with entity tags and single byte ranges (RFC 9110 §14).

use std::path::Path;

use axum::body::Body;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use http_range_header::{ParsedRanges, SyntacticallyCorrectRange as Range, parse_range_header};
use tokio::io::{AsyncReadExt, AsyncSeekExt};
use tokio_util::io::ReaderStream;

use super::wire::job_storage;
use crate::http::conditional::none_match_hits;
use crate::http::problem::{Kind, Problem};

/// Bytes read at a time.
const CHUNK: usize = 64 << 10;

/// Source of an answer's bytes.
pub enum Content<'a> {
    Memory(Bytes),
    File(&'a Path),
}

/// A file whose content never changes under the same tag.
pub struct Served<'a> {
    pub content: Content<'a>,
    pub bytes: u64,
    /// SHA-256 of the content.
    pub sha256: &'a str,
    pub content_type: HeaderValue,
}

/// Bytes that a request wants.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Wanted {
    All,
    /// From the first byte to the last, both included.
    Part(u64, u64),
    /// The range is beyond the end of the file.
    None,
}

/// Interprets a `Range` header for a file of `length` bytes. Anything but a single range of bytes is ignored, as RFC 9110 says.
fn wanted(range: Option<&str>, length: u64) -> Wanted {
    let ranges = range.and_then(|range| parse_range_header(range.trim()).ok());
    let ranges = ranges.map(ParsedRanges::into_ranges);
    let end = length.saturating_sub(1);
    let (first, last) = match ranges.as_deref() {
        Some(&[Range::FromStart(first)]) => (first, end),
        Some(&[Range::FromLast(count)]) if count > 0 => (length.saturating_sub(count), end),
        Some(&[Range::FromLast(_)]) => return Wanted::None,
        Some(&[Range::Indexed(first, last)]) => (first, last.min(end)),
        _ => return Wanted::All,
    };
    if first < length { Wanted::Part(first, last) } else { Wanted::None }
}

/// Answers with a file, or with the part of it that the request asks for.
///
/// # Errors
/// 416 for a range beyond the end; a file that cannot be read.
pub async fn serve(
    served: &Served<'_>,
    method: &Method,
    request: &HeaderMap,
) -> Result<Response, Problem> {
    let etag = format!("\"{}\"", served.sha256);
    let tag = HeaderValue::from_str(&etag).map_err(Problem::internal)?;
    let common = |response: &mut Response| {
        let headers = response.headers_mut();
        headers.insert(header::ETAG, tag.clone());
        headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-cache"));
        headers.insert(header::ACCEPT_RANGES, HeaderValue::from_static("bytes"));
    };
    if none_match_hits(request, &etag) {
        let mut response = StatusCode::NOT_MODIFIED.into_response();
        common(&mut response);
        return Ok(response);
    }
    let text = |name| request.get(name).and_then(|value: &HeaderValue| value.to_str().ok());
    // If the client's range belongs to another version, it gets the whole of this one.
    let is_same = text(header::IF_RANGE).is_none_or(|known| known.trim() == etag);
    let range = if *method == Method::GET && is_same { text(header::RANGE) } else { None };
    let (first, count, status) = match wanted(range, served.bytes) {
        Wanted::All => (0, served.bytes, StatusCode::OK),
        Wanted::Part(first, last) => (first, last - first + 1, StatusCode::PARTIAL_CONTENT),
        Wanted::None => {
            let detail = format!(
                "the range begins beyond the end of the file, which has {} bytes",
                served.bytes
            );
            let problem = Problem::new(Kind::RangeNotSatisfiable, detail).at("Range");
            let mut response = problem
                .accepted(format!("bytes=0-{}", served.bytes.saturating_sub(1)))
                .into_response();
            let whole = HeaderValue::from_str(&format!("bytes */{}", served.bytes))
                .map_err(Problem::internal)?;
            response.headers_mut().insert(header::CONTENT_RANGE, whole);
            return Ok(response);
        }
    };
    let body = if *method == Method::HEAD {
        Body::empty()
    } else {
        match &served.content {
            Content::Memory(bytes) => Body::from(part(bytes, first, count)),
            Content::File(file) => body(file, first, count).await?,
        }
    };
    let mut response = Response::new(body);
    *response.status_mut() = status;
    common(&mut response);
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_TYPE, served.content_type.clone());
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    headers.insert(header::CONTENT_LENGTH, count.into());
    if status == StatusCode::PARTIAL_CONTENT {
        let range = format!("bytes {first}-{}/{}", first + count - 1, served.bytes);
        headers.insert(
            header::CONTENT_RANGE,
            HeaderValue::from_str(&range).map_err(Problem::internal)?,
        );
    }
    Ok(response)
}

fn part(bytes: &Bytes, first: u64, count: u64) -> Bytes {
    let at = |place: u64| usize::try_from(place).unwrap_or(usize::MAX).min(bytes.len());
    bytes.slice(at(first)..at(first.saturating_add(count)))
}

async fn body(file: &Path, first: u64, count: u64) -> Result<Body, Problem> {
    let open = async {
        let mut file = tokio::fs::File::open(file).await?;
        file.seek(std::io::SeekFrom::Start(first)).await?;
        std::io::Result::Ok(file)
    };
    let opened = open.await.map_err(|error| job_storage(&error))?;
    Ok(Body::from_stream(ReaderStream::with_capacity(opened.take(count), CHUNK)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges() {
        let of = |range: &str| wanted(Some(range), 100);
        assert_eq!(wanted(None, 100), Wanted::All);
        assert_eq!(of("bytes=0-"), Wanted::Part(0, 99));
        assert_eq!(of("bytes=10-19"), Wanted::Part(10, 19));
        assert_eq!(of("bytes=10-1000"), Wanted::Part(10, 99));
        assert_eq!(of("bytes=-10"), Wanted::Part(90, 99));
        assert_eq!(of("bytes=-1000"), Wanted::Part(0, 99));
        assert_eq!(of("bytes=99999999999999999999-"), Wanted::None);
        for beyond in ["bytes=100-", "bytes=100-200", "bytes=-0"] {
            assert_eq!(of(beyond), Wanted::None, "{beyond}");
        }
        for ignored in [
            "",
            "bytes=",
            "bytes=-",
            "bytes=5-4",
            "bytes=0-1,3-4",
            "lines=0-1",
            "bytes=a-b",
            "bytes=+1-2",
        ] {
            assert_eq!(of(ignored), Wanted::All, "{ignored}");
        }
        assert_eq!(wanted(Some("bytes=0-"), 0), Wanted::None);
        assert_eq!(wanted(Some("bytes=-5"), 0), Wanted::None);
    }
}
