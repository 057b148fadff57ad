//! `POST /v1/scenes/{id}/compare`: two sets of settings at one pose, in pictures and in figures.
//!
//! Each side is two frames in the queue: its colours, and which pixels show the scene (the colours over a transparent background). A reference
//! has [`PARTS`] × [`PARTS`] times the pixels. All frames show one revision. They are compared on a blocking thread, one comparison at
//! a time, so that many of them cannot take the encoders' cores.

use std::sync::Arc;
use std::time::Instant;

use axum::body::Body;
use axum::extract::{Extension, State};
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::Response;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use utoipa::ToSchema;

use super::frame::{missing, queue_patiently, resolve, wait};
use super::params::{DEFAULT_QUALITY, FrameParams, Names, names, unknown_name};
use super::problem::{Kind, Problem};
use super::{App, Caller, NoQuery, Segments, body, conditional};
use crate::accuracy::difference::{Difference, Shot};
use crate::accuracy::metrics::{Coverage, psnr_db};
use crate::accuracy::report::heat;
use crate::accuracy::truth::{Finer, PARTS, averaged, is_covered, opaque, quads};
use crate::encode::{FrameImage, ImageFormat, encode};
use crate::engine::{
    EncodedFrame, EngineError, FrameRequest, Origin, Receipt, RequestId, ResolvedFrame,
};
use crate::plan::{Given, Output, Settings};

/// Largest body in bytes.
const MAX_BODY_BYTES: u64 = 1 << 20;
/// Most pixels of compared frames.
pub const MOST_PIXELS: u64 = 1 << 22;
/// Host memory that a comparison takes for each pixel: images, planes of the metrics, and the answer.
const BYTES_PER_PIXEL: u64 = 512;
/// Host memory of each pixel of a reference's frames.
const BYTES_PER_PART: u64 = 16;
/// How often frames are resolved again because the scene changed meanwhile.
const TRIES: usize = 3;

/// Formats of the images, which browsers show.
pub const FORMATS: [ImageFormat; 3] = [ImageFormat::Png, ImageFormat::Jpeg, ImageFormat::Webp];

/// Parameters beside the two sets of settings.
pub const NAMES: Names = Names {
    own: &["a", "b", "against", "images"],
    without: &[
        ("output", "colours are compared"),
        ("wait", "a comparison waits for complete frames"),
    ],
};

/// What `a` is compared with, in place of `b`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Against {
    /// Full detail at 4 × 4 times the pixels, samples as splats, averaged in linear light.
    Reference,
}

/// Two sets of settings, and the pose and size that their frames share.
#[derive(Deserialize, ToSchema)]
pub struct CompareRequest {
    /// Settings of the first frame. Missing settings take the values given beside `a`.
    #[schema(value_type = Given)]
    a: Map<String, Value>,
    /// Settings of the second frame, likewise. The errors are those of `a` against `b`.
    #[schema(value_type = Option<Given>)]
    b: Option<Map<String, Value>>,
    /// A reference in place of `b`.
    against: Option<Against>,
    /// Whether the answer has the images; default true.
    images: Option<bool>,
    #[serde(flatten)]
    #[schema(value_type = FrameParams)]
    frame: Map<String, Value>,
}

/// Errors of `a` against `b`, with the images.
#[derive(Serialize, ToSchema)]
pub struct Comparison {
    scene: String,
    revision: u64,
    width: u32,
    height: u32,
    /// Peak signal-to-noise ratio of red, green and blue in decibels; `null` for equal frames.
    psnr_db: Option<f64>,
    /// Structural similarity, 1 for equal frames.
    ssim: f64,
    /// Mean FLIP at 67 pixels per degree, 0 for equal frames.
    flip: f64,
    /// Largest difference of a red, green or blue byte.
    max_error: u8,
    /// Holes are pixels that `b` covers and `a` does not, leaks the reverse.
    coverage: Coverage,
    a: ComparedFrame,
    b: ComparedFrame,
    /// The FLIP map as a `data:` URI: dark blue where nobody sees a difference, yellow where it is largest.
    difference: Option<String>,
}

/// One side of a comparison.
#[derive(Serialize, ToSchema)]
pub struct ComparedFrame {
    /// GPU time of this one frame in milliseconds, without the frame of its coverage and without shadow maps, which both sides may share; `null` if the
    /// adapter has no timestamps.
    gpu_ms: Option<f64>,
    /// The image as a `data:` URI, opaque; `null` with `images: false`.
    image: Option<String>,
    /// Receipt of the frame of colours. That of a reference has the reference's own size.
    receipt: Receipt,
}

/// Compares two sets of settings at one pose.
///
/// Draws a frame with the settings `a` and another with `b`, or the reference, and answers with both frames, their receipts, the map of their
/// differences, and the errors of `a` against `b`. Settings beside `a` and `b` apply to both. Each side is two frames in the
/// queue, its colours and its coverage; those of a reference have 4 × 4 times the pixels. `deadline_ms` holds for all frames together.
#[utoipa::path(
    post,
    path = "/v1/scenes/{id}/compare",
    operation_id = "compareFrames",
    tag = "frames",
    params(("id" = String, Path, description = "A scene that `GET /v1/scenes` lists")),
    request_body(content = CompareRequest, content_type = "application/json"),
    responses((status = 200, description = "Both frames and their difference", body = Comparison)),
)]
pub async fn compare(
    State(app): State<Arc<App>>,
    Extension(Caller(client, _)): Extension<Caller>,
    Extension(request_id): Extension<RequestId>,
    Segments(id): Segments<String>,
    _: NoQuery,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let admission = app.engine.admission();
    let patience = app.settings.read_timeout;
    let request: CompareRequest =
        body::json(&headers, body, MAX_BODY_BYTES, patience, &admission).await?;
    let asked = Asked::read(request, app.engine.limits().max_side)?;
    app.engine.scene(&id).map_err(|error| missing(&app, &id, error.into()))?;
    let [width, height] = asked.size;
    let pixels = u64::from(width) * u64::from(height);
    let most = MOST_PIXELS.min(app.engine.limits().max_pixels);
    if pixels > most {
        let what = "pixels in a comparison";
        let (found, limit, parameter) = (pixels, most, Some("w"));
        return Err(EngineError::OverLimit { what, found, limit, parameter }.into());
    }
    let finer = asked.finer(&app)?;
    let parts = finer.map_or(0, |finer| u64::from(finer.width) * u64::from(finer.height));
    let needed = pixels * BYTES_PER_PIXEL + parts * BYTES_PER_PART;
    admission.grow("the comparison", needed).map_err(|error| {
        Problem::from(EngineError::from(error))
            .accepted("a smaller `w` and `h`, or a larger --host-memory-mib")
    })?;

    let [a, b] = asked.resolve(&app, &id, finer.as_ref()).await?;
    // A full queue refuses the first frame, as it refuses a single one. The others may have to wait until that one is drawn.
    let origin = |number| Origin { client, request_id: request_id.part(number) };
    let first = app.engine.queue(origin(0), a.color.clone())?;
    let mut queued = vec![(first, a.color.request.deadline)];
    // The colours come first, as they are timed.
    for (number, frame) in (1..).zip([&b.color, &a.coverage, &b.coverage]) {
        let ticket = queue_patiently(&app, &origin(number), frame).await?;
        queued.push((ticket, frame.request.deadline));
    }
    let mut frames = Vec::with_capacity(4);
    for (ticket, deadline) in queued {
        let frame = wait(&app, ticket, deadline).await?;
        app.metrics.frame(&frame);
        frames.push(frame);
    }
    let turn = app.comparing.clone().acquire_owned().await.map_err(Problem::internal)?;
    let work = move || {
        // Both last until the work has ended, even if the client has gone.
        let _held = (turn, admission);
        let drawn: [Arc<EncodedFrame>; 4] =
            frames.try_into().map_err(|_| Problem::internal("a comparison lost a frame"))?;
        asked.answer(&drawn, finer)
    };
    let answer = tokio::task::spawn_blocking(work).await.map_err(Problem::internal)??;
    let text = serde_json::to_vec(&answer).map_err(Problem::internal)?;
    let body = app.unread.hold(client, text.into(), &app.engine.admission())?;
    let mut response = Response::new(body);
    let json = HeaderValue::from_static("application/json");
    response.headers_mut().insert(header::CONTENT_TYPE, json);
    response.headers_mut().insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    Ok(response)
}

/// A checked request.
pub(super) struct Asked {
    a: FrameParams,
    /// `None` for a reference.
    b: Option<FrameParams>,
    size: [u32; 2],
    format: ImageFormat,
    quality: u8,
    has_images: bool,
    now: Instant,
}

/// The frames of one side.
struct Side {
    color: Arc<ResolvedFrame>,
    coverage: Arc<ResolvedFrame>,
}

impl Asked {
    pub(super) fn read(request: CompareRequest, longest: u32) -> Result<Asked, Problem> {
        for name in request.frame.keys() {
            NAMES.check(name)?;
        }
        let shared = FrameParams::from_json(Value::Object(request.frame), "")?;
        shared.check()?;
        shared.check_sides(longest)?;
        let format = shared.format()?.unwrap_or(ImageFormat::Png);
        if !FORMATS.contains(&format) {
            let reason = "browsers do not show it in a page";
            return Err(Problem::parameter("format", reason, "png, jpeg or webp"));
        }
        let a = side(request.a, "a", &shared)?;
        let b = match (request.b, request.against) {
            (Some(b), None) => Some(side(b, "b", &shared)?),
            (None, Some(Against::Reference)) => None,
            (Some(_), Some(_)) => {
                let reason = "cannot be given together with `b`";
                return Err(Problem::parameter("against", reason, "`b`, or `against`"));
            }
            (None, None) => {
                let accepted = "settings, or `against`: `reference` in place of `b`";
                return Err(Problem::parameter("b", "missing", accepted));
            }
        };
        let (now, side) = (Instant::now(), super::DEFAULT_SIDE);
        Ok(Asked {
            a,
            b,
            size: [shared.w.unwrap_or(side), shared.h.unwrap_or(side)],
            format,
            quality: shared.quality.unwrap_or(DEFAULT_QUALITY),
            has_images: request.images.unwrap_or(true),
            now,
        })
    }

    /// How the reference is drawn; `None` where none is asked for.
    fn finer(&self, app: &App) -> Result<Option<Finer>, Problem> {
        if self.b.is_some() {
            return Ok(None);
        }
        let a = Settings::from(self.a.settings).with_blur_decided(Output::Color, false);
        if a.is_blurred() {
            let reason = "the reference is a single exposure, in which everything is sharp";
            let name = format!("a.{}", Settings::LENS);
            return Err(Problem::parameter(name, reason, "0, or `b` in place of `against`"));
        }
        let limits = app.engine.limits();
        let finer = Finer::new(self.size, &limits).ok_or_else(|| {
            let ([width, height], most) = (self.size, limits.max_pixels);
            let (parts, side) = (u64::from(PARTS * PARTS), limits.max_side / PARTS);
            let detail = format!(
                "w: the reference of {width}x{height} pixels has {PARTS} × {PARTS} times as many, beyond the limits of {most} pixels and {} a side",
                limits.max_side
            );
            Problem::new(Kind::OverLimit, detail)
                .at("w")
                .accepted(format!("at most {} pixels and {side} a side beside `against`", most / parts))
        })?;
        Ok(Some(finer))
    }

    /// Resolves all frames at one revision of the scene.
    async fn resolve(
        &self,
        app: &App,
        id: &str,
        finer: Option<&Finer>,
    ) -> Result<[Side; 2], Problem> {
        for _ in 0..TRIES {
            let mark = app.engine.scene_mark(id);
            let a = self.side(app, id, &self.a, "a").await?;
            let b = match (&self.b, finer) {
                (Some(b), _) => self.side(app, id, b, "b").await?,
                (None, Some(finer)) => self.reference(app, id, finer).await?,
                (None, None) => return Err(Problem::internal("a comparison with nothing")),
            };
            if app.engine.scene_mark(id) == mark {
                return Ok([a, b]);
            }
        }
        let detail = format!("scene `{id}` changes faster than two frames of it can be prepared");
        Err(Problem::new(Kind::SceneChanged, detail).retry_after(super::frame::RETRY_LATE))
    }

    async fn side(
        &self,
        app: &App,
        id: &str,
        params: &FrameParams,
        place: &str,
    ) -> Result<Side, Problem> {
        let found = async {
            let request = params.request(id, ImageFormat::Raw, self.now)?;
            let request = FrameRequest { settings: request.settings.complete(), ..request };
            let color = resolve(app, request.clone()).await?;
            // A goal is pursued once, so that both frames are drawn in the same way.
            let settings = color.settings().without_goal().complete().finer(1, true);
            let coverage = resolve(app, FrameRequest { settings, ..request }).await?;
            Ok(Side { color, coverage })
        };
        found.await.map_err(|problem| placed(place, missing(app, id, problem)))
    }

    async fn reference(&self, app: &App, id: &str, finer: &Finer) -> Result<Side, Problem> {
        let settings = self.a.settings.exact().complete();
        let own = self.a.request(id, ImageFormat::Raw, self.now)?;
        let own = FrameRequest { settings, ..own };
        let found = async {
            let decided = *resolve(app, own.clone()).await?.settings();
            // A view from matrices belongs to a size.
            let wide =
                FrameParams { w: Some(finer.width), h: Some(finer.height), ..self.a.clone() };
            let pose = wide.request(id, ImageFormat::Raw, self.now)?.pose;
            let own = FrameRequest { pose, ..own };
            let request = |transparent| finer.request(&own, &decided, Output::Color, transparent);
            let color = resolve(app, request(false)).await?;
            Ok(Side { color, coverage: resolve(app, request(true)).await? })
        };
        found.await.map_err(|problem| missing(app, id, problem))
    }

    /// Compares the frames: colours of `a` and `b`, then their coverage.
    fn answer(
        &self,
        [a, b, a_coverage, b_coverage]: &[Arc<EncodedFrame>; 4],
        finer: Option<Finer>,
    ) -> Result<Comparison, Problem> {
        let [width, height] = self.size;
        let covered = |frame: &EncodedFrame| -> Vec<bool> {
            quads(&frame.bytes).into_iter().map(is_covered).collect()
        };
        let color = |frame: &EncodedFrame| -> Vec<[u8; 4]> {
            quads(&frame.bytes).into_iter().map(opaque).collect()
        };
        let (image, image_covered) = (color(a), covered(a_coverage));
        let (expected, expected_covered) = match finer {
            Some(_) => averaged(self.size, PARTS, &quads(&b.bytes), &quads(&b_coverage.bytes)),
            None => (color(b), covered(b_coverage)),
        };
        let reference = Shot { color: &expected, covered: &expected_covered };
        let shot = Shot { color: &image, covered: &image_covered };
        let found = Difference::between(reference, shot, self.size).map_err(Problem::internal)?;
        let Difference { mse, ssim, flip, max_error, coverage, map } = found;
        let picture = |rgba: Vec<[u8; 4]>| {
            if !self.has_images {
                return Ok::<_, Problem>(None);
            }
            let image = FrameImage::Color { width, height, rgba };
            let encoded = encode(&image, self.format, self.quality).map_err(Problem::internal)?;
            let kind = conditional::media_type(self.format);
            Ok(Some(format!("data:{kind};base64,{}", STANDARD.encode(&encoded.bytes))))
        };
        let side = |frame: &EncodedFrame, rgba| {
            let receipt = frame.receipt.clone();
            let gpu_ms = receipt.gpu_share_without_maps_ns().map(|ns| ns as f64 / 1e6);
            Ok::<_, Problem>(ComparedFrame { gpu_ms, image: picture(rgba)?, receipt })
        };
        Ok(Comparison {
            scene: a.receipt.scene.clone(),
            revision: a.receipt.revision,
            width,
            height,
            psnr_db: psnr_db(mse),
            ssim,
            flip,
            max_error,
            coverage,
            a: side(a, image)?,
            b: side(b, expected)?,
            difference: picture(map.into_iter().map(heat).collect())?,
        })
    }
}

/// Reads one set of settings, and fills it from the shared parameters.
fn side(
    given: Map<String, Value>,
    place: &str,
    shared: &FrameParams,
) -> Result<FrameParams, Problem> {
    for name in given.keys() {
        if Given::NAMES.contains(&name.as_str()) {
            continue;
        }
        let at = format!("{place}.{name}");
        return Err(match names().any(|known| known == name) {
            true => {
                let reason = "both frames have the same one";
                Problem::parameter(at, reason, format!("`{name}` beside `{place}`"))
            }
            false => unknown_name(name, Given::NAMES, &[]).at(at),
        });
    }
    let own = FrameParams::from_json(Value::Object(given), place)?;
    own.check().map_err(|problem| placed(place, problem))?;
    Ok(own.or(shared))
}

/// The problem of a setting, at its place in the body.
fn placed(place: &str, problem: Problem) -> Problem {
    match &problem.parameter {
        Some(name) if Given::NAMES.contains(&name.as_str()) => {
            let at = format!("{place}.{name}");
            problem.at(at)
        }
        _ => problem,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn read(body: Value) -> Result<Asked, Problem> {
        Asked::read(serde_json::from_value(body).unwrap(), 4096)
    }

    #[test]
    fn shared_settings_apply_to_both_sides() {
        let asked = read(json!({
            "w": 64, "h": 48, "lod": "spt", "a": {"reconstruct": "points"}, "b": {"lod": "full"}
        }));
        let asked = asked.ok().unwrap();
        assert_eq!(
            (asked.size, asked.format, asked.has_images),
            ([64, 48], ImageFormat::Png, true)
        );
        let text = |params: &FrameParams| params.settings.pairs();
        let pair = |name: &str, value: &str| (name.to_owned(), value.to_owned());
        assert_eq!(text(&asked.a), [pair("lod", "spt"), pair("reconstruct", "points")]);
        assert_eq!(text(&asked.b.unwrap()), [pair("lod", "full")]);
        assert!(read(json!({"a": {}, "against": "reference"})).ok().unwrap().b.is_none());
    }

    #[test]
    fn refusals_name_the_place() {
        for (body, place) in [
            (json!({"a": {}}), "b"),
            (json!({"a": {}, "b": {}, "against": "reference"}), "against"),
            (json!({"a": {"reconstruct": "voxels"}, "b": {}}), "a.reconstruct"),
            (json!({"a": {}, "b": {"max_error_px": -1}}), "b.max_error_px"),
            (json!({"a": {"w": 8}, "b": {}}), "a.w"),
            (json!({"a": {"reconstrct": "points"}, "b": {}}), "a.reconstrct"),
            (json!({"a": {}, "b": {}, "output": "depth"}), "output"),
            (json!({"a": {}, "b": {}, "wait": "ready"}), "wait"),
            (json!({"a": {}, "b": {}, "format": "raw"}), "format"),
            (json!({"a": {}, "b": {}, "w": 0}), "w"),
            (json!({"a": {}, "b": {}, "h": 5000}), "h"),
            (json!({"a": {}, "b": {}, "c": {}}), "c"),
        ] {
            let problem = read(body.clone()).err().unwrap();
            assert_eq!(
                (problem.status(), problem.parameter.as_deref()),
                (422, Some(place)),
                "{body}"
            );
            assert!(problem.accepted.is_some(), "{body}");
        }
    }
}
