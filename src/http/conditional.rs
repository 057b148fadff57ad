//! Conditional requests and content negotiation (RFC 9110 §12.5.1, §13.1.2), as pure functions.

use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};

use super::problem::{Kind, Problem};
use crate::encode::{self, ImageFormat};
use crate::plan::Output;

/// Returns whether `If-None-Match` names `etag` (quoted). The comparison is weak: `W/` is ignored.
pub fn none_match_hits(headers: &HeaderMap, etag: &str) -> bool {
    headers
        .get_all(header::IF_NONE_MATCH)
        .iter()
        .filter_map(|value| value.to_str().ok())
        .any(|list| list_names(list, etag))
}

fn list_names(list: &str, etag: &str) -> bool {
    if list.trim() == "*" {
        return true;
    }
    let etag = etag.strip_prefix("W/").unwrap_or(etag);
    let mut rest = list;
    loop {
        rest = rest.trim_start_matches([' ', '\t', ',']);
        rest = rest.strip_prefix("W/").unwrap_or(rest);
        // A tag may hold commas, so the list is split at the quotes.
        let Some(inner) = rest.strip_prefix('"') else { return false };
        let Some(length) = inner.find('"') else { return false };
        if rest.get(..length + 2) == Some(etag) {
            return true;
        }
        rest = &inner[length + 1..];
    }
}

/// Answers with `answer` and its entity tag (quoted), or with 304 if the client has it already. Clients ask again before each use.
///
/// # Errors
/// The tag is no header.
pub fn revalidated(
    request: &HeaderMap,
    etag: &str,
    answer: impl IntoResponse,
) -> Result<Response, Problem> {
    let tag = HeaderValue::from_str(etag).map_err(Problem::internal)?;
    let validators =
        [(header::ETAG, tag), (header::CACHE_CONTROL, HeaderValue::from_static("no-cache"))];
    Ok(if none_match_hits(request, etag) {
        (StatusCode::NOT_MODIFIED, validators).into_response()
    } else {
        (validators, answer).into_response()
    })
}

/// Formats in the server's order of preference, each with its media types.
const FORMATS: [(ImageFormat, &[&str]); 7] = [
    (ImageFormat::Png, &["image/png"]),
    (ImageFormat::Jpeg, &["image/jpeg"]),
    (ImageFormat::Webp, &["image/webp"]),
    (ImageFormat::Qoi, &["image/qoi", "image/x-qoi"]),
    (ImageFormat::Exr, &["image/x-exr", "image/aces"]),
    (ImageFormat::Pfm, &["image/x-portable-floatmap", "image/x-pfm"]),
    (ImageFormat::Raw, &["application/octet-stream"]),
];

/// Returns the media types that a client can ask for with `Accept`.
pub fn media_types() -> String {
    FORMATS.iter().map(|(_, types)| types[0]).collect::<Vec<_>>().join(", ")
}

/// Returns the media type of `format`.
pub fn media_type(format: ImageFormat) -> &'static str {
    FORMATS
        .iter()
        .find(|(candidate, _)| *candidate == format)
        .map_or("application/octet-stream", |(_, types)| types[0])
}

/// Chooses a format for `output` by `Accept`; without `Accept`, the first format that can hold `output`.
///
/// # Errors
/// 406 when every format that can hold `output` is excluded.
pub fn negotiate(headers: &HeaderMap, output: Output) -> Result<ImageFormat, Problem> {
    let candidates = FORMATS.iter().filter(|(format, _)| encode::accepts(*format, output).is_ok());
    let accept: Vec<&str> = headers
        .get_all(header::ACCEPT)
        .iter()
        .filter_map(|value| value.to_str().ok())
        .flat_map(|list| list.split(','))
        .map(str::trim)
        .filter(|range| !range.is_empty())
        .collect();
    let mut best: Option<(f32, ImageFormat)> = None;
    for (format, types) in candidates {
        if accept.is_empty() {
            return Ok(*format);
        }
        let quality = types.iter().map(|t| quality_of(t, &accept)).fold(0.0, f32::max);
        if quality > best.map_or(0.0, |(q, _)| q) {
            best = Some((quality, *format));
        }
    }
    best.map(|(_, format)| format).ok_or_else(|| {
        Problem::new(Kind::NotAcceptable, "no format on offer matches the Accept header")
            .at("Accept")
            .accepted(media_types())
    })
}

/// Returns the quality that the most specific matching range gives to `media_type`; 0 when none matches.
fn quality_of(media_type: &str, accept: &[&str]) -> f32 {
    let group = media_type.split('/').next().unwrap_or_default();
    let mut found = (0u8, 0.0);
    for range in accept {
        let mut parts = range.split(';');
        let name = parts.next().unwrap_or_default().trim();
        let specificity = if name.eq_ignore_ascii_case(media_type) {
            3
        } else if name.strip_suffix("/*").is_some_and(|g| g.eq_ignore_ascii_case(group)) {
            2
        } else if name == "*/*" || name == "*" {
            1
        } else {
            continue;
        };
        let quality = parts
            .find_map(|p| p.trim().strip_prefix("q=").map(|q| q.trim().parse::<f32>()))
            .and_then(Result::ok)
            .filter(|q| (0.0..=1.0).contains(q))
            .unwrap_or(1.0);
        if specificity > found.0 {
            found = (specificity, quality);
        }
    }
    found.1
}

/// Returns the seconds of `Prefer: wait=N`, if any.
pub fn prefer_wait(headers: &HeaderMap) -> Option<u64> {
    headers
        .get_all("prefer")
        .iter()
        .filter_map(|value| value.to_str().ok())
        .flat_map(|list| list.split(','))
        .find_map(|preference| {
            let (name, value) = preference.split_once('=')?;
            let value = value.split(';').next()?.trim().trim_matches('"');
            name.trim().eq_ignore_ascii_case("wait").then(|| value.parse().ok())?
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(name: &'static str, value: &str) -> HeaderMap {
        let mut headers = HeaderMap::new();
        headers.insert(name, HeaderValue::from_str(value).unwrap());
        headers
    }

    #[test]
    fn entity_tags_in_lists() {
        let hit = |value: &str| none_match_hits(&with("if-none-match", value), "\"a,b\"");
        assert!(hit("\"a,b\""));
        assert!(hit("W/\"a,b\""));
        assert!(hit("\"x\", W/\"y\" ,\"a,b\""));
        assert!(hit(" * "));
        assert!(!hit("\"a\", \"b\""));
        assert!(!hit("a,b"));
        assert!(!hit("\"a,b"));
        assert!(!hit(""));
        assert!(!none_match_hits(&HeaderMap::new(), "\"a\""));
    }

    #[test]
    fn accept_headers() {
        let choose = |value: &str| negotiate(&with("accept", value), Output::Color);
        assert_eq!(negotiate(&HeaderMap::new(), Output::Color).unwrap(), ImageFormat::Png);
        assert_eq!(choose("*/*").unwrap(), ImageFormat::Png);
        assert_eq!(choose("image/jpeg").unwrap(), ImageFormat::Jpeg);
        assert_eq!(choose("image/png;q=0.5, image/webp").unwrap(), ImageFormat::Webp);
        assert_eq!(choose("image/*;q=0.8, image/png;q=0").unwrap(), ImageFormat::Jpeg);
        // A browser's <img> accepts everything at full quality, so the server's order decides.
        let browser = "image/avif,image/webp,image/apng,image/svg+xml,image/*,*/*;q=0.8";
        assert_eq!(choose(browser).unwrap(), ImageFormat::Png);
        assert_eq!(choose("text/html").unwrap_err().status(), 406);
        assert_eq!(choose("image/png;q=0").unwrap_err().status(), 406);
    }

    #[test]
    fn prefer_wait_among_others() {
        assert_eq!(prefer_wait(&with("prefer", "respond-async, wait=7")), Some(7));
        assert_eq!(prefer_wait(&with("prefer", "Wait = 3; x=1")), Some(3));
        assert_eq!(prefer_wait(&with("prefer", "wait=soon")), None);
        assert_eq!(prefer_wait(&HeaderMap::new()), None);
    }
}
