//! The daemon's HTTP floor (7): requests become jobs, results become answers. Translation only; the
//! [engine](crate::engine) decides what can be drawn and whether there is room for it.
//!
//! ```text
//! connection → server (limits, timeouts) → gate (access, counters, panics) → handler
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
//! Clients share the device. A client is known by its key, or by its address where there are no keys ([`Caller`]).
//!
//! Every request has a name ([`naming`]): answers, receipts, problems and log lines carry it.
//!
//! A frame's entity tag is known before any GPU work, so the path to a 304 is short: one middleware, a span only at debug level,
//! one look-up in the engine. When a client disconnects, the handler's future is dropped, and with it the ticket, which frees the
//! job's place in the queue.

pub mod access;
mod accuracy;
mod body;
mod compare;
mod conditional;
mod connection;
mod frame;
mod frames;
mod headcount;
mod headers;
mod jobs;
mod metrics;
mod mjpeg;
mod names;
mod naming;
mod openapi;
mod params;
mod paths;
mod pick;
mod problem;
mod refusal;
mod registry;
mod scenes;
pub mod server;
mod service;
mod stream;
mod upload;
mod viewer;

use std::hash::{BuildHasher, RandomState};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};
use std::time::Duration;

use axum::Router;
use axum::body::HttpBody;
use axum::extract::{
    ConnectInfo, DefaultBodyLimit, FromRequestParts, MatchedPath, Path, Request, State,
};
use axum::http::request::Parts;
use axum::http::{HeaderName, HeaderValue, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use axum::routing::{get, patch, post};
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::cors::{AllowOrigin, CorsLayer};
use tracing::Instrument;

pub use jobs::WatchLimits;
pub use names::slug;
pub use openapi::{openapi_json, openapi_yaml};
pub use params::{DEFAULT_FOV_DEG, DEFAULT_QUALITY, DEFAULT_SIDE};
pub use problem::Problem;
pub use stream::StreamLimits;
pub use upload::quota::UploadLimits;

use crate::accuracy::service::Surveys;
use crate::engine::{Client, Engine};
use crate::jobs::Jobs;

/// Configuration of the HTTP side.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Canonical folder of scenes; uploads are stored below it.
    pub root: PathBuf,
    pub access: access::Access,
    /// Origins whose pages may read answers; empty for none.
    pub cors_origins: Vec<String>,
    /// Largest upload in bytes, all files together.
    pub max_upload_bytes: u64,
    pub upload_limits: UploadLimits,
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
    pub uploads: bool,
    /// Reads the access rules again; `None` where there is nothing to read.
    pub reread_access: Option<access::Reread>,
    pub streams: stream::StreamLimits,
    pub watches: WatchLimits,
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
    /// The turn of the comparison whose figures are computed.
    pub(crate) comparing: Arc<tokio::sync::Semaphore>,
    /// Key of the hash that numbers callers, so that no caller can choose a number that is another's.
    callers: RandomState,
    /// Origins whose pages may read `Server-Timing`.
    timing_origins: Option<HeaderValue>,
    /// The rules in force.
    access: parking_lot::RwLock<Arc<access::Access>>,
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
        Arc::new(App {
            surveys: Surveys::open(engine.clone(), folder),
            comparing: Arc::new(tokio::sync::Semaphore::new(1)),
            metrics: metrics::Metrics::new(&engine, jobs.as_ref().ok()),
            jobs,
            registry: registry::Registry::default(),
            uploads: upload::quota::Quota::new(settings.upload_limits),
            streams: stream::Streams::new(settings.streams),
            watchers: settings.watches.headcount(),
            callers: RandomState::new(),
            timing_origins: (!settings.cors_origins.is_empty())
                .then(|| HeaderValue::from_str(&settings.cors_origins.join(", ")).ok())
                .flatten(),
            access: parking_lot::RwLock::new(Arc::new(settings.access.clone())),
            phase: AtomicU8::new(0),
            engine,
            settings,
        })
    }

    pub fn phase(&self) -> Phase {
        match self.phase.load(Ordering::Relaxed) {
            0 => Phase::Starting,
            1 => Phase::Serving,
            2 => Phase::Leaving,
            _ => Phase::Draining,
        }
    }

    /// Reads the access rules again and puts them in force. If they cannot be read, the earlier rules stay.
    pub fn reread_access(&self) {
        let Some(reread) = &self.settings.reread_access else {
            tracing::info!("no API keys to read again");
            return;
        };
        match reread.0() {
            Ok(access) => {
                *self.access.write() = Arc::new(access);
                tracing::info!("API keys read again");
            }
            Err(error) => tracing::error!(error, "the API keys in force stay"),
        }
    }

    pub fn set_phase(&self, phase: Phase) {
        // Phases only go forward: a scene that finishes loading does not undo a drain.
        self.phase.fetch_max(phase as u8, Ordering::Relaxed);
        if phase == Phase::Draining {
            self.streams.drain();
            self.surveys.close();
            if let Ok(jobs) = &self.jobs {
                jobs.pause();
            }
        }
    }
}

/// Identity of a request's sender for shares and limits; attached to every request that has passed the access rules.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Caller(pub Client);

/// The key of a request, where keys are required; attached beside [`Caller`].
#[derive(Clone, Debug)]
pub(crate) struct Owner {
    /// Name of the key.
    pub name: Option<String>,
    /// Whether the key may change what others own. Without keys everybody may.
    pub is_admin: bool,
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
    "/v1/scenes/{id}/frame",
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

const UNMATCHED: &str = "unmatched";

const TIMING_ALLOW_ORIGIN: HeaderName = HeaderName::from_static("timing-allow-origin");

/// Builds the routes with all middleware.
pub fn router(app: Arc<App>) -> Router {
    let cors = cors(&app.settings.cors_origins);
    let router = Router::new()
        .route("/", get(viewer::page))
        .route("/viewer/{file}", get(viewer::file))
        .route("/healthz", get(service::healthz))
        .route("/readyz", get(service::readyz))
        .route("/metrics", get(service::metrics))
        .route("/openapi.yaml", get(service::openapi))
        .route("/v1/limits", get(service::limits))
        .route("/v1/scene-schema.json", get(service::scene_schema))
        .route("/v1/settings", get(service::settings))
        .route("/v1/scenes", get(scenes::list).post(upload::create))
        .route("/v1/scenes/{id}", get(scenes::show).delete(scenes::remove))
        .route("/v1/scenes/{id}/retry", post(upload::retry))
        .route("/v1/scenes/{id}/nodes/{node}", patch(scenes::patch_node))
        .route("/v1/scenes/{id}/frame", get(frame::frame))
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
        .layer(axum::middleware::from_fn_with_state(app.clone(), gate));
    let router = match cors {
        Some(cors) => router.layer(cors),
        None => router,
    };
    router.with_state(app)
}

/// Wraps every handler: gives the request a name, checks access, counts.
async fn gate(State(app): State<Arc<App>>, mut request: Request, next: Next) -> Response {
    let matched = request.extensions().get::<MatchedPath>().map(MatchedPath::as_str);
    let route = matched
        .and_then(|path| ROUTES.iter().find(|route| **route == path))
        .copied()
        .unwrap_or(UNMATCHED);
    let method = request.method().clone();
    let id = naming::of(request.headers());
    request.extensions_mut().insert(id.clone());
    let span = tracing::debug_span!("request", request_id = %id, %method, route);
    let answer = answer(&app, route, request, next).instrument(span);
    let mut response = naming::within(id.clone(), answer).await;
    let headers = response.headers_mut();
    headers.extend(naming::header(&id).map(|value| (naming::REQUEST_ID, value)));
    headers.extend(app.timing_origins.clone().map(|value| (TIMING_ALLOW_ORIGIN, value)));
    app.metrics.answered(route, &method, response.status().as_u16());
    response
}

/// Checks access and answers the request.
async fn answer(app: &App, route: &'static str, request: Request, next: Next) -> Response {
    let method = request.method().clone();
    // A client that waits for `100 Continue` sends no body after a refusal, so there is nothing to read.
    let expects = request.headers().contains_key(header::EXPECT);
    let (request, rest) = if request.body().is_end_stream() || expects {
        (request, None)
    } else {
        let (parts, whole) = request.into_parts();
        let (body, rest) = body::share(whole);
        (Request::from_parts(parts, body), Some(rest))
    };
    let mut request = request;
    let access = app.access.read().clone();
    let checked = access.check(&method, request.uri(), route, request.headers()).map(|key| {
        let address = request.extensions().get::<ConnectInfo<SocketAddr>>();
        let client = match (key, address) {
            (Some(key), _) => Client::Caller(app.callers.hash_one(&key.name)),
            (None, Some(from)) => Client::Caller(app.callers.hash_one(from.0.ip())),
            (None, None) => Client::Unnamed,
        };
        let is_admin = key.is_none_or(|key| key.scope == access::Scope::Admin);
        (client, Owner { name: key.map(|key| key.name.clone()), is_admin })
    });
    let response = match checked {
        Ok((client, owner)) => {
            request.extensions_mut().insert(Caller(client));
            request.extensions_mut().insert(owner);
            next.run(request).await
        }
        Err(problem) => problem.into_response(),
    };
    if let (Some(rest), true) = (rest, response.status().as_u16() >= 400) {
        rest.linger().await;
    }
    response
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
            let request = Request::new(axum::body::Body::empty());
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
