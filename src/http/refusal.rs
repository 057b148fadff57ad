//! Problems for requests whose head cannot be read.
//!
//! The HTTP library answers such a request itself, with a status and an empty body, before any handler runs. The connection finds
//! that answer in the bytes written and sends a complete answer instead. No handler answers with these statuses.

use axum::http::HeaderMap;
use bytes::Bytes;

use super::naming;
use super::problem::{Kind, PROBLEM_JSON, Problem};

/// Longest request head in bytes.
pub const MAX_HEAD_BYTES: usize = 32 << 10;
/// Largest number of headers of a request.
pub const MAX_HEADERS: usize = 64;

/// Returns the answer to send in place of `answer`, if `answer` is one of the library's own.
pub fn instead_of(answer: &[u8]) -> Option<Bytes> {
    let rest = answer.strip_prefix(b"HTTP/1.1 ").or_else(|| answer.strip_prefix(b"HTTP/1.0 "))?;
    let problem = match rest.get(..3)? {
        b"400" => {
            Problem::new(Kind::MalformedRequest, "the request line or a header cannot be read")
                .accepted("a request line and headers as HTTP/1.1 (RFC 9112) defines them")
        }
        b"414" | b"431" => {
            let detail =
                "the request line and the headers are too long, or there are too many headers";
            Problem::new(Kind::HeadTooLarge, detail)
                .accepted(format!("at most {MAX_HEAD_BYTES} bytes and {MAX_HEADERS} headers"))
        }
        _ => return None,
    };
    let head = std::str::from_utf8(answer.strip_suffix(b"\r\n\r\n")?).ok()?;
    if !head.lines().any(|line| line.eq_ignore_ascii_case("content-length: 0")) {
        return None;
    }
    let id = naming::of(&HeaderMap::new());
    let (status, name) = (problem.kind.status(), id.to_string());
    let body = problem.named(id).to_json();
    let length = body.len();
    Some(Bytes::from(format!(
        "HTTP/1.1 {status}\r\ncontent-type: {PROBLEM_JSON}\r\ncontent-length: {length}\r\ncache-control: no-store\r\n\
         x-request-id: {name}\r\nconnection: close\r\n\r\n{body}"
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_librarys_own_answers_are_replaced() {
        let own =
            b"HTTP/1.1 431 Request Header Fields Too Large\r\ncontent-length: 0\r\ndate: x\r\n\r\n";
        let answer = String::from_utf8(instead_of(own).unwrap().to_vec()).unwrap();
        assert!(answer.starts_with("HTTP/1.1 431 Request Header Fields Too Large\r\n"), "{answer}");
        let (head, body) = answer.split_once("\r\n\r\n").unwrap();
        assert!(head.contains(&format!("content-length: {}\r\n", body.len())), "{head}");
        assert!(body.contains("urn:pointillist:problem:head-too-large"), "{body}");
        for other in [
            "HTTP/1.1 404 Not Found\r\ncontent-length: 0\r\n\r\n",
            "HTTP/1.1 400 Bad Request\r\ncontent-length: 5\r\n\r\n",
            "HTTP/1.1 400 Bad Request\r\ncontent-length: 0\r\n\r\nHTTP",
            "HTTP/1.1 40",
            "\x00\x00\x12\x04",
        ] {
            assert!(instead_of(other.as_bytes()).is_none(), "{other}");
        }
    }
}
