//! `POST /v1/scenes`: from a request's body to a loaded scene.
//!
//! ```text
//! body ──stream──► root/uploads/.partial-N/ ──rename──► root/uploads/ID/ ──engine.load──► 201
//!        limits,        removed when anything          removed when it       └ slower than
//!        names          fails, disconnects too         is refused              `Prefer: wait` ─► 202
//! ```
//!
//! A scene as a bare JSON body names files of the server's root; one in a form names the files that
//! come with it. What was uploaded stays on disk until `DELETE` and is loaded again at the next start.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use axum::Json;
use axum::extract::{FromRequest, Multipart, Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use futures::Stream;
use tokio::io::AsyncWriteExt;

use super::names::{disposition_name, is_json_name, main_file, slug, valid_file_name, valid_id};
use super::params::{pairs, unknown_name};
use super::problem::{Kind, Problem, storage};
use super::registry::Reservation;
use super::scenes::SceneState;
use super::{App, Phase, body, conditional};
use crate::engine::{Engine, SceneInfo};

/// Folder below the root that uploads live in.
pub const FOLDER: &str = "uploads";
/// Wait for a scene to load where the client does not say, and at most.
const DEFAULT_WAIT: Duration = Duration::from_secs(10);
const MAX_WAIT: Duration = Duration::from_secs(300);
/// Files of one form.
pub const MAX_FILES: usize = 256;
const SCENE_FILE: &str = "scene.json";

/// A scene (JSON), an asset file, or a form with a scene or asset and the files that it names.
///
/// The body of an asset needs a name for its extension, as `name=` or in `Content-Disposition`.
/// `201` once the scene is loaded; `202` when that takes longer than `Prefer: wait=` seconds (10
/// where none is given, at most 300): the scene's address then says how it goes.
#[utoipa::path(
    post,
    path = "/v1/scenes",
    operation_id = "uploadScene",
    tag = "scenes",
    params(
        ("id" = Option<String>, Query, description = "Id of the scene, `[a-z0-9_-]{1,64}`; otherwise made from the name: small letters without their marks, digits, underscores, hyphens for all else, `scene` where nothing is left, with a number behind it where it is taken"),
        ("name" = Option<String>, Query, description = "File name of a raw body; of a form, which of its files is the scene or asset"),
        ("Content-Disposition" = Option<String>, Header, description = "`attachment; filename=…`, where `name` is not given"),
        ("Prefer" = Option<String>, Header, description = "`wait=SECONDS`"),
    ),
    request_body(content(
        (serde_json::Value = "application/json"),
        (Vec<u8> = "application/octet-stream"),
        (Object = "multipart/form-data"),
    )),
    responses(
        (status = 201, description = "Loaded", body = SceneState, headers(("Location" = String, description = "The scene"))),
        (status = 202, description = "Received, still loading", body = SceneState, headers(("Location" = String, description = "The scene"))),
    ),
)]
pub async fn create(State(app): State<Arc<App>>, request: Request) -> Result<Response, Problem> {
    let (parts, body) = request.into_parts();
    let headers = parts.headers.clone();
    let target = Target::from_uri(&parts.uri)?;
    if app.phase() == Phase::Draining {
        return Err(crate::engine::EngineError::ShuttingDown.into());
    }
    if !app.settings.uploads {
        return Err(Problem::new(Kind::UploadsOff, "this server takes no uploads (--no-uploads)")
            .accepted("a daemon that was started without --no-uploads"));
    }
    // A given id is taken before the body is received, so that a clash is answered at once.
    let reservation = target.id.as_deref().map(|id| reserve(&app, id)).transpose()?;
    let limit = app.settings.max_upload_bytes;
    body::check_length(&headers, limit)?;
    let received = receive(&app, &headers, &target, Request::from_parts(parts, body)).await?;
    let reservation = match reservation {
        Some(reservation) => reservation,
        None => reserve_derived(&app, &received.main)?,
    };
    let (folder, main) = received.settle(&app.settings.root, reservation.id())?;
    let id = reservation.id().to_owned();
    let loading = load_uploaded(app.clone(), reservation, folder, main);
    answer(&app, &headers, &id, loading).await
}

/// What the query says.
struct Target {
    id: Option<String>,
    name: Option<String>,
}

impl Target {
    fn from_uri(uri: &Uri) -> Result<Self, Problem> {
        let mut target = Target { id: None, name: None };
        for (name, value) in pairs(uri.query())? {
            match name.as_str() {
                "id" => target.id = Some(valid_id(value)?),
                "name" => target.name = Some(valid_file_name(&value)?),
                _ => return Err(unknown_name(&name, &["id", "name"], &[("filename", "name")])),
            }
        }
        Ok(target)
    }
}

fn reserve(app: &App, id: &str) -> Result<Reservation, Problem> {
    app.registry.reserve(id, |id| app.engine.scene(id).is_ok())
}

/// The name's slug, or that with a number behind it.
fn reserve_derived(app: &App, name: &str) -> Result<Reservation, Problem> {
    let slug = slug(name);
    let mut result = reserve(app, &slug);
    for number in 2..1000 {
        match result {
            Err(problem) if problem.status() == 409 => {
                result = reserve(app, &format!("{slug}-{number}"));
            }
            other => return other,
        }
    }
    result
}

/// Files on disk that are not a scene yet; removed unless [`Received::settle`]d.
struct Received {
    folder: PartialFolder,
    /// Name of the file to load, and what an id is made from.
    main: String,
}

struct PartialFolder(Option<PathBuf>);

impl PartialFolder {
    async fn create(root: &Path) -> Result<Self, Problem> {
        static NUMBER: AtomicU64 = AtomicU64::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let name = format!(".partial-{}-{number}", std::process::id());
        let path = root.join(FOLDER).join(name);
        tokio::fs::create_dir_all(&path).await.map_err(|error| storage(&error))?;
        Ok(Self(Some(path)))
    }

    fn path(&self) -> &Path {
        self.0.as_deref().unwrap_or(Path::new(""))
    }
}

impl Drop for PartialFolder {
    fn drop(&mut self) {
        if let Some(path) = self.0.take() {
            remove_folder(&path);
        }
    }
}

fn remove_folder(path: &Path) {
    match std::fs::remove_dir_all(path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            tracing::warn!(%error, folder = %path.display(), "an upload's files cannot be removed");
        }
        _ => {}
    }
}

impl Received {
    /// Moves the files to their place: the folder, and the file to load.
    fn settle(mut self, root: &Path, id: &str) -> Result<(PathBuf, PathBuf), Problem> {
        let folder = root.join(FOLDER).join(id);
        if folder.exists() {
            // The id is reserved and not loaded, so these are remains.
            remove_folder(&folder);
        }
        std::fs::rename(self.folder.path(), &folder).map_err(|error| storage(&error))?;
        self.folder.0 = None;
        let main = folder.join(&self.main);
        Ok((folder, main))
    }
}

/// Removes what was uploaded as `id`.
pub fn remove_files(root: &Path, id: &str) {
    // Ids of scenes found in the root need not be ones that uploads can have.
    if valid_id(id.to_owned()).is_ok() {
        let folder = root.join(FOLDER).join(id);
        if folder.is_dir() {
            remove_folder(&folder);
        }
    }
}

async fn receive(
    app: &App,
    headers: &HeaderMap,
    target: &Target,
    request: Request,
) -> Result<Received, Problem> {
    let media_type = body::media_type(headers);
    let folder = PartialFolder::create(&app.settings.root).await?;
    let mut budget = Budget {
        left: app.settings.max_upload_bytes,
        limit: app.settings.max_upload_bytes,
        patience: body::Patience::new(app.settings.read_timeout),
    };
    if media_type == "multipart/form-data" {
        let mut form = Multipart::from_request(request, &())
            .await
            .map_err(|error| Problem::new(Kind::BadBody, error.body_text()).at("Content-Type"))?;
        let result = receive_form(&mut form, folder, target, &mut budget).await;
        app.metrics.uploaded(budget.limit - budget.left);
        return result;
    }
    let name = match &target.name {
        Some(name) => Some(name.clone()),
        None => disposition_name(headers)?,
    };
    let mut stream = request.into_body().into_data_stream();
    let result = match name {
        Some(name) if !is_json_name(&name) => {
            write_file(&folder.path().join(&name), &mut stream, &mut budget).await.map(|()| name)
        }
        Some(name) => receive_scene(&folder, &mut stream, &mut budget, app).await.map(|()| name),
        None if body::is_json(&media_type) => receive_scene(&folder, &mut stream, &mut budget, app)
            .await
            .map(|()| SCENE_FILE.to_owned()),
        None => Err(unnamed(&media_type)),
    };
    app.metrics.uploaded(budget.limit - budget.left);
    let mut main = result?;
    if is_json_name(&main) {
        main = rename_scene(&folder, &main).await?;
    }
    Ok(Received { folder, main })
}

/// A scene keeps the name that it came with, as its id and its own name come from it.
async fn rename_scene(folder: &PartialFolder, name: &str) -> Result<String, Problem> {
    let (from, to) = (folder.path().join(SCENE_FILE), folder.path().join(name));
    tokio::fs::rename(from, to).await.map_err(|error| storage(&error))?;
    Ok(name.to_owned())
}

fn unnamed(media_type: &str) -> Problem {
    if media_type.is_empty() || media_type == "application/x-www-form-urlencoded" {
        return Problem::new(Kind::UnsupportedMediaType, "the body's type is not known")
            .at("Content-Type")
            .accepted(
                "application/json, multipart/form-data, or any type with ?name=FILE.EXTENSION",
            );
    }
    Problem::parameter("name", "an asset needs a file name", "?name=FILE.EXTENSION")
}

/// Bytes that may still come, and how long to wait for them.
struct Budget {
    left: u64,
    limit: u64,
    patience: body::Patience,
}

impl Budget {
    fn take(&mut self, bytes: usize) -> Result<(), Problem> {
        match self.left.checked_sub(bytes as u64) {
            Some(left) => {
                self.left = left;
                Ok(())
            }
            None => {
                self.left = 0;
                Err(body::too_large(self.limit))
            }
        }
    }
}

async fn write_file<E: std::fmt::Display>(
    path: &Path,
    stream: &mut (impl Stream<Item = Result<Bytes, E>> + Unpin),
    budget: &mut Budget,
) -> Result<(), Problem> {
    let mut file =
        tokio::fs::OpenOptions::new().write(true).create_new(true).open(path).await.map_err(
            |error| match error.kind() {
                std::io::ErrorKind::AlreadyExists => {
                    Problem::new(Kind::BadBody, "two files have the same name").at("name")
                }
                _ => storage(&error),
            },
        )?;
    while let Some(chunk) = budget.patience.next_chunk(stream).await? {
        budget.take(chunk.len())?;
        file.write_all(&chunk).await.map_err(|error| storage(&error))?;
    }
    file.flush().await.map_err(|error| storage(&error))
}

/// A scene whose files are those of the root: written so that they are found from where it lies.
async fn receive_scene<E: std::fmt::Display>(
    folder: &PartialFolder,
    stream: &mut (impl Stream<Item = Result<Bytes, E>> + Unpin),
    budget: &mut Budget,
    app: &App,
) -> Result<(), Problem> {
    let limit = app.engine.limits().max_json_bytes;
    let mut text = Vec::new();
    while let Some(chunk) = budget.patience.next_chunk(stream).await? {
        budget.take(chunk.len())?;
        if (text.len() + chunk.len()) as u64 > limit {
            return Err(body::too_large(limit));
        }
        text.extend_from_slice(&chunk);
    }
    let mut scene: serde_json::Value = body::parse_json(&text)?;
    relocate(&mut scene);
    let text = scene.to_string();
    tokio::fs::write(folder.path().join(SCENE_FILE), text).await.map_err(|error| storage(&error))
}

const UP_TO_ROOT: &str = "../../";

/// Rewrites `assets.*.file`, relative to the root, for a scene file two folders below it.
fn relocate(scene: &mut serde_json::Value) {
    let assets = scene.get_mut("assets").and_then(|assets| assets.as_object_mut());
    for asset in assets.into_iter().flat_map(|assets| assets.values_mut()) {
        if let Some(serde_json::Value::String(file)) = asset.get_mut("file") {
            // What the loader refuses must look to it as it came.
            let relative =
                !file.is_empty() && !file.starts_with(['/', '\\']) && !file.contains(':');
            if relative {
                file.insert_str(0, UP_TO_ROOT);
            }
        }
    }
}

async fn receive_form(
    form: &mut Multipart,
    folder: PartialFolder,
    target: &Target,
    budget: &mut Budget,
) -> Result<Received, Problem> {
    let broken = |error: axum::extract::multipart::MultipartError| {
        Problem::new(Kind::BadBody, format!("the form cannot be read: {}", error.body_text()))
    };
    let mut names: Vec<String> = Vec::new();
    loop {
        let next = budget.patience.wait(form.next_field()).await?;
        let Some(mut field) = next.map_err(broken)? else { break };
        let name = match (field.file_name(), field.name()) {
            (Some(name), _) => valid_file_name(name)?,
            (None, Some("scene")) => SCENE_FILE.to_owned(),
            (None, field) => {
                return Err(Problem::parameter(
                    field.unwrap_or("field").to_owned(),
                    "not a file",
                    "files with their names, and one field `scene` with the scene's JSON",
                ));
            }
        };
        if names.len() == MAX_FILES {
            return Err(Problem::new(Kind::BodyTooLarge, "too many files in one form")
                .accepted(format!("at most {MAX_FILES} files")));
        }
        write_file(&folder.path().join(&name), &mut field, budget).await.map_err(|problem| {
            match problem.parameter {
                Some(_) => problem.at(name.clone()),
                None => problem,
            }
        })?;
        names.push(name);
    }
    let main = main_file(&names, target.name.as_deref())?;
    Ok(Received { folder, main })
}

type Loading = tokio::task::JoinHandle<Result<SceneInfo, Problem>>;

/// Loads in the background, whether or not anybody waits.
fn load_uploaded(
    app: Arc<App>,
    reservation: Reservation,
    folder: PathBuf,
    main: PathBuf,
) -> Loading {
    tokio::spawn(async move {
        load(&app, reservation, main, |mut problem| {
            // Before the failure is known: from then on the id, and with it the folder, may be another upload's.
            remove_folder(&folder);
            problem.detail = problem.detail.replace(UP_TO_ROOT, "");
            let own =
                format!("{FOLDER}/{}/", folder.file_name().unwrap_or_default().to_string_lossy());
            problem.detail = problem.detail.replace(&own, "");
            problem
        })
        .await
    })
}

/// Loads a file under a reserved id; a failure stays with the id.
pub async fn load(
    app: &Arc<App>,
    reservation: Reservation,
    file: PathBuf,
    outward: impl FnOnce(Problem) -> Problem,
) -> Result<SceneInfo, Problem> {
    let engine: Engine = app.engine.clone();
    let id = reservation.id().to_owned();
    let outcome = tokio::task::spawn_blocking(move || engine.load(&id, &file)).await;
    let result = match outcome {
        Ok(result) => result.map_err(Problem::from),
        Err(panic) => Err(Problem::internal(format!("loading a scene: {panic}"))),
    };
    match result {
        Ok(info) => {
            reservation.finish();
            Ok(info)
        }
        Err(problem) => {
            let problem = outward(problem.hide_root(&app.settings.root));
            reservation.fail(problem.clone());
            Err(problem)
        }
    }
}

async fn answer(
    app: &App,
    headers: &HeaderMap,
    id: &str,
    loading: Loading,
) -> Result<Response, Problem> {
    let asked = conditional::prefer_wait(headers).map(Duration::from_secs);
    let wait = asked.unwrap_or(DEFAULT_WAIT).min(MAX_WAIT);
    let started = std::time::Instant::now();
    let (status, state) = match tokio::time::timeout(wait, loading).await {
        Ok(finished) => match finished.map_err(Problem::internal)? {
            Ok(info) => (StatusCode::CREATED, SceneState::Ready(Box::new(info))),
            Err(problem) => {
                // Told here, so nobody needs to ask for it.
                app.registry.forget(id);
                return Err(problem);
            }
        },
        Err(_) => {
            let loading_ms = u64::try_from(started.elapsed().as_millis()).unwrap_or(u64::MAX);
            (StatusCode::ACCEPTED, SceneState::Loading { id: id.to_owned(), loading_ms })
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

/// Uploads of earlier runs: ids and the files to load. What was left unfinished is removed.
pub fn earlier_uploads(root: &Path) -> Vec<(String, PathBuf)> {
    let Ok(folders) = std::fs::read_dir(root.join(FOLDER)) else { return Vec::new() };
    let mut found = Vec::new();
    for folder in folders.filter_map(Result::ok) {
        let name = folder.file_name().to_string_lossy().into_owned();
        if name.starts_with(".partial-") {
            remove_folder(&folder.path());
            continue;
        }
        let Ok(id) = valid_id(name) else { continue };
        let Ok(files) = std::fs::read_dir(folder.path()) else { continue };
        let names: Vec<String> = files
            .filter_map(Result::ok)
            .filter(|file| file.path().is_file())
            .map(|file| file.file_name().to_string_lossy().into_owned())
            .collect();
        match main_file(&names, None) {
            Ok(main) => found.push((id, folder.path().join(main))),
            Err(_) => tracing::warn!(id, "an earlier upload has no single file to load"),
        }
    }
    found.sort();
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_the_root_are_found_from_below() {
        let mut scene = serde_json::json!({
            "assets": { "a": { "file": "sub/a.ply" }, "b": { "file": "/etc/passwd" }, "c": 3 }
        });
        relocate(&mut scene);
        assert_eq!(scene["assets"]["a"]["file"], "../../sub/a.ply");
        assert_eq!(scene["assets"]["b"]["file"], "/etc/passwd");
        relocate(&mut serde_json::json!([1]));
    }

    #[test]
    fn budgets_end() {
        let patience = body::Patience::new(Duration::from_secs(1));
        let mut budget = Budget { left: 10, limit: 10, patience };
        budget.take(10).unwrap();
        assert_eq!(budget.take(1).unwrap_err().status(), 413);
    }
}
