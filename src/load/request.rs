//! A client that sends a GET for each frame, over HTTP/1.1 connections that are kept alive.
//!
//! A request takes the connection that was used last, or opens another if none is idle. There are therefore as many connections
//! as requests were ever in flight at once. A kept connection that turns out to be closed is replaced, because servers may close
//! idle connections at any time.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use anyhow::{Context, bail};
use bytes::Bytes;
use http_body_util::{BodyExt, Empty};
use hyper::client::conn::http1::{SendRequest, handshake};
use hyper::header::{AUTHORIZATION, HOST, HeaderMap, HeaderValue, RETRY_AFTER};
use hyper::{Request, Response, body::Incoming};
use hyper_util::rt::TokioIo;
use parking_lot::Mutex;
use tokio::net::TcpStream;

use super::drive::Client;
use super::poses::Poses;
use super::tally::{Answer, Outcome};
use super::wire::{ReceiptAnswer, Target, complaint, resource_path};

const RECEIPT: &str = "pointillist-receipt";
/// Bytes kept of a body that is neither frame nor refusal, to say what went wrong.
const COMPLAINT_BYTES: usize = 4096;

type Sender = SendRequest<Empty<Bytes>>;

/// A pool of connections to one server.
pub struct Connections {
    address: SocketAddr,
    authority: String,
    headers: HeaderMap,
    idle: Mutex<Vec<Sender>>,
    opened: AtomicU64,
}

enum Fault {
    NotConnected(String),
    BrokenOff(String),
}

impl From<Fault> for Outcome {
    fn from(fault: Fault) -> Self {
        match fault {
            Fault::NotConnected(why) => Outcome::NotConnected(why),
            Fault::BrokenOff(why) => Outcome::BrokenOff(why),
        }
    }
}

/// The message of an error and of all its sources.
fn words(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut source = error.source();
    while let Some(error) = source {
        text = format!("{text}: {error}");
        source = error.source();
    }
    text
}

impl Connections {
    /// Resolves the server's address, once for all connections. `key` is an API key.
    ///
    /// # Errors
    /// Fails for a host that is unknown or does not answer, and for a key that no header can carry.
    pub async fn new(target: &Target, key: Option<&str>) -> anyhow::Result<Self> {
        let found: Vec<SocketAddr> = tokio::net::lookup_host((target.host.as_str(), target.port))
            .await
            .with_context(|| format!("{}: no such host", target.host))?
            .collect();
        let mut headers = HeaderMap::new();
        headers.insert(HOST, HeaderValue::from_str(&target.authority())?);
        if let Some(key) = key {
            let mut value = HeaderValue::from_str(&format!("Bearer {key}"))
                .context("--key: only letters, digits and signs of ASCII")?;
            value.set_sensitive(true);
            headers.insert(AUTHORIZATION, value);
        }
        let mut refusal = String::from("it has no address");
        for address in found {
            let opened = tokio::time::timeout(Duration::from_secs(5), TcpStream::connect(address));
            match opened.await {
                Ok(Ok(_)) => {
                    let (idle, opened) = (Mutex::new(Vec::new()), AtomicU64::new(0));
                    let authority = target.authority();
                    return Ok(Self { address, authority, headers, idle, opened });
                }
                Ok(Err(error)) => refusal = error.to_string(),
                Err(_) => refusal = "no answer for 5 s".to_owned(),
            }
        }
        bail!("cannot connect to {}: {refusal}", target.authority())
    }

    /// Connections opened so far.
    pub fn opened(&self) -> u64 {
        self.opened.load(Ordering::Relaxed)
    }

    /// The value of the header `Host`.
    pub fn authority(&self) -> &str {
        &self.authority
    }

    /// The headers of every request.
    pub fn headers(&self) -> HeaderMap {
        self.headers.clone()
    }

    /// Opens a new connection to the server.
    ///
    /// # Errors
    /// Fails with the system's message.
    pub async fn connect(&self) -> Result<TcpStream, String> {
        let stream = TcpStream::connect(self.address).await.map_err(|error| words(&error))?;
        stream.set_nodelay(true).map_err(|error| words(&error))?;
        Ok(stream)
    }

    async fn open(&self) -> Result<Sender, Fault> {
        let fault = |error: &dyn std::error::Error| Fault::NotConnected(words(error));
        let stream = self.connect().await.map_err(Fault::NotConnected)?;
        let (sender, connection) =
            handshake(TokioIo::new(stream)).await.map_err(|error| fault(&error))?;
        self.opened.fetch_add(1, Ordering::Relaxed);
        // The task ends with the connection. Errors of the connection reach the request that it carries.
        tokio::spawn(connection);
        Ok(sender)
    }

    /// The idle connection that was used last, if it is still open.
    async fn kept(&self) -> Option<Sender> {
        loop {
            let mut sender = self.idle.lock().pop()?;
            if sender.ready().await.is_ok() {
                return Some(sender);
            }
        }
    }

    fn request(&self, path: &str) -> Result<Request<Empty<Bytes>>, Fault> {
        let mut request = Request::get(path)
            .body(Empty::new())
            .map_err(|error| Fault::BrokenOff(format!("{path}: {error}")))?;
        request.headers_mut().clone_from(&self.headers);
        Ok(request)
    }

    /// Sends a GET. The caller reads the answer's body and returns the connection to the pool.
    async fn send(&self, path: &str) -> Result<(Response<Incoming>, Sender), Fault> {
        while let Some(mut sender) = self.kept().await {
            // The server may have closed the connection just now. A GET can be sent again.
            if let Ok(response) = sender.send_request(self.request(path)?).await {
                return Ok((response, sender));
            }
        }
        let mut sender = self.open().await?;
        match sender.send_request(self.request(path)?).await {
            Ok(response) => Ok((response, sender)),
            Err(error) => Err(Fault::BrokenOff(words(&error))),
        }
    }

    /// Sends a GET and reads the answer to its end. Keeps as many bytes of the body as `keep` says for the status.
    async fn get(&self, path: &str, keep: impl Fn(u16) -> usize) -> Result<Read, Fault> {
        let (response, sender) = self.send(path).await?;
        let (head, mut body) = response.into_parts();
        let status = head.status.as_u16();
        let keep = keep(status);
        let mut read = Read { status, headers: head.headers, bytes: 0, body: Vec::new() };
        while let Some(frame) = body.frame().await {
            let frame = frame.map_err(|error| Fault::BrokenOff(words(&error)))?;
            let Some(data) = frame.data_ref() else { continue };
            read.bytes += data.len() as u64;
            let room = keep.saturating_sub(read.body.len()).min(data.len());
            read.body.extend_from_slice(&data[..room]);
        }
        if !sender.is_closed() {
            self.idle.lock().push(sender);
        }
        Ok(read)
    }

    /// Reads a JSON document from the server.
    ///
    /// # Errors
    /// Fails without an answer, for any status but 200, and for unexpected JSON.
    pub async fn json<T: serde::de::DeserializeOwned>(&self, path: &str) -> anyhow::Result<T> {
        let read = match self.get(path, |_| 64 << 20).await {
            Ok(read) => read,
            Err(Fault::NotConnected(why) | Fault::BrokenOff(why)) => bail!("GET {path}: {why}"),
        };
        if read.status != 200 {
            bail!("GET {path}: {}", complaint(read.status, &read.body));
        }
        serde_json::from_slice(&read.body)
            .with_context(|| format!("GET {path}: not the answer of a Pointillist server"))
    }
}

/// An answer, read to its end.
struct Read {
    status: u16,
    headers: HeaderMap,
    bytes: u64,
    /// The part of the body that was kept.
    body: Vec<u8>,
}

impl From<Read> for Answer {
    fn from(read: Read) -> Self {
        let receipt: Option<ReceiptAnswer> = read
            .headers
            .get(RECEIPT)
            .and_then(|value| serde_json::from_slice(value.as_bytes()).ok());
        Answer {
            status: read.status,
            bytes: read.bytes,
            has_retry_after: read.headers.contains_key(RETRY_AFTER),
            receipt,
            complaint: (!read.body.is_empty()).then(|| complaint(read.status, &read.body)),
        }
    }
}

/// Asks for each frame with a GET.
pub struct RequestClient {
    pub connections: Arc<Connections>,
    /// Prefix of the server's paths.
    pub prefix: String,
    pub scene: String,
    pub poses: Poses,
    /// Query parameters beside the pose.
    pub parameters: Vec<(String, String)>,
}

impl Client for RequestClient {
    async fn frame(&self, number: u64) -> Outcome {
        let pose = self.poses.pose(number);
        let path = resource_path(&self.prefix, &self.scene, "frame", &pose, &self.parameters);
        let keep = |status| if status < 400 { 0 } else { COMPLAINT_BYTES };
        match self.connections.get(&path, keep).await {
            Ok(read) => Outcome::Answered(read.into()),
            Err(fault) => fault.into(),
        }
    }
}
