//! Finished frames of a job: one, what is known of all, and all of them as one stream. They are there while the job still runs.

use std::fmt::Write;
use std::path::Path;
use std::sync::Arc;

use axum::body::Body;
use axum::extract::{Extension, State};
use axum::http::{HeaderMap, HeaderValue, Method, Uri, header};
use axum::response::Response;
use bytes::Bytes;
use futures::Stream;

use super::file::{Content, Served, serve};
use super::watchers::Watcher;
use super::wire::{JobState, damaged, job_problem, unknown_job};
use super::{blocking, job_id, jobs};
use crate::film::Record;
use crate::film::manifest::read_sound;
use crate::http::conditional::{media_type, revalidated};
use crate::http::frames::boundary;
use crate::http::params::{integer, once, pairs, unknown_name};
use crate::http::problem::{Kind, PROBLEM_JSON, Problem};
use crate::http::{App, Caller, NoQuery, Owner, Segments};
use crate::jobs::{Found, JobError, JobId, Jobs};

/// Longer files are checked by their length alone, and not read into memory.
const MOST_CHECKED_BYTES: u64 = 32 << 20;

/// A frame of a job, as soon as it is drawn. If the frame's file was damaged since, the answer is 410, and `resume` draws the frame again.
#[utoipa::path(
    get,
    path = "/v1/jobs/{id}/frames/{n}",
    operation_id = "getJobFrame",
    tag = "jobs",
    params(
        ("id" = String, Path, description = "The job"),
        ("n" = u64, Path, description = "Number of the frame, counted from the beginning of the path"),
        ("If-None-Match" = Option<String>, Header, description = "Entity tags that the client has"),
    ),
    responses(
        (
            status = 200,
            description = "The image, in the job's format",
            content(
                (Vec<u8> = "image/png"),
                (Vec<u8> = "image/jpeg"),
                (Vec<u8> = "image/webp"),
                (Vec<u8> = "image/qoi"),
                (Vec<u8> = "image/x-exr"),
                (Vec<u8> = "image/x-portable-floatmap"),
                (Vec<u8> = "application/octet-stream"),
            ),
            headers(("ETag" = String, description = "SHA-256 of the image, as in the manifest")),
        ),
        (status = 206, description = "The requested range", body = Vec<u8>, content_type = "application/octet-stream"),
        (status = 304, description = "The client has this frame already"),
    ),
)]
pub async fn frame(
    State(app): State<Arc<App>>,
    Extension(owner): Extension<Owner>,
    Segments((id, number)): Segments<(String, String)>,
    method: Method,
    _: NoQuery,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let is_plain = !number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit());
    let Some(number) = number.parse::<u64>().ok().filter(|_| is_plain) else {
        let shown: String = number.chars().take(64).collect();
        let detail = format!("`{shown}` is not a frame number");
        return Err(Problem::new(Kind::UnknownFrame, detail).accepted("a whole number"));
    };
    let (found, content, format) = blocking(&app, &owner, &id, move |jobs, id| {
        let (found, content) = steady(jobs, id, number, content)?;
        Ok((found, content, jobs.view(id)?.record.spec.frame.format))
    })
    .await?;
    let (record, file) = there(found, number)?;
    let served = Served {
        content: match content {
            Some(Whole::Checked(bytes)) => Content::Memory(bytes),
            Some(Whole::Long) => Content::File(&file),
            None => return Err(damaged(&id, &format!("frame {number}"))),
        },
        bytes: record.bytes,
        sha256: &record.sha256,
        content_type: HeaderValue::from_static(media_type(format)),
    };
    serve(&served, &method, &headers).await
}

/// Looks up a frame's record and applies `read` to its file; `None` where the file does not match the record. A run that redraws
/// frames may replace the file between the two steps; the record is then another one, or missing.
fn steady<T>(
    jobs: &Jobs,
    id: JobId,
    number: u64,
    read: impl Fn(&Record, &Path) -> Result<Option<T>, JobError>,
) -> Result<(Found, Option<T>), JobError> {
    let mut found = jobs.frame(id, number)?;
    loop {
        let Found::There { record, file } = &found else { return Ok((found, None)) };
        let content = read(record, file)?;
        if content.is_some() {
            return Ok((found, content));
        }
        let again = jobs.frame(id, number)?;
        if matches!(&again, Found::There { record: other, .. } if other == record) {
            return Ok((again, None));
        }
        found = again;
    }
}

/// A frame's file that matches its record.
enum Whole {
    Checked(Bytes),
    /// Only the length was checked.
    Long,
}

/// Reads all bytes of a frame's file; `None` where it is damaged or gone.
fn sound(record: &Record, file: &Path) -> Result<Option<Vec<u8>>, JobError> {
    let folder = file.parent().unwrap_or(Path::new(""));
    let failed = |error| JobError::Io { file: file.to_owned(), error };
    read_sound(folder, record).map_err(failed)
}

/// Checks a frame's file and returns its content; `None` where it is damaged or gone.
fn content(record: &Record, file: &Path) -> Result<Option<Whole>, JobError> {
    if record.bytes <= MOST_CHECKED_BYTES {
        return Ok(sound(record, file)?.map(|bytes| Whole::Checked(bytes.into())));
    }
    let failed = |error| JobError::Io { file: file.to_owned(), error };
    match std::fs::metadata(file) {
        Ok(found) => Ok((found.len() == record.bytes).then_some(Whole::Long)),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(failed(error)),
    }
}

fn there(found: Found, number: u64) -> Result<(Arc<Record>, std::path::PathBuf), Problem> {
    match found {
        Found::There { record, file } => Ok((record, file)),
        Found::NotDrawn => {
            Err(Problem::new(Kind::FrameNotDrawn, format!("frame {number} is not drawn yet")))
        }
        Found::NoSuch { first, last } => {
            let detail = format!("the job has no frame {number}");
            Err(Problem::new(Kind::UnknownFrame, detail).accepted(format!("{first} to {last}")))
        }
        Found::Dropped => {
            let detail =
                "the job kept only its video; the frames were deleted when it was finished";
            Err(Problem::new(Kind::UnknownFrame, detail)
                .accepted("a job with `frames` in its `want`"))
        }
    }
}

/// The manifest: one line of JSON about all frames, and one line for each finished frame, with its file's length and SHA-256. While the
/// job runs, lines are added in the order in which frames are finished.
#[utoipa::path(
    get,
    path = "/v1/jobs/{id}/frames",
    operation_id = "getJobManifest",
    tag = "jobs",
    params(
        ("id" = String, Path, description = "The job"),
        ("If-None-Match" = Option<String>, Header, description = "Entity tags that the client has"),
    ),
    responses(
        (status = 200, description = "JSON lines", body = String, content_type = "application/jsonl"),
        (status = 304, description = "The client has this manifest already"),
    ),
)]
pub async fn manifest(
    State(app): State<Arc<App>>,
    Extension(owner): Extension<Owner>,
    Segments(id): Segments<String>,
    _: NoQuery,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let text = blocking(&app, &owner, &id, |jobs, id| {
        jobs.view(id)?;
        let file = jobs.place(id).manifest();
        match std::fs::read(&file) {
            Ok(mut text) => {
                // Cut off a line that is still being written.
                let whole = text.iter().rposition(|&byte| byte == b'\n').map_or(0, |at| at + 1);
                text.truncate(whole);
                Ok(text)
            }
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(Vec::new()),
            Err(error) => Err(crate::jobs::JobError::Io { file, error }),
        }
    })
    .await?;
    let etag = format!("\"{}\"", crate::film::manifest::checksum(&text));
    let json_lines = [(header::CONTENT_TYPE, HeaderValue::from_static("application/jsonl"))];
    revalidated(&headers, &etag, (json_lines, text))
}

/// All frames as one stream, in the order of the path. While the job runs, each part is sent when its frame is drawn. A job that ends
/// before its last frame ends the stream with a part of type `application/problem+json`. A stream that reaches `watch_ms` of
/// `GET /v1/limits` ends in this way as well; continue it with `from`.
#[utoipa::path(
    get,
    path = "/v1/jobs/{id}/multipart",
    operation_id = "getJobFrames",
    tag = "jobs",
    params(
        ("id" = String, Path, description = "The job"),
        ("from" = Option<u64>, Query, description = "Number of the first frame to send; default: the job's first"),
    ),
    responses((
        status = 200,
        description = "One part per frame, with `Pointillist-Frame`, `Content-Type`, `Content-Length` and `ETag`",
        body = Vec<u8>,
        content_type = "multipart/mixed",
    )),
)]
pub async fn multipart(
    State(app): State<Arc<App>>,
    Extension(Caller(client, caps)): Extension<Caller>,
    Extension(owner): Extension<Owner>,
    Segments(id): Segments<String>,
    method: Method,
    uri: Uri,
) -> Result<Response, Problem> {
    let from = from(uri.query())?;
    let view = blocking(&app, &owner, &id, |jobs, id| jobs.view(id)).await?;
    // While the video is made, its frames are still there.
    if view.record.made.video.is_some() && !view.record.spec.want.frames {
        there(Found::Dropped, 0)?;
    }
    let first = view.record.spec.from.unwrap_or(0);
    let last = view.total.map(|total| first + total.saturating_sub(1));
    let from = from.unwrap_or(first);
    if from < first || last.is_some_and(|last| from > last) {
        let accepted =
            last.map_or_else(|| format!("{first} or more"), |last| format!("{first} to {last}"));
        return Err(Problem::parameter("from", format!("the job has no frame {from}"), accepted));
    }
    let boundary = boundary();
    let content_type = format!("multipart/mixed; boundary={boundary}");
    let body = if method == Method::HEAD {
        Body::empty()
    } else {
        let film = FilmParts {
            jobs: jobs(&app)?,
            id: job_id(&id)?,
            content_type: media_type(view.record.spec.frame.format),
        };
        let watcher = Watcher::take(&app, client, &caps)?;
        Body::from_stream(parts(film, from, boundary, watcher))
    };
    let mut response = Response::new(body);
    let content_type = HeaderValue::from_str(&content_type).map_err(Problem::internal)?;
    response.headers_mut().insert(header::CONTENT_TYPE, content_type);
    response.headers_mut().insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    Ok(response)
}

/// Reads the number of the first frame from the query.
fn from(query: Option<&str>) -> Result<Option<u64>, Problem> {
    const ACCEPTED: &str = "a whole number";
    let mut from = None;
    for (name, value) in pairs(query)? {
        match name.as_str() {
            "from" => once(&mut from, &name, integer(&name, &value, ACCEPTED)?)?,
            _ => return Err(unknown_name(&name, &["from"], &[])),
        }
    }
    Ok(from)
}

struct FilmParts {
    jobs: Jobs,
    id: JobId,
    content_type: &'static str,
}

/// The next step of a film's stream.
enum Next {
    Frame(Arc<Record>, Vec<u8>),
    Later,
    End,
}

impl FilmParts {
    /// Returns frame `number`, if it is there.
    fn next(&self, number: u64) -> Result<Next, Problem> {
        let problem = |error| job_problem(&self.jobs, &self.id.to_string(), error);
        // Look up the state first: if the job has ended before its frame is missing, the frame never comes.
        let view = self.jobs.view(self.id).map_err(problem)?;
        let job = JobState::new(&view);
        let (found, bytes) = steady(&self.jobs, self.id, number, sound).map_err(problem)?;
        match found {
            Found::There { record, .. } => {
                let whole = bytes.map(|bytes| Next::Frame(record, bytes));
                whole.ok_or_else(|| damaged(&self.id.to_string(), &format!("frame {number}")))
            }
            Found::NoSuch { .. } => Ok(Next::End),
            Found::Dropped => {
                Err(there(Found::Dropped, number).err().unwrap_or_else(|| unknown_job("")))
            }
            Found::NotDrawn if job.has_ended() => {
                let detail = format!(
                    "the job ended before frame {number}; GET /v1/jobs/{} has the cause",
                    self.id
                );
                Err(Problem::new(Kind::FrameNotDrawn, detail))
            }
            Found::NotDrawn if self.jobs.is_paused() => {
                Err(crate::engine::EngineError::ShuttingDown.into())
            }
            Found::NotDrawn => Ok(Next::Later),
        }
    }
}

/// Builds the answer's body. Nothing is read before the client asks for it.
fn parts(
    film: FilmParts,
    first: u64,
    boundary: String,
    watcher: Watcher,
) -> impl Stream<Item = Result<Bytes, std::convert::Infallible>> {
    let film = Arc::new(film);
    async_stream::stream! {
        let mut number = first;
        let Ok(mut changes) = film.jobs.watch(film.id) else { return };
        loop {
            // Mark changes as seen before looking for the frame: anything that happens meanwhile counts as a change.
            changes.mark_unchanged();
            let worker = film.clone();
            let next = tokio::task::spawn_blocking(move || worker.next(number)).await;
            let next = match next.map_err(Problem::internal).and_then(|next| next) {
                // The time limit also applies while frames are there: a slow reader does not keep its place for ever.
                Ok(Next::Later | Next::Frame(..)) if watcher.is_over() => {
                    let detail = format!("{}; frame {number} has not been sent yet", watcher.reason());
                    Err(Problem::new(Kind::FrameNotDrawn, detail)
                        .accepted(format!("GET /v1/jobs/{}/multipart?from={number}", film.id)))
                }
                next => next,
            };
            match next {
                Ok(Next::Frame(record, bytes)) => {
                    yield Ok(frame_head(&boundary, &record, film.content_type));
                    yield Ok(Bytes::from(bytes));
                    number += 1;
                }
                Ok(Next::Later) => watcher.changed(&mut changes).await,
                Ok(Next::End) => break,
                Err(problem) => {
                    let content = problem.to_json();
                    let head = format!(
                        "\r\n--{boundary}\r\nPointillist-Frame: {number}\r\ncontent-type: {PROBLEM_JSON}\r\ncontent-length: {}\r\n\r\n",
                        content.len()
                    );
                    yield Ok(Bytes::from(head));
                    yield Ok(Bytes::from(content));
                    break;
                }
            }
        }
        yield Ok(Bytes::from(format!("\r\n--{boundary}--\r\n")));
    }
}

fn frame_head(boundary: &str, record: &Record, content_type: &str) -> Bytes {
    let mut head = format!("\r\n--{boundary}\r\nPointillist-Frame: {}\r\n", record.frame);
    // Writing to a string cannot fail.
    let _ = write!(head, "content-type: {content_type}\r\netag: \"{}\"\r\n", record.sha256);
    let _ = write!(head, "content-length: {}\r\n\r\n", record.bytes);
    Bytes::from(head)
}
