//! `/v1/jobs`: films that are drawn in the background. Translation only; [`crate::jobs`] does the work.
//!
//! | file | answers |
//! |---|---|
//! | [`create`] | `POST /v1/jobs`: from a body to a [`Spec`](crate::jobs::Spec) |
//! | here | list, show, cancel, resume and delete jobs |
//! | [`wire`] | a job as JSON, and its refusals and failures as problems |
//! | [`events`] | progress as server-sent events |
//! | [`frames`] | finished frames: one, the manifest, all in one stream |
//! | [`video`] | the video |
//! | [`watchers`] | limits on the number and duration of answers that follow jobs |
//! | [`file`](mod@file) | files as answers: entity tags and byte ranges |
//!
//! A job belongs to the key that made it. Other keys need the admin scope ([`blocking`] checks that), and lists show a key only
//! its own jobs. Without keys all jobs belong to everybody.
//!
//! Changes of a job wait for the disk and therefore run on a blocking thread.

pub mod create;
pub mod events;
pub mod file;
pub mod frames;
pub mod video;
mod watchers;
pub mod wire;

pub use watchers::WatchLimits;

use std::sync::Arc;

use axum::Json;
use axum::extract::{Extension, State};
use axum::http::{StatusCode, Uri};

use self::wire::{JobList, JobState, StateName, job_problem};
use super::params::{once, pairs, unknown_name};
use super::problem::{Kind, Problem};
use super::{App, NoQuery, Owner, Segments};
use crate::jobs::{JobError, JobId, Jobs};

/// The jobs of this server.
///
/// # Errors
/// 503 where the server has no jobs.
fn jobs(app: &App) -> Result<Jobs, Problem> {
    app.jobs.clone().map_err(|reason| {
        Problem::new(Kind::JobsOff, reason).accepted("restart the server with --state FOLDER")
    })
}

/// Reads a job's number from an address.
///
/// # Errors
/// 404: text that is no number names no job.
fn job_id(text: &str) -> Result<JobId, Problem> {
    let is_plain = !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    text.parse().ok().filter(|_| is_plain).ok_or_else(|| wire::unknown_job(text))
}

/// Runs a closure on a thread that may block; for the job of an address, only if the job belongs to `owner`.
///
/// # Errors
/// 404: there is no such job, or the job belongs to another key. Also the problems of the closure.
async fn blocking<T: Send + 'static>(
    app: &Arc<App>,
    owner: &Owner,
    id: &str,
    work: impl FnOnce(&Jobs, JobId) -> Result<T, JobError> + Send + 'static,
) -> Result<T, Problem> {
    let (jobs, number) = (jobs(app)?, job_id(id)?);
    let found = jobs.owner(number).map_err(|error| job_problem(&jobs, id, error))?;
    if !owner.is_theirs(found.as_deref()) {
        // As for a job that does not exist: a key does not learn how many jobs others have.
        return Err(wire::unknown_job(id));
    }
    let worker = jobs.clone();
    tokio::task::spawn_blocking(move || work(&worker, number))
        .await
        .map_err(Problem::internal)?
        .map_err(|error| job_problem(&jobs, &number.to_string(), error))
}

impl Owner {
    /// Returns whether this key may use what `owner` has made.
    pub(crate) fn is_theirs(&self, owner: Option<&str>) -> bool {
        self.is_admin || owner.is_some() && owner == self.name.as_deref()
    }
}

/// All jobs of the request's key, newest first. An admin key, or a server without keys, lists the jobs of all keys.
#[utoipa::path(
    get,
    path = "/v1/jobs",
    operation_id = "listJobs",
    tag = "jobs",
    params(("state" = Option<StateName>, Query, description = "List only jobs in this state")),
    responses((status = 200, description = "The jobs", body = JobList)),
)]
pub async fn list(
    State(app): State<Arc<App>>,
    Extension(owner): Extension<Owner>,
    uri: Uri,
) -> Result<Json<JobList>, Problem> {
    let state = wanted_state(uri.query())?;
    let jobs = jobs(&app)?;
    let mut views =
        tokio::task::spawn_blocking(move || jobs.list()).await.map_err(Problem::internal)?;
    views.retain(|view| owner.is_theirs(view.record.owner.as_deref()));
    views.retain(|view| state.is_none_or(|state| StateName::of(&view.record.state) == state));
    Ok(Json(JobList::new(&views)))
}

/// Reads the state by which listed jobs are filtered.
fn wanted_state(query: Option<&str>) -> Result<Option<StateName>, Problem> {
    let mut state = None;
    for (name, value) in pairs(query)? {
        if name != "state" {
            return Err(unknown_name(&name, &["state"], &[]));
        }
        let found = serde_json::from_value(serde_json::Value::String(value));
        let found = found.map_err(|error| {
            Problem::parameter(&name, error, "queued, running, done, failed or cancelled, once")
        })?;
        once(&mut state, &name, found)?;
    }
    Ok(state)
}

/// A job: its state, progress, rate, error and links.
#[utoipa::path(
    get,
    path = "/v1/jobs/{id}",
    operation_id = "getJob",
    tag = "jobs",
    params(("id" = String, Path, description = "The job")),
    responses((status = 200, description = "The job", body = JobState)),
)]
pub async fn show(
    State(app): State<Arc<App>>,
    Extension(owner): Extension<Owner>,
    Segments(id): Segments<String>,
    _: NoQuery,
) -> Result<Json<JobState>, Problem> {
    let view = blocking(&app, &owner, &id, |jobs, id| jobs.view(id)).await?;
    Ok(Json(JobState::new(&view)))
}

/// Cancels a queued or running job. Its finished frames stay, and the job can be resumed. Repeating the request changes nothing.
#[utoipa::path(
    post,
    path = "/v1/jobs/{id}/cancel",
    operation_id = "cancelJob",
    tag = "jobs",
    params(("id" = String, Path, description = "The job")),
    responses((status = 200, description = "The cancelled job", body = JobState)),
)]
pub async fn cancel(
    State(app): State<Arc<App>>,
    Extension(owner): Extension<Owner>,
    Segments(id): Segments<String>,
    _: NoQuery,
) -> Result<Json<JobState>, Problem> {
    let view = blocking(&app, &owner, &id, |jobs, id| jobs.cancel(id).and_then(|()| jobs.view(id)))
        .await?;
    Ok(Json(JobState::new(&view)))
}

/// Queues an ended job again. The job keeps undamaged frames that show the scene as it is now, and draws the others. Resuming a
/// job that is done checks its files, and makes damaged or lost files again.
#[utoipa::path(
    post,
    path = "/v1/jobs/{id}/resume",
    operation_id = "resumeJob",
    tag = "jobs",
    params(("id" = String, Path, description = "The job")),
    responses((status = 200, description = "The queued job", body = JobState)),
)]
pub async fn resume(
    State(app): State<Arc<App>>,
    Extension(owner): Extension<Owner>,
    Segments(id): Segments<String>,
    _: NoQuery,
) -> Result<Json<JobState>, Problem> {
    let view = blocking(&app, &owner, &id, |jobs, id| jobs.resume(id).and_then(|()| jobs.view(id)))
        .await?;
    Ok(Json(JobState::new(&view)))
}

/// Deletes a job in any state, with its frames and its video.
#[utoipa::path(
    delete,
    path = "/v1/jobs/{id}",
    operation_id = "deleteJob",
    tag = "jobs",
    params(("id" = String, Path, description = "The job")),
    responses((status = 204, description = "The job is deleted")),
)]
pub async fn remove(
    State(app): State<Arc<App>>,
    Extension(owner): Extension<Owner>,
    Segments(id): Segments<String>,
    _: NoQuery,
) -> Result<StatusCode, Problem> {
    blocking(&app, &owner, &id, |jobs, id| jobs.remove(id)).await?;
    Ok(StatusCode::NO_CONTENT)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn jobs_are_their_keys_own() {
        let owner = |name: Option<&str>, is_admin| Owner {
            name: name.map(str::to_owned),
            is_admin,
            ..Owner::default()
        };
        let (ann, admin, anybody) =
            (owner(Some("ann"), false), owner(Some("root"), true), owner(None, true));
        for (by, is_anns) in [(Some("ann"), true), (Some("bob"), false), (None, false)] {
            assert_eq!(ann.is_theirs(by), is_anns, "{by:?}");
            assert!(admin.is_theirs(by) && anybody.is_theirs(by));
        }
    }

    #[test]
    fn queries_of_lists() {
        assert_eq!(wanted_state(None).ok(), Some(None));
        assert_eq!(wanted_state(Some("state=done")).ok(), Some(Some(StateName::Done)));
        for (query, parameter) in [
            ("state=don", "state"),
            ("state=", "state"),
            ("state=done&state=done", "state"),
            ("stat=done", "stat"),
        ] {
            let problem = wanted_state(Some(query)).unwrap_err();
            let found = (problem.status(), problem.parameter.as_deref());
            assert_eq!(found, (422, Some(parameter)), "{query}: {}", problem.detail);
        }
    }

    #[test]
    fn numbers_of_jobs() {
        assert_eq!(job_id("17").ok(), Some(17));
        for other in ["", "x", "-1", "+1", "1.5", "99999999999999999999999"] {
            assert_eq!(job_id(other).map_err(|problem| problem.status()), Err(404), "{other}");
        }
    }
}
