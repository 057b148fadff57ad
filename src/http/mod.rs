//! The daemon's HTTP floor (7): requests become jobs, results become answers. Translation only; what
//! can be drawn, and whether there is room for it, the [engine](crate::engine) decides.
//!
//! ```text
//! connection → server (limits, timeouts) → gate (access, counters, panics) → handler
//!                                              frame   params → engine.etag → 304
//!                                                                  └→ engine.submit → image + receipt
//!                                              frames  the same, pose after pose, as multipart/mixed
//!                                              stream  WebSocket: poses in, the newest one's frame out
//!                                              upload  body → disk → engine.load → 201, or 202
//! ```
//!
//! Who asks takes turns with all others: by its key, or by its address where there are no keys ([`Caller`]).
//!
//! A frame's entity tag is known before any GPU work, so the path to a 304 is short: one middleware,
//! no spans, one look at the engine. A client that goes away drops the handler's future, and with it
//! the ticket, which frees the job's place in the queue.

pub mod access;
mod body;
mod conditional;
mod frame;
mod frames;
mod headers;
mod metrics;
mod names;
mod openapi;
mod params;
mod problem;
mod registry;
mod scenes;
pub mod server;
mod service;
mod stream;
mod upload;

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
use axum::http::header;
use axum::http::request::Parts;
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use axum::routing::{get, patch, post};
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::cors::{AllowOrigin, CorsLayer};

pub use names::slug;
pub use openapi::{openapi_json, openapi_yaml};
pub use params::{DEFAULT_FOV_DEG, DEFAULT_QUALITY, DEFAULT_SIDE};
pub use problem::{Problem, nearest};
pub use stream::StreamLimits;

use crate::engine::{Client, Engine};

/// How the HTTP side is set up.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Canonical folder of scenes; uploads go below it.
    pub root: PathBuf,
    pub access: access::Access,
    /// Origins whose pages may read answers; empty for none.
    pub cors_origins: Vec<String>,
    /// Bytes of one upload, all files together.
    pub max_upload_bytes: u64,
    pub max_connections: usize,
    /// Longest wait for a frame, whatever the client says.
    pub frame_timeout: Duration,
    /// Longest wait for the head of a request, and for the next piece of its body; after the same time
    /// a body must have come at a least rate.
    pub read_timeout: Duration,
    /// How long answers in flight may take when the server stops.
    pub drain: Duration,
    pub streams: stream::StreamLimits,
}

/// What every handler shares.
pub struct App {
    pub(crate) engine: Engine,
    pub(crate) settings: Settings,
    pub(crate) metrics: metrics::Metrics,
    pub(crate) registry: registry::Registry,
    pub(crate) streams: stream::Streams,
    /// Keys the numbers of callers, so that nobody chooses one that is another's.
    callers: RandomState,
    phase: AtomicU8,
}

/// What the server as a whole is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Scenes given at the start are being loaded.
    Starting,
    Serving,
    Draining,
}

impl App {
    pub fn new(engine: Engine, settings: Settings) -> Arc<App> {
        Arc::new(App {
            metrics: metrics::Metrics::new(&engine),
            registry: registry::Registry::default(),
            streams: stream::Streams::new(settings.streams),
            callers: RandomState::new(),
            phase: AtomicU8::new(0),
            engine,
            settings,
        })
    }

    pub fn phase(&self) -> Phase {
        match self.phase.load(Ordering::Relaxed) {
            0 => Phase::Starting,
            1 => Phase::Serving,
            _ => Phase::Draining,
        }
    }

    pub fn set_phase(&self, phase: Phase) {
        // Phases only go forward: a scene that finishes loading does not undo a drain.
        self.phase.fetch_max(phase as u8, Ordering::Relaxed);
        if phase == Phase::Draining {
            self.streams.drain();
        }
    }
}

/// Who sent a request, as far as taking turns and limits go; put beside every request that has passed the access rules.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Caller(pub Client);

/// Every route, as the counters and the access rules name them.
const ROUTES: [&str; 14] = [
    "/",
    "/healthz",
    "/readyz",
    "/metrics",
    "/openapi.yaml",
    "/v1/limits",
    "/v1/scene-schema.json",
    "/v1/scenes",
    "/v1/scenes/{id}",
    "/v1/scenes/{id}/nodes/{node}",
    "/v1/scenes/{id}/frame",
    "/v1/scenes/{id}/frames",
    STREAM,
    UNMATCHED,
];

const STREAM: &str = "/v1/scenes/{id}/stream";

const UNMATCHED: &str = "unmatched";

/// The routes with everything around them.
pub fn router(app: Arc<App>) -> Router {
    let cors = cors(&app.settings.cors_origins);
    let router = Router::new()
        .route("/", get(service::viewer))
        .route("/healthz", get(service::healthz))
        .route("/readyz", get(service::readyz))
        .route("/metrics", get(service::metrics))
        .route("/openapi.yaml", get(service::openapi))
        .route("/v1/limits", get(service::limits))
        .route("/v1/scene-schema.json", get(service::scene_schema))
        .route("/v1/scenes", get(scenes::list).post(upload::create))
        .route("/v1/scenes/{id}", get(scenes::show).delete(scenes::remove))
        .route("/v1/scenes/{id}/nodes/{node}", patch(scenes::patch_node))
        .route("/v1/scenes/{id}/frame", get(frame::frame))
        .route("/v1/scenes/{id}/frames", post(frames::frames))
        .route(STREAM, get(stream::stream))
        .fallback(service::unknown_route)
        .method_not_allowed_fallback(service::method_not_allowed)
        // Each handler bounds its own body, while it reads.
        .layer(DefaultBodyLimit::disable())
        .layer(axum::middleware::from_fn_with_state(app.clone(), gate))
        .layer(CatchPanicLayer::custom(panicked));
    let router = match cors {
        Some(cors) => router.layer(cors),
        None => router,
    };
    router.with_state(app)
}

/// Access and counters, around every handler.
async fn gate(State(app): State<Arc<App>>, request: Request, next: Next) -> Response {
    let matched = request.extensions().get::<MatchedPath>().map(MatchedPath::as_str);
    let route = matched
        .and_then(|path| ROUTES.iter().find(|route| **route == path))
        .copied()
        .unwrap_or(UNMATCHED);
    let method = request.method().clone();
    // A client that waits for `100 Continue` sends nothing that would have to be read after a refusal.
    let expects = request.headers().contains_key(header::EXPECT);
    let (request, rest) = if request.body().is_end_stream() || expects {
        (request, None)
    } else {
        let (parts, whole) = request.into_parts();
        let (body, rest) = body::share(whole);
        (Request::from_parts(parts, body), Some(rest))
    };
    let mut request = request;
    let checked =
        app.settings.access.check(&method, request.uri(), route, request.headers()).map(|key| {
            let address = request.extensions().get::<ConnectInfo<SocketAddr>>();
            match (key, address) {
                (Some(key), _) => Client::Caller(app.callers.hash_one(key)),
                (None, Some(from)) => Client::Caller(app.callers.hash_one(from.0.ip())),
                (None, None) => Client::Unnamed,
            }
        });
    let response = match checked {
        Ok(client) => {
            request.extensions_mut().insert(Caller(client));
            next.run(request).await
        }
        Err(problem) => problem.into_response(),
    };
    if let (Some(rest), true) = (rest, response.status().as_u16() >= 400) {
        rest.linger().await;
    }
    app.metrics.answered(route, &method, response.status().as_u16());
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
    use axum::http::{HeaderName, HeaderValue, Method};
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
            .allow_headers([header::AUTHORIZATION, header::CONTENT_TYPE, header::IF_NONE_MATCH])
            .expose_headers([
                header::ETAG,
                header::RETRY_AFTER,
                header::LOCATION,
                HeaderName::from_static("server-timing"),
                frame::RECEIPT_HEADER,
            ]),
    )
}

/// Path parameters whose failure is a problem like any other.
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
