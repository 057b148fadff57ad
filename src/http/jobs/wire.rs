//! A job as JSON, and the problems of jobs.

use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::ToSchema;

use crate::film::FilmError;
use crate::film::video::VideoError;
use crate::http::problem::{Kind, Problem, ProblemDocument};
use crate::jobs::book::Failure;
use crate::jobs::{
    FailureKind, FrameSpec, JobError, Jobs, PathChoice, Refusal, Stage, State, StateError, View,
};
use crate::plan::Given;

/// A job.
#[derive(Serialize, ToSchema)]
pub struct JobState {
    id: String,
    state: StateName,
    /// Stage of a running job: `baking`, `frames` or `video`; `null` while the job prepares, and while it waits for its turn at the
    /// next stage.
    stage: Option<&'static str>,
    /// Progress of the bake that the frames need, from 0 to 1; only during the stage `baking`.
    #[serde(skip_serializing_if = "Option::is_none")]
    baked: Option<f64>,
    /// Name of the API key that created the job; `null` if the server had no keys.
    owner: Option<String>,
    /// Id of the request that created the job. The receipts of its frames carry ids such as `job-7/42`.
    request_id: Option<String>,
    scene: String,
    /// The path's name in the scene, or the path itself. A list shows only the number of `keys` of such a path.
    #[schema(value_type = Object)]
    path: Value,
    /// Frames per second of the film; `null` if the request gave none and the job was recovered and has not run since.
    fps: Option<f64>,
    want: Vec<&'static str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    bitrate_kbps: Option<u32>,
    settings: JobSettings,
    frames: JobFrames,
    /// Recent rate of the running job in frames per second: frames drawn or, in the stage `video`, frames encoded. `null` during the
    /// first second of a stage, because the first frames do not predict the others.
    frames_per_second: Option<f64>,
    /// Estimated seconds until the stage ends, from `frames_per_second`.
    eta_seconds: Option<f64>,
    /// Condition that a queued job waits for, besides its turn, or a running one: with `--nats`, a worker that can draw its frames.
    waits_for: Option<String>,
    /// Why the job failed. The type is `urn:pointillist:problem:` and one of `scene-changed`, `unknown-scene` (the scene did not appear in time),
    /// `job-refused`, `job-quota`, `storage`, `job-failed`, `video-failed`, `job-recovered`, `internal`.
    #[schema(value_type = Option<ProblemDocument>)]
    error: Option<Problem>,
    /// Disk space of all files of the job, in bytes.
    bytes: u64,
    /// SHA-256 of `frames.jsonl`, which has a line with a checksum for each frame; set once all frames are drawn.
    manifest_sha256: Option<String>,
    video: Option<JobVideo>,
    /// Time of creation, in milliseconds since 1970.
    created_ms: u64,
    /// Time at which the job entered its state, in milliseconds since 1970.
    since_ms: u64,
    /// Time at which an ended job will be deleted, or a job that waits for its scene will fail.
    expires_ms: Option<u64>,
    links: JobLinks,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum StateName {
    /// The job waits for its turn, or for the condition in `waits_for`.
    Queued,
    Running,
    Done,
    /// The job failed and can be resumed.
    Failed,
    /// The job was cancelled and can be resumed.
    Cancelled,
}

impl StateName {
    pub fn of(state: &State) -> StateName {
        match state {
            State::Queued { .. } => StateName::Queued,
            State::Running => StateName::Running,
            State::Done => StateName::Done,
            State::Failed(_) => StateName::Failed,
            State::Cancelled => StateName::Cancelled,
        }
    }
}

/// Frames of a job.
#[derive(Serialize, ToSchema)]
pub struct JobFrames {
    /// Number of frames drawn.
    done: u64,
    /// Number of frames requested; `null` if the job was recovered and has not run since.
    total: Option<u64>,
    /// Numbers of the first and the last requested frame.
    from: Option<u64>,
    to: Option<u64>,
    /// Number of frames encoded so far; only during the stage `video`.
    #[serde(skip_serializing_if = "Option::is_none")]
    coded: Option<u64>,
}

/// How frames are drawn. A missing setting takes the scene's value or does not apply.
#[derive(Serialize, ToSchema)]
pub struct JobSettings {
    w: u32,
    h: u32,
    format: crate::encode::ImageFormat,
    quality: u8,
    output: crate::plan::Output,
    #[serde(flatten)]
    settings: Given,
}

/// A finished video.
#[derive(Serialize, ToSchema)]
pub struct JobVideo {
    bytes: u64,
    sha256: String,
}

/// Addresses of a job's resources.
#[derive(Serialize, ToSchema)]
pub struct JobLinks {
    #[serde(rename = "self")]
    this: String,
    scene: String,
    events: String,
    /// Address of the manifest.
    frames: String,
    /// Address of one frame; replace `{n}` by its number.
    frame: String,
    multipart: String,
    /// Address of the video, if the job makes one.
    video: Option<String>,
}

#[derive(Serialize, ToSchema)]
pub struct JobList {
    jobs: Vec<JobState>,
}

impl JobList {
    pub fn new(views: &[View]) -> JobList {
        JobList { jobs: views.iter().map(JobState::brief).collect() }
    }
}

impl JobSettings {
    fn new(frame: &FrameSpec) -> JobSettings {
        JobSettings {
            w: frame.width,
            h: frame.height,
            format: frame.format,
            quality: frame.quality,
            output: frame.output,
            settings: frame.settings,
        }
    }
}

impl JobState {
    /// The job in a list: without parts that may be long.
    fn brief(view: &View) -> JobState {
        let mut job = JobState::new(view);
        if let Some(keys) = job.path.get("keys").and_then(Value::as_array).map(Vec::len) {
            job.path = serde_json::json!({ "keys": keys });
        }
        job
    }

    pub fn new(view: &View) -> JobState {
        let record = &view.record;
        let spec = &record.spec;
        let this = format!("/v1/jobs/{}", record.id);
        let to = |what: &str| format!("{this}/{what}");
        let (waits_for, error) = match &record.state {
            State::Queued { waits_for } => (waits_for.clone(), None),
            State::Failed(failure) => (None, Some(failure_problem(failure))),
            State::Running => (view.waits_for.clone(), None),
            State::Done | State::Cancelled => (None, None),
        };
        let wanted = [("frames", spec.want.frames), ("video", spec.want.video)];
        JobState {
            id: record.id.to_string(),
            state: StateName::of(&record.state),
            stage: match view.stage {
                Stage::None => None,
                Stage::Baking => Some("baking"),
                Stage::Frames => Some("frames"),
                Stage::Video => Some("video"),
            },
            baked: (view.stage == Stage::Baking).then_some(view.baked),
            owner: record.owner.clone(),
            request_id: record.request_id.clone(),
            scene: spec.scene.clone(),
            path: match &spec.path {
                PathChoice::Named(name) => Value::String(name.clone()),
                PathChoice::Inline(text) => serde_json::from_str(text).unwrap_or_default(),
            },
            fps: record.made.fps.or(spec.fps),
            want: wanted
                .iter()
                .filter(|(_, is_wanted)| *is_wanted)
                .map(|(name, _)| *name)
                .collect(),
            bitrate_kbps: spec.want.bitrate_kbps,
            settings: JobSettings::new(&spec.frame),
            frames: JobFrames {
                done: view.done,
                total: view.total,
                from: spec.from,
                to: spec.to,
                coded: (view.stage == Stage::Video).then_some(view.coded),
            },
            frames_per_second: view.rate,
            eta_seconds: view.eta_s,
            waits_for,
            error,
            bytes: view.bytes,
            manifest_sha256: record.made.manifest_sha256.clone(),
            video: record
                .made
                .video
                .as_ref()
                .map(|video| JobVideo { bytes: video.bytes, sha256: video.sha256.clone() }),
            created_ms: record.created_ms,
            since_ms: record.since_ms,
            expires_ms: view.expires_ms,
            links: JobLinks {
                scene: format!("/v1/scenes/{}", spec.scene),
                events: to("events"),
                frames: to("frames"),
                frame: to("frames/{n}"),
                multipart: to("multipart"),
                video: spec.want.video.then(|| to("video.mp4")),
                this,
            },
        }
    }

    /// Whether the job changes no more unless a client acts.
    pub fn has_ended(&self) -> bool {
        !matches!(self.state, StateName::Queued | StateName::Running)
    }

    pub fn state(&self) -> StateName {
        self.state
    }
}

pub fn unknown_job(id: &str) -> Problem {
    let shown: String = id.chars().take(64).collect();
    Problem::new(Kind::UnknownJob, format!("there is no job `{shown}`"))
        .accepted("an id that GET /v1/jobs lists")
}

/// Builds the problem of a failed job.
fn failure_problem(failure: &Failure) -> Problem {
    let kind = match failure.kind {
        FailureKind::SceneChanged => Kind::SceneChanged,
        FailureKind::SceneGone => Kind::UnknownScene,
        FailureKind::Refused => Kind::JobRefused,
        FailureKind::DiskQuota => Kind::OutOfJobDisk,
        FailureKind::Storage => Kind::OutOfDisk,
        FailureKind::Engine => Kind::JobFailed,
        FailureKind::Video => Kind::VideoFailed,
        FailureKind::Recovered => Kind::JobRecovered,
        FailureKind::Internal => Kind::Internal,
    };
    let problem = Problem::new(kind, failure.detail.clone());
    problem.accepted("POST to the job's /resume, once the cause is fixed")
}

/// Builds the problem of an operation on job `id` that failed.
pub fn job_problem(jobs: &Jobs, id: &str, error: JobError) -> Problem {
    match error {
        JobError::Refused(refusal) => match refusal {
            Refusal::Unknown => unknown_job(id),
            Refusal::State { state, accepted } => {
                Problem::new(Kind::JobState, format!("job {id} is {state}")).accepted(accepted)
            }
            Refusal::KeyReused { id } => Problem::new(
                Kind::KeyReused,
                format!("the key was used before, for job {id}, whose request was different"),
            )
            .at("Idempotency-Key")
            .accepted("a new key for each job, or the original request"),
            Refusal::TooManyUnfinished { limit } => Problem::new(
                Kind::TooManyJobs,
                format!("the limit of {limit} queued and running jobs is reached"),
            )
            .accepted("wait until a job ends, or cancel one")
            .retry_after(jobs.retry_after()),
            Refusal::TooManyOfOwner { limit } => Problem::new(
                Kind::TooManyJobs,
                format!("this key has {limit} queued and running jobs, the most of one key"),
            )
            .accepted("wait until a job of this key ends, or cancel one")
            .retry_after(jobs.retry_after()),
            Refusal::TooMany { limit } => Problem::new(
                Kind::TooManyJobs,
                format!("the limit of {limit} stored jobs is reached"),
            )
            .accepted("DELETE jobs that have ended")
            .retry_after(jobs.retry_after()),
        },
        JobError::Full { used, limit } => Problem::new(
            Kind::OutOfJobDisk,
            format!("job storage is full: {used} of {limit} bytes used"),
        )
        .accepted(
            "DELETE jobs that have ended, or restart the server with a larger --job-disk-mib",
        ),
        JobError::State(StateError::Io { error, .. }) | JobError::Io { error, .. } => {
            job_storage(&error)
        }
        JobError::State(error) => Problem::internal(error),
    }
}

/// Builds the problem of a job's file that differs from its record.
pub fn damaged(id: &str, what: &str) -> Problem {
    Problem::new(Kind::JobFileDamaged, format!("{what} of job {id} is damaged or missing on disk"))
        .accepted(format!("POST /v1/jobs/{id}/resume, which creates the file again"))
}

/// Builds the problem of a job's file that cannot be read or written.
pub fn job_storage(error: &std::io::Error) -> Problem {
    tracing::error!(%error, "cannot read or write a file of a job");
    let detail = match error.kind() {
        std::io::ErrorKind::StorageFull | std::io::ErrorKind::QuotaExceeded => {
            "the disk of the state folder is full"
        }
        std::io::ErrorKind::ReadOnlyFilesystem | std::io::ErrorKind::PermissionDenied => {
            "the state folder is not writable"
        }
        _ => "the state folder cannot be used",
    };
    Problem::new(Kind::OutOfDisk, detail)
}

/// Builds the problem of a path that cannot be drawn.
pub fn film_problem(error: FilmError) -> Problem {
    match error {
        FilmError::Engine(error) | FilmError::Frame { error, .. } => {
            // The error names a place in a scene file, and the path in the request corresponds to that place.
            let is_path = matches!(error, crate::engine::EngineError::Scene(_));
            let problem = Problem::from(error);
            if !is_path {
                return problem;
            }
            let place = match problem.parameter.as_deref() {
                None | Some("" | "$" | ".") => "path".to_owned(),
                Some(place) => format!("path.{}", place.trim_start_matches("$.")),
            };
            Problem { kind: Kind::BadParameter, parameter: Some(place), ..problem }
        }
        FilmError::BadRange { parameter, reason } => Problem::parameter(
            parameter,
            reason,
            "frame numbers within the path; fps from 0.001 to 1000",
        ),
        FilmError::Path(error) => {
            Problem::parameter("path", error, "a path whose camera can be computed at any time")
        }
        other => Problem::internal(other),
    }
}

/// Builds the problem of a video that cannot be made.
pub fn video_problem(error: VideoError) -> Problem {
    let text = error.to_string();
    match error {
        VideoError::Unfit { parameter, reason } => {
            Problem::parameter(parameter, reason, "a value that fits a video")
        }
        VideoError::NoCoder => {
            Problem::new(Kind::Unavailable, text).at("want").accepted("`[\"frames\"]`")
        }
        _ => Problem::internal(text),
    }
}
