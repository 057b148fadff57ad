//! The access log, a line of JSON for each request, and the audit log, a line for each change and each refused key.
//!
//! Each line is appended with one write, so that lines of several threads do not mix. SIGHUP opens the files anew, as logrotate
//! needs it. Neither log holds keys, queries or bodies.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use axum::body::{Body, HttpBody};
use axum::http::{Method, Uri};
use bytes::Bytes;
use parking_lot::Mutex;
use serde::Serialize;

use crate::engine::{Receipt, RequestId};

/// Name that stands for standard output.
const STDOUT: &str = "-";

/// A file, or standard output, to which lines are appended.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    /// `None` for standard output.
    file: Mutex<Option<File>>,
}

fn open(path: &Path) -> io::Result<Option<File>> {
    if path == Path::new(STDOUT) {
        return Ok(None);
    }
    let mut options = OpenOptions::new();
    options.append(true).create(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o640);
    options.open(path).map(Some)
}

impl Journal {
    /// Opens a file for appending; `-` is standard output.
    ///
    /// # Errors
    /// The file cannot be opened.
    pub fn open(path: &Path) -> io::Result<Journal> {
        Ok(Journal { path: path.to_owned(), file: Mutex::new(open(path)?) })
    }

    /// Opens the file anew. If that fails, the open file stays in use.
    pub fn reopen(&self) {
        match open(&self.path) {
            Ok(file) => *self.file.lock() = file,
            Err(error) => {
                tracing::error!(%error, path = %self.path.display(), "cannot reopen the log file");
            }
        }
    }

    /// Appends a value as one line of JSON.
    pub fn write(&self, value: &impl Serialize) {
        let Ok(mut line) = serde_json::to_vec(value) else { return };
        line.push(b'\n');
        let written = match &mut *self.file.lock() {
            Some(file) => file.write_all(&line),
            None => io::stdout().lock().write_all(&line),
        };
        if let Err(error) = written {
            tracing::error!(%error, path = %self.path.display(), "cannot write the log file");
        }
    }
}

/// Time that a frame spent, attached to answers that hold one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spent {
    queue_ms: f64,
    device_ms: Option<f64>,
}

impl Spent {
    pub fn of(receipt: &Receipt) -> Spent {
        let ms = |ns: u64| ns as f64 / 1e6;
        Spent { queue_ms: ms(receipt.queue_ns), device_ms: receipt.gpu_share_ns().map(ms) }
    }
}

/// One line of a log.
#[derive(Clone, Debug, Serialize)]
pub struct Line {
    /// Seconds since 1970.
    time: f64,
    request_id: String,
    /// Name of the key.
    key: Option<String>,
    address: Option<IpAddr>,
    method: String,
    route: &'static str,
    /// The scene or job of the address.
    target: Option<String>,
    status: u16,
    /// What was refused or changed; in the audit log only.
    #[serde(skip_serializing_if = "Option::is_none")]
    event: Option<&'static str>,
    /// Bytes of the body that were sent.
    #[serde(skip_serializing_if = "Option::is_none")]
    bytes: Option<u64>,
    #[serde(flatten)]
    spent: Option<Spent>,
    /// Milliseconds from the request's head to the last byte of its answer.
    #[serde(skip_serializing_if = "Option::is_none")]
    total_ms: Option<f64>,
}

/// What is known of a request before it is answered.
#[derive(Clone)]
pub struct Asked {
    pub request_id: RequestId,
    pub address: Option<IpAddr>,
    pub method: Method,
    pub route: &'static str,
    pub target: Option<String>,
    pub at: Instant,
}

/// Returns the scene or the job of an address, as the client wrote it.
pub fn target(uri: &Uri) -> Option<String> {
    let mut parts = uri.path().split('/').skip(1);
    let (Some("v1"), Some("scenes" | "jobs"), Some(id)) =
        (parts.next(), parts.next(), parts.next())
    else {
        return None;
    };
    Some(id.chars().take(64).collect())
}

impl Asked {
    /// Builds the line of an answer.
    pub fn answered(&self, key: Option<&str>, status: u16) -> Line {
        Line {
            time: now(),
            request_id: self.request_id.to_string(),
            key: key.map(str::to_owned),
            address: self.address,
            method: self.method.as_str().chars().take(16).collect(),
            route: self.route,
            target: self.target.clone(),
            status,
            event: None,
            bytes: None,
            spent: None,
            total_ms: None,
        }
    }
}

fn now() -> f64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    (since.as_secs_f64() * 1e3).round() / 1e3
}

impl Line {
    pub fn event(self, event: &'static str) -> Line {
        Line { event: Some(event), ..self }
    }
}

/// A line of the audit log about the server itself.
#[derive(Serialize)]
pub struct Notice {
    time: f64,
    event: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<String>,
}

impl Notice {
    pub fn new(event: &'static str, error: Option<String>) -> Notice {
        Notice { time: now(), event, error }
    }
}

/// A body that writes its request's line when it ends or is dropped.
struct Logged {
    body: Body,
    journal: Arc<Journal>,
    line: Line,
    bytes: u64,
    at: Instant,
}

/// Wraps a body, so that its request is logged when the answer has been sent or given up.
pub fn logged(
    body: Body,
    journal: Arc<Journal>,
    line: Line,
    spent: Option<Spent>,
    at: Instant,
) -> Body {
    Body::new(Logged { body, journal, line: Line { spent, ..line }, bytes: 0, at })
}

impl HttpBody for Logged {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<hyper::body::Frame<Bytes>, axum::Error>>> {
        let polled = Pin::new(&mut self.body).poll_frame(context);
        if let Poll::Ready(Some(Ok(frame))) = &polled
            && let Some(data) = frame.data_ref()
        {
            self.bytes += data.len() as u64;
        }
        polled
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> hyper::body::SizeHint {
        self.body.size_hint()
    }
}

impl Drop for Logged {
    fn drop(&mut self) {
        self.line.bytes = Some(self.bytes);
        self.line.total_ms = Some(self.at.elapsed().as_secs_f64() * 1e3);
        self.line.time = now();
        self.journal.write(&self.line);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asked() -> Asked {
        Asked {
            request_id: RequestId::fresh(),
            address: Some("192.0.2.1".parse().unwrap()),
            method: Method::GET,
            route: "/v1/scenes/{id}/frame",
            target: target(&Uri::from_static("/v1/scenes/town/frame?secret=1")),
            at: Instant::now(),
        }
    }

    #[test]
    fn a_body_is_logged_with_its_bytes_when_it_ends() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("access.log");
        let journal = Arc::new(Journal::open(&path).unwrap());
        let spent = Some(Spent { queue_ms: 2.0, device_ms: None });
        let line = asked().answered(Some("eye"), 200);
        let body = logged(Body::from("12345"), journal.clone(), line, spent, Instant::now());
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        runtime.block_on(axum::body::to_bytes(body, 99)).unwrap();
        // Moved away, as logrotate does.
        std::fs::rename(&path, folder.path().join("old")).unwrap();
        journal.reopen();
        journal.write(&asked().answered(None, 401).event("refused"));
        let read = |name: &str| {
            let text = std::fs::read_to_string(folder.path().join(name)).unwrap();
            assert_eq!(text.lines().count(), 1, "{text}");
            serde_json::from_str::<serde_json::Value>(&text).unwrap()
        };
        let first = read("old");
        for (name, value) in [
            ("key", serde_json::json!("eye")),
            ("bytes", 5.into()),
            ("queue_ms", 2.0.into()),
            ("device_ms", serde_json::Value::Null),
            ("target", "town".into()),
            ("address", "192.0.2.1".into()),
        ] {
            assert_eq!(first[name], value, "{first}");
        }
        assert!(!first.to_string().contains("secret"));
        assert_eq!(read("access.log")["event"], "refused");
    }
}
