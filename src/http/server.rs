//! Listener, limits on connections, start and stop.
//!
//! ```text
//! listen ─► Starting ──scenes loaded──► Serving ──SIGTERM──► Leaving ──`drain_delay`──► Draining ─► exit
//!           /healthz 200                /readyz 200          /readyz 503                no new connections;
//!           /readyz  503                                     all is served as before    answers in flight end
//!                                                                                       within `drain`, streams are
//!                                                                                       closed with 1001, jobs pause
//! SIGINT, and SIGHUP where the terminal that it was started from has gone: Draining at once
//! a second SIGTERM, SIGINT or such SIGHUP: exit at once
//! SIGHUP without a terminal: API keys are read again
//! a render thread that panicked: /healthz and /readyz 503, and the watchdog is no longer patted
//! ```
//!
//! A connection must send the head of a request within `read_timeout`; an idle connection is closed after the same time, and a
//! connection that accepts no bytes of its answer for [`STALLED_WRITE`] is dropped. A connection beyond `max_connections` gets a
//! short refusal and is closed. A few of these at a time are read first, so that health probes are answered.

use std::future::Future;
use std::net::{SocketAddr, TcpListener};
use std::path::PathBuf;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use axum::response::{IntoResponse, Response};
use axum_server::Handle;
use axum_server::accept::Accept;
use bytes::{Buf, Bytes};
use hyper::header::CONTENT_LENGTH;
use hyper_util::rt::TokioTimer;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, ReadBuf};
use tokio::net::TcpStream;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::{Instant, Sleep};

use super::problem::{Kind, Problem};
use super::registry::Reservation;
use super::upload::store::Earlier;
use super::{App, Phase, refusal, router, service, upload};
use crate::engine::{Engine, Readiness, Source};

/// Time after which a client that reads nothing of its answer is dropped.
const STALLED_WRITE: Duration = Duration::from_secs(60);
/// Requests in flight on one HTTP/2 connection.
const MAX_STREAMS: u32 = 128;
/// Length of an HTTP/2 preface, which is also nearly that of the shortest HTTP/1 request.
const PREFACE_BYTES: u64 = 24;
/// Limits of reading on after a refused head, in time and bytes: closing at once would reset the connection, and the client might
/// never see the answer.
const LINGER: Duration = Duration::from_secs(1);
const LINGER_BYTES: usize = 1 << 20;

/// Scenes to load at the start.
#[derive(Clone, Debug, Default)]
pub struct StartScenes {
    /// Id and file.
    pub scenes: Vec<(String, PathBuf)>,
    /// Whether the scenes were named explicitly, so that it is a failure if none of them loads.
    pub required: bool,
}

/// Serves until a signal to stop. Calls `listening` as soon as requests are answered, and `ready` once scenes are loaded.
///
/// # Errors
/// A failed listener, or the failure of every scene that was asked for by name.
pub async fn serve(
    app: Arc<App>,
    listener: TcpListener,
    start: StartScenes,
    listening: impl FnOnce(SocketAddr),
    ready: impl FnOnce(&Engine, SocketAddr),
) -> anyhow::Result<()> {
    let address = listener.local_addr()?;
    listener.set_nonblocking(true)?;
    let handle = Handle::new();
    let mut signals = Signals::new()?;
    // Reserve all ids before the first request is answered, so that no upload takes the id of a scene.
    let (asked, required) = (start.scenes.len(), start.required);
    let reserved = reserve_scenes(&app, start).await?;
    let mut server = tokio::spawn(run(app.clone(), listener, handle.clone()));
    if let Ok(jobs) = &app.jobs {
        // Jobs whose scenes are not loaded yet wait for them.
        jobs.start()?;
    }
    listening(address);

    let loading = load_scenes(&app, reserved, asked, required);
    tokio::select! {
        loaded = loading => {
            loaded?;
            app.set_phase(Phase::Serving);
            ready(&app.engine, address);
            notify(&[sd_notify::NotifyState::Ready]);
            let watchdog = tokio::spawn(watchdog(app.clone()));
            let signal = tokio::select! {
                signal = signals.stop(&app) => signal,
                ended = &mut server => return Ok(ended??),
            };
            watchdog.abort();
            notify(&[sd_notify::NotifyState::Stopping]);
            let delay = app.settings.drain_delay;
            if signal == SIGTERM && !delay.is_zero() {
                tracing::info!(signal, seconds = delay.as_secs(), "not ready any more; draining soon");
                app.set_phase(Phase::Leaving);
                tokio::select! {
                    () = tokio::time::sleep(delay) => {}
                    signal = signals.stop(&app) => {
                        tracing::warn!(signal, "stopping at once");
                        upload::stand_down(&app);
                        return Ok(());
                    }
                    ended = &mut server => return Ok(ended??),
                }
            }
            tracing::info!(signal, "draining");
        }
        signal = signals.stop(&app) => {
            tracing::info!(signal, "stopped while loading");
            notify(&[sd_notify::NotifyState::Stopping]);
        }
        ended = &mut server => return Ok(ended??),
    }

    app.set_phase(Phase::Draining);
    handle.graceful_shutdown(Some(app.settings.drain));
    let drained = async {
        let _ = (&mut server).await;
        app.streams.closed().await;
        let (engine, jobs) = (app.engine.clone(), app.jobs.clone());
        let _ = tokio::task::spawn_blocking(move || {
            // Stop jobs before the engine, because they record their progress.
            if let Ok(jobs) = &jobs {
                jobs.wait();
            }
            engine.drain();
        })
        .await;
    };
    // The drain time of connections, and as much again for the engine's last jobs.
    let patience = app.settings.drain * 2 + Duration::from_secs(1);
    tokio::select! {
        done = tokio::time::timeout(patience, drained) => match done {
            Ok(()) => tracing::info!("drained"),
            Err(_) => tracing::warn!("stopping with work in flight"),
        },
        signal = signals.stop(&app) => tracing::warn!(signal, "stopping at once"),
    }
    upload::stand_down(&app);
    Ok(())
}

async fn run(
    app: Arc<App>,
    listener: TcpListener,
    handle: Handle<SocketAddr>,
) -> std::io::Result<()> {
    let settings = &app.settings;
    let read_timeout = settings.read_timeout;
    let acceptor = Doorkeeper {
        app: app.clone(),
        places: Arc::new(Semaphore::new(settings.max_connections)),
        probes: Arc::new(Semaphore::new(PROBES)),
        read_timeout,
    };
    let mut server = axum_server::from_tcp(listener)?.handle(handle).acceptor(acceptor);
    let builder = server.http_builder();
    builder
        .http1()
        .timer(TokioTimer::new())
        .header_read_timeout(read_timeout)
        .max_buf_size(refusal::MAX_HEAD_BYTES)
        .max_headers(refusal::MAX_HEADERS)
        .keep_alive(true);
    builder
        .http2()
        .timer(TokioTimer::new())
        .max_concurrent_streams(MAX_STREAMS)
        .keep_alive_interval(read_timeout)
        .keep_alive_timeout(read_timeout);
    server.serve(router(app).into_make_service_with_connect_info::<SocketAddr>()).await
}

/// A scene to load at the start.
struct Reserved {
    reservation: Result<Reservation, Problem>,
    id: String,
    source: Option<Source>,
    /// Why a kept upload is not loaded.
    refusal: Option<Problem>,
}

/// Finds kept uploads and reserves the ids of all scenes, first of those asked for by name.
async fn reserve_scenes(app: &Arc<App>, start: StartScenes) -> anyhow::Result<Vec<Reserved>> {
    // Without uploads the folder may belong to another daemon, which alone cleans it up.
    let root = app.settings.uploads.then(|| app.settings.root.clone());
    let earlier = tokio::task::spawn_blocking(move || {
        root.map_or_else(Vec::new, |root| upload::store::earlier(&root))
    })
    .await?;
    let at = |(id, file)| (id, Some(Source::at(file)), None);
    let mut scenes: Vec<_> = start.scenes.into_iter().map(at).collect();
    for Earlier { id, source, key, bytes, refusal } in earlier {
        app.uploads.keep(&id, app.uploads.known(key.as_deref(), bytes));
        scenes.push((id, source, refusal));
    }
    let reserve = |(id, source, refusal): (String, _, _)| {
        let is_loaded = |id: &str| app.engine.scene(id).is_ok();
        let reservation = app.registry.reserve(&id, app.engine.admission(), is_loaded);
        Reserved { reservation, id, source, refusal }
    };
    Ok(scenes.into_iter().map(reserve).collect())
}

/// Loads scenes one after the other, because each may need most of the memory. The first `asked` scenes were asked for by name;
/// if `required`, at least one of them must load.
async fn load_scenes(
    app: &Arc<App>,
    reserved: Vec<Reserved>,
    asked: usize,
    required: bool,
) -> anyhow::Result<()> {
    let mut failed = 0;
    for (index, Reserved { reservation, id, source, refusal }) in reserved.into_iter().enumerate() {
        let shown = source.as_ref().map(|source| source.path.display().to_string());
        let result = match (reservation, source, refusal) {
            (Ok(reservation), Some(source), None) => {
                upload::load(app.clone(), reservation, source, upload::Origin::Kept).await
            }
            (Ok(reservation), source, refusal) => {
                let problem = refusal.unwrap_or_else(|| Problem::internal("nothing to load"));
                reservation.fail(problem.clone(), source);
                Err(problem)
            }
            (Err(problem), ..) => Err(problem),
        };
        match result {
            // The engine has logged the scene.
            Ok(_) => {}
            Err(problem) => {
                failed += usize::from(index < asked);
                tracing::error!(id, file = shown, problem = problem.detail, "scene not loaded");
            }
        }
    }
    anyhow::ensure!(
        !(required && asked > 0 && failed == asked),
        "none of the scenes asked for could be loaded; the log says why"
    );
    Ok(())
}

const SIGTERM: &str = "SIGTERM";

/// Waits for SIGTERM or SIGINT, for commands other than the daemon. Needs a runtime. From this call on, these signals no longer
/// end the process.
pub fn stop_signal() -> std::io::Result<impl Future<Output = &'static str>> {
    #[cfg(unix)]
    {
        use tokio::signal::unix::{SignalKind, signal};
        let mut terminate = signal(SignalKind::terminate())?;
        let mut interrupt = signal(SignalKind::interrupt())?;
        Ok(async move {
            tokio::select! {
                _ = terminate.recv() => SIGTERM,
                _ = interrupt.recv() => "SIGINT",
            }
        })
    }
    #[cfg(not(unix))]
    Ok(async {
        let _ = tokio::signal::ctrl_c().await;
        "interrupt"
    })
}

/// Signals to the daemon; once this exists, they no longer end the process by themselves.
#[cfg(unix)]
struct Signals {
    terminate: tokio::signal::unix::Signal,
    interrupt: tokio::signal::unix::Signal,
    hangup: tokio::signal::unix::Signal,
    /// Whether standard error was a terminal at the start, so that a hangup means that the terminal has gone.
    has_terminal: bool,
}

#[cfg(unix)]
impl Signals {
    /// Begins to listen for signals; needs a runtime.
    fn new() -> std::io::Result<Signals> {
        use std::io::IsTerminal;
        use tokio::signal::unix::{SignalKind, signal};
        Ok(Signals {
            terminate: signal(SignalKind::terminate())?,
            interrupt: signal(SignalKind::interrupt())?,
            hangup: signal(SignalKind::hangup())?,
            has_terminal: std::io::stderr().is_terminal(),
        })
    }

    /// Waits for a signal to stop and returns its name. A hangup that is no such signal has the access rules read again.
    async fn stop(&mut self, app: &App) -> &'static str {
        loop {
            tokio::select! {
                _ = self.terminate.recv() => return SIGTERM,
                _ = self.interrupt.recv() => return "SIGINT",
                _ = self.hangup.recv() => {
                    if self.has_terminal {
                        return "SIGHUP";
                    }
                    app.reread_access();
                }
            }
        }
    }
}

/// Console interrupts.
#[cfg(not(unix))]
struct Signals;

#[cfg(not(unix))]
impl Signals {
    fn new() -> std::io::Result<Signals> {
        Ok(Signals)
    }

    async fn stop(&mut self, _: &App) -> &'static str {
        let _ = tokio::signal::ctrl_c().await;
        "interrupt"
    }
}

/// Notifies the service manager, where there is one.
fn notify(state: &[sd_notify::NotifyState]) {
    if let Err(error) = sd_notify::notify(state) {
        tracing::warn!(%error, "the service manager cannot be told");
    }
}

/// Returns whether the render loop moves, or may still do so.
fn is_alive(readiness: &Readiness) -> bool {
    !matches!(readiness, Readiness::Stalled { .. } | Readiness::Failed)
}

/// Pats the service manager's watchdog twice in each of its periods while the render loop moves.
async fn watchdog(app: Arc<App>) {
    let Some(period) = sd_notify::watchdog_enabled() else { return };
    loop {
        if is_alive(&app.engine.readiness()) {
            notify(&[sd_notify::NotifyState::Watchdog]);
        }
        tokio::time::sleep(period / 2).await;
    }
}

/// Accepts connections up to the limit.
#[derive(Clone)]
struct Doorkeeper {
    app: Arc<App>,
    places: Arc<Semaphore>,
    /// Permits for connections beyond the limit that may be health probes.
    probes: Arc<Semaphore>,
    read_timeout: Duration,
}

/// Limits of connections beyond `max_connections` that are read: their number, bytes and time.
const PROBES: usize = 16;
const PROBE_BYTES: usize = 2048;
const PROBE_READ: Duration = Duration::from_millis(300);

impl<S: Send + 'static> Accept<TcpStream, S> for Doorkeeper {
    type Stream = Guarded;
    type Service = S;
    type Future = Pin<Box<dyn Future<Output = std::io::Result<(Guarded, S)>> + Send>>;

    fn accept(&self, mut stream: TcpStream, service: S) -> Self::Future {
        let place = self.places.clone().try_acquire_owned();
        let Doorkeeper { app, probes, read_timeout, .. } = self.clone();
        Box::pin(async move {
            let Ok(place) = place else {
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
            Ok((Guarded::new(stream, place, read_timeout), service))
        })
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

/// A connection that holds its place, with two limits that the HTTP library lacks: time for the first
/// bytes, which the library reads before it knows their protocol, and time for writes.
struct Guarded {
    stream: TcpStream,
    _place: OwnedSemaphorePermit,
    read_bytes: u64,
    preface_until: Pin<Box<Sleep>>,
    write_until: Pin<Box<Sleep>>,
    is_write_pending: bool,
    /// Answer that replaces one of the HTTP library.
    instead: Option<Instead>,
}

/// An answer in transit, and the bytes read after it.
struct Instead {
    rest: Bytes,
    unread: usize,
    until: Pin<Box<Sleep>>,
}

impl Guarded {
    fn new(stream: TcpStream, place: OwnedSemaphorePermit, read_timeout: Duration) -> Self {
        Self {
            stream,
            _place: place,
            read_bytes: 0,
            preface_until: Box::pin(tokio::time::sleep(read_timeout)),
            write_until: Box::pin(tokio::time::sleep(STALLED_WRITE)),
            is_write_pending: false,
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

    /// Turns a write that takes too long into an error.
    fn bounded<T>(
        &mut self,
        context: &mut Context<'_>,
        result: Poll<std::io::Result<T>>,
    ) -> Poll<std::io::Result<T>> {
        if result.is_ready() {
            self.is_write_pending = false;
            return result;
        }
        if !self.is_write_pending {
            self.is_write_pending = true;
            self.write_until.as_mut().reset(Instant::now() + STALLED_WRITE);
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
        let before = buffer.filled().len();
        match Pin::new(&mut self.stream).poll_read(context, buffer) {
            Poll::Ready(result) => {
                self.read_bytes += (buffer.filled().len() - before) as u64;
                Poll::Ready(result)
            }
            Poll::Pending if self.read_bytes < PREFACE_BYTES => {
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
        self.bounded(context, result)
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
        self.bounded(context, result)
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
    fn the_watchdog_is_patted_while_there_is_hope() {
        for readiness in
            [Readiness::Ready, Readiness::Starting, Readiness::DeviceLost, Readiness::Draining]
        {
            assert!(is_alive(&readiness), "{readiness:?}");
        }
        assert!(!is_alive(&Readiness::Stalled { for_ms: 30_000 }));
        assert!(!is_alive(&Readiness::Failed));
    }
}
