//! Errors as `application/problem+json` (RFC 9457).
//!
//! Errors below this floor know no HTTP. The one `match` in `From<EngineError>` gives each case its [`Kind`], and [`Kind::facts`]
//! gives each kind its status, its stable `type` and its title. Internal errors are logged there, once, and never sent.

use std::time::Duration;

use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;

use super::naming;
use crate::assets::AssetError;
use crate::engine::{EngineError, RequestId};
use crate::math::CameraError;
use crate::memory::Interrupt;
use crate::scene::SceneError;

/// Makes [`Kind`] of a table with a line for each kind of problem: its name, its HTTP status, the last part of its `type`, and its title.
macro_rules! kinds {
    ($($kind:ident $status:literal $name:literal $title:literal;)+) => {
        /// Kinds of problem. Each has one status and one `type` that never change.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum Kind {
            $($kind,)+
        }

        impl Kind {
            /// Every kind, in the order of the documentation.
            pub const ALL: &[Kind] = &[$(Kind::$kind,)+];

            /// Returns status, `type` and title.
            pub fn facts(self) -> (u16, &'static str, &'static str) {
                match self {
                    $(Kind::$kind => ($status, concat!("urn:pointillist:problem:", $name), $title),)+
                }
            }
        }
    };
}

kinds! {
    MalformedRequest     400 "malformed-request"       "malformed HTTP request";
    HeadTooLarge         431 "head-too-large"          "the request's head is too large";
    UnknownRoute         404 "unknown-route"           "no such resource";
    UnknownScene         404 "unknown-scene"           "no such scene";
    UnknownNode          404 "unknown-node"            "no such node";
    UnknownPath          404 "unknown-path"            "no such camera path";
    MethodNotAllowed     405 "method-not-allowed"      "method not allowed";
    NotAcceptable        406 "not-acceptable"          "no acceptable image format";
    RequestTimeout       408 "request-timeout"         "the request body stalled";
    UpgradeRequired      426 "upgrade-required"        "a WebSocket handshake is needed";
    SceneExists          409 "scene-exists"            "the scene id is in use";
    SceneLoading         409 "scene-loading"           "the scene is still loading";
    BodyTooLarge         413 "body-too-large"          "the request body is too large";
    SceneTooLarge        413 "scene-too-large"         "the scene is too large";
    UnsupportedMediaType 415 "unsupported-media-type"  "unsupported media type";
    UnsupportedAsset     415 "unsupported-asset"       "unsupported asset format";
    BadParameter         422 "bad-parameter"           "a parameter cannot be used";
    UnknownParameter     422 "unknown-parameter"       "unknown parameter";
    Unavailable          422 "unavailable-parameter"   "not available in this version";
    BadBody              422 "bad-body"                "the request body cannot be used";
    OverLimit            422 "over-limit"              "over a limit";
    AssetRefused         422 "asset-refused"           "an asset cannot be read";
    SceneRefused         422 "scene-refused"           "the scene is not valid";
    Unauthorized         401 "unauthorized"            "an API key is needed";
    Forbidden            403 "forbidden"               "not allowed";
    TooManyRequests      429 "too-many-requests"       "too many requests";
    DeviceQuota          429 "device-quota"            "the key's GPU time is used up";
    WrongHost            421 "wrong-host"              "not a name of this server";
    Busy                 503 "busy"                    "the server is busy";
    DeadlineExceeded     503 "deadline-exceeded"       "the deadline passed";
    FrameTimeout         503 "frame-timeout"           "the frame took too long";
    DeviceLost           503 "device-lost"             "the GPU was lost";
    ShuttingDown         503 "shutting-down"           "the server is shutting down";
    NotReady             503 "not-ready"               "the server is not ready";
    OutOfGpuMemory       507 "out-of-gpu-memory"       "not enough GPU memory";
    OutOfMemory          507 "out-of-memory"           "not enough host memory";
    OutOfDisk            507 "storage"                 "the disk cannot be read or written";
    TooManyScenes        429 "too-many-scenes"         "too many scenes";
    UploadQuota          507 "upload-quota"            "upload storage is full";
    LoadCancelled        409 "load-cancelled"          "the load was cancelled";
    LoadLost             500 "load-lost"               "the server ended while it loaded the scene";
    UnknownJob           404 "unknown-job"             "no such job";
    UnknownFrame         404 "unknown-frame"           "the job has no such frame";
    FrameNotDrawn        404 "frame-not-drawn"         "the frame is not drawn yet";
    NoVideo              404 "no-video"                "there is no video";
    JobState             409 "job-state"               "the job's state does not allow it";
    SceneChanged         409 "scene-changed"           "the scene changed while it was drawn";
    JobRecovered         409 "job-recovered"           "the job's record was lost; the job was recovered";
    RangeNotSatisfiable  416 "range-not-satisfiable"   "the range is beyond the end of the file";
    JobRefused           422 "job-refused"             "the job does not fit its scene";
    KeyReused            422 "key-reused"              "the idempotency key was used before";
    TooManyJobs          429 "too-many-jobs"           "too many jobs";
    JobFailed            500 "job-failed"              "the job could not be drawn";
    VideoFailed          500 "video-failed"            "the video could not be made";
    NotMeasured          404 "not-measured"            "the accuracy was not measured yet";
    Measuring            409 "measuring"               "another measurement is running";
    MeasurementFailed    500 "measurement-failed"      "the accuracy could not be measured";
    JobsOff              503 "jobs-off"                "this server accepts no jobs";
    UploadsOff           503 "uploads-off"             "this server accepts no uploads";
    OutOfJobDisk         507 "job-quota"               "job storage is full";
    JobFileDamaged       410 "job-file-damaged"        "a file of the job is damaged or missing";
    Internal             500 "internal"                "internal error";
}

impl Kind {
    pub fn status(self) -> StatusCode {
        StatusCode::from_u16(self.facts().0).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR)
    }
}

/// An error on its way to a client.
#[derive(Clone, Debug, Serialize)]
#[serde(into = "ProblemDocument")]
pub struct Problem {
    pub kind: Kind,
    /// Description of this occurrence.
    pub detail: String,
    /// The parameter, header, or place in the body at fault.
    pub parameter: Option<String>,
    /// The accepted values or actions.
    pub accepted: Option<String>,
    /// When trying again is worthwhile.
    pub retry_after_ms: Option<u64>,
    /// Id of the request that this answers; `None` stands for the request that is being answered when this is sent.
    pub request_id: Option<RequestId>,
}

/// An error as the client sees it (RFC 9457).
#[derive(Serialize, ToSchema)]
#[schema(as = Problem)]
pub struct ProblemDocument {
    /// Stable; programs may match on it.
    #[schema(example = "urn:pointillist:problem:bad-parameter")]
    r#type: &'static str,
    /// Meaning of the type; fixed text.
    title: &'static str,
    status: u16,
    /// Description of this occurrence.
    detail: String,
    /// The parameter, header, or place in the body at fault.
    #[serde(skip_serializing_if = "Option::is_none")]
    parameter: Option<String>,
    /// Values or actions that would be accepted.
    #[serde(skip_serializing_if = "Option::is_none")]
    accepted: Option<String>,
    /// Milliseconds after which a retry is worthwhile, from the measured cost of the queued work.
    #[serde(skip_serializing_if = "Option::is_none")]
    retry_after_ms: Option<u64>,
    /// Id of the request, under which the server's log has details.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<String>)]
    request_id: Option<RequestId>,
}

impl From<Problem> for ProblemDocument {
    fn from(problem: Problem) -> Self {
        let (status, r#type, title) = problem.kind.facts();
        let Problem { detail, parameter, accepted, retry_after_ms, .. } = problem;
        let request_id = problem.request_id.or_else(naming::current);
        Self { r#type, title, status, detail, parameter, accepted, retry_after_ms, request_id }
    }
}

impl Problem {
    pub fn new(kind: Kind, detail: impl Into<String>) -> Self {
        Self {
            kind,
            detail: detail.into(),
            parameter: None,
            accepted: None,
            retry_after_ms: None,
            request_id: None,
        }
    }

    /// Builds the problem of a parameter that cannot be used as given.
    pub fn parameter(
        name: impl Into<String>,
        reason: impl std::fmt::Display,
        accepted: impl Into<String>,
    ) -> Self {
        let name = name.into();
        let mut problem = Self::new(Kind::BadParameter, format!("{name}: {reason}"));
        problem.parameter = Some(name);
        problem.accepted = Some(accepted.into());
        problem
    }

    /// Logs `inner` and hides it from the client.
    pub fn internal(inner: impl std::fmt::Display) -> Self {
        let request_id = naming::current();
        let request_id = request_id.as_ref().map(RequestId::as_str);
        tracing::error!(request_id, error = %inner, "internal error");
        Self::new(Kind::Internal, "the server failed; its log has the cause")
    }

    pub fn at(mut self, parameter: impl Into<String>) -> Self {
        self.parameter = Some(parameter.into());
        self
    }

    pub fn accepted(mut self, accepted: impl Into<String>) -> Self {
        self.accepted = Some(accepted.into());
        self
    }

    pub fn retry_after(mut self, after: Duration) -> Self {
        self.retry_after_ms = Some(u64::try_from(after.as_millis()).unwrap_or(u64::MAX));
        self
    }

    /// Attaches the id of another request, or of a part of this one.
    pub fn named(mut self, request_id: RequestId) -> Self {
        self.request_id = Some(request_id);
        self
    }

    /// Makes paths below `root` relative, so that clients do not see where the server keeps its files.
    pub fn hide_root(mut self, root: &std::path::Path) -> Self {
        let prefix = format!("{}{}", root.display(), std::path::MAIN_SEPARATOR);
        if prefix.len() > 1 {
            self.detail = self.detail.replace(&prefix, "");
        }
        self
    }

    pub fn status(&self) -> u16 {
        self.kind.facts().0
    }

    /// Returns the body as JSON; also used for parts of a multipart answer.
    pub fn to_json(&self) -> String {
        // This cannot fail: there are only strings and numbers.
        serde_json::to_string(self).unwrap_or_default()
    }
}

/// Returns whole seconds for `Retry-After`, rounded up, at least one.
fn retry_after_seconds(after_ms: u64) -> u64 {
    after_ms.div_ceil(1000).max(1)
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let mut response = (self.kind.status(), self.to_json()).into_response();
        let headers = response.headers_mut();
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(PROBLEM_JSON));
        headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
        if let Some(after_ms) = self.retry_after_ms {
            headers.insert(header::RETRY_AFTER, retry_after_seconds(after_ms).into());
        }
        if self.kind == Kind::UpgradeRequired {
            headers.insert(header::UPGRADE, HeaderValue::from_static("websocket"));
        }
        if self.status() == 401 {
            headers.insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
        }
        response
    }
}

pub const PROBLEM_JSON: &str = "application/problem+json";

impl From<EngineError> for Problem {
    fn from(error: EngineError) -> Self {
        let text = error.to_string();
        match error {
            EngineError::UnknownScene { .. } => {
                Problem::new(Kind::UnknownScene, text).accepted("an id that GET /v1/scenes lists")
            }
            EngineError::UnknownNode { .. } => Problem::new(Kind::UnknownNode, text)
                .accepted("a name in `nodes` of GET /v1/scenes/{id}"),
            EngineError::BadParameter { parameter, reason, accepted } => {
                Problem::parameter(parameter, reason, accepted)
            }
            EngineError::SceneExists { .. } => Problem::new(Kind::SceneExists, text)
                .at("id")
                .accepted("an unused id, or DELETE the scene first"),
            EngineError::Busy { retry_after } => {
                Problem::new(Kind::Busy, text).retry_after(retry_after)
            }
            EngineError::Overtaken => Problem::new(Kind::Busy, text),
            EngineError::DeadlineExceeded { retry_after } => {
                Problem::new(Kind::DeadlineExceeded, text)
                    .at("deadline_ms")
                    .retry_after(retry_after)
            }
            EngineError::DeviceLost { retry_after } => {
                Problem::new(Kind::DeviceLost, text).retry_after(retry_after)
            }
            EngineError::ShuttingDown => {
                Problem::new(Kind::ShuttingDown, text).retry_after(Duration::from_secs(5))
            }
            EngineError::OutOfGpuMemory { .. } | EngineError::OverBinding { .. } => {
                Problem::new(Kind::OutOfGpuMemory, text)
                    .accepted("`lod=spt`, which does with less where copies are many; a scene that fits; a larger --gpu-budget-mib")
            }
            EngineError::Interrupted(Interrupt::Cancelled) => {
                Problem::new(Kind::LoadCancelled, text).accepted("upload the files again")
            }
            EngineError::Interrupted(Interrupt::OutOfMemory(error)) => match error.is_hopeless() {
                true => Problem::new(Kind::SceneTooLarge, text)
                    .accepted("a smaller scene, or a larger --host-memory-mib"),
                false => Problem::new(Kind::OutOfMemory, text).accepted(
                    "DELETE other scenes and send the request again, or restart with a larger --host-memory-mib",
                ),
            },
            EngineError::OverLimit { what, limit, parameter, .. } => {
                // Limits of frames, which antialiasing lowers.
                let listed = match parameter {
                    Some(_) => "GET /v1/limits lists all limits, those of frames without antialiasing",
                    None => "GET /v1/limits lists all limits",
                };
                let accepted = format!("at most {limit} {what}; {listed}");
                let problem = Problem::new(Kind::OverLimit, text).accepted(accepted);
                parameter.into_iter().fold(problem, Problem::at)
            }
            EngineError::Asset(inner) => match &*inner {
                AssetError::Io { source, .. } if !is_users_fault(source) => Problem::internal(text),
                AssetError::Io { .. } | AssetError::Malformed { .. } => {
                    Problem::new(Kind::AssetRefused, text)
                }
                AssetError::Unsupported { .. } => Problem::new(Kind::UnsupportedAsset, text),
                AssetError::TooLarge { .. } => Problem::new(Kind::SceneTooLarge, text),
                AssetError::Interrupted(inner) => EngineError::from(inner.clone()).into(),
            },
            EngineError::Scene(inner) => match &*inner {
                SceneError::Io { source, .. } if !is_users_fault(source) => Problem::internal(text),
                SceneError::Io { .. } => Problem::new(Kind::SceneRefused, text),
                SceneError::Invalid { path, .. } => {
                    let path = path.clone();
                    Problem::new(Kind::SceneRefused, text).at(path)
                }
                SceneError::TooLarge { .. } => Problem::new(Kind::SceneTooLarge, text),
                SceneError::Interrupted(inner) => EngineError::from(inner.clone()).into(),
            },
            EngineError::Internal(inner) | EngineError::NoGpu(inner) => Problem::internal(inner),
        }
    }
}

/// Returns whether a failed read is due to the file's name or content rather than to the machine.
fn is_users_fault(error: &std::io::Error) -> bool {
    use std::io::ErrorKind::*;
    matches!(
        error.kind(),
        NotFound
            | PermissionDenied
            | InvalidData
            | InvalidInput
            | InvalidFilename
            | UnexpectedEof
            | IsADirectory
            | NotADirectory
    )
}

impl From<CameraError> for Problem {
    fn from(error: CameraError) -> Self {
        let mut problem = Problem::new(Kind::BadParameter, error.to_string());
        problem.parameter = Some(error.parameter.to_owned());
        problem
    }
}

/// Builds the problem of an upload's file that could not be written.
pub fn storage(error: &std::io::Error) -> Problem {
    tracing::error!(%error, "cannot store an upload");
    let detail = match error.kind() {
        std::io::ErrorKind::StorageFull | std::io::ErrorKind::QuotaExceeded => {
            "the disk of the scene root is full"
        }
        std::io::ErrorKind::ReadOnlyFilesystem | std::io::ErrorKind::PermissionDenied => {
            "the scene root is not writable"
        }
        _ => "the upload could not be written",
    };
    Problem::new(Kind::OutOfDisk, detail)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;
    use std::sync::Arc;

    #[test]
    fn every_kind_has_its_own_type_and_a_real_status() {
        let mut types = HashSet::new();
        for kind in Kind::ALL {
            let (status, urn, title) = kind.facts();
            assert!(urn.starts_with("urn:pointillist:problem:"), "{urn}");
            assert!(types.insert(urn), "{urn} twice");
            assert!((400..600).contains(&status) && !title.is_empty());
        }
    }

    #[test]
    fn retry_after_is_rounded_up() {
        let response =
            Problem::from(EngineError::Busy { retry_after: Duration::from_millis(1001) })
                .into_response();
        assert_eq!(response.status(), 503);
        assert_eq!(response.headers()[header::RETRY_AFTER], "2");
        assert_eq!(response.headers()[header::CONTENT_TYPE], PROBLEM_JSON);
        let response =
            Problem::from(EngineError::Busy { retry_after: Duration::ZERO }).into_response();
        assert_eq!(response.headers()[header::RETRY_AFTER], "1");
    }

    #[test]
    fn internal_errors_keep_their_secret() {
        let problem = Problem::from(EngineError::Internal("pool 0xdeadbeef".into()));
        assert_eq!(problem.status(), 500);
        assert!(!problem.to_json().contains("deadbeef"));
    }

    #[test]
    fn asset_errors_by_cause() {
        let asset = |error| Problem::from(EngineError::Asset(Arc::new(error)));
        let file = || "/srv/scenes/a.ply".to_owned();
        let unsupported = asset(AssetError::Unsupported { file: file(), reason: "?".into() });
        assert_eq!(unsupported.status(), 415);
        let missing = asset(AssetError::Io {
            file: file(),
            source: std::io::Error::from(std::io::ErrorKind::NotFound),
        });
        assert_eq!(missing.status(), 422);
        let broken =
            asset(AssetError::Io { file: file(), source: std::io::Error::other("disk on fire") });
        assert_eq!(broken.status(), 500);
        let large =
            asset(AssetError::TooLarge { file: file(), what: "vertices", found: 2, limit: 1 });
        assert_eq!(large.status(), 413);
        let hidden = unsupported.hide_root(std::path::Path::new("/srv/scenes"));
        assert_eq!(hidden.detail, "a.ply: ?");
    }

    #[test]
    fn memory_that_can_never_be_had_is_told_from_memory_that_is_in_use() {
        let memory = crate::memory::HostMemory::new(100);
        let held = memory.reserve("another scene", 90).unwrap();
        let refused = |bytes| {
            let interrupt = Interrupt::from(memory.reserve("a.ply", bytes).unwrap_err());
            Problem::from(EngineError::from(interrupt))
        };
        let full = refused(20);
        assert_eq!(full.status(), 507);
        assert!(["20", "90", "100"].iter().all(|n| full.detail.contains(n)), "{}", full.detail);
        assert_eq!(refused(101).status(), 413);
        drop(held);
        assert!(memory.reserve("a.ply", 20).is_ok());
    }
}
