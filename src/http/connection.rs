//! Connections: how many there may be, and for how long each may stall.
//!
//! A connection must send the head of a request within `read_timeout`; an idle connection is closed after the same time. A connection that accepts fewer
//! than [`PART`] bytes in [`STALLED`] is dropped, and so is one whose client takes no more of one of its [answers](Answers). A connection over HTTP/2
//! ends after five minutes without a request, whatever else its client sends. A connection beyond `max_connections` gets a
//! short refusal and is closed. A few of these at a time are read first, so that health probes are answered. The same holds for a
//! connection beyond those that one address may have. With TLS, such connections are closed without an answer, since a handshake
//! costs more than the answer is worth.

use std::future::Future;
use std::net::IpAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use axum::response::{IntoResponse, Response};
use axum_server::accept::Accept;
use bytes::{Buf, Bytes};
use hyper::header::CONTENT_LENGTH;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, ReadBuf};
use tokio::net::TcpStream;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::{Instant, Sleep};
use tokio_rustls::server::TlsStream;
use tokio_util::either::Either;

use super::answers::{Answers, PART, Patience, STALLED, Watched};
use super::problem::{Kind, Problem};
use super::{App, address, refusal, service};

/// The first bytes of a connection over HTTP/2. The shortest HTTP/1 request is nearly as long.
const PREFACE: &[u8; 24] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";
/// Limits of reading on after a refused head, in time and bytes: closing at once would reset the connection, and the client might
/// never see the answer.
const LINGER: Duration = Duration::from_secs(1);
const LINGER_BYTES: usize = 1 << 20;

/// A connection's bytes, with or without TLS.
type Socket = Either<TcpStream, Box<TlsStream<TcpStream>>>;

/// Accepts connections up to the limit.
#[derive(Clone)]
pub struct Doorkeeper {
    pub app: Arc<App>,
    pub places: Arc<Semaphore>,
    /// Permits for connections beyond the limit that may be health probes.
    pub probes: Arc<Semaphore>,
    pub read_timeout: Duration,
    /// Whether this is the main listener: its connections speak TLS if the server has a certificate, and each address may have so many.
    pub is_main: bool,
}

/// Longest time for a TLS handshake.
const HANDSHAKE: Duration = Duration::from_secs(10);

/// Limits of connections beyond `max_connections` that are read: their number, bytes and time.
pub const PROBES: usize = 16;
const PROBE_BYTES: usize = 2048;
const PROBE_READ: Duration = Duration::from_millis(300);

impl<S: Send + 'static> Accept<TcpStream, S> for Doorkeeper {
    type Stream = Guarded;
    type Service = Watched<S>;
    type Future = Pin<Box<dyn Future<Output = std::io::Result<(Guarded, Watched<S>)>> + Send>>;

    fn accept(&self, mut stream: TcpStream, service: S) -> Self::Future {
        let place = self.places.clone().try_acquire_owned().ok();
        let place = place.and_then(|place| Place::take(&self.app, &stream, place, self.is_main));
        let Doorkeeper { app, probes, read_timeout, is_main, .. } = self.clone();
        let tls = app.rules.read().tls.clone().filter(|_| is_main);
        Box::pin(async move {
            let Some(place) = place else {
                if tls.is_some() {
                    return Err(std::io::Error::other("no place left"));
                }
                let answer = async {
                    let probe = probes.try_acquire_owned().ok();
                    let answer = match probe {
                        Some(_) => {
                            let read = probed(&app, &mut stream);
                            tokio::time::timeout(PROBE_READ, read).await.ok().flatten()
                        }
                        None => None,
                    };
                    turn_away(&mut stream, answer).await
                };
                let _ = tokio::time::timeout(Duration::from_secs(1), answer).await;
                return Err(std::io::Error::other("no place left"));
            };
            stream.set_nodelay(true)?;
            let socket = match tls {
                None => Either::Left(stream),
                Some(tls) => {
                    let handshake = tokio_rustls::TlsAcceptor::from(tls).accept(stream);
                    let stream =
                        tokio::time::timeout(read_timeout.min(HANDSHAKE), handshake).await??;
                    Either::Right(Box::new(stream))
                }
            };
            let answers = Answers::default();
            let service = answers.of(service);
            Ok((Guarded::new(socket, place, read_timeout, answers), service))
        })
    }
}

/// A connection's place in all, and among those of its address; dropping it frees both.
struct Place {
    app: Arc<App>,
    /// `None` for trusted proxies, which connect for many clients.
    address: Option<IpAddr>,
    _place: OwnedSemaphorePermit,
}

impl Place {
    /// Returns `None` when the address has as many connections as it may have.
    fn take(
        app: &Arc<App>,
        stream: &TcpStream,
        place: OwnedSemaphorePermit,
        counts_addresses: bool,
    ) -> Option<Place> {
        let peer = stream.peer_addr().ok().map(|peer| peer.ip());
        let rules = app.rules();
        let proxies = &rules.bounds.trusted_proxies;
        let address = peer
            .filter(|peer| counts_addresses && !address::is_trusted(*peer, proxies))
            .map(address::network);
        let most = rules.bounds.max_connections_per_address.unwrap_or(usize::MAX);
        if address.is_some_and(|address| !app.connections.take(address, usize::MAX, most)) {
            return None;
        }
        Some(Place { app: app.clone(), address, _place: place })
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        if let Some(address) = self.address {
            self.app.connections.give_back(address);
        }
    }
}

/// Returns the answer to a health probe, if the connection begins with one.
async fn probed(app: &Arc<App>, stream: &mut TcpStream) -> Option<Response> {
    let mut head = Vec::new();
    // Read the whole head: a connection closed with unread bytes is reset, and the answer may be lost.
    while !head.windows(4).any(|end| end == b"\r\n\r\n") {
        if head.len() >= PROBE_BYTES || stream.read_buf(&mut head).await.ok()? == 0 {
            return None;
        }
    }
    let state = axum::extract::State(app.clone());
    Some(if head.starts_with(b"GET /healthz ") {
        service::healthz(state).await.into_response()
    } else if head.starts_with(b"GET /readyz ") {
        service::readyz(state).await.into_response()
    } else {
        return None;
    })
}

/// Sends an answer, by default that there is no place, and closes.
async fn turn_away(stream: &mut TcpStream, answer: Option<Response>) -> std::io::Result<()> {
    let answer = answer.unwrap_or_else(|| {
        let problem = Problem::new(Kind::Busy, "too many connections");
        problem.retry_after(Duration::from_secs(1)).into_response()
    });
    let (head, body) = answer.into_parts();
    let body = axum::body::to_bytes(body, PROBE_BYTES).await.unwrap_or_default();
    let mut answer = format!("HTTP/1.1 {}\r\n", head.status).into_bytes();
    for (name, value) in head.headers.iter().filter(|(name, _)| *name != CONTENT_LENGTH) {
        answer.extend([name.as_str().as_bytes(), b": ", value.as_bytes(), b"\r\n"].concat());
    }
    let rest = format!("content-length: {}\r\nconnection: close\r\n\r\n", body.len());
    answer.extend(rest.as_bytes());
    answer.extend(body);
    stream.write_all(&answer).await?;
    stream.shutdown().await
}

/// A connection that holds its place, with limits that the HTTP library lacks: time for the first bytes, which the library reads before it knows their
/// protocol, time for writes, and time for a client to take a part of an answer.
pub struct Guarded {
    stream: Socket,
    _place: Place,
    beginning: Beginning,
    preface_until: Pin<Box<Sleep>>,
    write_until: Pin<Box<Sleep>>,
    is_write_pending: bool,
    /// Bytes written since the time limit of writes began.
    written: usize,
    patience: Patience,
    /// Answer that replaces one of the HTTP library.
    instead: Option<Instead>,
}

/// The first bytes of a connection, which tell its protocol.
#[derive(Default)]
struct Beginning {
    bytes: usize,
    is_http1: bool,
}

impl Beginning {
    fn note(&mut self, bytes: &[u8]) {
        let expected = &PREFACE[self.bytes..];
        let new = &bytes[..bytes.len().min(expected.len())];
        self.is_http1 |= !expected.starts_with(new);
        self.bytes += new.len();
    }

    fn is_whole(&self) -> bool {
        self.bytes == PREFACE.len()
    }

    fn is_http2(&self) -> bool {
        self.is_whole() && !self.is_http1
    }
}

/// An answer in transit, and the bytes read after it.
struct Instead {
    rest: Bytes,
    unread: usize,
    until: Pin<Box<Sleep>>,
}

impl Guarded {
    fn new(stream: Socket, place: Place, read_timeout: Duration, answers: Answers) -> Self {
        Self {
            stream,
            _place: place,
            beginning: Beginning::default(),
            preface_until: Box::pin(tokio::time::sleep(read_timeout)),
            write_until: Box::pin(tokio::time::sleep(STALLED)),
            is_write_pending: false,
            written: 0,
            patience: Patience::new(answers),
            instead: None,
        }
    }

    /// Sends a whole answer in place of one of the HTTP library; `None` where these bytes are not such an answer.
    fn poll_instead(
        &mut self,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Option<Poll<std::io::Result<usize>>> {
        if self.instead.is_none() {
            let rest = refusal::instead_of(bytes)?;
            let until = Box::pin(tokio::time::sleep(LINGER));
            self.instead = Some(Instead { rest, unread: LINGER_BYTES, until });
        }
        let mut instead = self.instead.take()?;
        let result = self.poll_rest(context, &mut instead).map_ok(|()| bytes.len());
        if result.is_pending() {
            self.instead = Some(instead);
        }
        Some(result)
    }

    fn poll_rest(
        &mut self,
        context: &mut Context<'_>,
        instead: &mut Instead,
    ) -> Poll<std::io::Result<()>> {
        while !instead.rest.is_empty() {
            let written = Pin::new(&mut self.stream).poll_write(context, &instead.rest);
            let written = std::task::ready!(self.bounded(context, written))?;
            instead.rest.advance(written);
        }
        std::task::ready!(Pin::new(&mut self.stream).poll_shutdown(context))?;
        while instead.unread > 0 && instead.until.as_mut().poll(context).is_pending() {
            let mut space = [0; 4096];
            let mut buffer = ReadBuf::new(&mut space);
            match Pin::new(&mut self.stream).poll_read(context, &mut buffer) {
                Poll::Pending => return Poll::Pending,
                Poll::Ready(Ok(())) if !buffer.filled().is_empty() => {
                    instead.unread = instead.unread.saturating_sub(buffer.filled().len());
                }
                Poll::Ready(_) => break,
            }
        }
        Poll::Ready(Ok(()))
    }

    /// As [`Guarded::bounded`], for a write of some bytes. Only [`PART`] of them end the wait that the time limit is for.
    fn bounded_write(
        &mut self,
        context: &mut Context<'_>,
        result: Poll<std::io::Result<usize>>,
    ) -> Poll<std::io::Result<usize>> {
        if self.patience.is_over(context, self.beginning.is_http2()) {
            return Poll::Ready(Err(std::io::ErrorKind::TimedOut.into()));
        }
        if let Poll::Ready(Ok(bytes)) = result
            && self.is_write_pending
        {
            self.written += bytes;
            if self.written < PART {
                return result;
            }
        }
        self.bounded(context, result)
    }

    /// Turns a write that takes too long into an error.
    fn bounded<T>(
        &mut self,
        context: &mut Context<'_>,
        result: Poll<std::io::Result<T>>,
    ) -> Poll<std::io::Result<T>> {
        if result.is_ready() {
            (self.is_write_pending, self.written) = (false, 0);
            return result;
        }
        if !self.is_write_pending {
            self.is_write_pending = true;
            self.write_until.as_mut().reset(Instant::now() + STALLED);
        }
        match self.write_until.as_mut().poll(context) {
            Poll::Ready(()) => Poll::Ready(Err(std::io::ErrorKind::TimedOut.into())),
            Poll::Pending => Poll::Pending,
        }
    }
}

impl AsyncRead for Guarded {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<std::io::Result<()>> {
        let is_http2 = self.beginning.is_http2();
        if self.patience.is_over(context, is_http2) {
            return Poll::Ready(Err(std::io::ErrorKind::TimedOut.into()));
        }
        let before = buffer.filled().len();
        match Pin::new(&mut self.stream).poll_read(context, buffer) {
            Poll::Ready(result) => {
                self.beginning.note(&buffer.filled()[before..]);
                Poll::Ready(result)
            }
            Poll::Pending if !self.beginning.is_whole() => {
                match self.preface_until.as_mut().poll(context) {
                    Poll::Ready(()) => Poll::Ready(Err(std::io::ErrorKind::TimedOut.into())),
                    Poll::Pending => Poll::Pending,
                }
            }
            Poll::Pending => Poll::Pending,
        }
    }
}

impl AsyncWrite for Guarded {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<std::io::Result<usize>> {
        if let Some(result) = self.poll_instead(context, bytes) {
            return result;
        }
        let result = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.bounded_write(context, result)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        slices: &[std::io::IoSlice<'_>],
    ) -> Poll<std::io::Result<usize>> {
        let mut filled = slices.iter().filter(|slice| !slice.is_empty());
        if let (Some(only), None) = (filled.next(), filled.next())
            && let Some(result) = self.poll_instead(context, only)
        {
            return result;
        }
        let result = Pin::new(&mut self.stream).poll_write_vectored(context, slices);
        self.bounded_write(context, result)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<std::io::Result<()>> {
        let result = Pin::new(&mut self.stream).poll_flush(context);
        self.bounded(context, result)
    }

    fn poll_shutdown(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<std::io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_bytes_tell_the_protocol() {
        // Bytes may come one by one, and others follow them.
        for pieces in [1, 5, 23, 24, 64] {
            let sent = [PREFACE.as_slice(), &[0; 40]].concat();
            let mut beginning = Beginning::default();
            for piece in sent.chunks(pieces) {
                beginning.note(piece);
            }
            assert!(beginning.is_http2(), "{pieces}");
            let mut beginning = Beginning::default();
            for piece in b"PROPFIND / HTTP/1.1\r\nhost: a\r\n\r\n".chunks(pieces) {
                beginning.note(piece);
            }
            assert!(beginning.is_whole() && !beginning.is_http2(), "{pieces}");
        }
        let mut short = Beginning::default();
        short.note(&PREFACE[..23]);
        assert!(!short.is_whole() && !short.is_http2());
    }
}
