//! Uploads on disk: one folder each, with a record of the upload and the state of its load.
//!
//! ```text
//! received ──► loading ──► loaded          at the next start:
//!                 │                          received, loaded: loaded again
//!                 └─ the process died        loading: the loader died with the process. It is tried
//!                                            again if the upload was loaded before, once; otherwise
//!                                            the upload is listed as failed, until retry or DELETE
//! ```
//!
//! The record lies beside the files, under a name that no upload may have. It is on disk before a loader begins, so that an
//! upload that crashes the process does so only once. The record of a loaded upload is written before the loader begins, too: when the upload is
//! loaded, a file is only renamed, which needs no space on a disk that has become full.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::engine::Source;
use crate::http::names::{main_file, valid_id};
use crate::http::problem::{Kind, Problem};

/// Folder of uploads below the root.
pub const FOLDER: &str = "uploads";
/// The name begins with a dot, which no uploaded file's name does.
const RECORD: &str = ".upload.json";
/// The record that an upload will have once it is loaded.
const AS_LOADED: &str = ".upload.json.loaded";
const PARTIAL: &str = ".partial-";

/// Record of an upload.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Record {
    /// Name of the file to load.
    pub main: String,
    /// Whether names of files in the scene are relative to the server's root rather than to the scene.
    pub from_root: bool,
    /// Up direction, where the upload gave one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub up: Option<[f64; 3]>,
    /// Name of the API key of the upload.
    pub key: Option<String>,
    /// Bytes of all files.
    pub bytes: u64,
    pub stage: Stage,
    /// Whether it has ever been loaded.
    pub was_loaded: bool,
    /// Number of consecutive loads that ended with the process.
    pub deaths: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    Received,
    Loading,
    Loaded,
}

/// An upload from an earlier run.
pub struct Earlier {
    pub id: String,
    /// File to load; `None` where nothing says which file that is.
    pub source: Option<Source>,
    pub key: Option<String>,
    pub bytes: u64,
    /// Reason why it is not loaded.
    pub refusal: Option<Problem>,
}

impl Record {
    pub fn new(main: String, from_root: bool, key: Option<String>, bytes: u64) -> Record {
        let stage = Stage::Received;
        Record { main, from_root, up: None, key, bytes, stage, was_loaded: false, deaths: 0 }
    }

    /// Returns the source of the upload with this record.
    pub fn source(&self, root: &Path, id: &str) -> Source {
        Source {
            path: folder_of(root, id).join(&self.main),
            base: self.from_root.then(|| root.to_owned()),
            up: self.up.map(DVec3::from_array),
        }
    }

    /// Reads the record of an upload.
    ///
    /// # Errors
    /// The record is missing or malformed.
    pub fn read(folder: &Path) -> io::Result<Record> {
        Ok(serde_json::from_slice(&fs::read(folder.join(RECORD))?)?)
    }

    /// Writes the record into the upload's folder atomically.
    ///
    /// # Errors
    /// Errors of the disk.
    pub fn write(&self, folder: &Path) -> io::Result<()> {
        self.write_as(folder, RECORD)
    }

    fn write_as(&self, folder: &Path, name: &str) -> io::Result<()> {
        let fresh = folder.join(".upload.json.new");
        let mut file = File::create(&fresh)?;
        file.write_all(&serde_json::to_vec(self)?)?;
        file.sync_all()?;
        fs::rename(fresh, folder.join(name))?;
        sync_folder(folder)
    }

    /// Returns the record of the upload after a load.
    fn as_loaded(&self) -> Record {
        Record { stage: Stage::Loaded, was_loaded: true, deaths: 0, ..self.clone() }
    }
}

/// Makes changes of a folder's entries survive a power cut.
pub fn sync_folder(folder: &Path) -> io::Result<()> {
    if cfg!(unix) { File::open(folder)?.sync_all() } else { Ok(()) }
}

/// Does work that waits for the disk without holding up other requests: on a network, a disk may hang.
pub fn in_place<T>(work: impl FnOnce() -> T) -> T {
    use tokio::runtime::{Handle, RuntimeFlavor};
    match Handle::try_current().map(|runtime| runtime.runtime_flavor()) {
        Ok(RuntimeFlavor::MultiThread) => tokio::task::block_in_place(work),
        _ => work(),
    }
}

pub fn folder_of(root: &Path, id: &str) -> PathBuf {
    root.join(FOLDER).join(id)
}

/// Returns whether there are files of an upload with this id.
pub fn holds(root: &Path, id: &str) -> bool {
    // Scenes found in the root may have ids that uploads cannot have.
    valid_id(id.to_owned()).is_ok() && folder_of(root, id).is_dir()
}

/// Removes the files of upload `id`, for good: a restart does not find them again.
///
/// # Errors
/// Errors of the disk; the upload is then as it was.
pub fn remove_files(root: &Path, id: &str) -> io::Result<()> {
    remove_synced(root, id, sync_folder)
}

/// Does the work of [`remove_files`]; `sync` is [`sync_folder`].
fn remove_synced(
    root: &Path,
    id: &str,
    sync: impl FnOnce(&Path) -> io::Result<()>,
) -> io::Result<()> {
    if !holds(root, id) {
        return Ok(());
    }
    // A folder is renamed at once or not at all, and the next start removes what has this name.
    let (folder, away) = (folder_of(root, id), partial(root));
    fs::rename(&folder, &away)?;
    if let Err(error) = sync(&root.join(FOLDER)) {
        fs::rename(&away, &folder)?;
        return Err(error);
    }
    remove_folder(&away);
    Ok(())
}

pub fn remove_folder(path: &Path) {
    match fs::remove_dir_all(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            tracing::warn!(%error, folder = %path.display(), "cannot remove an upload's files");
        }
        _ => {}
    }
}

/// Returns the name of a folder for files that are not an upload yet.
pub fn partial(root: &Path) -> PathBuf {
    static NUMBER: AtomicU64 = AtomicU64::new(0);
    let number = NUMBER.fetch_add(1, Ordering::Relaxed);
    root.join(FOLDER).join(format!("{PARTIAL}{}-{number}", std::process::id()))
}

/// Records that a loader begins. An upload that was loaded before is loaded again even if the disk is full.
pub fn begin(root: &Path, id: &str) -> io::Result<()> {
    let Some((folder, mut record)) = recorded(root, id)? else { return Ok(()) };
    let as_loaded = record.as_loaded();
    record.stage = Stage::Loading;
    match as_loaded.write_as(&folder, AS_LOADED).and_then(|()| record.write(&folder)) {
        Err(error) if record.was_loaded => {
            tracing::warn!(id, %error, "cannot write an upload's record; it is loaded all the same");
            Ok(())
        }
        written => written,
    }
}

/// Records that an upload has been loaded.
pub fn finish(root: &Path, id: &str) -> io::Result<()> {
    let Some((folder, record)) = recorded(root, id)? else { return Ok(()) };
    match fs::rename(folder.join(AS_LOADED), folder.join(RECORD)) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        Ok(()) => sync_folder(&folder),
        // The disk was full when the loader began.
        Err(_) if record == record.as_loaded() => Ok(()),
        Err(_) => record.as_loaded().write(&folder),
    }
}

/// Records that a loader ended without a scene while the process lives on.
pub fn set_aside(root: &Path, id: &str) -> io::Result<()> {
    change(root, id, |record| {
        if record.stage == Stage::Loading {
            record.stage = if record.was_loaded { Stage::Loaded } else { Stage::Received };
        }
        record.deaths = 0;
    })
}

/// Records that the process ends by itself while it loads an upload. An upload that is not being loaded keeps its count of deaths.
pub fn stand_down(root: &Path, id: &str) -> io::Result<()> {
    match recorded(root, id)? {
        Some((_, record)) if record.stage == Stage::Loading => set_aside(root, id),
        _ => Ok(()),
    }
}

/// Changes the record of an upload. A scene without a record was not uploaded.
fn change(root: &Path, id: &str, edit: impl FnOnce(&mut Record)) -> io::Result<()> {
    let Some((folder, mut record)) = recorded(root, id)? else { return Ok(()) };
    edit(&mut record);
    record.write(&folder)
}

/// Returns the folder and the record of an upload; `None` for a scene that was not uploaded.
fn recorded(root: &Path, id: &str) -> io::Result<Option<(PathBuf, Record)>> {
    if !holds(root, id) {
        return Ok(None);
    }
    let folder = folder_of(root, id);
    match Record::read(&folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        record => Ok(Some((folder, record?))),
    }
}

/// Lists uploads of earlier runs by id, and removes unfinished ones.
pub fn earlier(root: &Path) -> Vec<Earlier> {
    let Ok(folders) = fs::read_dir(root.join(FOLDER)) else { return Vec::new() };
    let mut found = Vec::new();
    for folder in folders.filter_map(Result::ok) {
        let name = folder.file_name().to_string_lossy().into_owned();
        if name.starts_with(PARTIAL) {
            remove_folder(&folder.path());
        } else if let Ok(id) = valid_id(name)
            && folder.path().is_dir()
        {
            found.push(look_at(root, id, &folder.path()));
        }
    }
    found.sort_by(|a, b| a.id.cmp(&b.id));
    found
}

fn look_at(root: &Path, id: String, folder: &Path) -> Earlier {
    let mut record = match Record::read(folder).or_else(|error| guess(folder, error)) {
        Ok(record) => record,
        Err(problem) => {
            return Earlier { id, source: None, key: None, bytes: 0, refusal: Some(problem) };
        }
    };
    let mut refusal = None;
    if record.stage == Stage::Loading {
        record.deaths += 1;
        record.stage = if record.was_loaded { Stage::Loaded } else { Stage::Received };
    }
    // An upload that loaded before gets a second try: another load may have caused the crash.
    if record.deaths > u32::from(record.was_loaded) {
        let times = match record.deaths {
            1 => "once".to_owned(),
            times => format!("{times} times in a row"),
        };
        let detail = format!(
            "{}: the server ended while it loaded this upload, {times}; it is not retried automatically",
            record.main
        );
        let problem = Problem::new(Kind::LoadLost, detail);
        refusal = Some(problem.accepted("POST /v1/scenes/{id}/retry, or DELETE /v1/scenes/{id}"));
    }
    if let Err(error) = record.write(folder) {
        tracing::warn!(id, %error, "cannot write an upload's record");
    }
    let source = Some(record.source(root, &id));
    Earlier { id, source, key: record.key, bytes: record.bytes, refusal }
}

/// Guesses the record of an upload without one: earlier versions kept none and loaded the only possible file.
fn guess(folder: &Path, error: io::Error) -> Result<Record, Problem> {
    let refused = |detail: String| {
        Problem::new(Kind::LoadLost, detail).accepted("DELETE /v1/scenes/{id}, and a new upload")
    };
    if error.kind() != io::ErrorKind::NotFound {
        return Err(refused(format!("cannot read the upload's record: {error}")));
    }
    let files = fs::read_dir(folder).map_err(|error| refused(error.to_string()))?;
    let (mut names, mut bytes) = (Vec::new(), 0);
    for file in files.filter_map(Result::ok).filter(|file| file.path().is_file()) {
        names.push(file.file_name().to_string_lossy().into_owned());
        bytes += file.metadata().map_or(0, |metadata| metadata.len());
    }
    match main_file(&names, None) {
        Ok(main) => Ok(Record::new(main, false, None, bytes)),
        Err(_) => Err(refused(format!(
            "the record does not say which of the upload's {} files to load",
            names.len()
        ))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(stage: Stage, was_loaded: bool, deaths: u32) -> Record {
        let record = Record::new("a.ply".into(), false, Some("key".into()), 7);
        Record { up: Some([0.0, 0.0, 1.0]), stage, was_loaded, deaths, ..record }
    }

    fn upload(root: &Path, id: &str, record: &Record) -> PathBuf {
        let folder = folder_of(root, id);
        fs::create_dir_all(&folder).unwrap();
        record.write(&folder).unwrap();
        folder
    }

    #[test]
    fn a_loader_that_died_is_not_tried_for_ever() {
        let root = tempfile::tempdir().unwrap();
        let root = root.path();
        upload(root, "new", &record(Stage::Received, false, 0));
        upload(root, "fatal", &record(Stage::Loading, false, 0));
        upload(root, "known", &record(Stage::Loading, true, 0));
        let refused = || -> Vec<bool> {
            earlier(root).iter().map(|upload| upload.refusal.is_some()).collect()
        };
        // In order of id: fatal, known, new. An upload that was loaded before is tried once more.
        assert_eq!(refused(), [true, false, false]);
        assert_eq!(refused(), [true, false, false]);
        begin(root, "known").unwrap();
        let found = earlier(root);
        let detail = &found[1].refusal.as_ref().unwrap().detail;
        assert!(detail.contains("a.ply") && detail.contains("2 times"), "{detail}");
        assert_eq!((found[1].key.as_deref(), found[1].bytes), (Some("key"), 7));
        assert_eq!(found[1].source.as_ref().unwrap().up, Some(DVec3::Z));
        finish(root, "known").unwrap();
        assert_eq!(
            Record::read(&folder_of(root, "known")).unwrap(),
            record(Stage::Loaded, true, 0)
        );
        // A loader that ends by itself does not count against the upload.
        begin(root, "new").unwrap();
        set_aside(root, "new").unwrap();
        assert!(earlier(root)[2].refusal.is_none());
    }

    #[test]
    fn a_stop_clears_only_the_load_under_way() {
        let root = tempfile::tempdir().unwrap();
        let root = root.path();
        let waiting = upload(root, "waiting", &record(Stage::Loaded, true, 1));
        let loading = upload(root, "loading", &record(Stage::Loaded, true, 1));
        begin(root, "loading").unwrap();
        for id in ["waiting", "loading", "absent"] {
            stand_down(root, id).unwrap();
        }
        assert_eq!(Record::read(&waiting).unwrap(), record(Stage::Loaded, true, 1));
        assert_eq!(Record::read(&loading).unwrap(), record(Stage::Loaded, true, 0));
    }

    #[test]
    fn a_disk_that_becomes_full_loses_no_upload() {
        let root = tempfile::tempdir().unwrap();
        let root = root.path();
        let folder = upload(root, "new", &record(Stage::Received, false, 0));
        begin(root, "new").unwrap();
        assert_eq!(Record::read(&folder).unwrap(), record(Stage::Loading, false, 0));
        // A folder of that name keeps new records from being written, as a full disk does.
        let full = folder.join(".upload.json.new");
        fs::create_dir(&full).unwrap();
        finish(root, "new").unwrap();
        assert_eq!(Record::read(&folder).unwrap(), record(Stage::Loaded, true, 0));
        // After a restart the disk is still full.
        assert!(earlier(root)[0].refusal.is_none());
        begin(root, "new").unwrap();
        finish(root, "new").unwrap();
        assert_eq!(Record::read(&folder).unwrap(), record(Stage::Loaded, true, 0));
        // A load that ended with the process is counted once there is space.
        fs::remove_dir(&full).unwrap();
        begin(root, "new").unwrap();
        assert_eq!(Record::read(&folder).unwrap(), record(Stage::Loading, true, 0));
        // What was never loaded is refused by a full disk, because a crash could not be recorded.
        let never = upload(root, "never", &record(Stage::Received, false, 0));
        fs::create_dir(never.join(".upload.json.new")).unwrap();
        assert!(begin(root, "never").is_err());
        assert_eq!(Record::read(&never).unwrap(), record(Stage::Received, false, 0));
    }

    #[test]
    fn a_removal_that_the_disk_does_not_confirm_removes_nothing() {
        let root = tempfile::tempdir().unwrap();
        let root = root.path();
        let loaded = record(Stage::Loaded, true, 0);
        let folder = upload(root, "known", &loaded);
        let refused = remove_synced(root, "known", |_| Err(io::Error::other("the disk failed")));
        assert_eq!(refused.unwrap_err().to_string(), "the disk failed");
        assert_eq!(Record::read(&folder).unwrap(), loaded);
        remove_files(root, "known").unwrap();
        assert_eq!(fs::read_dir(root.join(FOLDER)).unwrap().count(), 0);
    }

    #[test]
    fn uploads_without_a_record_are_taken_as_before() {
        let root = tempfile::tempdir().unwrap();
        let root = root.path();
        let write = |name: &str| {
            let path = root.join(FOLDER).join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, "12345").unwrap();
        };
        write("one/a.obj");
        write("one/a.mtl");
        write("two/a.ply");
        write("two/b.ply");
        write("broken/a.ply");
        write("broken/.upload.json");
        write(".partial-1-1/a.ply");
        let found = earlier(root);
        let told: Vec<_> = found.iter().map(|e| (e.id.as_str(), e.refusal.is_none())).collect();
        assert_eq!(told, [("broken", false), ("one", true), ("two", false)]);
        assert_eq!(found[1].bytes, 10);
        assert_eq!(found[1].source, Some(Source::at(root.join("uploads/one/a.obj"))));
        assert!(!root.join("uploads/.partial-1-1").exists());
        // The upload now has a record.
        assert_eq!(Record::read(&folder_of(root, "one")).unwrap().main, "a.obj");
    }
}
