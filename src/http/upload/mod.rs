//! `POST /v1/scenes`: from a request's body to a loaded scene.
//!
//! ```text
//! body ──stream──► root/uploads/.partial-N/ ──rename──► root/uploads/ID/ ──engine.load──► 201
//!        limits,        removed when anything          removed when it       └ slower than
//!        names          fails, disconnects too         is refused              `Prefer: wait` ─► 202
//! ```
//!
//! A scene sent as a bare JSON body names files of the server's root; a scene in a form names the files that come with it.
//! Uploads stay on disk ([`store`]) until `DELETE` and are loaded again at the next start. [`quota`] limits their number and
//! bytes.

pub mod follow;
mod form;
mod loading;
pub mod quota;
pub mod store;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use axum::Extension;
use axum::body::Body;
use axum::extract::{FromRequest, Multipart, Request, State};
use axum::http::{HeaderMap, Uri};
use axum::response::Response;
use bytes::Bytes;
use futures::Stream;
use glam::DVec3;
use tokio::io::AsyncWriteExt;

pub use self::loading::{Origin, load, stand_down};

use self::form::{Limited, Progress};
use self::loading::answer;
use self::quota::Share;
use self::store::{FOLDER, Record};
use super::names::{disposition_name, is_json_name, main_file, slug, valid_file_name, valid_id};
use super::params::{number, once, pairs, unknown_name};
use super::problem::{Kind, Problem, storage};
use super::registry::SceneState;
use super::registry::{Entry, Reservation};
use super::{App, NoQuery, Owner, Phase, Segments, body};
use crate::engine::{EngineError, Source};
use crate::memory::Admission;
use crate::scene::{Up, UpForm};

/// Largest number of files in one form.
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
        ("id" = Option<String>, Query, description = "Id of the scene, `[a-z0-9_-]{1,64}`. Without it, the server makes an id from the name: lower-case letters without accents, digits and underscores stay, and hyphens replace all else; an empty result becomes `scene`, and an id in use gets a number appended"),
        ("name" = Option<String>, Query, description = "File name of a raw body; in a form, the name of the file that is the scene or asset"),
        ("up" = Option<UpForm>, Query, style = Form, explode = false, description = "Up direction of a point or triangle file: `x`, `y`, `z`, `-x`, `-y`, `-z` or `x,y,z`; guessed if missing. The server stores it with the upload. A scene file has its own `up` instead"),
        ("Content-Disposition" = Option<String>, Header, description = "`attachment; filename=…`, used if `name` is not given"),
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
pub async fn create(
    State(app): State<Arc<App>>,
    Extension(owner): Extension<Owner>,
    request: Request,
) -> Result<Response, Problem> {
    let (parts, body) = request.into_parts();
    let headers = parts.headers.clone();
    let target = Target::from_uri(&parts.uri)?;
    refuse_while_draining(&app)?;
    app.settings.uploads.accepted()?;
    let rules = app.rules();
    let share = app.uploads.admit(owner.name.as_deref(), rules.bounds.uploads, &owner.quotas)?;
    // Reserve a given id before the body is received, so that a clash is answered at once.
    let reservation = target.id.as_deref().map(|id| reserve(&app, id)).transpose()?;
    let limit = rules.bounds.max_upload_bytes;
    body::check_length(&headers, limit)?;
    let admission = reservation.as_ref().map(|reservation| reservation.admission().clone());
    let mut budget = Budget {
        left: limit,
        limit,
        share,
        admission: admission.unwrap_or_default(),
        patience: body::Patience::new(app.settings.read_timeout),
    };
    let request = Request::from_parts(parts, body);
    let result = receive(&app, &headers, &target, request, &mut budget).await;
    app.metrics.uploaded(budget.limit - budget.left);
    let received = result?;
    let reservation = match reservation {
        Some(reservation) => reservation,
        None => reserve_derived(&app, &received.main)?,
    };
    let id = reservation.id().to_owned();
    let settle = || received.settle(&app.settings.root, &id, target.up, &budget.share);
    let source = store::in_place(settle)?;
    app.uploads.keep(&id, budget.share);
    answer(&app, &headers, reservation, source, Origin::Fresh).await
}

fn refuse_while_draining(app: &App) -> Result<(), Problem> {
    if app.phase() == Phase::Draining {
        return Err(EngineError::ShuttingDown.into());
    }
    Ok(())
}

/// Retries a failed load: of an upload whose load was interrupted by the end of the server, of an upload that lacked
/// memory, or of a scene of the server's root. The answers are those of an upload.
#[utoipa::path(
    post,
    path = "/v1/scenes/{id}/retry",
    tag = "scenes",
    params(
        ("id" = String, Path, description = "A scene whose `state` is `failed`"),
        ("Prefer" = Option<String>, Header, description = "`wait=SECONDS`"),
    ),
    responses(
        (status = 201, description = "Loaded", body = SceneState, headers(("Location" = String, description = "The scene"))),
        (status = 202, description = "Still loading", body = SceneState, headers(("Location" = String, description = "The scene"))),
    ),
)]
pub async fn retry(
    State(app): State<Arc<App>>,
    Extension(owner): Extension<Owner>,
    Segments(id): Segments<String>,
    _: NoQuery,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    refuse_while_draining(&app)?;
    owner.check_scene(&app, &id)?;
    match app.registry.get(&id) {
        Some(Entry::Failed { source: Some(_), .. }) => {}
        Some(Entry::Failed { problem, .. }) => {
            return Err(problem.accepted("upload the files again; they were not kept"));
        }
        Some(Entry::Loading { .. }) => {
            return Err(Problem::new(Kind::SceneLoading, format!("scene `{id}` is being loaded")));
        }
        Some(Entry::Removing { .. }) => {
            return Err(Problem::new(Kind::SceneLoading, format!("scene `{id}` is being removed")));
        }
        None => {
            app.engine.scene(&id)?;
            return Err(Problem::new(Kind::SceneExists, format!("scene `{id}` is loaded")));
        }
    }
    if app.settings.uploads.are_kept() {
        let changed = store::in_place(|| store::set_aside(&app.settings.root, &id));
        changed.map_err(|error| storage(&error))?;
    }
    let Some((reservation, source)) = app.registry.retry(&id, app.engine.admission()) else {
        return Err(Problem::new(Kind::SceneLoading, format!("scene `{id}` is being loaded")));
    };
    answer(&app, &headers, reservation, source, Origin::Kept).await
}

/// Parameters of the query.
pub(super) struct Target {
    id: Option<String>,
    name: Option<String>,
    /// A unit vector.
    up: Option<DVec3>,
}

impl Target {
    pub(super) fn from_uri(uri: &Uri) -> Result<Self, Problem> {
        let mut target = Target { id: None, name: None, up: None };
        for (name, value) in pairs(uri.query())? {
            match name.as_str() {
                "id" => once(&mut target.id, &name, valid_id(value)?)?,
                "name" => once(&mut target.name, &name, valid_file_name(&value)?)?,
                "up" => once(&mut target.up, &name, direction(&name, &value)?)?,
                _ => {
                    return Err(unknown_name(
                        &name,
                        &["id", "name", "up"],
                        &[("filename", "name")],
                    ));
                }
            }
        }
        Ok(target)
    }
}

impl Target {
    /// Refuses `up` for a scene, because its cameras and paths may depend on its own up direction.
    fn check_up(&self, main: &str) -> Result<(), Problem> {
        if self.up.is_none() || !is_json_name(main) {
            return Ok(());
        }
        let reason = "a scene file sets its own up direction";
        Err(Problem::parameter(
            "up",
            reason,
            "set `up` in the scene file, or leave the parameter out",
        ))
    }
}

#[cfg(any(test, fuzzing))]
impl Target {
    /// Panics where a parameter that was accepted cannot be used.
    pub(super) fn check(self) {
        assert!(self.id.is_none_or(|id| valid_id(id).is_ok()));
        assert!(self.name.is_none_or(|name| valid_file_name(&name).is_ok()));
        assert!(self.up.is_none_or(|up| (up.length() - 1.0).abs() < 1e-9));
    }
}

/// Reads a parameter as a unit vector.
fn direction(name: &str, value: &str) -> Result<DVec3, Problem> {
    let Up(up) = number(name, value, Up::ACCEPTED)?;
    let unusable = || Problem::parameter(name, "is too short or too long", Up::ACCEPTED);
    up.try_normalize().ok_or_else(unusable)
}

fn reserve(app: &App, id: &str) -> Result<Reservation, Problem> {
    app.registry.reserve(id, app.engine.admission(), |id| app.engine.scene(id).is_ok())
}

/// Reserves the name's slug, or the slug with a number appended.
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

/// Files on disk that are not a scene yet; they are removed unless [`Received::settle`] is called.
struct Received {
    folder: PartialFolder,
    /// Name of the file to load; the id may be derived from it.
    main: String,
    /// Whether names of files are relative to the server's root.
    from_root: bool,
}

struct PartialFolder(Option<PathBuf>);

impl PartialFolder {
    async fn create(root: &Path) -> Result<Self, Problem> {
        tokio::fs::create_dir_all(root.join(FOLDER)).await.map_err(|error| storage(&error))?;
        loop {
            let path = store::partial(root);
            match tokio::fs::create_dir(&path).await {
                Ok(()) => return Ok(Self(Some(path))),
                // An earlier process had the same id, as in containers, and its folder could not be removed.
                Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(storage(&error)),
            }
        }
    }

    fn path(&self) -> &Path {
        self.0.as_deref().unwrap_or(Path::new(""))
    }
}

impl Drop for PartialFolder {
    fn drop(&mut self) {
        if let Some(path) = self.0.take() {
            store::in_place(|| store::remove_folder(&path));
        }
    }
}

impl Received {
    /// Moves the files and their record to their final place, where they outlast the process.
    fn settle(
        mut self,
        root: &Path,
        id: &str,
        up: Option<DVec3>,
        share: &Share,
    ) -> Result<Source, Problem> {
        let folder = store::folder_of(root, id);
        if folder.exists() {
            // The id is reserved and not loaded, so these files are left over from an earlier upload.
            store::remove_files(root, id).map_err(|error| storage(&error))?;
        }
        let key = share.key().map(str::to_owned);
        let record = Record {
            up: up.map(|up| up.to_array()),
            ..Record::new(self.main.clone(), self.from_root, key, share.bytes())
        };
        let moved = record.write(self.folder.path()).and_then(|()| {
            std::fs::rename(self.folder.path(), &folder)?;
            self.folder.0 = None;
            // An upload that is not acknowledged must not come back at the next start.
            store::sync_folder(&root.join(FOLDER)).inspect_err(|_| store::remove_folder(&folder))
        });
        moved.map_err(|error| storage(&error))?;
        Ok(record.source(root, id))
    }
}

async fn receive(
    app: &App,
    headers: &HeaderMap,
    target: &Target,
    request: Request,
    budget: &mut Budget,
) -> Result<Received, Problem> {
    let media_type = body::media_type(headers);
    let folder = PartialFolder::create(&app.settings.root).await?;
    if media_type == "multipart/form-data" {
        let progress = Progress::default();
        let limited =
            |body: Body| Body::from_stream(Limited::new(body.into_data_stream(), progress.clone()));
        let mut form = Multipart::from_request(request.map(limited), &())
            .await
            .map_err(|error| Problem::new(Kind::BadBody, error.body_text()).at("Content-Type"))?;
        let received = receive_form(&mut form, folder, target, budget, &progress).await;
        return if progress.is_over() {
            Err(Problem::new(Kind::BadBody, form::too_long()))
        } else {
            received
        };
    }
    let name = match &target.name {
        Some(name) => Some(name.clone()),
        None => disposition_name(headers)?,
    };
    let main = match name {
        Some(name) => name,
        None if body::is_json(&media_type) => SCENE_FILE.to_owned(),
        None => return Err(unnamed(&media_type)),
    };
    target.check_up(&main)?;
    // A scene without a form names files of the root.
    let from_root = is_json_name(&main);
    if from_root {
        budget.limit_to(app.engine.limits().max_json_bytes);
    }
    let mut stream = request.into_body().into_data_stream();
    write_file(&folder.path().join(&main), &mut stream, budget, &Progress::default()).await?;
    Ok(Received { folder, main, from_root })
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

/// Limits on bytes and waiting while an upload is received.
struct Budget {
    left: u64,
    limit: u64,
    /// Share of the limits on all uploads.
    share: Share,
    /// Admission of the load to come: receiving stops once it is cancelled.
    admission: Admission,
    patience: body::Patience,
}

impl Budget {
    /// Lowers the limit; to be called before any bytes arrive.
    fn limit_to(&mut self, limit: u64) {
        self.limit = self.limit.min(limit);
        self.left = self.limit;
    }

    fn take(&mut self, bytes: usize) -> Result<(), Problem> {
        self.admission.check().map_err(EngineError::from)?;
        match self.left.checked_sub(bytes as u64) {
            Some(left) => {
                self.left = left;
                self.share.take(bytes as u64)
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
    progress: &Progress,
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
        progress.reset();
        budget.take(chunk.len())?;
        file.write_all(&chunk).await.map_err(|error| storage(&error))?;
    }
    // `sync_all` of tokio says nothing of the last write, which may have found a full disk.
    file.flush().await.map_err(|error| storage(&error))?;
    // Acknowledged files must outlast a power cut.
    file.sync_all().await.map_err(|error| storage(&error))
}

async fn receive_form(
    form: &mut Multipart,
    folder: PartialFolder,
    target: &Target,
    budget: &mut Budget,
    progress: &Progress,
) -> Result<Received, Problem> {
    let broken = |error: axum::extract::multipart::MultipartError| {
        Problem::new(Kind::BadBody, format!("the form cannot be read: {}", error.body_text()))
    };
    let mut names: Vec<String> = Vec::new();
    loop {
        let next = budget.patience.wait(form.next_field()).await?;
        let Some(mut field) = next.map_err(broken)? else { break };
        progress.reset();
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
        write_file(&folder.path().join(&name), &mut field, budget, progress).await.map_err(
            |problem| match problem.parameter {
                Some(_) => problem.at(name.clone()),
                None => problem,
            },
        )?;
        names.push(name);
    }
    let main = main_file(&names, target.name.as_deref())?;
    target.check_up(&main)?;
    Ok(Received { folder, main, from_root: false })
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[tokio::test]
    async fn a_leftover_of_an_earlier_process_joins_no_upload() {
        let root = tempfile::tempdir().unwrap();
        for number in 0..256 {
            let name = format!(".partial-{}-{number}", std::process::id());
            let left = root.path().join(FOLDER).join(name);
            std::fs::create_dir_all(&left).unwrap();
            std::fs::write(left.join("a.ply"), "ply").unwrap();
        }
        let folder = PartialFolder::create(root.path()).await.unwrap();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn budgets_end() {
        let patience = body::Patience::new(Duration::from_secs(1));
        let limits =
            quota::UploadLimits { scenes: 1, scenes_per_key: 1, bytes: 99, bytes_per_key: 99 };
        let share = quota::Quota::default().admit(None, limits, &Default::default()).unwrap();
        let admission = Admission::default();
        let mut budget = Budget { left: 10, limit: 10, share, admission, patience };
        budget.take(10).unwrap();
        assert_eq!(budget.take(1).unwrap_err().status(), 413);
        budget.admission.cancel();
        assert_eq!(budget.take(0).unwrap_err().status(), 409);
    }
}
