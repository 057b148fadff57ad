//! `GET /v1/jobs/{id}/events`: a job's progress as server-sent events (the `EventSource` of the HTML standard).
//!
//! Every event carries the whole job, so no event depends on an earlier one: a client that comes late or reads slowly misses only
//! steps in between. The event's id names the state. A client that reconnects with that id gets no event until the state changes.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::{Extension, State};
use axum::http::{HeaderMap, StatusCode};
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use futures::Stream;

use super::watchers::Watcher;
use super::wire::{JobState, StateName};
use super::{blocking, job_id, jobs};
use crate::http::problem::Problem;
use crate::http::{App, Caller, NoQuery, Owner, Segments};
use crate::jobs::{JobId, Jobs, View};

/// Shortest time between two events.
const PACE: Duration = Duration::from_millis(100);
/// A comment keeps proxies from closing a connection on which nothing happens.
const KEEP_ALIVE: Duration = Duration::from_secs(15);
/// Delay after which a client that lost its connection is asked to reconnect.
const RETRY: Duration = Duration::from_secs(2);

/// Progress of a job as server-sent events: the job as it is now, then an event for each change, until the job has ended.
///
/// Events are named `job` while the job is queued or running, and `done`, `failed`, `cancelled` or `deleted` at the end; `data` is the job as
/// `GET /v1/jobs/{id}` has it. After `watch_ms` of `GET /v1/limits` an event `reconnect` ends the stream. An `EventSource` reconnects by
/// itself and misses nothing. A server that stops closes the stream without an event: reconnect with `Last-Event-ID`.
#[utoipa::path(
    get,
    path = "/v1/jobs/{id}/events",
    operation_id = "followJob",
    tag = "jobs",
    params(
        ("id" = String, Path, description = "The job"),
        ("Last-Event-ID" = Option<String>, Header, description = "Id of the last event that the client received; the server sends only later changes"),
    ),
    responses(
        (status = 200, description = "The events, each with `event`, `id` and `data`", body = Object, content_type = "text/event-stream"),
        (status = 204, description = "The job has ended, and the client has its last event"),
    ),
)]
pub async fn events(
    State(app): State<Arc<App>>,
    Extension(Caller(client, caps)): Extension<Caller>,
    Extension(owner): Extension<Owner>,
    Segments(id): Segments<String>,
    _: NoQuery,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let view = blocking(&app, &owner, &id, |jobs, id| jobs.view(id)).await?;
    let jobs = jobs(&app)?;
    let known =
        headers.get("last-event-id").and_then(|value| value.to_str().ok()).map(str::to_owned);
    if JobState::new(&view).has_ended() && known.as_ref() == Some(&event_id(&jobs, &view)) {
        // An `EventSource` takes this status for the end; after any other it would reconnect for ever.
        return Ok(StatusCode::NO_CONTENT.into_response());
    }
    let told = told(jobs, job_id(&id)?, known, Watcher::take(&app, client, &caps)?);
    let mut response =
        Sse::new(told).keep_alive(KeepAlive::new().interval(KEEP_ALIVE)).into_response();
    // Some proxies buffer answers before they forward them.
    response.headers_mut().insert("x-accel-buffering", axum::http::HeaderValue::from_static("no"));
    Ok(response)
}

/// Returns an id for one state of a job, unique across states and across processes.
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
            // Mark changes as seen before reading the job, so that a change during the read is sent next.
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
                // This cannot fail: all numbers are finite.
                let Ok(event) = event.json_data(&job) else { return };
                yield Ok(event);
                known = Some(event_id);
            }
            if job.has_ended() || jobs.is_paused() {
                return;
            }
            // Changes within this time are merged into one event. Removing a job is a change as well.
            tokio::time::sleep(PACE).await;
            watcher.changed(&mut changes).await;
            // The time limit also ends a stream that always has news.
            if watcher.is_over() {
                let reason = serde_json::json!({ "id": id.to_string(), "reason": watcher.reason() });
                yield Ok(Event::default().event("reconnect").retry(RETRY).data(reason.to_string()));
                return;
            }
        }
    }
}
