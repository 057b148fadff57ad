//! From the files of an upload to a loaded scene, and back: loads, their answers, and files that are removed when a load fails.
//!
//! The id is reserved until the files of a failed load are removed: the folder and the share of the limits may belong to another upload
//! once the id is free.

use std::sync::Arc;
use std::time::Duration;

use axum::Json;
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};

use super::store::{self, FOLDER};
use crate::engine::{Engine, EngineError, SceneInfo, Source};
use crate::http::problem::{Kind, Problem, storage};
use crate::http::registry::{Ended, Entry, Load, Reservation, SceneState};
use crate::http::{App, conditional};
use crate::memory::Interrupt;

/// Default and longest wait for a scene to load.
const DEFAULT_WAIT: Duration = Duration::from_secs(10);
const MAX_WAIT: Duration = Duration::from_secs(300);

/// A load that runs whether or not somebody waits for it.
pub type Loading = tokio::task::JoinHandle<Result<SceneInfo, Problem>>;

/// Origin of a load's files, which decides whether they are removed when it fails.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Origin {
    /// A new upload: its files are removed when the load fails for good.
    Fresh,
    /// Files of the root, or an earlier upload: they stay.
    Kept,
}

/// Loads a scene under a reserved id even if nobody waits; the id keeps a failure.
pub async fn load(
    app: Arc<App>,
    reservation: Reservation,
    source: Source,
    origin: Origin,
) -> Result<SceneInfo, Problem> {
    let engine: Engine = app.engine.clone();
    let (id, root) = (reservation.id().to_owned(), app.settings.root.clone());
    let (file, admission) = (source.clone(), reservation.admission().clone());
    // Without uploads, the folder of uploads may belong to another server.
    let records = app.settings.uploads.are_kept();
    let outcome = tokio::task::spawn_blocking(move || {
        if records {
            store::begin(&root, &id).map_err(|error| storage(&error))?;
        }
        let result = engine.load_within(&id, &file, &admission);
        let noted = if result.is_ok() { store::finish } else { store::set_aside };
        if records && let Err(error) = noted(&root, &id) {
            tracing::warn!(id, %error, "cannot write an upload's record");
        }
        match result {
            Err(EngineError::Interrupted(Interrupt::Cancelled)) => Ok(None),
            result => result.map(Some).map_err(Problem::from),
        }
    })
    .await;
    let result = match outcome {
        Ok(result) => result,
        Err(panic) => Err(Problem::internal(format!("loading a scene: {panic}"))),
    };
    let id = reservation.id().to_owned();
    match result {
        Ok(Some(info)) => {
            let loaded = app.engine.load_number(&id);
            reservation.finish(loaded.map_or(Ended::Gone, Ended::Loaded));
            Ok(info)
        }
        Ok(None) => {
            tracing::info!(id, "load cancelled");
            // Forget the files before the id is free: afterwards the folder may belong to another upload.
            match forget_files(&app, &id).await {
                Ok(()) => reservation.finish(Ended::Gone),
                Err(problem) => reservation.fail(problem, Some(source)),
            }
            Err(EngineError::Interrupted(Interrupt::Cancelled).into())
        }
        Err(problem) => {
            let mut problem = problem.hide_root(&app.settings.root);
            problem.detail = problem.detail.replace(&format!("{FOLDER}/{id}/"), "");
            // There may be enough memory later.
            let mut stays = origin == Origin::Kept || problem.kind == Kind::OutOfMemory;
            if !stays {
                stays = forget_files(&app, &id).await.is_err();
            }
            reservation.fail(problem.clone(), stays.then_some(source));
            Err(problem)
        }
    }
}

/// Removes the files of upload `id` and their share of the limits. The id must be reserved.
///
/// # Errors
/// The files cannot be removed, and the upload would be there again after a restart.
async fn forget_files(app: &Arc<App>, id: &str) -> Result<(), Problem> {
    if !app.settings.uploads.are_kept() {
        return Ok(());
    }
    let (root, name) = (app.settings.root.clone(), id.to_owned());
    let removed = tokio::task::spawn_blocking(move || store::remove_files(&root, &name)).await;
    removed.map_err(Problem::internal)?.map_err(|error| storage(&error))?;
    app.uploads.forget(id);
    Ok(())
}

/// Records for all running loads that the process ends by itself, so that they do not count as having killed it.
pub fn stand_down(app: &App) {
    if !app.settings.uploads.are_kept() {
        return;
    }
    for (id, entry) in app.registry.list() {
        // The records of failed uploads, and of those that wait for their turn, keep their counts of deaths.
        if matches!(entry, Entry::Loading { .. })
            && let Err(error) = store::stand_down(&app.settings.root, &id)
        {
            tracing::warn!(id, %error, "cannot write an upload's record");
        }
    }
}

/// Loads a scene under a reserved id, and answers when it is loaded or after the time that the client gives.
pub async fn answer(
    app: &Arc<App>,
    headers: &HeaderMap,
    reservation: Reservation,
    source: Source,
    origin: Origin,
) -> Result<Response, Problem> {
    let (id, this) = (reservation.id().to_owned(), reservation.load());
    let loading: Loading = tokio::spawn(load(app.clone(), reservation, source, origin));
    let asked = conditional::prefer_wait(headers).map(Duration::from_secs);
    let wait = asked.unwrap_or(DEFAULT_WAIT).min(MAX_WAIT);
    let started = std::time::Instant::now();
    let (status, state) = match tokio::time::timeout(wait, loading).await {
        Ok(finished) => match finished.map_err(Problem::internal)? {
            Ok(info) => (StatusCode::CREATED, SceneState::Ready(Box::new(info))),
            Err(problem) => {
                // The failure is reported here, so no entry needs to keep it.
                if origin == Origin::Fresh {
                    // To be finished even if the client goes.
                    let _ = tokio::spawn(forget_failure(app.clone(), id, this)).await;
                }
                return Err(problem);
            }
        },
        Err(_) => {
            let loading_ms = u64::try_from(started.elapsed().as_millis()).unwrap_or(u64::MAX);
            (StatusCode::ACCEPTED, SceneState::Loading { id: id.clone(), loading_ms })
        }
    };
    let mut response = (status, Json(state)).into_response();
    let location = HeaderValue::from_str(&format!("/v1/scenes/{id}")).map_err(Problem::internal)?;
    response.headers_mut().insert(header::LOCATION, location);
    if asked.is_some() {
        let applied = HeaderValue::from_str(&format!("wait={}", wait.as_secs()));
        let applied = applied.map_err(Problem::internal)?;
        response.headers_mut().insert(HeaderName::from_static("preference-applied"), applied);
    }
    Ok(response)
}

/// Forgets the failure of a load, and the files that were kept for another try.
async fn forget_failure(app: Arc<App>, id: String, load: Load) {
    if let Some(claim) = app.registry.claim_failure(&id, &load)
        && forget_files(&app, &id).await.is_ok()
    {
        claim.finish(Ended::Gone);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns how long each proxy waits for an answer, in a section of HAProxy's files and one of nginx's.
    fn patience(haproxy: &str, nginx: &str) -> [Duration; 3] {
        let seconds = |text: &str, section: &str, setting: &str| {
            let (_, section) = text.split_once(section).unwrap();
            let (_, value) = section.split_once(setting).unwrap();
            let (seconds, _) = value.split_once('s').unwrap();
            Duration::from_secs(seconds.parse().unwrap())
        };
        let haproxy = |text| seconds(text, haproxy, "timeout server ");
        [
            haproxy(include_str!("../../../deploy/haproxy.cfg")),
            haproxy(include_str!("../../../deploy/kubernetes/haproxy.cfg")),
            seconds(include_str!("../../../deploy/nginx.conf"), nginx, "proxy_read_timeout "),
        ]
    }

    /// A proxy that gives up first answers 504 for an upload that succeeds.
    #[test]
    fn the_proxies_wait_for_as_long_as_clients_may() {
        for wait in patience("backend keeper\n", "location / {\n") {
            assert!(wait > MAX_WAIT, "{wait:?}");
        }
    }

    /// A proxy that gives up first hides the server's answer, which names the limit and when to try again.
    #[test]
    fn the_proxies_wait_for_longer_than_a_server_does_for_a_frame() {
        let settings = include_str!("../../../deploy/pointillist.toml");
        let (_, limit) = settings.split_once("frame-timeout-seconds = ").unwrap();
        let (limit, _) = limit.split_once('\n').unwrap();
        let limit = Duration::from_secs(limit.parse().unwrap());
        for wait in patience("defaults\n", "location ~ ^/v1/scenes/[^/]+/frame$ {\n") {
            assert!(wait > limit, "{wait:?}");
        }
    }
}
