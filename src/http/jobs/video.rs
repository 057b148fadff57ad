//! `GET /v1/jobs/{id}/video.mp4`.

use std::sync::Arc;

use axum::extract::{Extension, State};
use axum::http::{HeaderMap, HeaderValue, Method};
use axum::response::Response;

use super::blocking;
use super::file::{Content, Served, serve};
use super::wire::{JobState, StateName, damaged};
use crate::http::problem::{Kind, Problem};
use crate::http::{App, NoQuery, Owner, Segments};

/// The film as a video: H.264 in MP4, playable while it downloads. Range requests are supported, so that players can seek.
#[utoipa::path(
    get,
    path = "/v1/jobs/{id}/video.mp4",
    operation_id = "getJobVideo",
    tag = "jobs",
    params(
        ("id" = String, Path, description = "The job"),
        ("Range" = Option<String>, Header, description = "`bytes=FIRST-LAST`, one range"),
        ("If-Range" = Option<String>, Header, description = "Entity tag of the file that the range belongs to"),
        ("If-None-Match" = Option<String>, Header, description = "Entity tags that the client has"),
    ),
    responses(
        (
            status = 200,
            description = "The video",
            body = Vec<u8>,
            content_type = "video/mp4",
            headers(("ETag" = String, description = "SHA-256 of the video"), ("Accept-Ranges" = String, description = "`bytes`")),
        ),
        (status = 206, description = "The requested range", body = Vec<u8>, content_type = "video/mp4"),
        (status = 304, description = "The client has this video already"),
    ),
)]
pub async fn video(
    State(app): State<Arc<App>>,
    Extension(owner): Extension<Owner>,
    Segments(id): Segments<String>,
    method: Method,
    _: NoQuery,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let (view, file, length) = blocking(&app, &owner, &id, |jobs, id| {
        let file = jobs.place(id).video();
        let length = std::fs::metadata(&file).ok().map(|found| found.len());
        Ok((jobs.view(id)?, file, length))
    })
    .await?;
    let Some(video) = &view.record.made.video else {
        return Err(no_video(&JobState::new(&view), view.record.spec.want.video));
    };
    // Only the length is checked: a video may be long, and players ask for many ranges of it.
    if length != Some(video.bytes) {
        return Err(damaged(&id, "the video"));
    }
    let served = Served {
        content: Content::File(&file),
        bytes: video.bytes,
        sha256: &video.sha256,
        content_type: HeaderValue::from_static("video/mp4"),
    };
    serve(&served, &method, &headers).await
}

fn no_video(job: &JobState, is_wanted: bool) -> Problem {
    let detail = match (is_wanted, job.state()) {
        (false, _) => "the job makes no video: `video` is not in its `want`",
        (true, StateName::Queued | StateName::Running) => "the video is not finished yet",
        (true, _) => "there is no video: the job ended before it was finished",
    };
    Problem::new(Kind::NoVideo, detail)
}
