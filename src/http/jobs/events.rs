//! `GET /v1/jobs/{id}/events`: a job's progress as server-sent events (the `EventSource` of the HTML standard).
//!
//! Every event carries the whole job, so that none is needed to understand the next: a client that comes late or reads slowly
//! misses nothing but steps in between. Its id tells which state that was; who comes back with that id hears nothing until there
//! is news.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::{Extension, State};
use axum::http::{HeaderMap, StatusCode, Uri};
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use futures::Stream;

use super::watchers::Watcher;
use super::wire::{JobState, StateName};
use super::{blocking, job_id, jobs, no_query};
use crate::http::problem::Problem;
use crate::http::{App, Caller, Owner, Segments};
use crate::jobs::{JobId, Jobs, View};

/// Events come no faster than this.
const PACE: Duration = Duration::from_millis(100);
/// A comment keeps proxies from closing a connection on which nothing happens.
const KEEP_ALIVE: Duration = Duration::from_secs(15);
/// After which a client that lost its connection is asked to come back.
const RETRY: Duration = Duration::from_secs(2);

/// Progress of a job as server-sent events: the job as it is now, then whenever something changes, until it has ended.
///
/// Events are named `job` while it is queued or running, and `done`, `failed`, `cancelled` or `deleted` at the end; `data` is the job as
/// `GET /v1/jobs/{id}` has it. After `watch_ms` of `GET /v1/limits` an event `reconnect` ends the stream; an `EventSource` comes again by
/// itself and misses nothing. A server that stops ends the stream without such an end: come back with `Last-Event-ID`.
#[utoipa::path(
    get,
    path = "/v1/jobs/{id}/events",
    operation_id = "followJob",
    tag = "jobs",
    params(
        ("id" = String, Path, description = "The job"),
        ("Last-Event-ID" = Option<String>, Header, description = "The id of the last event that the client has: what it knows is not sent again"),
    ),
    responses(
        (status = 200, description = "The events, each with `event`, `id` and `data`", body = Object, content_type = "text/event-stream"),
        (status = 204, description = "The job has ended, and the client knows"),
    ),
)]
pub async fn events(
    State(app): State<Arc<App>>,
    Extension(Caller(client)): Extension<Caller>,
    Extension(owner): Extension<Owner>,
    Segments(id): Segments<String>,
    uri: Uri,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    no_query(&uri)?;
    let view = blocking(&app, &owner, &id, |jobs, id| jobs.view(id)).await?;
    let jobs = jobs(&app)?;
    let known =
        headers.get("last-event-id").and_then(|value| value.to_str().ok()).map(str::to_owned);
    if JobState::new(&view).has_ended() && known.as_ref() == Some(&event_id(&jobs, &view)) {
        // What an `EventSource` takes for the end; it would come back for ever.
        return Ok(StatusCode::NO_CONTENT.into_response());
    }
    let told = told(jobs, job_id(&id)?, known, Watcher::take(&app, client)?);
    let mut response =
        Sse::new(told).keep_alive(KeepAlive::new().interval(KEEP_ALIVE)).into_response();
    // Some proxies collect answers before they pass them on.
    response.headers_mut().insert("x-accel-buffering", axum::http::HeaderValue::from_static("no"));
    Ok(response)
}

/// Tells one state of a job from all others, also from those of earlier processes.
fn event_id(jobs: &Jobs, view: &View) -> String {
    format!("{:x}-{}", jobs.epoch(), view.version)
}

fn told(
    jobs: Jobs,
    id: JobId,
    known: Option<String>,
    watcher: Watcher,
) -> impl Stream<Item = Result<Event, Infallible>> {
    async_stream::stream! {
        let Ok(mut changes) = jobs.watch(id) else { return };
        let mut known = known;
        loop {
            // Before it is looked at: what changes meanwhile is told next.
            changes.mark_unchanged();
            let worker = jobs.clone();
            let Ok(found) = tokio::task::spawn_blocking(move || worker.view(id)).await else { return };
            let Ok(view) = found else {
                yield Ok(Event::default().event("deleted").data(format!("{{\"id\":\"{id}\"}}")));
                return;
            };
            let job = JobState::new(&view);
            let event_id = event_id(&jobs, &view);
            if known.as_ref() != Some(&event_id) {
                let name = match job.state() {
                    StateName::Queued | StateName::Running => "job",
                    StateName::Done => "done",
                    StateName::Failed => "failed",
                    StateName::Cancelled => "cancelled",
                };
                let event = Event::default().event(name).id(&event_id).retry(RETRY);
                // Cannot fail: numbers are finite.
                let Ok(event) = event.json_data(&job) else { return };
                yield Ok(event);
                known = Some(event_id);
            }
            if job.has_ended() || jobs.is_paused() {
                return;
            }
            // Of many changes the last is told. Removing a job is a change as well.
            tokio::time::sleep(PACE).await;
            // A job that is gone has no more changes: the next look tells.
            let change = tokio::time::timeout_at(watcher.until, changes.changed()).await;
            // Also where there is always news.
            if change.is_err() || watcher.is_over() {
                let reason = serde_json::json!({ "id": id.to_string(), "reason": watcher.reason() });
                yield Ok(Event::default().event("reconnect").retry(RETRY).data(reason.to_string()));
                return;
            }
        }
    }
}
