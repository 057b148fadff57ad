//! `/v1/scenes/{id}/accuracy`: what accuracy costs in time for a scene, measured on this machine. Translation only;
//! [`crate::accuracy::service`] does the work.

use std::sync::Arc;
use std::time::Duration;

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::ToSchema;

use super::frame::missing;
use super::params::unknown_name;
use super::problem::{Kind, Problem, ProblemDocument};
use super::viewer::entity_tag;
use super::{App, NoQuery, Segments, body, conditional};
use crate::accuracy::results::Results;
use crate::accuracy::service::{
    Failure, MOST_CAMERAS, MOST_REPEATS, Progress, Refusal, State as SurveyState, View, Wanted,
};
use crate::json::{self, whole};

/// Largest body in bytes.
const MAX_BODY_BYTES: u64 = 64 << 10;
/// Default size of frames.
pub const DEFAULT_SIZE: [u32; 2] = [320, 180];
/// Default numbers of timed frames, of a quick and of a whole measurement.
const DEFAULT_REPEATS: [u32; 2] = [3, 5];
/// When a request is worth repeating while another measurement runs.
const RETRY_RUNNING: Duration = Duration::from_secs(10);

const KEYS: [&str; 6] = ["planner", "quick", "cameras", "w", "h", "repeats"];
const SYNONYMS: [(&str, &str); 4] =
    [("camera", "cameras"), ("width", "w"), ("height", "h"), ("repeat", "repeats")];

/// Scope of a measurement.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct AccuracyRequest {
    /// Measure for the planner, which chooses settings for a time budget or a least PSNR; default false. Many settings are drawn from 24 views, in
    /// three sizes from `w` × `h` to three times that on each side. `quick`, `cameras` and `repeats` do not apply.
    planner: Option<bool>,
    /// Few settings and one pose, unless `cameras` are named; default true. A whole measurement compares every setting that trades accuracy for
    /// time, from up to five cameras.
    quick: Option<bool>,
    /// Names of cameras in the scene. Default are its first ones, or views around a scene without cameras.
    cameras: Option<Vec<String>>,
    /// Width of the frames in pixels; default 320.
    #[serde(default, deserialize_with = "whole::optional")]
    w: Option<u32>,
    /// Height of the frames in pixels; default 180.
    #[serde(default, deserialize_with = "whole::optional")]
    h: Option<u32>,
    /// Number of timed frames of each setting and pose; default 3, or 5 with `quick: false`.
    #[serde(default, deserialize_with = "whole::optional")]
    repeats: Option<u32>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum AccuracyStateName {
    /// There are no results, and nothing was begun.
    NotMeasured,
    Running,
    /// `results` are those of the latest measurement.
    Done,
    Failed,
    Cancelled,
}

/// Progress of a running measurement.
#[derive(Serialize, ToSchema)]
pub struct AccuracyProgress {
    /// Number of the step at hand, from 1.
    done: u64,
    /// Number of steps; 0 before it is known.
    total: u64,
    /// The step at hand, in words.
    what: String,
}

/// What the planner chooses from.
#[derive(Serialize, ToSchema)]
pub struct PlannerState {
    /// Number of settings.
    settings: usize,
    /// Number of poses at which they were measured.
    poses: usize,
}

/// State and results of a scene's accuracy measurement.
#[derive(Serialize, ToSchema)]
pub struct AccuracyState {
    scene: String,
    /// State of the latest measurement.
    state: AccuracyStateName,
    progress: Option<AccuracyProgress>,
    /// Why the latest measurement failed. The type is `urn:pointillist:problem:` and one of `scene-changed` and `measurement-failed`.
    #[schema(value_type = Option<ProblemDocument>)]
    error: Option<Problem>,
    /// Whether the results are of another content of the scene, another adapter or another build; `null` without results.
    stale: Option<bool>,
    /// Revision of the scene that was measured.
    revision: Option<u64>,
    /// End of the measurement, in milliseconds since 1970.
    since_ms: Option<u64>,
    /// What was measured for the planner, of this content of the scene on this adapter; `null` if nothing was.
    planner: Option<PlannerState>,
    /// Results of the last measurement that was done, as `accuracy.json` of the command `pointillist accuracy` has them.
    #[schema(value_type = Option<Results>)]
    results: Option<Value>,
}

impl AccuracyState {
    fn new(
        scene: &str,
        view: Option<&View>,
        planner: Option<[usize; 2]>,
    ) -> Result<AccuracyState, Problem> {
        let (mut progress, mut error) = (None, None);
        let state = match view.map(|view| &view.state) {
            None => AccuracyStateName::NotMeasured,
            Some(SurveyState::Running(Progress { done, total, what })) => {
                let (done, total, what) = (*done, *total, what.clone());
                progress = Some(AccuracyProgress { done, total, what });
                AccuracyStateName::Running
            }
            Some(SurveyState::Done) => AccuracyStateName::Done,
            Some(SurveyState::Cancelled) => AccuracyStateName::Cancelled,
            Some(SurveyState::Failed(failure)) => {
                error = Some(failed(failure));
                AccuracyStateName::Failed
            }
        };
        let kept = view.and_then(|view| view.kept.as_ref());
        let results = kept.map(|kept| kept.value()).transpose().map_err(Problem::internal)?;
        Ok(AccuracyState {
            scene: scene.to_owned(),
            state,
            progress,
            error,
            stale: view.and_then(|view| view.is_stale),
            revision: kept.map(|kept| kept.revision),
            since_ms: kept.map(|kept| kept.since_ms),
            planner: planner.map(|[settings, poses]| PlannerState { settings, poses }),
            results,
        })
    }
}

fn failed(failure: &Failure) -> Problem {
    match failure {
        Failure::SceneChanged => {
            let detail = "the scene changed while its accuracy was measured";
            Problem::new(Kind::SceneChanged, detail).accepted("measure it again")
        }
        Failure::Other(detail) => Problem::new(Kind::MeasurementFailed, detail),
    }
}

/// The results of the last finished measurement of this scene's accuracy and its cost in time, and the state of the latest one.
///
/// Results stay until they are measured again, or the scene is deleted. They are `stale` once the scene, the adapter or the build has changed.
#[utoipa::path(
    get,
    path = "/v1/scenes/{id}/accuracy",
    operation_id = "getAccuracy",
    tag = "scenes",
    params(
        ("id" = String, Path, description = "The scene"),
        ("If-None-Match" = Option<String>, Header, description = "Entity tags that the client has"),
    ),
    responses(
        (
            status = 200,
            description = "The results, and the state of the latest measurement",
            body = AccuracyState,
            headers(("ETag" = String, description = "Strong; changes with the state, its progress and the results")),
        ),
        (status = 304, description = "Nothing has changed"),
    ),
)]
pub async fn show(
    State(app): State<Arc<App>>,
    Segments(id): Segments<String>,
    _: NoQuery,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let text = on_thread(&app, &id, |app, id| {
        let known = state(app, id)?;
        serde_json::to_string(&known).map_err(Problem::internal)
    })
    .await?;
    let json = [(header::CONTENT_TYPE, HeaderValue::from_static("application/json"))];
    conditional::revalidated(&headers, &entity_tag(&text), (json, text))
}

/// Measures the accuracy of a scene, in the background.
///
/// The frames take the time that requests and streams leave, as those of a job do. One scene is measured at a time. `GET` shows the progress and then the
/// results. A scene that changes meanwhile ends the measurement. The body may be `{}`.
#[utoipa::path(
    post,
    path = "/v1/scenes/{id}/accuracy",
    operation_id = "measureAccuracy",
    tag = "scenes",
    params(("id" = String, Path, description = "The scene")),
    request_body(content = AccuracyRequest, content_type = "application/json"),
    responses((
        status = 202,
        description = "The measurement has begun",
        body = AccuracyState,
        headers(("Location" = String, description = "Where the progress and the results are")),
    )),
)]
pub async fn begin(
    State(app): State<Arc<App>>,
    Segments(id): Segments<String>,
    _: NoQuery,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let (admission, patience) = (app.engine.admission(), app.settings.read_timeout);
    let value: Value = body::json(&headers, body, MAX_BODY_BYTES, patience, &admission).await?;
    let wanted = wanted(value)?;
    let known = on_thread(&app, &id, move |app, id| {
        app.surveys.begin(id, wanted).map_err(|refusal| refused(app, id, refusal))?;
        state(app, id)
    })
    .await?;
    let place = HeaderValue::from_str(&format!("/v1/scenes/{id}/accuracy"));
    let place = [(header::LOCATION, place.map_err(Problem::internal)?)];
    Ok((StatusCode::ACCEPTED, place, Json(known)).into_response())
}

/// Cancels the running measurement of a scene; earlier results stay. Repeating the request changes nothing.
#[utoipa::path(
    post,
    path = "/v1/scenes/{id}/accuracy/cancel",
    operation_id = "cancelAccuracy",
    tag = "scenes",
    params(("id" = String, Path, description = "The scene")),
    responses((status = 200, description = "The state of the latest measurement", body = AccuracyState)),
)]
pub async fn cancel(
    State(app): State<Arc<App>>,
    Segments(id): Segments<String>,
    _: NoQuery,
) -> Result<Json<AccuracyState>, Problem> {
    let known = on_thread(&app, &id, |app, id| {
        app.surveys.cancel(id);
        state(app, id)
    });
    Ok(Json(known.await?))
}

/// Deletes the results of a scene and what was measured for the planner, and cancels its measurement.
#[utoipa::path(
    delete,
    path = "/v1/scenes/{id}/accuracy",
    operation_id = "deleteAccuracy",
    tag = "scenes",
    params(("id" = String, Path, description = "The scene")),
    responses((status = 204, description = "The results are deleted")),
)]
pub async fn remove(
    State(app): State<Arc<App>>,
    Segments(id): Segments<String>,
    _: NoQuery,
) -> Result<StatusCode, Problem> {
    on_thread(&app, &id, |app, id| {
        let had_results = app.surveys.forget(id);
        let unlearned = app.engine.unlearn(id);
        let had_planner = unlearned.map_err(|error| missing(app, id, error.into()))?;
        if had_results || had_planner { Ok(StatusCode::NO_CONTENT) } else { Err(not_measured(id)) }
    })
    .await
}

/// Runs a closure on a thread that may block, if the scene is loaded.
async fn on_thread<T: Send + 'static>(
    app: &Arc<App>,
    id: &str,
    work: impl FnOnce(&App, &str) -> Result<T, Problem> + Send + 'static,
) -> Result<T, Problem> {
    app.engine.scene(id).map_err(|error| missing(app, id, error.into()))?;
    let (worker, name) = (app.clone(), id.to_owned());
    tokio::task::spawn_blocking(move || work(&worker, &name)).await.map_err(Problem::internal)?
}

fn state(app: &App, id: &str) -> Result<AccuracyState, Problem> {
    let planner = app.engine.planner_size(id).map_err(|error| missing(app, id, error.into()))?;
    AccuracyState::new(id, app.surveys.view(id).as_ref(), planner)
}

fn not_measured(id: &str) -> Problem {
    Problem::new(Kind::NotMeasured, format!("the accuracy of scene `{id}` was not measured yet"))
        .accepted("POST /v1/scenes/{id}/accuracy measures it")
}

/// Reads and checks a body.
pub(super) fn wanted(value: Value) -> Result<Wanted, Problem> {
    let Some(object) = value.as_object() else {
        return Err(Problem::new(Kind::BadBody, "the body is no JSON object").accepted("{}"));
    };
    if let Some(name) = object.keys().find(|name| !KEYS.contains(&name.as_str())) {
        return Err(unknown_name(name, &KEYS, &SYNONYMS));
    }
    let request: AccuracyRequest = serde_path_to_error::deserialize(value).map_err(|error| {
        let path = error.path().to_string();
        Problem::new(Kind::BadBody, format!("{path}: {}", json::plain(&error.inner().to_string())))
            .at(path)
    })?;
    let is_for_planner = request.planner.unwrap_or(false);
    let given = [
        ("quick", request.quick.is_some()),
        ("cameras", request.cameras.is_some()),
        ("repeats", request.repeats.is_some()),
    ];
    if let Some((name, _)) = given.into_iter().find(|(_, is_given)| is_for_planner && *is_given) {
        let reason = "a measurement for the planner has its own views and repeats";
        return Err(Problem::parameter(name, reason, "no value beside `\"planner\": true`"));
    }
    let is_quick = request.quick.unwrap_or(true);
    let [quick, whole] = DEFAULT_REPEATS;
    let [width, height] = DEFAULT_SIZE;
    let repeats = request.repeats.unwrap_or(if is_quick { quick } else { whole });
    let size = [request.w.unwrap_or(width), request.h.unwrap_or(height)];
    for (name, side) in ["w", "h"].into_iter().zip(size) {
        if side == 0 {
            let accepted = "a whole number of pixels, at least 1";
            return Err(Problem::parameter(name, "must not be 0", accepted));
        }
    }
    if !(1..=MOST_REPEATS).contains(&repeats) {
        let reason = format!("{repeats} is out of range");
        return Err(Problem::parameter("repeats", reason, format!("1 to {MOST_REPEATS}")));
    }
    let count = request.cameras.as_ref().map_or(1, Vec::len);
    if !(1..=MOST_CAMERAS).contains(&count) {
        let accepted = format!("1 to {MOST_CAMERAS} names, or none of `cameras`");
        return Err(Problem::parameter("cameras", format!("{count} names"), accepted));
    }
    let cameras = request.cameras.unwrap_or_default();
    Ok(Wanted { is_for_planner, is_quick, cameras, size, repeats })
}

fn refused(app: &App, id: &str, refusal: Refusal) -> Problem {
    let text = refusal.to_string();
    match refusal {
        Refusal::Running { .. } => Problem::new(Kind::Measuring, text)
            .accepted(
                "wait until it is done, or POST /v1/scenes/{id}/accuracy/cancel for that scene",
            )
            .retry_after(RETRY_RUNNING),
        Refusal::Empty => {
            Problem::new(Kind::SceneRefused, text).accepted("a scene that shows something")
        }
        Refusal::UnknownCamera(error) => {
            let at = "cameras";
            Problem::parameter(at, error, "names of `cameras` in GET /v1/scenes/{id}")
        }
        Refusal::TooLarge { most, side, .. } => Problem::new(Kind::OverLimit, format!("w: {text}"))
            .at("w")
            .accepted(format!("at most {most} pixels and {side} a side")),
        Refusal::Engine(error) => missing(app, id, error.into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn bodies_have_defaults_and_limits() {
        let plain = wanted(json!({})).unwrap();
        assert_eq!((plain.is_quick, plain.size, plain.repeats), (true, DEFAULT_SIZE, 3));
        let whole = wanted(json!({"quick": false, "w": 64.0, "h": 48, "cameras": ["a"]})).unwrap();
        assert_eq!((whole.size, whole.repeats), ([64, 48], 5));
        assert_eq!(whole.cameras, ["a"]);
        for (body, parameter) in [
            (json!({"quik": true}), "quik"),
            (json!({"quick": 1}), "quick"),
            (json!({"w": 0}), "w"),
            (json!({"h": 1.5}), "h"),
            (json!({"repeats": 0}), "repeats"),
            (json!({"repeats": 101}), "repeats"),
            (json!({"cameras": []}), "cameras"),
            (json!({"cameras": [1]}), "cameras[0]"),
        ] {
            let problem = wanted(body.clone()).unwrap_err();
            let found = (problem.status(), problem.parameter.as_deref());
            assert_eq!(found, (422, Some(parameter)), "{body}: {}", problem.detail);
        }
        // A list would do for a structure without required members.
        for body in [json!([]), json!([null, null]), json!("quick")] {
            let problem = wanted(body.clone()).unwrap_err();
            assert_eq!((problem.status(), problem.parameter), (422, None), "{body}");
        }
    }
}
