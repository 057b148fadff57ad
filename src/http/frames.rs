//! `POST /v1/scenes/{id}/frames`: many poses, one streamed `multipart/mixed` answer.
//!
//! Poses are submitted a window ahead of the part that is being written, so that the engine can batch them. The window is
//! limited, so that one client does not fill the queue. When the queue is full, the stream waits for a place; a pose that still
//! gets none is answered with a part that holds the problem.

use std::collections::VecDeque;
use std::fmt::Write;
use std::hash::{BuildHasher, Hasher, RandomState};
use std::sync::Arc;
use std::time::Instant;

use axum::body::Body;
use axum::extract::{Extension, State};
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::Response;
use bytes::Bytes;
use futures::Stream;
use serde::Deserialize;
use utoipa::ToSchema;

use super::access::signed::Caps;
use super::frame::{choose_format, missing, queue_patiently, receipt_headers, resolve, wait};
use super::limits::{LONGEST_PAUSE, Standing};
use super::params::FrameParams;
use super::problem::{Kind, PROBLEM_JSON, Problem};
use super::{App, Caller, NoQuery, Phase, Segments, body};
use crate::encode::ImageFormat;
use crate::engine::{
    Client, EncodedFrame, EngineError, FrameRequest, FrameTicket, Origin, RequestId,
};
use crate::film::MOST_PIXELS;
use crate::memory::Reservation;

/// Largest body in bytes.
const MAX_BODY_BYTES: u64 = 16 << 20;
/// Largest number of poses in one request.
pub const MAX_POSES: usize = 10_000;

/// Poses, and the parameters that they share.
#[derive(Deserialize, ToSchema)]
pub struct FramesRequest {
    /// Each pose may set any parameter of a frame's query. Missing parameters take the values given beside `poses`.
    #[schema(value_type = Vec<FrameParams>)]
    poses: Vec<serde_json::Value>,
    #[serde(flatten)]
    #[schema(value_type = FrameParams)]
    defaults: serde_json::Map<String, serde_json::Value>,
}

/// Frames for many poses, streamed in order.
///
/// Each part has its own `Content-Type`, `Content-Length`, `Pointillist-Receipt` and
/// `Server-Timing`; its receipt's `request_id` is the request's with the pose's number from 0, as in `4bf92f35/7`.
/// A value that is invalid in every frame refuses the whole request. A pose that cannot be drawn because of other parameters or the scene becomes a part of type `application/problem+json`;
/// the other poses are drawn. `deadline_ms` counts from the moment a pose's turn comes.
/// Without `format`, the header `Accept` names the formats; `multipart/mixed` in it is ignored.
#[utoipa::path(
    post,
    path = "/v1/scenes/{id}/frames",
    operation_id = "drawFrames",
    tag = "frames",
    params(
        ("id" = String, Path, description = "A scene that `GET /v1/scenes` lists"),
    ),
    request_body(content = FramesRequest, content_type = "application/json"),
    responses((status = 200, description = "One part per pose, in order", body = Vec<u8>, content_type = "multipart/mixed")),
)]
pub async fn frames(
    State(app): State<Arc<App>>,
    Extension(Caller(client, caps)): Extension<Caller>,
    Extension(request_id): Extension<RequestId>,
    Segments(id): Segments<String>,
    _: NoQuery,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let admission = app.engine.admission();
    let patience = app.settings.read_timeout;
    let request: FramesRequest =
        body::json(&headers, body, MAX_BODY_BYTES, patience, &admission).await?;
    let defaults = FrameParams::from_json(serde_json::Value::Object(request.defaults), "")?;
    if request.poses.is_empty() || request.poses.len() > MAX_POSES {
        return Err(Problem::new(
            Kind::BadBody,
            format!("`poses` has {} entries", request.poses.len()),
        )
        .at("poses")
        .accepted(format!("1 to {MAX_POSES} poses")));
    }
    let longest = app.engine.limits().max_side;
    defaults.check()?;
    defaults.check_sides(longest)?;
    let bytes = request.poses.len() * size_of::<FrameParams>();
    admission.grow("poses", bytes as u64).map_err(EngineError::from)?;
    let poses = request.poses.into_iter().enumerate();
    let poses: Result<Vec<FrameParams>, Problem> =
        poses.map(|(index, pose)| read_pose(index, pose, longest)).collect();
    let poses = poses?;
    app.engine.scene(&id).map_err(|error| missing(&app, &id, error.into()))?;
    let boundary = boundary();
    let content_type = format!("multipart/mixed; boundary={boundary}");
    let headers = image_ranges(&headers);
    // What the body took besides is released.
    admission.shrink_to(bytes as u64);
    let held = admission.keep(bytes as u64);
    let batch = Batch { app, client, caps, request_id, id, defaults, headers, poses, _held: held };
    let mut response = Response::new(Body::from_stream(parts(batch, boundary)));
    let content_type = HeaderValue::from_str(&content_type).map_err(Problem::internal)?;
    response.headers_mut().insert(header::CONTENT_TYPE, content_type);
    response.headers_mut().insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    Ok(response)
}

/// Reads and checks the parameters of pose `index`. `longest` is the longest side of a frame, in pixels.
fn read_pose(index: usize, pose: serde_json::Value, longest: u32) -> Result<FrameParams, Problem> {
    let place = format!("poses[{index}]");
    let params = FrameParams::from_json(pose, &place)?;
    params.check().and_then(|()| params.check_sides(longest)).map_err(|problem| {
        let parameter = problem.parameter.clone().unwrap_or_default();
        problem.at(format!("{place}.{parameter}"))
    })?;
    Ok(params)
}

/// Returns the ranges of `Accept` that are not for the container.
fn image_ranges(headers: &HeaderMap) -> HeaderMap {
    let mut kept = HeaderMap::new();
    for value in headers.get_all(header::ACCEPT) {
        let ranges: Vec<&str> = value
            .to_str()
            .unwrap_or_default()
            .split(',')
            .filter(|range| !range.trim_start().starts_with("multipart/"))
            .collect();
        if let Ok(value) = HeaderValue::from_str(&ranges.join(",")) {
            kept.append(header::ACCEPT, value);
        }
    }
    kept
}

/// Returns a random boundary, which no client can have drawn into an image.
pub(super) fn boundary() -> String {
    let random = || RandomState::new().build_hasher().finish();
    format!("pointillist-{:016x}{:016x}", random(), random())
}

/// A queued frame.
struct Promised {
    ticket: FrameTicket,
    deadline: Option<Instant>,
    pixels: u64,
}

/// Returns the number of pixels of all queued frames.
fn pixels_of(pending: &VecDeque<Result<Promised, Problem>>) -> u64 {
    pending.iter().flatten().map(|promised| promised.pixels).sum()
}

/// Returns whether another frame may be queued ahead of the one to send, beside `pending` frames with so many pixels. Finished frames
/// stay in memory until the client reads them, so the window is limited in pixels, too.
fn has_room(window: usize, pending: usize, pixels: u64) -> bool {
    pending == 0 || (pending < window && pixels < MOST_PIXELS)
}

struct Batch {
    app: Arc<App>,
    client: Client,
    request_id: RequestId,
    id: String,
    defaults: FrameParams,
    headers: HeaderMap,
    poses: Vec<FrameParams>,
    caps: Caps,
    /// Memory of the poses.
    _held: Reservation,
}

impl Batch {
    /// Takes the parameters of pose `index` out of the request.
    fn pose(&mut self, index: usize) -> Result<(FrameParams, ImageFormat), Problem> {
        let params = self.poses.get_mut(index).map(std::mem::take).unwrap_or_default();
        let params = params.or(&self.defaults);
        let (format, _) = choose_format(&params, &self.headers)?;
        Ok((params, format))
    }

    /// Returns the id of pose `index`.
    fn name(&self, index: usize) -> RequestId {
        self.request_id.part(index as u64)
    }

    /// Returns whether another pose may be drawn; `None` where the client's key has no GPU time left now. If `waits`, waits for that,
    /// as long as a client waits for a frame.
    ///
    /// # Errors
    /// The key was removed or has expired, or has had no time for that long.
    async fn may_draw(&self, waits: bool) -> Option<Result<(), Problem>> {
        let end = Instant::now() + self.app.settings.frame_timeout;
        loop {
            match self.app.standing(self.client, &self.caps) {
                Standing::Good => return Some(Ok(())),
                Standing::Gone => {
                    let detail = "the key was removed or has expired";
                    return Some(Err(Problem::new(Kind::Unauthorized, detail)));
                }
                Standing::Spent(_) if !waits => return None,
                Standing::Spent(wait)
                    if Instant::now() >= end || self.app.phase() == Phase::Draining =>
                {
                    let detail = "this key has used its GPU time a minute";
                    return Some(Err(Problem::new(Kind::DeviceQuota, detail).retry_after(wait)));
                }
                Standing::Spent(wait) => tokio::time::sleep(wait.min(LONGEST_PAUSE)).await,
            }
        }
    }

    /// Queues a pose. Returns `None` when the queue is full and `wait_for_place` is false.
    async fn submit(
        &self,
        index: usize,
        (params, format): &(FrameParams, ImageFormat),
        wait_for_place: bool,
    ) -> Option<Result<Promised, Problem>> {
        let turn = Instant::now();
        let request = match params.request(&self.id, *format, turn) {
            Ok(request) => request,
            Err(problem) => return Some(Err(problem)),
        };
        let frame = match resolve(&self.app, request).await {
            Ok(frame) => frame,
            Err(problem) => return Some(Err(problem)),
        };
        let origin = Origin { client: self.client, request_id: self.name(index) };
        let queued = match wait_for_place {
            true => queue_patiently(&self.app, &origin, &frame).await,
            false => match self.app.engine.queue(origin, frame.clone()) {
                Err(EngineError::Busy { .. }) => return None,
                queued => queued,
            },
        };
        let FrameRequest { deadline, width, height, .. } = frame.request;
        let pixels = u64::from(width) * u64::from(height);
        Some(queued.map(|ticket| Promised { ticket, deadline, pixels }).map_err(Problem::from))
    }
}

/// Builds the answer's body.
fn parts(
    mut batch: Batch,
    boundary: String,
) -> impl Stream<Item = Result<Bytes, std::convert::Infallible>> {
    async_stream::stream! {
        let window = (2 * batch.app.engine.limits().max_batch).max(1);
        let mut pending: VecDeque<Result<Promised, Problem>> = VecDeque::new();
        let mut held: Option<(FrameParams, ImageFormat)> = None;
        let mut next = 0;
        // Why no further pose is drawn.
        let mut refusal: Option<Problem> = None;
        for index in 0..batch.poses.len() {
            while has_room(window, pending.len(), pixels_of(&pending)) && next < batch.poses.len() {
                if refusal.is_none() {
                    match batch.may_draw(pending.is_empty()).await {
                        None => break,
                        Some(may) => refusal = may.err(),
                    }
                }
                if let Some(problem) = &refusal {
                    pending.push_back(Err(problem.clone()));
                    next += 1;
                    continue;
                }
                let pose = match held.take().map_or_else(|| batch.pose(next), Ok) {
                    Ok(pose) => pose,
                    Err(problem) => {
                        pending.push_back(Err(problem));
                        next += 1;
                        continue;
                    }
                };
                match batch.submit(next, &pose, pending.is_empty()).await {
                    Some(queued) => {
                        pending.push_back(queued);
                        next += 1;
                    }
                    None => {
                        held = Some(pose);
                        break;
                    }
                }
            }
            let Some(front) = pending.pop_front() else { break };
            let result = match front {
                Ok(Promised { ticket, deadline, .. }) => wait(&batch.app, ticket, deadline).await,
                Err(problem) => Err(problem),
            };
            if let Ok(frame) = &result {
                batch.app.metrics.frame(frame);
            }
            let result = result.map_err(|problem| problem.named(batch.name(index)));
            let (head, content) = part(index as u64, result);
            yield Ok(Bytes::from(format!("\r\n--{boundary}\r\n{head}")));
            yield Ok(content);
        }
        yield Ok(Bytes::from(format!("\r\n--{boundary}--\r\n")));
    }
}

/// Returns a part's header and its content.
pub fn part(index: u64, result: Result<Arc<EncodedFrame>, Problem>) -> (String, Bytes) {
    let mut head = format!("Pointillist-Pose: {index}\r\n");
    // Writing to a string cannot fail.
    let content = match result {
        Ok(frame) => {
            for (name, value) in receipt_headers(&frame) {
                let _ = write!(head, "{name}: {}\r\n", value.to_str().unwrap_or_default());
            }
            frame.bytes.clone()
        }
        Err(problem) => {
            let _ = write!(head, "{}: {PROBLEM_JSON}\r\n", header::CONTENT_TYPE);
            Bytes::from(problem.to_json())
        }
    };
    let _ = write!(head, "{}: {}\r\n\r\n", header::CONTENT_LENGTH, content.len());
    (head, content)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boundaries_differ_and_are_tokens() {
        let (a, b) = (boundary(), boundary());
        assert_ne!(a, b);
        assert!(a.len() <= 70 && a.bytes().all(|c| c.is_ascii_alphanumeric() || c == b'-'));
    }

    #[test]
    fn few_large_frames_are_drawn_ahead() {
        assert!(has_room(32, 31, 31 << 18) && !has_room(32, 32, 0));
        let (mut pending, pixels) = (0, 1 << 25);
        while has_room(32, pending, pending as u64 * pixels) {
            pending += 1;
        }
        assert_eq!(pending, 2);
        assert!(has_room(1, 0, 0) && !has_room(1, 1, 0));
    }

    #[test]
    fn a_failed_pose_is_a_problem_part() {
        let problem = Problem::parameter("poses[2].eye", "bad", "three numbers");
        let (head, content) = part(2, Err(problem));
        assert!(head.starts_with("Pointillist-Pose: 2\r\n"), "{head}");
        assert!(head.contains("content-type: application/problem+json\r\n"));
        assert!(head.ends_with(&format!("content-length: {}\r\n\r\n", content.len())));
    }

    #[test]
    fn the_container_does_not_choose_the_format() {
        let mut headers = HeaderMap::new();
        headers.insert(header::ACCEPT, HeaderValue::from_static("multipart/mixed, image/jpeg"));
        let ranges = image_ranges(&headers);
        let (format, _) = choose_format(&FrameParams::default(), &ranges).unwrap();
        assert_eq!(format, ImageFormat::Jpeg);
        headers.insert(header::ACCEPT, HeaderValue::from_static("multipart/mixed"));
        let (format, _) = choose_format(&FrameParams::default(), &image_ranges(&headers)).unwrap();
        assert_eq!(format, ImageFormat::Png);
    }
}
