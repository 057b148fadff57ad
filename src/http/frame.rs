//! `GET /v1/scenes/{id}/frame`.

use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::body::Body;
use axum::extract::{Extension, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};

use super::journal::Spent;
use super::problem::{Kind, Problem};
use super::{App, Caller, Phase, Segments, conditional, headers};
use crate::encode::ImageFormat;
use crate::engine::{
    EncodedFrame, EngineError, FrameRequest, FrameTicket, Origin, RequestId, Resolution,
    ResolvedFrame,
};
use crate::plan::Given;

use super::params::FrameParams;

pub const RECEIPT_HEADER: HeaderName = HeaderName::from_static("pointillist-receipt");
/// Header that says why little or nothing is visible, why a goal is not promised, that translucent surfaces may be missing, or that the frame is
/// provisional.
pub const WARNING_HEADER: HeaderName = HeaderName::from_static("pointillist-warning");
pub const SERVER_TIMING: HeaderName = HeaderName::from_static("server-timing");
/// Time for which a bake goes on after the deadline of the request that needed it.
const BAKE_AFTER_DEADLINE: Duration = Duration::from_secs(60);
/// Longest wait of one frame of several for a place in the queue.
const MAX_QUEUEING: Duration = Duration::from_secs(30);
/// `Retry-After` of a request whose deadline passed during a bake.
pub(super) const RETRY_LATE: Duration = Duration::from_secs(1);
const REVALIDATE: HeaderValue = HeaderValue::from_static("no-cache");

/// A frame.
///
/// The entity tag is a hash of everything that the image depends on and is known before rendering:
/// `If-None-Match` costs no GPU work, and neither does `HEAD`. `Pointillist-Receipt` says what was
/// understood and done, `Server-Timing` what it cost. Without `format`, the header `Accept` names the formats.
#[utoipa::path(
    get,
    path = "/v1/scenes/{id}/frame",
    operation_id = "getFrame",
    tag = "frames",
    params(
        ("id" = String, Path, description = "A scene that `GET /v1/scenes` lists"),
        FrameParams,
        Given,
        ("If-None-Match" = Option<String>, Header, description = "Entity tags that the client has"),
        ("Prefer" = Option<String>, Header, description = "`wait=SECONDS`, where `deadline_ms` is not given"),
    ),
    responses(
        (
            status = 200,
            description = "The image",
            content(
                (Vec<u8> = "image/png"),
                (Vec<u8> = "image/jpeg"),
                (Vec<u8> = "image/webp"),
                (Vec<u8> = "image/qoi"),
                (Vec<u8> = "image/x-exr"),
                (Vec<u8> = "image/x-portable-floatmap"),
                (Vec<u8> = "application/octet-stream"),
            ),
            headers(
                ("ETag" = String, description = "Strong, known before rendering"),
                ("Server-Timing" = String, description = "Milliseconds of queue, batch, each pass, device-wait, readback, encode-wait, encode, and their total"),
                ("Pointillist-Receipt" = String, description = "A `Receipt` as one line of JSON, ASCII only"),
                ("Pointillist-Warning" = Option<String>, description = "Why little or nothing can be seen in the image, why a goal is not promised, that translucent surfaces may be missing, or that the frame is provisional, where that is so"),
            ),
        ),
        (status = 304, description = "The client has this frame already"),
    ),
)]
pub async fn frame(
    State(app): State<Arc<App>>,
    Extension(Caller(client, caps)): Extension<Caller>,
    Extension(request_id): Extension<RequestId>,
    Segments(id): Segments<String>,
    method: Method,
    uri: Uri,
    request_headers: HeaderMap,
) -> Result<Response, Problem> {
    let params = FrameParams::from_query(uri.query())?;
    let (format, negotiated) = choose_format(&params, &request_headers)?;
    let now = Instant::now();
    let mut request = params.request(&id, format, now)?;
    if request.deadline.is_none() {
        request.deadline = conditional::prefer_wait(&request_headers)
            .and_then(|seconds| now.checked_add(Duration::from_secs(seconds)));
    }

    // A key that owes time gets what it has already, and starts no work.
    let check_time =
        || client.owner().map_or(Ok(()), |key| app.limits.check_device(key, Instant::now()));
    let resolved = resolve_if(&app, request, check_time);
    let resolved = resolved.await.map_err(|problem| missing(&app, &id, problem))?;
    app.check_caps(&caps, &resolved)?;
    let etag = resolved.final_etag();
    let tag = match etag {
        Some(etag) => Some(
            HeaderValue::from_str(etag)
                .map_err(|_| Problem::internal(format!("the tag {etag:?} is no header")))?,
        ),
        // The next answer may show another picture.
        None => None,
    };
    if etag.is_some_and(|etag| conditional::none_match_hits(&request_headers, etag)) {
        app.metrics.not_modified.inc();
        let mut response = StatusCode::NOT_MODIFIED.into_response();
        validators(response.headers_mut(), tag, negotiated);
        return Ok(response);
    }
    check_time()?;
    if method == Method::HEAD {
        // A body of unknown length, so that the library adds no `Content-Length`.
        let body =
            Body::from_stream(futures::stream::empty::<Result<bytes::Bytes, std::io::Error>>());
        let mut response = Response::new(body);
        let media_type = HeaderValue::from_static(conditional::media_type(format));
        response.headers_mut().insert(header::CONTENT_TYPE, media_type);
        validators(response.headers_mut(), tag, negotiated);
        return Ok(response);
    }

    let ticket = app.engine.queue(Origin { client, request_id }, resolved.clone())?;
    let frame = wait(&app, ticket, resolved.request.deadline).await?;
    app.metrics.frame(&frame);
    let body = app.unread.hold(client, frame.bytes.clone(), &app.engine.admission())?;
    let mut response = Response::new(body);
    let headers = response.headers_mut();
    for (name, value) in receipt_headers(&frame) {
        headers.insert(name, value);
    }
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    // After a device loss another adapter may have drawn the frame.
    let tag = tag.filter(|_| frame.receipt.adapter == resolved.adapter());
    validators(headers, tag, negotiated);
    response.extensions_mut().insert(Spent::of(&frame.receipt));
    Ok(response)
}

/// Resolves a request after the bake that it needs, which may take seconds. After the request's deadline the bake goes on for
/// [`BAKE_AFTER_DEADLINE`], because the client will try again.
pub async fn resolve(app: &App, request: FrameRequest) -> Result<Arc<ResolvedFrame>, Problem> {
    resolve_if(app, request, || Ok(())).await
}

/// Resolves a request as [`resolve`] does, and bakes nothing unless `check` allows it.
async fn resolve_if(
    app: &App,
    request: FrameRequest,
    check: impl FnOnce() -> Result<(), Problem>,
) -> Result<Arc<ResolvedFrame>, Problem> {
    let unbaked = match app.engine.resolve(request)? {
        Resolution::Ready(frame) => return Ok(frame),
        Resolution::NeedsBake(unbaked) => unbaked,
    };
    check()?;
    let Some(deadline) = unbaked.request().deadline else { return Ok(unbaked.bake().await?) };
    let mut frame = Box::pin(unbaked.bake());
    match tokio::time::timeout_at(deadline.into(), &mut frame).await {
        Ok(result) => Ok(result?),
        Err(_) => {
            tokio::spawn(tokio::time::timeout(BAKE_AFTER_DEADLINE, frame));
            Err(EngineError::DeadlineExceeded { retry_after: RETRY_LATE }.into())
        }
    }
}

/// Chooses the format, and returns whether `Accept` decided it.
pub fn choose_format(
    params: &FrameParams,
    headers: &HeaderMap,
) -> Result<(ImageFormat, bool), Problem> {
    match params.format()? {
        Some(format) => Ok((format, false)),
        None => Ok((conditional::negotiate(headers, params.output()?)?, true)),
    }
}

/// Replaces the 404 of a scene that is still loading, or whose load failed.
pub fn missing(app: &App, id: &str, problem: Problem) -> Problem {
    if problem.status() != 404 {
        return problem;
    }
    match app.registry.get(id) {
        // A balancer may ask another server, which has its scenes already.
        Some(super::registry::Entry::Loading { .. }) if app.phase() == Phase::Starting => {
            let detail = format!("scene `{id}` is still loading: the server is starting");
            Problem::new(Kind::NotReady, detail).retry_after(Duration::from_secs(1))
        }
        Some(super::registry::Entry::Loading { .. }) => {
            Problem::new(Kind::SceneLoading, format!("scene `{id}` is still loading"))
                .retry_after(Duration::from_secs(1))
        }
        // A balancer asks another server, which may have had more memory.
        Some(super::registry::Entry::Failed { problem, .. })
            if super::upload::follow::is_followed(app, id) =>
        {
            let detail = format!(
                "this server could not load scene `{id}`, and tries again: {}",
                problem.detail
            );
            Problem::new(Kind::NotReady, detail).retry_after(Duration::from_secs(5))
        }
        Some(super::registry::Entry::Failed { problem, .. }) => problem,
        Some(super::registry::Entry::Removing { .. }) => problem,
        None if super::upload::follow::is_coming(app, id) => Problem::new(
            Kind::SceneLoading,
            format!("scene `{id}` was uploaded and is not loaded yet"),
        )
        .retry_after(Duration::from_secs(1)),
        None => problem,
    }
}

/// Queues a frame. While the queue is full, waits for a place, at most until the frame's deadline and for [`MAX_QUEUEING`]: for requests of several
/// frames, whose own frames fill the queue.
pub(super) async fn queue_patiently(
    app: &App,
    origin: &Origin,
    frame: &Arc<ResolvedFrame>,
) -> Result<FrameTicket, EngineError> {
    let end = Instant::now() + MAX_QUEUEING;
    let end = frame.request.deadline.map_or(end, |deadline| deadline.min(end));
    loop {
        match app.engine.queue(origin.clone(), frame.clone()) {
            Err(EngineError::Busy { retry_after }) if Instant::now() < end => {
                let pause = retry_after.clamp(Duration::from_millis(2), Duration::from_secs(1));
                tokio::time::sleep(pause).await;
            }
            queued => return queued,
        }
    }
}

/// Waits for a frame, at most until its deadline or the server's limit. Dropping the future drops the ticket.
pub async fn wait(
    app: &App,
    ticket: FrameTicket,
    deadline: Option<Instant>,
) -> Result<Arc<EncodedFrame>, Problem> {
    let limit = app.settings.frame_timeout;
    let end = Instant::now() + limit;
    let is_due_before = deadline.is_some_and(|deadline| deadline < end);
    match tokio::time::timeout_at(deadline.map_or(end, |due| due.min(end)).into(), ticket).await {
        Ok(result) => Ok(result?),
        Err(_) if is_due_before => {
            Err(EngineError::DeadlineExceeded { retry_after: RETRY_LATE }.into())
        }
        Err(_) => Err(Problem::new(
            Kind::FrameTimeout,
            format!("the frame was not finished within {} seconds", limit.as_secs()),
        )
        .retry_after(limit)),
    }
}

/// Builds the headers for content type, receipt, warning and timing of a frame, or of a part with a frame.
pub fn receipt_headers(frame: &EncodedFrame) -> Vec<(HeaderName, HeaderValue)> {
    let mut found = vec![(header::CONTENT_TYPE, HeaderValue::from_static(frame.content_type))];
    found.extend(headers::receipt(&frame.receipt).map(|value| (RECEIPT_HEADER, value)));
    found.extend(headers::warning(&frame.receipt).map(|value| (WARNING_HEADER, value)));
    found.extend(headers::server_timing(&frame.receipt).map(|value| (SERVER_TIMING, value)));
    found
}

/// Sets the headers for caches. An answer without a tag is not stored.
fn validators(headers: &mut HeaderMap, etag: Option<HeaderValue>, negotiated: bool) {
    let Some(etag) = etag else {
        headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
        return;
    };
    headers.insert(header::ETAG, etag);
    headers.insert(header::CACHE_CONTROL, REVALIDATE);
    if negotiated {
        headers.insert(header::VARY, HeaderValue::from_static("accept"));
    }
}
