//! Handlers for health, readiness, metrics, limits and the contract.

use std::sync::{Arc, LazyLock};
use std::time::Duration;

use axum::Json;
use axum::extract::{Extension, State};
use axum::http::{HeaderName, HeaderValue, Method, Uri, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;

use super::access::Quotas;
use super::problem::{Kind, Problem};
use super::telemetry::Telemetry;
use super::{App, NoQuery, Owner, Phase, ROUTES, metrics as exposition, openapi_yaml};
use crate::engine::{Limits, Readiness};
use crate::plan::{self, Setting};
use crate::spelling::nearest;

const PLAIN: [(HeaderName, HeaderValue); 2] = [
    (header::CONTENT_TYPE, HeaderValue::from_static("text/plain; charset=utf-8")),
    (header::CACHE_CONTROL, HeaderValue::from_static("no-store")),
];

const FAILED: &str = "the render thread has ended; restart the server";

/// Liveness: the process answers. Answers 503 once the process can no longer draw and has to be restarted.
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

/// Readiness: the server can draw frames now. Answers 503 while scenes load at the start, when the render loop
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

/// Sends metrics to a collector once more, at the end.
pub async fn push_last_metrics(app: &App, telemetry: &Telemetry) -> Result<(), String> {
    let text = app.metrics.exposition().map_err(|error| error.to_string())?;
    telemetry.push(&text).await
}

/// Sends metrics to a collector again and again, for as long as the process lives.
pub async fn push_metrics(app: Arc<App>, telemetry: Arc<Telemetry>) {
    let mut interval = tokio::time::interval(telemetry.interval());
    interval.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let mut is_failing = false;
    loop {
        interval.tick().await;
        let Ok(text) = app.metrics.exposition() else { continue };
        let pushed = telemetry.push(&text).await;
        match pushed {
            // Once, not each minute.
            Err(error) if !is_failing => {
                tracing::warn!(
                    error,
                    "cannot send metrics to the OpenTelemetry collector; further tries follow"
                );
                is_failing = true;
            }
            Err(_) => {}
            Ok(()) => is_failing = false,
        }
    }
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

/// The settings of frames: names, values, defaults, and which settings depend on which others.
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

/// Limits of the server.
#[derive(Serialize, ToSchema)]
pub struct ServerLimits {
    #[serde(flatten)]
    engine: Limits,
    /// Largest total size of the files of one upload, in bytes.
    max_upload_bytes: u64,
    uploads: UploadLimits,
    max_connections: usize,
    /// Largest width times height of the frames of a comparison, and of a measurement of accuracy.
    max_compare_pixels: u64,
    max_accuracy_pixels: u64,
    /// Longest wait for a frame, in milliseconds.
    frame_timeout_ms: u64,
    /// Maximum number of open streams, in total and per client.
    max_streams: usize,
    max_streams_per_client: usize,
    /// Milliseconds after which a stream is closed if its client sends nothing, or an `mjpeg` if its client reads nothing.
    stream_idle_ms: u64,
    /// Largest message that a stream's client may send, in bytes.
    max_stream_message_bytes: usize,
    /// Messages per second that a stream's client may send; bursts may be four times as large.
    max_stream_messages_per_second: u32,
    /// Limits of jobs; `null` if this server accepts none.
    jobs: Option<JobLimits>,
    /// Limits of the request's key; `null` if this server asks for none.
    key: Option<KeyLimits>,
}

/// Limits of one key; `null` where only the limits of the server apply.
#[derive(Serialize, ToSchema)]
pub struct KeyLimits {
    /// Maximum number of uploaded scenes, and of their bytes on disk.
    max_scenes: Option<u64>,
    max_bytes: Option<u64>,
    /// Maximum number of open streams.
    max_streams: Option<usize>,
    max_requests_per_second: Option<f64>,
    /// Maximum GPU time in milliseconds per minute.
    max_device_ms_per_minute: Option<u64>,
}

impl KeyLimits {
    fn of(quotas: &Quotas) -> KeyLimits {
        let Quotas { scenes, bytes, device_ms_per_minute, streams, requests_per_second } = *quotas;
        KeyLimits {
            max_scenes: scenes,
            max_bytes: bytes,
            max_streams: streams,
            max_requests_per_second: requests_per_second,
            max_device_ms_per_minute: device_ms_per_minute,
        }
    }
}

/// Limits and current use of uploads. Limits per key apply if the server asks for keys.
#[derive(Serialize, ToSchema)]
pub struct UploadLimits {
    /// Maximum number of uploaded scenes, in total and per key.
    max_scenes: u64,
    max_scenes_per_key: u64,
    /// Maximum disk space of uploads in bytes, in total and per key.
    max_bytes: u64,
    max_bytes_per_key: u64,
    scenes: u64,
    bytes: u64,
}

/// Limits and current use of jobs.
#[derive(Serialize, ToSchema)]
pub struct JobLimits {
    /// Maximum number of queued and running jobs. A job that waits for its scene does not count.
    max_unfinished: usize,
    /// Maximum number of queued and running jobs of one API key, including those that wait for their scene.
    max_unfinished_per_key: usize,
    /// Maximum number of stored jobs, ended ones included. Beyond it, the oldest ended job of the key that has most of them is deleted.
    max_kept: usize,
    /// Maximum number of frames of one path.
    max_frames: u64,
    /// Maximum disk space of all jobs in bytes; `bytes` is the current use.
    max_bytes: u64,
    bytes: u64,
    /// Milliseconds for which an ended job is kept, and for which a job waits for its scene.
    ttl_ms: u64,
    /// Maximum number of jobs whose frames are drawn at the same time.
    max_drawing: usize,
    /// Maximum number of open answers that follow jobs (`events`, `multipart`), in total and per client.
    max_watchers: usize,
    max_watchers_per_client: usize,
    /// Milliseconds after which an answer that follows a job ends, and the client has to reconnect.
    watch_ms: u64,
}

/// The limits in force. The server refuses requests beyond them with 413, 422, 429 or 507.
#[utoipa::path(
    get,
    path = "/v1/limits",
    operation_id = "getLimits",
    tag = "service",
    responses((status = 200, description = "The limits", body = ServerLimits)),
)]
pub async fn limits(
    State(app): State<Arc<App>>,
    Extension(owner): Extension<Owner>,
    _: NoQuery,
) -> Json<ServerLimits> {
    let (settings, rules) = (&app.settings, app.rules());
    let bounds = &rules.bounds;
    let ms = |duration: Duration| u64::try_from(duration.as_millis()).unwrap_or(u64::MAX);
    Json(ServerLimits {
        engine: app.engine.limits(),
        max_upload_bytes: bounds.max_upload_bytes,
        uploads: {
            let (limits, held) = (&bounds.uploads, app.uploads.held());
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
        max_compare_pixels: super::compare::MOST_PIXELS,
        max_accuracy_pixels: crate::accuracy::service::MOST_PIXELS,
        frame_timeout_ms: ms(settings.frame_timeout),
        max_streams: bounds.streams.most,
        max_streams_per_client: bounds.streams.most_per_client,
        stream_idle_ms: ms(bounds.streams.idle),
        max_stream_message_bytes: super::stream::MAX_MESSAGE_BYTES,
        max_stream_messages_per_second: super::stream::MOST_MESSAGES_PER_SECOND,
        jobs: app.jobs.as_ref().ok().map(|jobs| {
            let config = jobs.config();
            JobLimits {
                max_unfinished: config.limits.most_unfinished,
                max_unfinished_per_key: config.limits.most_unfinished_per_owner(),
                max_kept: config.limits.most,
                max_frames: crate::film::shots::MOST_FRAMES,
                max_bytes: config.most_bytes,
                bytes: jobs.used_bytes(),
                ttl_ms: config.limits.ttl_ms,
                max_drawing: config.limits.slots.drawing,
                max_watchers: bounds.watches.most,
                max_watchers_per_client: bounds.watches.most_per_client,
                watch_ms: ms(bounds.watches.longest),
            }
        }),
        key: owner.name.as_ref().map(|_| KeyLimits::of(&owner.quotas)),
    })
}

/// Answers an address that the listener for monitoring lacks.
pub async fn not_monitored(uri: Uri) -> Problem {
    nothing_at(&shortened(&uri)).accepted("/metrics, /healthz or /readyz")
}

pub async fn unknown_route(State(app): State<Arc<App>>, uri: Uri) -> Problem {
    let path = shortened(&uri);
    let is_here = |route: &&str| *route != "/metrics" || !app.settings.edge.metrics_apart;
    let known = ROUTES.iter().copied().filter(|route| route.starts_with('/')).filter(is_here);
    let problem = nothing_at(&path);
    match nearest(&path, known) {
        Some(route) => problem.accepted(format!("{route}; all routes are in /openapi.yaml")),
        None => problem.accepted("the routes in /openapi.yaml"),
    }
}

pub async fn method_not_allowed(method: Method, uri: Uri) -> Problem {
    let path = shortened(&uri);
    Problem::new(Kind::MethodNotAllowed, format!("{path} does not take {method}"))
        .accepted("the methods in the Allow header")
}

fn nothing_at(path: &str) -> Problem {
    Problem::new(Kind::UnknownRoute, format!("there is nothing at {path}"))
}

/// Returns the part of a path that an answer repeats.
fn shortened(uri: &Uri) -> String {
    uri.path().chars().take(128).collect()
}
