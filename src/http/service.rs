//! Handlers for health, readiness, metrics, limits and the contract.

use std::sync::{Arc, LazyLock};
use std::time::Duration;

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderName, HeaderValue, Method, Uri, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;

use super::problem::{Kind, Problem, nearest};
use super::{App, NoQuery, Phase, ROUTES, metrics as exposition, openapi_yaml};
use crate::engine::{Limits, Readiness};
use crate::plan::{self, Setting};

const PLAIN: [(HeaderName, HeaderValue); 2] = [
    (header::CONTENT_TYPE, HeaderValue::from_static("text/plain; charset=utf-8")),
    (header::CACHE_CONTROL, HeaderValue::from_static("no-store")),
];

const FAILED: &str = "the render thread ended; the server has to be started again";

/// Liveness: the process answers. 503 once it can never draw again and has to be started anew.
#[utoipa::path(
    get,
    path = "/healthz",
    operation_id = "getHealth",
    tag = "service",
    responses((status = 200, description = "Alive", body = String, content_type = "text/plain")),
)]
pub async fn healthz(State(app): State<Arc<App>>) -> Result<Response, Problem> {
    if app.engine.readiness() == Readiness::Failed {
        return Err(Problem::new(Kind::NotReady, FAILED));
    }
    Ok((PLAIN, "ok\n").into_response())
}

/// Readiness: frames can be had now. 503 while scenes load at the start, when the render loop
/// stalls or has ended, when the GPU is lost, and while the server drains.
#[utoipa::path(
    get,
    path = "/readyz",
    operation_id = "getReadiness",
    tag = "service",
    responses((status = 200, description = "Ready", body = String, content_type = "text/plain")),
)]
pub async fn readyz(State(app): State<Arc<App>>) -> Result<Response, Problem> {
    let reason = match (app.phase(), app.engine.readiness()) {
        (_, Readiness::Failed) => return Err(Problem::new(Kind::NotReady, FAILED)),
        (Phase::Leaving | Phase::Draining, _) | (_, Readiness::Draining) => "draining".to_owned(),
        (_, Readiness::Stalled { for_ms }) => {
            format!("the render loop has stalled for {for_ms} ms")
        }
        (_, Readiness::DeviceLost) => "the GPU was lost; scenes are being rebuilt".to_owned(),
        (Phase::Starting, _) => "loading scenes".to_owned(),
        (_, Readiness::Starting) => "starting".to_owned(),
        (Phase::Serving, Readiness::Ready) => return Ok((PLAIN, "ready\n").into_response()),
    };
    Err(Problem::new(Kind::NotReady, reason).retry_after(Duration::from_secs(1)))
}

/// Prometheus metrics.
#[utoipa::path(
    get,
    path = "/metrics",
    operation_id = "getMetrics",
    tag = "service",
    responses((status = 200, description = "OpenMetrics text", body = String, content_type = "application/openmetrics-text")),
)]
pub async fn metrics(State(app): State<Arc<App>>) -> Result<Response, Problem> {
    let text = app.metrics.exposition().map_err(Problem::internal)?;
    let content_type = HeaderValue::from_static(exposition::OPENMETRICS);
    Ok(([(header::CONTENT_TYPE, content_type)], text).into_response())
}

/// This contract.
#[utoipa::path(
    get,
    path = "/openapi.yaml",
    operation_id = "getContract",
    tag = "service",
    responses((status = 200, description = "OpenAPI", body = Object, content_type = "application/yaml")),
)]
pub async fn openapi() -> Result<Response, Problem> {
    const YAML: HeaderValue = HeaderValue::from_static("application/yaml");
    static CONTRACT: LazyLock<Result<String, String>> =
        LazyLock::new(|| openapi_yaml().map_err(|error| error.to_string()));
    let text = CONTRACT.as_ref().map_err(Problem::internal)?;
    Ok(([(header::CONTENT_TYPE, YAML)], text.as_str()).into_response())
}

/// The JSON Schema of scene files, for editors.
#[utoipa::path(
    get,
    path = "/v1/scene-schema.json",
    operation_id = "getSceneSchema",
    tag = "service",
    responses((status = 200, description = "JSON Schema", body = Object, content_type = "application/schema+json")),
)]
pub async fn scene_schema() -> Response {
    const SCHEMA: HeaderValue = HeaderValue::from_static("application/schema+json");
    let text = crate::scene::json_schema().to_string();
    ([(header::CONTENT_TYPE, SCHEMA)], text).into_response()
}

/// Settings of a frame, in the order in which the viewer shows them.
#[derive(Serialize, ToSchema)]
pub struct SettingList {
    settings: &'static [Setting],
}

/// The settings that a frame may have: names, values, defaults, and which go with which others.
#[utoipa::path(
    get,
    path = "/v1/settings",
    operation_id = "getSettings",
    tag = "service",
    responses((status = 200, description = "The settings", body = SettingList)),
)]
pub async fn settings(_: NoQuery) -> Json<SettingList> {
    Json(SettingList { settings: plan::declared() })
}

/// What the server takes on at most.
#[derive(Serialize, ToSchema)]
pub struct ServerLimits {
    #[serde(flatten)]
    engine: Limits,
    /// Bytes of one upload, all its files together.
    max_upload_bytes: u64,
    uploads: UploadLimits,
    max_connections: usize,
    /// Longest wait for a frame, in milliseconds.
    frame_timeout_ms: u64,
    /// Streams at the same time: of all clients, and of one.
    max_streams: usize,
    max_streams_per_client: usize,
    /// A stream on which nothing came from its client for so long is closed; so is an `mjpeg` of which nothing was taken.
    stream_idle_ms: u64,
    /// Bytes of one message of a stream's client.
    max_stream_message_bytes: usize,
    /// Messages of a stream's client in a second; four times as many at once.
    max_stream_messages_per_second: u32,
    /// Of jobs, where this server draws any.
    jobs: Option<JobLimits>,
}

/// What uploads may hold, and what they hold now. Limits of a key apply where keys are asked for.
#[derive(Serialize, ToSchema)]
pub struct UploadLimits {
    /// Uploaded scenes: of all clients, and of one key.
    max_scenes: u64,
    max_scenes_per_key: u64,
    /// Bytes of uploads on the disk: of all clients, and of one key.
    max_bytes: u64,
    max_bytes_per_key: u64,
    scenes: u64,
    bytes: u64,
}

/// What jobs may take.
#[derive(Serialize, ToSchema)]
pub struct JobLimits {
    /// Jobs that are queued or running.
    max_unfinished: usize,
    /// Jobs at all.
    max_kept: usize,
    /// Frames of one path.
    max_frames: u64,
    /// Bytes of all jobs on the disk, and how many there are now.
    max_bytes: u64,
    bytes: u64,
    /// How long a job is kept after it ended, and how long one waits for its scene.
    ttl_ms: u64,
    /// Jobs whose frames are drawn at the same time.
    max_drawing: usize,
    /// Answers that follow jobs (`events`, `multipart`) at the same time: of all clients, and of one.
    max_watchers: usize,
    max_watchers_per_client: usize,
    /// How long such an answer may wait before it ends and the client has to come again.
    watch_ms: u64,
}

/// The limits in force; what is beyond them is refused with 413, 422, 429 or 507.
#[utoipa::path(
    get,
    path = "/v1/limits",
    operation_id = "getLimits",
    tag = "service",
    responses((status = 200, description = "The limits", body = ServerLimits)),
)]
pub async fn limits(State(app): State<Arc<App>>, _: NoQuery) -> Json<ServerLimits> {
    let settings = &app.settings;
    let ms = |duration: Duration| u64::try_from(duration.as_millis()).unwrap_or(u64::MAX);
    Json(ServerLimits {
        engine: app.engine.limits(),
        max_upload_bytes: settings.max_upload_bytes,
        uploads: {
            let (limits, held) = (app.uploads.limits(), app.uploads.held());
            UploadLimits {
                max_scenes: limits.scenes,
                max_scenes_per_key: limits.scenes_per_key,
                max_bytes: limits.bytes,
                max_bytes_per_key: limits.bytes_per_key,
                scenes: held.scenes,
                bytes: held.bytes,
            }
        },
        max_connections: settings.max_connections,
        frame_timeout_ms: ms(settings.frame_timeout),
        max_streams: settings.streams.most,
        max_streams_per_client: settings.streams.most_per_client,
        stream_idle_ms: ms(settings.streams.idle),
        max_stream_message_bytes: super::stream::MAX_MESSAGE_BYTES,
        max_stream_messages_per_second: super::stream::MOST_MESSAGES_PER_SECOND,
        jobs: app.jobs.as_ref().ok().map(|jobs| {
            let config = jobs.config();
            JobLimits {
                max_unfinished: config.limits.most_unfinished,
                max_kept: config.limits.most,
                max_frames: crate::film::shots::MOST_FRAMES,
                max_bytes: config.most_bytes,
                bytes: jobs.used_bytes(),
                ttl_ms: config.limits.ttl_ms,
                max_drawing: config.limits.slots.drawing,
                max_watchers: settings.watches.most,
                max_watchers_per_client: settings.watches.most_per_client,
                watch_ms: ms(settings.watches.longest),
            }
        }),
    })
}

pub async fn unknown_route(uri: Uri) -> Problem {
    let path: String = uri.path().chars().take(128).collect();
    let known = ROUTES.iter().copied().filter(|route| route.starts_with('/'));
    let problem = Problem::new(Kind::UnknownRoute, format!("there is nothing at {path}"));
    match nearest(&path, known) {
        Some(route) => problem.accepted(format!("{route}; all routes are in /openapi.yaml")),
        None => problem.accepted("the routes in /openapi.yaml"),
    }
}

pub async fn method_not_allowed(method: Method, uri: Uri) -> Problem {
    let path: String = uri.path().chars().take(128).collect();
    Problem::new(Kind::MethodNotAllowed, format!("{path} does not take {method}"))
        .accepted("the methods in the Allow header")
}
