//! The server's HTTP floor (7): requests become jobs, results become answers. Translation only; the
//! [engine](crate::engine) decides what can be drawn and whether there is room for it.
//!
//! ```text
//! connection → server (TLS, limits, timeouts) → gate (access, rates, logs, counters, panics) → handler
//!                                              frame   params → engine.etag → 304
//!                                                                  └→ engine.submit → image + receipt
//!                                              frames  one frame for each pose, as multipart/mixed
//!                                              compare two settings at one pose, and how their frames differ
//!                                              pick    what pixels show: positions, instances
//!                                              stream  WebSocket: poses in, the newest one's frame out
//!                                              mjpeg   a path's frames in real time, as an <img> shows them
//!                                              upload  body → disk → engine.load → 201, or 202
//!                                              jobs    films, drawn in the background; files and events
//!                                              accuracy  what accuracy costs in time, measured in the background
//! ```
//!
//! Clients share the device. A client is known by its key, or by its address where there are no keys ([`Caller`]). Behind trusted
//! proxies the address is the one that they forward ([`address`]).
//!
//! Every request has a name ([`naming`]): answers, receipts, problems and log lines carry it.
//!
//! A frame's entity tag is known before any GPU work, so the path to a 304 is short: one middleware, a span only at debug level,
//! one look-up in the engine. When a client disconnects, the handler's future is dropped, and with it the ticket, which frees the
//! job's place in the queue.

pub mod access;
mod accuracy;
pub mod address;
mod answers;
mod body;
mod bucket;
mod compare;
mod conditional;
mod connection;
mod frame;
mod frames;
#[cfg(any(test, fuzzing))]
mod fuzzing;
mod gate;
mod headcount;
mod headers;
mod jobs;
pub mod journal;
mod limits;
mod metrics;
mod mjpeg;
mod names;
mod naming;
mod openapi;
mod params;
mod patch_queue;
mod paths;
mod pick;
mod problem;
mod refusal;
mod registry;
pub mod rules;
mod scenes;
pub mod server;
mod service;
mod stream;
pub mod telemetry;
pub mod tls;
mod unread;
mod upload;
mod viewer;

use std::collections::HashMap;
use std::hash::{BuildHasher, RandomState};
use std::net::IpAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::time::{Duration, Instant, SystemTime};

use axum::Router;
use axum::extract::{DefaultBodyLimit, FromRequestParts, Path};
use axum::http::request::Parts;
use axum::http::{HeaderName, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, patch, post};
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::cors::{AllowOrigin, CorsLayer};

#[cfg(any(test, fuzzing))]
pub(crate) use fuzzing::TARGETS as FUZZ_TARGETS;
pub use jobs::WatchLimits;
pub use names::slug;
pub use openapi::{openapi_json, openapi_yaml};
pub use params::{DEFAULT_FOV_DEG, DEFAULT_QUALITY, DEFAULT_SIDE};
pub use problem::Problem;
pub use service::{push_last_metrics, push_metrics};
pub use stream::StreamLimits;
pub use upload::follow::Uploads;
pub use upload::quota::UploadLimits;

use self::access::Quotas;
use self::access::signed::Caps;
use self::journal::Journal;
use self::limits::{Holder, Limits, Standing};
use self::rules::{Bounds, Reread, Rules};
use self::telemetry::Telemetry;
use crate::accuracy::service::Surveys;
use crate::engine::{Client, Engine, ResolvedFrame};
use crate::jobs::Jobs;

/// Configuration of the HTTP side.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Canonical folder of scenes; uploads are stored below it.
    pub root: PathBuf,
    pub access: access::Access,
    /// Origins whose pages may read answers; empty for none.
    pub cors_origins: Vec<String>,
    pub max_connections: usize,
    /// Longest wait for a frame, whatever the client asks for.
    pub frame_timeout: Duration,
    /// Longest wait for a request's head and for the next piece of its body. After this time a body must also have arrived at a
    /// minimum rate.
    pub read_timeout: Duration,
    /// Longest time that answers in flight may take when the server stops.
    pub drain: Duration,
    /// Time for which a stopping server goes on serving while `/readyz` already says no.
    pub drain_delay: Duration,
    /// Whether clients may add scenes.
    pub uploads: Uploads,
    pub bounds: Bounds,
    /// Reads keys, certificates and bounds again.
    pub reread: Reread,
    pub edge: Edge,
}

/// Settings of what stands between the network and the handlers.
#[derive(Clone, Debug, Default)]
pub struct Edge {
    /// Whether `/metrics` is served on a listener of its own, and not on the main one.
    pub metrics_apart: bool,
    pub tls: Option<tls::Tls>,
    pub access_log: Option<Arc<Journal>>,
    pub audit_log: Option<Arc<Journal>>,
    /// Where traces and metrics are sent.
    pub telemetry: Option<Arc<Telemetry>>,
}

/// State shared by all handlers.
pub struct App {
    pub(crate) engine: Engine,
    pub(crate) settings: Settings,
    pub(crate) metrics: metrics::Metrics,
    pub(crate) registry: registry::Registry,
    pub(crate) uploads: upload::quota::Quota,
    pub(crate) streams: stream::Streams,
    /// Counts the watchers of jobs.
    pub(crate) watchers: headcount::Headcount,
    /// The jobs, or the reason why there are none.
    pub(crate) jobs: Result<Jobs, String>,
    pub(crate) surveys: Surveys,
    /// Answers that clients have not read yet.
    unread: unread::Unread,
    pub(crate) patches: patch_queue::PatchQueue,
    /// The turn of the comparison whose figures are computed.
    pub(crate) comparing: Arc<tokio::sync::Semaphore>,
    /// Key of the hash that numbers callers, so that no caller can choose a number that is another's.
    callers: RandomState,
    /// Origins whose pages may read `Server-Timing`.
    timing_origins: Option<HeaderValue>,
    /// The rules in force.
    rules: parking_lot::RwLock<Arc<Rules>>,
    /// The turn of the reload that reads files.
    reloading: parking_lot::Mutex<()>,
    wants_reload: AtomicBool,
    limits: Arc<Limits>,
    /// Connections by address.
    connections: headcount::Headcount<IpAddr>,
    phase: AtomicU8,
}

/// Phase of the server's life.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Scenes given at the start are being loaded.
    Starting,
    Serving,
    /// Requests are served as before, but `/readyz` tells load balancers to send no more.
    Leaving,
    Draining,
}

impl App {
    pub fn new(engine: Engine, settings: Settings, jobs: Result<Jobs, String>) -> Arc<App> {
        let folder = jobs.as_ref().ok().map(|jobs| jobs.folder().join("accuracy"));
        let limits = Arc::new(Limits::new());
        let app = Arc::new(App {
            surveys: Surveys::open(engine.clone(), folder),
            unread: unread::Unread::new(engine.limits().host_memory_bytes),
            patches: patch_queue::PatchQueue::default(),
            comparing: Arc::new(tokio::sync::Semaphore::new(1)),
            metrics: metrics::Metrics::new(
                &engine,
                jobs.as_ref().ok(),
                limits.clone(),
                &settings.edge,
            ),
            jobs,
            registry: registry::Registry::default(),
            uploads: upload::quota::Quota::default(),
            streams: stream::Streams::default(),
            watchers: headcount::Headcount::default(),
            callers: RandomState::new(),
            timing_origins: (!settings.cors_origins.is_empty())
                .then(|| HeaderValue::from_str(&settings.cors_origins.join(", ")).ok())
                .flatten(),
            rules: parking_lot::RwLock::new(Arc::new(Rules {
                access: settings.access.clone(),
                tls: settings.edge.tls.clone(),
                bounds: settings.bounds.clone(),
            })),
            reloading: parking_lot::Mutex::new(()),
            wants_reload: AtomicBool::new(false),
            limits,
            connections: headcount::Headcount::default(),
            phase: AtomicU8::new(0),
            engine,
            settings,
        });
        app.know_keys(&app.settings.access);
        app
    }

    pub fn phase(&self) -> Phase {
        match self.phase.load(Ordering::Relaxed) {
            0 => Phase::Starting,
            1 => Phase::Serving,
            2 => Phase::Leaving,
            _ => Phase::Draining,
        }
    }

    /// Returns the rules in force.
    pub(crate) fn rules(&self) -> Arc<Rules> {
        self.rules.read().clone()
    }

    /// Tells the quotas of keys, which open streams are held to as well.
    fn know_keys(&self, access: &access::Access) {
        let holders = match access {
            access::Access::Open { .. } => None,
            access::Access::Keys(keys) => {
                let holder = |key: &access::ApiKey| {
                    let (quotas, expires) = (key.quotas, key.expires);
                    (
                        self.number_of(key),
                        Holder { quotas, expires, credentials: key.credentials() },
                    )
                };
                Some(keys.iter().map(holder).collect::<HashMap<_, _>>())
            }
        };
        self.limits.set_holders(holders);
    }

    fn audit(&self, entry: &impl serde::Serialize) {
        if let Some(journal) = &self.settings.edge.audit_log {
            journal.write(entry);
        }
    }

    /// Returns the number of a key's client.
    fn number_of(&self, key: &access::ApiKey) -> u64 {
        self.callers.hash_one(&key.name)
    }

    /// Returns the limits of a client's key, as they are now.
    pub(crate) fn quotas_of(&self, client: Client) -> Quotas {
        client.owner().map_or_else(Quotas::default, |number| self.limits.quotas(number))
    }

    /// Returns whether a client that has been let in may go on drawing.
    pub(crate) fn standing(&self, client: Client, caps: &Caps) -> Standing {
        let Some(number) = client.owner() else { return Standing::Good };
        self.limits.standing(number, caps, Instant::now(), SystemTime::now())
    }

    /// Refuses a frame that is larger or dearer than a signed address allows.
    pub(crate) fn check_caps(&self, caps: &Caps, frame: &ResolvedFrame) -> Result<(), Problem> {
        let over = |what: &str, found: u64, most: u64| {
            let detail = format!("this signed address allows {most} {what} a frame, not {found}");
            Problem::new(problem::Kind::OverLimit, detail)
                .at("signature")
                .accepted(format!("at most {most} {what}"))
        };
        let pixels = frame.pixels_in_all();
        if let Some(most) = caps.pixels.filter(|most| pixels > *most) {
            return Err(over("pixels, with all their parts and exposures,", pixels, most));
        }
        let Some(most) = caps.device_ms else { return Ok(()) };
        let estimate = self.engine.estimated_cost(frame);
        let found = u64::try_from(estimate.as_nanos().div_ceil(1_000_000)).unwrap_or(u64::MAX);
        match found > most {
            true => Err(over("estimated milliseconds of GPU time", found, most)),
            false => Ok(()),
        }
    }

    pub fn set_phase(&self, phase: Phase) {
        // Phases only go forward: a scene that finishes loading does not undo a drain.
        self.phase.fetch_max(phase as u8, Ordering::Relaxed);
        self.metrics.entered(self.phase());
        if phase == Phase::Draining {
            self.streams.drain();
            self.surveys.close();
            if let Ok(jobs) = &self.jobs {
                jobs.pause();
            }
        }
    }
}

/// Identity of a request's sender for shares and limits, and the limits of a signed address; attached to every request that has passed the access rules.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Caller(pub Client, pub Caps);

/// The key of a request, where keys are required; attached beside [`Caller`].
#[derive(Clone, Debug, Default)]
pub(crate) struct Owner {
    /// Name of the key.
    pub name: Option<String>,
    /// Whether the key may change what others own. Without keys everybody may.
    pub is_admin: bool,
    pub quotas: Quotas,
}

impl Owner {
    /// Refuses changes of scenes that another key uploaded, and of scenes of the root.
    pub(crate) fn check_scene(&self, app: &App, id: &str) -> Result<(), Problem> {
        let is_known = app.registry.get(id).is_some() || app.engine.scene(id).is_ok();
        // An admin may change everything, and a scene that does not exist is nobody's.
        if self.is_admin || !is_known {
            return Ok(());
        }
        if app.uploads.owner(id).is_some_and(|owner| self.is_theirs(owner.as_deref())) {
            return Ok(());
        }
        let detail = format!("scene `{id}` was not uploaded with this key");
        Err(Problem::new(problem::Kind::Forbidden, detail)
            .at("Authorization")
            .accepted("the key that uploaded the scene, or a key of scope admin"))
    }
}

/// Every route, as the counters and the access rules name them.
const ROUTES: [&str; 32] = [
    "/",
    "/viewer/{file}",
    "/healthz",
    "/readyz",
    "/metrics",
    "/openapi.yaml",
    "/v1/limits",
    "/v1/scene-schema.json",
    "/v1/settings",
    "/v1/scenes",
    "/v1/scenes/{id}",
    "/v1/scenes/{id}/retry",
    "/v1/scenes/{id}/nodes/{node}",
    FRAME,
    "/v1/scenes/{id}/frames",
    "/v1/scenes/{id}/compare",
    "/v1/scenes/{id}/accuracy",
    "/v1/scenes/{id}/accuracy/cancel",
    "/v1/scenes/{id}/pick",
    "/v1/scenes/{id}/mjpeg",
    "/v1/scenes/{id}/paths/{name}",
    STREAM,
    "/v1/jobs",
    "/v1/jobs/{id}",
    "/v1/jobs/{id}/cancel",
    "/v1/jobs/{id}/resume",
    "/v1/jobs/{id}/events",
    "/v1/jobs/{id}/frames",
    "/v1/jobs/{id}/frames/{n}",
    "/v1/jobs/{id}/multipart",
    "/v1/jobs/{id}/video.mp4",
    UNMATCHED,
];

const STREAM: &str = "/v1/scenes/{id}/stream";

const FRAME: &str = "/v1/scenes/{id}/frame";

const UNMATCHED: &str = "unmatched";

const TIMING_ALLOW_ORIGIN: HeaderName = HeaderName::from_static("timing-allow-origin");

/// Builds the routes with all middleware.
pub fn router(app: Arc<App>) -> Router {
    let cors = cors(&app.settings.cors_origins);
    let router = match app.settings.edge.metrics_apart {
        true => Router::new(),
        false => Router::new().route("/metrics", get(service::metrics)),
    };
    let router = router
        .route("/", get(viewer::page))
        .route("/viewer/{file}", get(viewer::file))
        .route("/healthz", get(service::healthz))
        .route("/readyz", get(service::readyz))
        .route("/openapi.yaml", get(service::openapi))
        .route("/v1/limits", get(service::limits))
        .route("/v1/scene-schema.json", get(service::scene_schema))
        .route("/v1/settings", get(service::settings))
        .route("/v1/scenes", get(scenes::list).post(upload::create))
        .route("/v1/scenes/{id}", get(scenes::show).delete(scenes::remove))
        .route("/v1/scenes/{id}/retry", post(upload::retry))
        .route("/v1/scenes/{id}/nodes/{node}", patch(scenes::patch_node))
        .route(FRAME, get(frame::frame))
        .route("/v1/scenes/{id}/frames", post(frames::frames))
        .route("/v1/scenes/{id}/compare", post(compare::compare))
        .route(
            "/v1/scenes/{id}/accuracy",
            get(accuracy::show).post(accuracy::begin).delete(accuracy::remove),
        )
        .route("/v1/scenes/{id}/accuracy/cancel", post(accuracy::cancel))
        .route("/v1/scenes/{id}/pick", get(pick::pick).post(pick::pick_many))
        .route("/v1/scenes/{id}/mjpeg", get(mjpeg::mjpeg))
        .route("/v1/scenes/{id}/paths/{name}", get(paths::show))
        .route(STREAM, get(stream::stream))
        .route("/v1/jobs", get(jobs::list).post(jobs::create::create))
        .route("/v1/jobs/{id}", get(jobs::show).delete(jobs::remove))
        .route("/v1/jobs/{id}/cancel", post(jobs::cancel))
        .route("/v1/jobs/{id}/resume", post(jobs::resume))
        .route("/v1/jobs/{id}/events", get(jobs::events::events))
        .route("/v1/jobs/{id}/frames", get(jobs::frames::manifest))
        .route("/v1/jobs/{id}/frames/{n}", get(jobs::frames::frame))
        .route("/v1/jobs/{id}/multipart", get(jobs::frames::multipart))
        .route("/v1/jobs/{id}/video.mp4", get(jobs::video::video))
        .fallback(service::unknown_route)
        .method_not_allowed_fallback(service::method_not_allowed)
        // Each handler limits its own body while it reads.
        .layer(DefaultBodyLimit::disable())
        .layer(CatchPanicLayer::custom(panicked))
        .layer(axum::middleware::from_fn_with_state(app.clone(), gate::gate));
    let router = match cors {
        Some(cors) => router.layer(cors),
        None => router,
    };
    router.with_state(app)
}

/// Builds the routes of the listener for monitoring, which asks for no key. If `only_loopback`, it answers only to names of loopback.
pub fn monitoring(app: Arc<App>, only_loopback: bool) -> Router {
    let guard = move |request: axum::extract::Request, next: axum::middleware::Next| async move {
        if only_loopback {
            access::check_host(request.uri(), request.headers())?;
        }
        Ok::<_, Problem>(next.run(request).await)
    };
    Router::new()
        .route("/metrics", get(service::metrics))
        .route("/healthz", get(service::healthz))
        .route("/readyz", get(service::readyz))
        .fallback(service::not_monitored)
        .method_not_allowed_fallback(service::method_not_allowed)
        .layer(axum::middleware::from_fn(guard))
        .with_state(app)
}

fn panicked(cause: Box<dyn std::any::Any + Send + 'static>) -> Response {
    let cause = cause
        .downcast_ref::<&str>()
        .map(|text| (*text).to_owned())
        .or_else(|| cause.downcast_ref::<String>().cloned())
        .unwrap_or_default();
    Problem::internal(format!("a handler panicked: {cause}")).into_response()
}

fn cors(origins: &[String]) -> Option<CorsLayer> {
    use axum::http::Method;
    if origins.is_empty() {
        return None;
    }
    let allowed = if origins.iter().any(|origin| origin == "*") {
        AllowOrigin::any()
    } else {
        AllowOrigin::list(origins.iter().filter_map(|origin| HeaderValue::from_str(origin).ok()))
    };
    Some(
        CorsLayer::new()
            .allow_origin(allowed)
            .allow_methods([Method::GET, Method::HEAD, Method::POST, Method::PATCH, Method::DELETE])
            .allow_headers([
                header::AUTHORIZATION,
                header::CONTENT_TYPE,
                header::IF_NONE_MATCH,
                header::RANGE,
                HeaderName::from_static("idempotency-key"),
                HeaderName::from_static("last-event-id"),
                naming::REQUEST_ID,
            ])
            .expose_headers([
                header::ETAG,
                header::RETRY_AFTER,
                header::CONTENT_RANGE,
                header::LOCATION,
                HeaderName::from_static("server-timing"),
                frame::RECEIPT_HEADER,
                frame::WARNING_HEADER,
                naming::REQUEST_ID,
            ]),
    )
}

/// Path parameters whose failure becomes a problem.
pub(crate) struct Segments<T>(pub T);

impl<T, S> FromRequestParts<S> for Segments<T>
where
    T: serde::de::DeserializeOwned + Send,
    S: Send + Sync,
{
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        Path::<T>::from_request_parts(parts, state)
            .await
            .map(|Path(value)| Segments(value))
            .map_err(|_| {
                Problem::new(problem::Kind::UnknownRoute, "the address is not valid UTF-8")
            })
    }
}

/// Refuses a query on addresses that read none, because the query would be silently ignored.
pub(crate) struct NoQuery;

impl<S: Send + Sync> FromRequestParts<S> for NoQuery {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Problem> {
        match params::pairs(parts.uri.query())?.first() {
            None => Ok(NoQuery),
            Some((name, _)) => Err(params::unknown_name(name, &[], &[]).accepted("no parameters")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tower::ServiceExt;

    #[test]
    fn a_panic_is_a_problem_and_keeps_its_words() {
        let router = Router::new()
            .route("/", get(|| async { panic!("a secret") as &'static str }))
            .layer(CatchPanicLayer::custom(panicked));
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        let (status, body) = runtime.block_on(async {
            let request = axum::extract::Request::new(axum::body::Body::empty());
            let response = router.oneshot(request).await.unwrap();
            let status = response.status();
            (status, axum::body::to_bytes(response.into_body(), 4096).await.unwrap())
        });
        assert_eq!(status, 500);
        let body = String::from_utf8_lossy(&body);
        assert!(body.contains("urn:pointillist:problem:internal"), "{body}");
        assert!(!body.contains("secret"), "{body}");
    }
}
