//! `GET /v1/scenes/{id}/mjpeg`: a film for any `<img>`, as `multipart/x-mixed-replace`.
//!
//! ```text
//! timeline (which frame is due; pure) ─▶ a latest slot of the engine ─▶ part ─▶ part ─▶ …
//!                                          │ the next due frame replaces a frame that still waits there
//! ```
//!
//! A frame is drawn only when the client reads: after a pause the stream goes on with the frame that is due, unless the pause was
//! longer than a stream may be idle ([`watched`]). Without a path it shows one view, and shows it again when the scene changes.

mod playback;
mod timeline;
mod watched;

use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::body::Body;
use axum::extract::{Extension, State};
use axum::http::{HeaderName, HeaderValue, Method, Uri, header};
use axum::response::Response;
use bytes::Bytes;
use futures::Stream;
use serde::Deserialize;
use utoipa::IntoParams;

use self::playback::{Playback, Show};
use self::timeline::Timeline;
use self::watched::Watched;
use super::frame::missing;
use super::frames::{boundary, part};
use super::params::{FrameParams, Names, number, once, pairs};
use super::problem::Problem;
use super::{App, Caller, Segments};
use crate::encode::ImageFormat;
use crate::engine::{EncodedFrame, FrameRequest, Origin, RequestId};
use crate::plan::Given;
use crate::scene::CameraPath;

/// Range of frames per second that a client can ask for.
pub const FPS_RANGE: [f64; 2] = [0.1, 120.0];
/// Largest frame rate of a still view, which is redrawn only when the scene changes.
const DEFAULT_FPS: f64 = 30.0;

/// Parameters that the query may hold.
pub const NAMES: Names = Names {
    own: &["path", "fps", "loop"],
    without: &[("deadline_ms", "late frames are always left out")],
};

/// Parameters that a frame's query does not have.
#[derive(Debug, Default, PartialEq, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub struct ScreeningParams {
    /// Name of a camera path in the scene. Without it, the stream shows the view of `camera` or of a pose, and redraws it when the scene changes.
    path: Option<String>,
    /// Frames per second, 0.1 to 120; default: the path's own.
    fps: Option<f64>,
    /// Whether the path starts again at its end. Otherwise the answer ends with the path's last frame.
    r#loop: Option<bool>,
}

/// A film as Motion JPEG, for `<img>`.
///
/// Each part is a JPEG with its `Pointillist-Receipt`, and with `Pointillist-Pose`, its frame's number. Frame `n` of a path is what it shows
/// `n / fps` seconds after its first key. The server leaves out frames that it cannot draw or send in time, so that the film takes as
/// long as the path. It ends with the path's last frame unless it loops, when the scene is deleted, and when the server stops; it
/// counts as one of the streams that `GET /v1/limits` allows, and ends when the client reads nothing for `stream_idle_ms`.
#[utoipa::path(
    get,
    path = "/v1/scenes/{id}/mjpeg",
    operation_id = "playFilm",
    tag = "frames",
    params(("id" = String, Path, description = "A scene that `GET /v1/scenes` lists"), ScreeningParams, FrameParams, Given),
    responses((
        status = 200,
        description = "One JPEG per part; each replaces the one before",
        body = Vec<u8>,
        content_type = "multipart/x-mixed-replace",
    )),
)]
pub async fn mjpeg(
    State(app): State<Arc<App>>,
    Extension(Caller(client, caps)): Extension<Caller>,
    Extension(request_id): Extension<RequestId>,
    Segments(id): Segments<String>,
    method: Method,
    uri: Uri,
) -> Result<Response, Problem> {
    let (wanted, params) = ScreeningParams::from_query(uri.query())?;
    let request = params.request(&id, ImageFormat::Jpeg, Instant::now())?;
    let mark = app.engine.scene_mark(&id);
    let show = wanted.show(&app, &request).map_err(|problem| missing(&app, &id, problem))?;
    let mut playback =
        Playback::new(app.clone(), Origin { client, request_id }, caps, request, show, mark)?;
    // The first frame is drawn here, so that errors are reported before the first byte.
    let first = match method {
        Method::HEAD => None,
        _ => Some(playback.first().await.map_err(|problem| missing(&app, &id, problem))?),
    };
    let boundary = boundary();
    let content_type = format!("multipart/x-mixed-replace; boundary={boundary}");
    let film = Watched::new(parts(playback, first, boundary), app.rules().bounds.streams.idle);
    let mut response = Response::new(Body::from_stream(film));
    let headers = response.headers_mut();
    let content_type = HeaderValue::from_str(&content_type).map_err(Problem::internal)?;
    headers.insert(header::CONTENT_TYPE, content_type);
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    // nginx would otherwise buffer frames.
    headers.insert(HeaderName::from_static("x-accel-buffering"), HeaderValue::from_static("no"));
    Ok(response)
}

impl ScreeningParams {
    pub(super) fn from_query(query: Option<&str>) -> Result<(Self, FrameParams), Problem> {
        const FRAMES_PER_SECOND: &str = "0.1 to 120 frames per second";
        let (mut wanted, mut params) = (ScreeningParams::default(), FrameParams::default());
        for (name, value) in pairs(query)? {
            match name.as_str() {
                "path" => once(&mut wanted.path, &name, value)?,
                "fps" => once(&mut wanted.fps, &name, number(&name, &value, FRAMES_PER_SECOND)?)?,
                "loop" => once(&mut wanted.r#loop, &name, number(&name, &value, "true or false")?)?,
                _ => {
                    NAMES.check(&name)?;
                    params.set(&name, &value)?;
                }
            }
        }
        wanted.check(&params)?;
        Ok((wanted, params))
    }

    fn check(&self, params: &FrameParams) -> Result<(), Problem> {
        if params.format()?.is_some_and(|format| format != ImageFormat::Jpeg) {
            let accepted = "jpeg, or left out";
            return Err(Problem::parameter("format", "the frames are JPEGs", accepted));
        }
        if let Some(fps) = self.fps {
            check_fps(fps, "")?;
        }
        if self.path.is_some() {
            if let Some(name) = params.pose_parameter() {
                let reason = "cannot be given together with `path`";
                return Err(Problem::parameter(name, reason, "either of the two"));
            }
        } else if self.r#loop.is_some() {
            let reason = "without `path`, there is nothing to repeat";
            return Err(Problem::parameter("loop", reason, "give `path`, or leave `loop` out"));
        }
        Ok(())
    }

    /// Returns the path or the view to show.
    fn show(&self, app: &App, request: &FrameRequest) -> Result<Show, Problem> {
        let Some(name) = &self.path else {
            app.engine.scene(&request.scene)?;
            let fps = self.fps.unwrap_or(DEFAULT_FPS);
            return Ok(Show::View { least: Duration::from_secs_f64(1.0 / fps) });
        };
        let path: CameraPath = app.engine.camera_path(&request.scene, name)?;
        let fps = self.fps.unwrap_or(path.fps);
        check_fps(fps, "the path's own ")?;
        let timeline = Timeline::new(fps, path.frame_count(fps), self.r#loop.unwrap_or_default());
        Ok(Show::Path {
            timeline,
            fps,
            start_s: path.frame_time_s(0, fps),
            sampler: path.sampler()?,
        })
    }
}

fn check_fps(fps: f64, whose: &str) -> Result<(), Problem> {
    let [least, most] = FPS_RANGE;
    if (least..=most).contains(&fps) {
        return Ok(());
    }
    let reason = format!("{whose}{fps} is out of range");
    Err(Problem::parameter("fps", reason, format!("{least} to {most} frames per second")))
}

/// Bytes of an image handed over at a time, so small that a slow reader still counts as reading.
const PIECE_BYTES: usize = 32 << 10;

/// Builds the answer's body. A part ends with the next part's delimiter, because a browser shows it only then.
fn parts(
    mut playback: Playback,
    first: Option<Arc<EncodedFrame>>,
    boundary: String,
) -> impl Stream<Item = Bytes> {
    async_stream::stream! {
        let delimiter = Bytes::from(format!("\r\n--{boundary}"));
        // Skip the line break before the first delimiter; no part precedes it.
        yield delimiter.slice(2..);
        let mut next = first;
        while let Some(frame) = next {
            let (head, content) = part(playback.frame_number(), Ok(frame));
            yield Bytes::from(format!("\r\n{head}"));
            let mut rest = content;
            while !rest.is_empty() {
                yield rest.split_to(rest.len().min(PIECE_BYTES));
            }
            yield delimiter.clone();
            next = playback.next().await;
        }
        yield Bytes::from_static(b"--\r\n");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(query: &str) -> (u16, String, String) {
        let problem = ScreeningParams::from_query(Some(query)).unwrap_err();
        let accepted = problem.accepted.clone().unwrap_or_default();
        (problem.status(), problem.parameter.clone().unwrap_or_default(), accepted)
    }

    #[test]
    fn parameters_of_a_screening_and_of_its_frames() {
        let query = "path=fly&fps=12.5&loop=true&w=64&h=48&reconstruct=splats&format=jpeg";
        let (wanted, params) = ScreeningParams::from_query(Some(query)).unwrap();
        let expected =
            ScreeningParams { path: Some("fly".into()), fps: Some(12.5), r#loop: Some(true) };
        assert_eq!((wanted, params.w), (expected, Some(64)));
        assert_eq!(ScreeningParams::from_query(None).unwrap().0, ScreeningParams::default());
    }

    #[test]
    fn what_cannot_be_shown_is_named() {
        for (query, parameter, accepted) in [
            ("fps=0", "fps", "0.1 to 120"),
            ("fps=NaN", "fps", "0.1 to 120"),
            ("fps=x", "fps", "0.1 to 120"),
            ("loop=true", "loop", "give `path`"),
            ("path=a&loop=yes", "loop", "true or false"),
            ("path=a&path=b", "path", "once"),
            ("path=a&camera=front", "camera", "either"),
            ("path=a&eye=0,0,1", "eye", "either"),
            ("format=png", "format", "jpeg"),
            ("deadline_ms=4", "deadline_ms", "leave it out"),
            ("lop=true", "lop", "path, fps, loop, camera"),
        ] {
            let (status, at, would_be) = refused(query);
            assert_eq!((status, at.as_str()), (422, parameter), "{query}");
            assert!(would_be.contains(accepted), "{query}: {would_be}");
        }
    }
}
