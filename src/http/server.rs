//! Listener, start and stop.
//!
//! ```text
//! listen ─► Starting ──scenes loaded──► Serving ──SIGTERM──► Leaving ──`drain_delay`──► Draining ─► exit
//!           /healthz 200                /readyz 200          /readyz 503                no new connections;
//!           /readyz  503                                     all is served as before    answers in flight end
//!                                                                                       within `drain`, streams are
//!                                                                                       closed with 1001, jobs pause
//! SIGINT, and SIGHUP where the terminal that it was started from has gone: Draining at once
//! a second SIGTERM, SIGINT or such SIGHUP: exit at once
//! SIGHUP without a terminal: keys, certificates and limits are read again, and logs are opened anew
//! a render thread that panicked: /healthz and /readyz 503, and the watchdog is no longer patted
//! ```

use std::future::Future;
use std::net::{SocketAddr, TcpListener};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use axum_server::{Handle, Server};
use hyper_util::rt::TokioTimer;
use tokio::sync::Semaphore;
use tokio::task::JoinHandle;

use super::connection::{Doorkeeper, PROBES};
use super::problem::Problem;
use super::registry::Reservation;
use super::upload::follow::{self, Followed};
use super::upload::store::Earlier;
use super::{App, Phase, Uploads, refusal, router, upload};
use crate::engine::{Engine, Readiness, Source};

/// Requests in flight on one HTTP/2 connection.
const MAX_STREAMS: u32 = 128;

/// Open connections of those who read metrics on a listener of its own.
const MONITORS: usize = 64;

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
    let (reserved, followed) = reserve_scenes(&app, start).await?;
    let mut server = tokio::spawn(run(app.clone(), listener, handle.clone()));
    if let Ok(jobs) = &app.jobs {
        // Jobs whose scenes are not loaded yet wait for them.
        jobs.start()?;
    }
    listening(address);

    // A signal drops only the reference: the load under way stays in the registry, where `stand_down` finds it.
    let mut loading = std::pin::pin!(load_scenes(&app, reserved, asked, required));
    tokio::select! {
        loaded = &mut loading => {
            loaded?;
            app.set_phase(Phase::Serving);
            if let Some(followed) = followed {
                tokio::spawn(follow::follow(app.clone(), followed));
            }
            let surveys = app.surveys.clone();
            tokio::task::spawn_blocking(move || surveys.resume());
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

    drain(&app, &handle, server, &mut signals).await;
    Ok(())
}

/// Lets answers under way, streams and jobs end, for as long as the settings allow and until another signal.
async fn drain<T>(
    app: &Arc<App>,
    handle: &Handle<SocketAddr>,
    server: JoinHandle<T>,
    signals: &mut Signals,
) {
    app.set_phase(Phase::Draining);
    handle.graceful_shutdown(Some(app.settings.drain));
    let drained = async {
        let _ = server.await;
        app.streams.closed().await;
        let (engine, jobs, surveys) = (app.engine.clone(), app.jobs.clone(), app.surveys.clone());
        let _ = tokio::task::spawn_blocking(move || {
            // Stop jobs before the engine, because they record their progress.
            if let Ok(jobs) = &jobs {
                jobs.wait();
            }
            surveys.wait();
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
        signal = signals.stop(app) => tracing::warn!(signal, "stopping at once"),
    }
    upload::stand_down(app);
}

async fn run(
    app: Arc<App>,
    listener: TcpListener,
    handle: Handle<SocketAddr>,
) -> std::io::Result<()> {
    let places = app.settings.max_connections;
    let server = with_limits(&app, listener, places, true)?.handle(handle);
    server.serve(router(app).into_make_service_with_connect_info::<SocketAddr>()).await
}

/// Builds a server with the limits of connections, heads and times, for at most `places` connections.
fn with_limits(
    app: &Arc<App>,
    listener: TcpListener,
    places: usize,
    is_main: bool,
) -> std::io::Result<Server<SocketAddr, Doorkeeper>> {
    let read_timeout = app.settings.read_timeout;
    let acceptor = Doorkeeper {
        app: app.clone(),
        places: Arc::new(Semaphore::new(places)),
        probes: Arc::new(Semaphore::new(PROBES)),
        read_timeout,
        is_main,
    };
    let mut server = axum_server::from_tcp(listener)?.acceptor(acceptor);
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
    Ok(server)
}

/// Serves metrics and health on a listener of its own until the process ends, without TLS and keys.
///
/// # Errors
/// A failed listener.
pub async fn serve_monitoring(app: Arc<App>, listener: TcpListener) -> std::io::Result<()> {
    listener.set_nonblocking(true)?;
    let only_loopback = listener.local_addr()?.ip().is_loopback();
    let server = with_limits(&app, listener, MONITORS, false)?;
    server.serve(super::monitoring(app, only_loopback).into_make_service()).await
}

/// A scene to load at the start.
struct Reserved {
    reservation: Result<Reservation, Problem>,
    id: String,
    source: Option<Source>,
    /// Why a kept upload is not loaded.
    refusal: Option<Problem>,
}

/// Finds uploads and reserves the ids of all scenes, first of those asked for by name. Returns what is known of followed uploads.
async fn reserve_scenes(
    app: &Arc<App>,
    start: StartScenes,
) -> anyhow::Result<(Vec<Reserved>, Option<Followed>)> {
    let (root, uploads) = (app.settings.root.clone(), app.settings.uploads);
    let (earlier, followed) = tokio::task::spawn_blocking(move || match uploads {
        Uploads::Kept => (upload::store::earlier(&root), None),
        Uploads::Followed => {
            let (earlier, followed) = Followed::begin(&root);
            (earlier, Some(followed))
        }
        Uploads::Refused => (Vec::new(), None),
    })
    .await?;
    let at = |(id, file)| (id, Some(Source::at(file)), None);
    let mut scenes: Vec<_> = start.scenes.into_iter().map(at).collect();
    for Earlier { id, source, key, bytes, refusal } in earlier {
        if !scenes.iter().any(|(known, ..)| *known == id) {
            let limits = app.rules().bounds.uploads;
            app.uploads.keep(&id, app.uploads.known(key.as_deref(), limits, bytes));
        }
        scenes.push((id, source, refusal));
    }
    let reserve = |(id, source, refusal): (String, _, _)| {
        let is_loaded = |id: &str| app.engine.scene(id).is_ok();
        let reservation = app.registry.reserve(&id, app.engine.admission(), is_loaded);
        Reserved { reservation, id, source, refusal }
    };
    Ok((scenes.into_iter().map(reserve).collect(), followed))
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

/// Waits for SIGTERM, SIGINT, or the end of the terminal, for commands other than the server. Needs a runtime. From this call on, these signals no
/// longer end the process. SIGHUP is ignored where standard error is no terminal.
pub fn stop_signal() -> std::io::Result<impl Future<Output = &'static str>> {
    let mut signals = Signals::new()?;
    let nothing = || tracing::info!("SIGHUP: there are no files to read again");
    Ok(async move { signals.stop_or(nothing).await })
}

/// Signals to the process; once this exists, they no longer end the process by themselves.
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

    /// Waits for a signal to stop and returns its name. A hangup that is no such signal has the rules read again.
    async fn stop(&mut self, app: &Arc<App>) -> &'static str {
        // Neither a disk that hangs nor requests that keep all other threads busy may hold up a signal.
        let reload = || {
            let app = app.clone();
            apart("reload", move || app.reload());
        };
        self.stop_or(reload).await
    }

    /// Waits for a signal to stop and returns its name. `hang_up` is called at each hangup that is no such signal.
    async fn stop_or(&mut self, hang_up: impl Fn()) -> &'static str {
        loop {
            tokio::select! {
                _ = self.terminate.recv() => return SIGTERM,
                _ = self.interrupt.recv() => return "SIGINT",
                _ = self.hangup.recv() => {
                    if self.has_terminal {
                        return "SIGHUP";
                    }
                    hang_up();
                }
            }
        }
    }
}

/// Does `work` on a thread of its own.
#[cfg(unix)]
fn apart(name: &str, work: impl FnOnce() + Send + 'static) {
    if let Err(error) = std::thread::Builder::new().name(name.to_owned()).spawn(work) {
        tracing::error!(%error, "no thread can be started for a {name}");
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
        self.stop_or(|| ()).await
    }

    async fn stop_or(&mut self, _: impl Fn()) -> &'static str {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(unix)]
    #[test]
    fn a_reload_needs_no_thread_of_the_runtime() {
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .max_blocking_threads(1)
            .build()
            .unwrap();
        let (end, ended) = std::sync::mpsc::sync_channel::<()>(0);
        runtime.spawn_blocking(move || ended.recv());
        let (done, is_done) = std::sync::mpsc::sync_channel(1);
        runtime.spawn(async move { apart("reload", move || done.send(()).unwrap()) });
        assert!(is_done.recv_timeout(Duration::from_secs(60)).is_ok());
        drop(end);
    }

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
