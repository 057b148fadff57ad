//! `POST /v1/jobs`: refuses a job that is known to fail before it is created.

use std::sync::Arc;
use std::time::Instant;

use axum::Json;
use axum::body::Body;
use axum::extract::{Extension, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use serde_json::{Map, Value};
use utoipa::ToSchema;

use super::jobs;
use super::wire::{JobState, film_problem, job_problem, video_problem};
use crate::encode::ImageFormat;
use crate::engine::RequestId;
use crate::film::video::{Coder, Reel};
use crate::http::frame::missing;
use crate::http::params::{self, FrameParams, unknown_name};
use crate::http::problem::{Kind, Problem};
use crate::http::{App, NoQuery, Owner, Phase, body};
use crate::jobs::{FrameSpec, Origin, PathChoice, Repeat, Spec, Want, find_shots};
use crate::json::{self, whole};

/// Largest body in bytes, enough for some thousand keys of a path.
const MAX_BODY_BYTES: u64 = 256 << 10;
pub const MAX_KEY_BYTES: usize = 255;
/// Number of outputs that a job can have: frames and a video.
pub const MAX_WANTED: usize = 2;

/// A film to draw. The body may also hold any parameter of a frame's query except the pose, `wait` and `deadline_ms`.
#[derive(Deserialize, ToSchema)]
pub struct JobRequest {
    /// Id of a scene that `GET /v1/scenes` lists.
    scene: String,
    /// Name of a path in the scene, or the content of a path file: `{"keys": […]}`.
    #[schema(value_type = Object)]
    path: Value,
    /// Frames per second; default: the path's own.
    fps: Option<f64>,
    /// Number of the first frame; default 0.
    #[serde(default, deserialize_with = "whole::optional")]
    from: Option<u64>,
    /// Number of the last frame; default: the path's last.
    #[serde(default, deserialize_with = "whole::optional")]
    to: Option<u64>,
    /// Results to keep: `frames`, `video` or both; default `["frames"]`. With `video` alone, the frames are deleted once the video is
    /// finished.
    want: Option<Vec<Wanted>>,
    /// Bit rate of the video in kilobits per second; default: from its size and frame rate.
    #[serde(default, deserialize_with = "whole::optional")]
    bitrate_kbps: Option<u32>,
    #[serde(flatten)]
    #[schema(value_type = FrameParams)]
    frame: Map<String, Value>,
}

#[derive(Clone, Copy, Debug, PartialEq, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Wanted {
    Frames,
    Video,
}

const NAMES: [&str; 7] = ["scene", "path", "fps", "from", "to", "want", "bitrate_kbps"];
/// Frame parameters that the path sets, or that have no meaning in a job.
pub const NOT_HERE: [(&str, &str); 10] = [
    ("camera", "the path sets the camera of every frame"),
    ("eye", "the path sets the camera of every frame"),
    ("target", "the path sets the camera of every frame"),
    ("up", "the path sets the camera of every frame"),
    ("fov", "the path sets the camera of every frame"),
    ("ortho_height", "the path sets the camera of every frame"),
    ("view", "the path sets the camera of every frame"),
    ("proj", "the path sets the camera of every frame"),
    ("wait", "frames of a job always wait for normals and kernels"),
    ("deadline_ms", "frames of a job have no deadline"),
];
const SYNONYMS: [(&str, &str); 5] = [
    ("rate", "fps"),
    ("bitrate", "bitrate_kbps"),
    ("start", "from"),
    ("end", "to"),
    ("wants", "want"),
];

/// Creates a job: a camera path drawn frame by frame. Clients fetch its frames one by one, as one stream or as a video.
///
/// The server stores the job on disk before it answers, and resumes the job after a restart or crash. A repeated request with the same
/// `Idempotency-Key` returns the first request's job, so a client may safely retry a request whose answer it did not get.
#[utoipa::path(
    post,
    path = "/v1/jobs",
    operation_id = "createJob",
    tag = "jobs",
    params(("Idempotency-Key" = Option<String>, Header, description = "1 to 255 visible ASCII characters, with spaces between them allowed; valid for as long as the job exists. Leading and trailing spaces and tabs are ignored")),
    request_body(content = JobRequest, content_type = "application/json"),
    responses((
        status = 201,
        description = "The new job, or the job that the same request created before",
        body = JobState,
        headers(("Location" = String, description = "The job's address")),
    )),
)]
pub async fn create(
    State(app): State<Arc<App>>,
    Extension(owner): Extension<Owner>,
    Extension(request_id): Extension<RequestId>,
    _: NoQuery,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let jobs = jobs(&app)?;
    let patience = app.settings.read_timeout;
    let admission = app.engine.admission();
    let value: Value = body::json(&headers, body, MAX_BODY_BYTES, patience, &admission).await?;
    let spec = spec(value)?;
    let key = idempotency_key(&headers)?;
    if app.phase() == Phase::Draining {
        return Err(crate::engine::EngineError::ShuttingDown.into());
    }
    let repeat = key.map(|key| Repeat {
        owner: owner.name.clone().unwrap_or_default(),
        key,
        fingerprint: spec.fingerprint(),
    });
    // A job that is known was checked when it was created; the check might fail now.
    let known = repeat.as_ref().is_some_and(|repeat| jobs.is_known(repeat));
    let film = if known { None } else { Some(check(&app, &spec)?) };
    let origin = Origin { owner: owner.name, request_id: Some(request_id.to_string()) };
    let worker = jobs.clone();
    let created = tokio::task::spawn_blocking(move || {
        let (id, _) = worker.create(spec, origin, repeat, film)?;
        worker.view(id)
    });
    let view =
        created.await.map_err(Problem::internal)?.map_err(|error| job_problem(&jobs, "", error))?;
    let location = HeaderValue::from_str(&format!("/v1/jobs/{}", view.record.id))
        .map_err(Problem::internal)?;
    Ok((StatusCode::CREATED, [(header::LOCATION, location)], Json(JobState::new(&view)))
        .into_response())
}

/// Returns the `Idempotency-Key` of a request.
pub(in crate::http) fn idempotency_key(headers: &HeaderMap) -> Result<Option<String>, Problem> {
    const NAME: &str = "Idempotency-Key";
    let fail = |reason: &str| {
        Err(Problem::parameter(
            NAME,
            reason,
            format!(
                "one header of 1 to {MAX_KEY_BYTES} visible ASCII characters, with spaces between them allowed"
            ),
        ))
    };
    let mut values = headers.get_all(NAME).iter();
    let Some(value) = values.next() else { return Ok(None) };
    if values.next().is_some() {
        return fail("given twice");
    }
    let bytes = value.as_bytes();
    if bytes.is_empty() || bytes.len() > MAX_KEY_BYTES {
        return fail("has no usable length");
    }
    // `to_str` accepts tabs as visible characters.
    match value.to_str() {
        Ok(key) if !key.contains('\t') => Ok(Some(key.to_owned())),
        _ => fail("holds a character that is neither visible ASCII nor a space"),
    }
}

/// Reads the specification of a job from a body, as far as possible without looking at a scene.
pub(in crate::http) fn spec(value: Value) -> Result<Spec, Problem> {
    let Some(object) = value.as_object() else {
        return Err(
            Problem::new(Kind::BadBody, "the body is not a JSON object").accepted(NAMES.join(", "))
        );
    };
    for name in object.keys() {
        if let Some((_, why)) = NOT_HERE.iter().find(|(known, _)| known == name) {
            return Err(Problem::parameter(name, format!("a job has none: {why}"), "leave it out"));
        }
        if NAMES.contains(&name.as_str()) || params::check_name(name).is_ok() {
            continue;
        }
        let unavailable =
            params::check_name(name).err().filter(|problem| problem.kind == Kind::Unavailable);
        let mut known = NAMES.to_vec();
        known.extend(params::names().filter(|name| !NOT_HERE.iter().any(|(not, _)| not == name)));
        return Err(unavailable.unwrap_or_else(|| unknown_name(name, &known, &SYNONYMS)));
    }
    let request: JobRequest = serde_path_to_error::deserialize(value).map_err(|error| {
        let path = error.path().to_string();
        let problem = Problem::new(Kind::BadBody, json::plain(&error.inner().to_string()));
        if path == "." { problem } else { problem.at(path) }
    })?;
    let path = match &request.path {
        Value::String(name) => PathChoice::Named(name.clone()),
        Value::Object(_) => PathChoice::Inline(request.path.to_string().into()),
        _ => {
            let accepted = "the name of a path in the scene, or an object with `keys`";
            return Err(Problem::parameter(
                "path",
                "is neither a name nor a path object",
                accepted,
            ));
        }
    };
    let want = request.want.unwrap_or_else(|| vec![Wanted::Frames]);
    if want.len() > MAX_WANTED {
        let reason = format!("{} are wanted", want.len());
        return Err(Problem::parameter("want", reason, "`frames`, `video`, or both"));
    }
    let want = Want {
        frames: want.contains(&Wanted::Frames),
        video: want.contains(&Wanted::Video),
        bitrate_kbps: request.bitrate_kbps,
    };
    if !want.frames && !want.video {
        return Err(Problem::parameter("want", "the list is empty", "`frames`, `video`, or both"));
    }
    if want.bitrate_kbps.is_some() && !want.video {
        return Err(Problem::parameter(
            "bitrate_kbps",
            "frames have none",
            "add `video` to `want`, or leave `bitrate_kbps` out",
        ));
    }
    let params = FrameParams::from_json(Value::Object(request.frame), "")?;
    let format = params.format()?.unwrap_or(ImageFormat::Png);
    let request_of_frames = params.request(&request.scene, format, Instant::now())?;
    Ok(Spec {
        scene: request.scene,
        path,
        fps: request.fps,
        from: request.from,
        to: request.to,
        frame: FrameSpec::new(&request_of_frames),
        want,
    })
}

/// Checks that a job can be drawn, as far as possible without drawing. Returns its number of frames and frames per second.
fn check(app: &App, spec: &Spec) -> Result<(u64, f64), Problem> {
    let request = spec.request();
    app.engine
        .scene(&spec.scene)
        .map_err(|error| missing(app, &spec.scene, error.into()).at("scene"))?;
    let shots = find_shots(&app.engine, spec).map_err(film_problem)?;
    let checked = app.engine.check(&request);
    checked.map_err(|error| missing(app, &spec.scene, error.into()))?;
    if spec.want.video {
        let coder = Coder::find().map_err(video_problem)?;
        Reel::new(&request, &shots, spec.want.bitrate_kbps).check(&coder).map_err(video_problem)?;
    }
    Ok((shots.wanted().count() as u64, shots.fps()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn refused(value: Value) -> (u16, String, String) {
        let problem = spec(value).unwrap_err();
        (problem.status(), problem.parameter.unwrap_or_default(), problem.detail)
    }

    #[test]
    fn bodies_become_specs() {
        let made =
            spec(json!({"scene": "s", "path": "fly", "w": 64, "h": 48, "to": 9, "format": "jpeg"}))
                .unwrap();
        assert_eq!((made.path.clone(), made.to), (PathChoice::Named("fly".to_owned()), Some(9)));
        assert_eq!((made.frame.width, made.frame.format), (64, ImageFormat::Jpeg));
        assert_eq!(made.want, Want { frames: true, video: false, bitrate_kbps: None });
        let keys = json!({"keys": [{"t": 0, "eye": [0, 0, 1], "target": [0, 0, 0]}]});
        let made =
            spec(json!({"scene": "s", "path": keys, "want": ["video"], "bitrate_kbps": 900.0, "to": 9.0, "w": 64.0}))
                .unwrap();
        assert_eq!(made.want, Want { frames: false, video: true, bitrate_kbps: Some(900) });
        assert_eq!((made.to, made.frame.width), (Some(9), 64));
        let PathChoice::Inline(text) = made.path else { panic!() };
        assert_eq!(serde_json::from_str::<Value>(&text).unwrap(), keys);
    }

    #[test]
    fn what_cannot_be_is_named() {
        for (value, parameter, words) in [
            (json!([]), "", "not a JSON object"),
            (json!({"path": "p"}), "", "missing field `scene`"),
            (json!({"scene": "s"}), "", "missing field `path`"),
            (json!({"scene": "s", "path": 3}), "path", "neither a name nor a path"),
            (
                json!({"scene": "s", "path": "p", "eye": [0, 0, 1]}),
                "eye",
                "the path sets the camera",
            ),
            (json!({"scene": "s", "path": "p", "deadline_ms": 5}), "deadline_ms", "no deadline"),
            (json!({"scene": "s", "path": "p", "wnat": ["video"]}), "wnat", "did you mean `want`?"),
            (json!({"scene": "s", "path": "p", "width": 64}), "width", "no parameter `width`"),
            (json!({"scene": "s", "path": "p", "effects": "ao"}), "effects", "not available"),
            (json!({"scene": "s", "path": "p", "want": []}), "want", "the list is empty"),
            (json!({"scene": "s", "path": "p", "want": ["gif"]}), "want[0]", "unknown variant"),
            (
                json!({"scene": "s", "path": "p", "bitrate_kbps": 900}),
                "bitrate_kbps",
                "frames have none",
            ),
            (json!({"scene": "s", "path": "p", "fps": "fast"}), "fps", "expected a number"),
            (json!({"scene": "s", "path": "p", "w": 0}), "w", "must not be 0"),
            (json!({"scene": "s", "path": "p", "format": "gif"}), "format", "not available"),
            (
                json!({"scene": "s", "path": "p", "from": -1}),
                "from",
                "found the number -1; expected a whole number",
            ),
        ] {
            let shown = value.to_string();
            let (status, at, detail) = refused(value);
            assert_eq!((status, at.as_str()), (422, parameter), "{shown}: {detail}");
            assert!(detail.contains(words), "{shown}: {detail}");
        }
    }

    #[test]
    fn keys_of_repeated_requests() {
        let key = |values: &[&str]| {
            let mut headers = HeaderMap::new();
            for value in values {
                headers
                    .append("Idempotency-Key", HeaderValue::from_bytes(value.as_bytes()).unwrap());
            }
            idempotency_key(&headers).map_err(|problem| problem.status())
        };
        assert_eq!(key(&[]), Ok(None));
        assert_eq!(key(&["a-1"]), Ok(Some("a-1".to_owned())));
        assert_eq!(key(&["a 1"]), Ok(Some("a 1".to_owned())));
        for bad in [&[""][..], &["a", "b"], &["é"], &["a\tb"], &[&"x".repeat(256)]] {
            assert_eq!(key(bad), Err(422), "{bad:?}");
        }
    }
}
