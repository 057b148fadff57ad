//! The access log, a line of JSON for each request, and the audit log, a line for each change and each refused key.
//!
//! A thread writes each log, so that neither a disk that hangs nor a reader that stalls holds up requests. When [`MOST_WAITING`]
//! lines wait for it, further lines are lost; they are counted, and a line says how many once lines can be written again. Each line is
//! appended with one write. SIGHUP opens the files anew, as logrotate needs it. Neither log holds keys, queries or bodies.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, OnceLock};
use std::task::{Context, Poll};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use axum::body::{Body, HttpBody};
use axum::http::{Method, Uri};
use bytes::Bytes;
use prometheus_client::metrics::counter::Counter;
use serde::Serialize;

use crate::engine::{Receipt, RequestId};

/// Name that stands for standard output.
const STDOUT: &str = "-";
/// Maximum number of lines that wait to be written; a line has less than a kilobyte.
const MOST_WAITING: usize = 8192;

/// A file, or standard output, to which a thread appends lines.
#[derive(Debug)]
pub struct Journal {
    orders: SyncSender<Order>,
    lost: Counter,
    /// Whether the file is to be opened anew before the next line.
    is_moved: Arc<AtomicBool>,
}

/// What the thread of a log does next.
enum Order {
    Write(Vec<u8>),
    /// Writes no request line: wakes the thread, so that it opens the file anew or reports lost lines.
    Look,
    /// Tells that all lines before are written.
    Tell(SyncSender<()>),
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

fn append(file: &mut Option<File>, line: &[u8]) -> io::Result<()> {
    match file {
        Some(file) => file.write_all(line),
        None => io::stdout().lock().write_all(line),
    }
}

fn line_of(value: &impl Serialize) -> Option<Vec<u8>> {
    let mut line = serde_json::to_vec(value).ok()?;
    line.push(b'\n');
    Some(line)
}

/// What the thread of a log works with.
struct Writer {
    path: PathBuf,
    file: Option<File>,
    orders: Receiver<Order>,
    lost: Counter,
    is_moved: Arc<AtomicBool>,
    /// Whether the last line may be there in part.
    is_torn: bool,
}

impl Writer {
    /// Carries out orders until the log is dropped.
    fn run(mut self) {
        let mut told = 0;
        while let Ok(order) = self.orders.recv() {
            if self.is_moved.swap(false, Ordering::Relaxed) {
                self.open_anew();
            }
            match order {
                Order::Write(line) if !self.append(&line) => {
                    self.lost.inc();
                    continue;
                }
                Order::Write(_) | Order::Look => {}
                // Whoever waits may have given up.
                Order::Tell(done) => drop(done.try_send(())),
            }
            let count = self.lost.get();
            let gap = Gap { time: now(), event: "lines-lost", count: count - told };
            if count > told && line_of(&gap).is_some_and(|line| self.append(&line)) {
                told = count;
            }
        }
    }

    fn open_anew(&mut self) {
        match open(&self.path) {
            Ok(file) => (self.file, self.is_torn) = (file, false),
            Err(error) => {
                tracing::error!(%error, path = %self.path.display(), "cannot reopen the log file");
            }
        }
    }

    /// Appends a line. Returns whether it is written.
    fn append(&mut self, line: &[u8]) -> bool {
        let begun = if self.is_torn { [b"\n", line].concat() } else { line.to_vec() };
        let written = append(&mut self.file, &begun);
        self.is_torn = written.is_err();
        if let Err(error) = written {
            tracing::error!(%error, path = %self.path.display(), "cannot write the log file");
        }
        !self.is_torn
    }
}

/// A line in place of those that were lost.
#[derive(Serialize)]
struct Gap {
    time: f64,
    event: &'static str,
    count: u64,
}

impl Journal {
    /// Opens a file for appending; `-` is standard output.
    ///
    /// # Errors
    /// The file cannot be opened, or the thread cannot be started.
    pub fn open(path: &Path) -> io::Result<Journal> {
        Journal::with_room(path, MOST_WAITING)
    }

    fn with_room(path: &Path, most_waiting: usize) -> io::Result<Journal> {
        let file = open(path)?;
        let (orders, received) = sync_channel(most_waiting);
        let lost = Counter::default();
        let is_moved = Arc::new(AtomicBool::new(false));
        let writer = Writer {
            path: path.to_owned(),
            file,
            orders: received,
            lost: lost.clone(),
            is_moved: is_moved.clone(),
            is_torn: false,
        };
        std::thread::Builder::new().name("log".to_owned()).spawn(move || writer.run())?;
        Ok(Journal { orders, lost, is_moved })
    }

    /// Has the file opened anew before the next line, by the log's thread. If that fails, the open file stays in use.
    pub fn reopen(&self) {
        self.is_moved.store(true, Ordering::Relaxed);
        // If lines wait, there is no need.
        let _ = self.orders.try_send(Order::Look);
    }

    /// Appends a value as one line of JSON, without waiting until it is written.
    pub fn write(&self, value: &impl Serialize) {
        let Some(line) = line_of(value) else { return };
        if self.orders.try_send(Order::Write(line)).is_err() {
            self.lost.inc();
        }
    }

    /// Waits until all lines are written, at most for `patience`. Returns whether they are.
    pub fn flush(&self, patience: Duration) -> bool {
        let (done, is_done) = sync_channel(1);
        let end = Instant::now() + patience;
        let mut order = Order::Tell(done);
        while let Err(std::sync::mpsc::TrySendError::Full(back)) = self.orders.try_send(order) {
            if Instant::now() >= end {
                return false;
            }
            order = back;
            std::thread::sleep(Duration::from_millis(5));
        }
        is_done.recv_timeout(end.saturating_duration_since(Instant::now())).is_ok()
    }

    /// Returns the counter of lines that were not written.
    pub fn lost(&self) -> Counter {
        self.lost.clone()
    }
}

/// Time that a frame spent, attached to answers that hold one.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Spent {
    queue_ms: f64,
    device_ms: Option<f64>,
    /// Names and nanoseconds of the frame's stages in their order. Logs tell the two times above only.
    #[serde(skip)]
    pub stages: Vec<(&'static str, u64)>,
    /// Names and nanoseconds of the passes on the GPU.
    #[serde(skip)]
    pub passes: Vec<(&'static str, u64)>,
    #[serde(skip)]
    pub ready_at: SystemTime,
}

impl Spent {
    /// The stage that has the passes.
    pub const DRAW: &str = "draw";

    /// Takes the times of a frame that is ready now.
    pub fn of(receipt: &Receipt) -> Spent {
        let ms = |ns: u64| ns as f64 / 1e6;
        let stages = vec![
            ("queue", receipt.queue_ns),
            ("record", receipt.record_ns),
            ("device wait", receipt.device_wait_ns),
            (Self::DRAW, receipt.gpu_ns.unwrap_or(0)),
            ("readback", receipt.readback_ns),
            ("encode wait", receipt.encode_wait_ns),
            ("encode", receipt.encode_ns),
        ];
        let passes = receipt.passes.iter().filter_map(|pass| Some((pass.name, pass.gpu_ns?)));
        Spent {
            queue_ms: ms(receipt.queue_ns),
            device_ms: receipt.gpu_share_ns().map(ms),
            stages,
            passes: passes.collect(),
            ready_at: SystemTime::now(),
        }
    }
}

/// One line of a log.
#[derive(Clone, Debug, Serialize)]
pub struct Line {
    /// Seconds since 1970.
    time: f64,
    pub request_id: String,
    /// Name of the key.
    pub key: Option<String>,
    /// Whether the key itself did not come, but an address that it has signed.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    signed: bool,
    pub address: Option<IpAddr>,
    pub method: String,
    pub route: &'static str,
    /// The scene or job of the address.
    pub target: Option<String>,
    /// `None` where the client went away before the answer.
    pub status: Option<u16>,
    /// What was refused or changed; in the audit log only.
    #[serde(skip_serializing_if = "Option::is_none")]
    event: Option<&'static str>,
    /// Bytes of the body that were sent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bytes: Option<u64>,
    #[serde(flatten)]
    pub spent: Option<Spent>,
    /// Milliseconds from the request's head to the last byte of its answer.
    #[serde(skip_serializing_if = "Option::is_none")]
    total_ms: Option<f64>,
}

/// What is known of a request before it is answered.
pub struct Asked {
    pub request_id: RequestId,
    /// Name of the key, once it is known.
    pub key: OnceLock<String>,
    /// Whether the request has passed the access rules and the rates.
    pub is_let_in: AtomicBool,
    /// Whether it came by an address that the key has signed.
    pub is_signed: AtomicBool,
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
    /// Builds the line of an answer, or of none. An answer that made a scene or a job names it.
    pub fn line(&self, status: Option<u16>, made: Option<String>) -> Line {
        Line {
            time: now(),
            request_id: self.request_id.to_string(),
            key: self.key.get().cloned(),
            signed: self.is_signed.load(Ordering::Relaxed),
            address: self.address,
            method: self.method.as_str().chars().take(16).collect(),
            route: self.route,
            target: made.or_else(|| self.target.clone()),
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

    /// Adds the time that the answer's frame spent, if it holds one.
    pub fn spent(self, spent: Option<Spent>) -> Line {
        Line { spent, ..self }
    }

    /// Adds the time since the request's head.
    pub fn after(self, at: Instant) -> Line {
        Line { total_ms: Some(at.elapsed().as_secs_f64() * 1e3), ..self }
    }
}

/// A line of the audit log about the server itself.
#[derive(Serialize)]
pub struct Notice {
    time: f64,
    event: &'static str,
    /// What was read again.
    subject: &'static str,
    /// Keys or limits that differ from the last reading.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    changes: Vec<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<String>,
}

impl Notice {
    /// A reload of `subject`, with what has changed or why it was refused.
    pub fn reload(subject: &'static str, read: Result<Vec<String>, String>) -> Notice {
        let (event, changes, error) = match read {
            Ok(changes) => ("reload", changes, None),
            Err(error) => ("reload-refused", Vec::new(), Some(error)),
        };
        Notice { time: now(), event, subject, changes, error }
    }
}

/// A body that completes its request's line when it ends or is dropped.
struct Logged<F: FnMut(&Line)> {
    body: Body,
    tell: F,
    line: Line,
    bytes: u64,
    at: Instant,
}

/// Wraps a body. Passes the request's line to `tell` when the answer has been sent or given up.
pub fn logged(
    body: Body,
    line: Line,
    at: Instant,
    tell: impl FnMut(&Line) + Send + Unpin + 'static,
) -> Body {
    Body::new(Logged { body, tell, line, bytes: 0, at })
}

impl<F: FnMut(&Line) + Unpin> HttpBody for Logged<F> {
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

impl<F: FnMut(&Line)> Drop for Logged<F> {
    fn drop(&mut self) {
        self.line.bytes = Some(self.bytes);
        self.line.total_ms = Some(self.at.elapsed().as_secs_f64() * 1e3);
        self.line.time = now();
        (self.tell)(&self.line);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asked(key: Option<&str>) -> Asked {
        Asked {
            request_id: RequestId::fresh(),
            is_let_in: AtomicBool::new(true),
            is_signed: AtomicBool::new(false),
            key: key.map_or_else(OnceLock::new, |key| OnceLock::from(key.to_owned())),
            address: Some("192.0.2.1".parse().unwrap()),
            method: Method::GET,
            route: "/v1/scenes/{id}/frame",
            target: target(&Uri::from_static("/v1/scenes/town/frame?secret=1")),
            at: Instant::now(),
        }
    }

    fn lines(path: &Path) -> Vec<serde_json::Value> {
        let text = std::fs::read_to_string(path).unwrap();
        text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
    }

    const PATIENCE: Duration = Duration::from_secs(60);

    #[test]
    fn a_body_is_logged_with_its_bytes_when_it_ends() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("access.log");
        let journal = Arc::new(Journal::open(&path).unwrap());
        let spent = Some(Spent {
            queue_ms: 2.0,
            device_ms: None,
            stages: Vec::new(),
            passes: Vec::new(),
            ready_at: UNIX_EPOCH,
        });
        let line = Line { spent, ..asked(Some("eye")).line(Some(200), None) };
        let log = journal.clone();
        let body = logged(Body::from("12345"), line, Instant::now(), move |line| log.write(line));
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        runtime.block_on(axum::body::to_bytes(body, 99)).unwrap();
        assert!(journal.flush(PATIENCE));
        // Moved away, as logrotate does.
        let old = folder.path().join("old");
        std::fs::rename(&path, &old).unwrap();
        journal.reopen();
        journal.write(&asked(None).line(Some(401), Some("made".to_owned())).event("refused"));
        assert!(journal.flush(PATIENCE));
        let (before, after) = (lines(&old), lines(&path));
        assert_eq!((before.len(), after.len()), (1, 1), "{before:?} {after:?}");
        let first = &before[0];
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
        assert_eq!((&after[0]["event"], &after[0]["target"]), (&"refused".into(), &"made".into()));
    }

    /// A pipe whose reader reads nothing stands for a disk that hangs.
    #[cfg(unix)]
    #[test]
    fn a_log_that_stalls_loses_lines_and_says_how_many() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pipe");
        let made = std::process::Command::new("mkfifo").arg(&path).status().unwrap();
        assert!(made.success());
        let mut reader = File::options().read(true).write(true).open(&path).unwrap();
        let journal = Journal::with_room(&path, 4).unwrap();
        let text = "x".repeat(1000);
        let mut sent = 0;
        while journal.flush(Duration::from_millis(20)) {
            journal.write(&text);
            sent += 1;
            assert!(sent < 10_000, "a pipe has no such room");
        }
        // More than wait.
        for _ in 0..9 {
            journal.write(&text);
            sent += 1;
        }
        let lost = journal.lost().get();
        assert!(lost > 0);
        let read = std::thread::spawn(move || {
            let (mut found, mut told) = (0, 0);
            let lines = std::io::BufRead::lines(std::io::BufReader::new(&mut reader));
            for line in lines {
                let line: serde_json::Value = serde_json::from_str(&line.unwrap()).unwrap();
                match line["count"].as_u64() {
                    Some(count) => told += count,
                    None => found += 1,
                }
                if found + told == sent {
                    break;
                }
            }
            (found, told)
        });
        let (found, told) = read.join().unwrap();
        assert_eq!((found + told, told), (sent, lost));
    }
}
