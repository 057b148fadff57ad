//! Serves the uploads that another server keeps in the same root.
//!
//! ```text
//! keeper     POST ──► uploads/ID/ ──load──► its record says `was_loaded`
//!                                                 │ read every second
//! follower                                        └──► load; remove once the folder is gone or is another upload's
//! ```
//!
//! One server keeps the uploads: it counts quotas, writes records and finds out whether a file takes its loader down. Followers
//! only read, so the servers need no lock and no protocol between them, and a folder on a network file system will do. A follower
//! serves an upload once the keeper has loaded it. Changes of nodes are not in the files, so they stay with the server that made
//! them.

use std::collections::{BTreeMap, BTreeSet, HashMap, VecDeque};
use std::fs;
use std::io;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use super::loading::{Loading, Origin, load};
use super::store::{Earlier, FOLDER, Record, folder_of, holds, in_place};
use crate::engine::Source;
use crate::http::names::valid_id;
use crate::http::problem::{Kind, Problem};
use crate::http::registry::{Ended, Entry};
use crate::http::{App, Phase};

/// Time between two looks at the folder.
const PERIOD: Duration = Duration::from_secs(1);
/// Longest wait for a cancelled load to end.
const LONGEST_STEP: Duration = Duration::from_secs(30);

/// Times after which a load that failed is repeated: the first, which doubles with each further failure, and the longest.
const FIRST_PAUSE: Duration = Duration::from_secs(2);
const LONGEST_PAUSE: Duration = Duration::from_secs(300);

/// Ways in which a server treats uploads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Uploads {
    /// It accepts uploads and keeps them below its root.
    Kept,
    /// It refuses uploads, and serves those that another server keeps.
    Followed,
    /// It refuses uploads.
    Refused,
}

impl Uploads {
    pub fn are_kept(self) -> bool {
        self == Uploads::Kept
    }

    /// Returns whether clients may upload.
    ///
    /// # Errors
    /// This server takes no uploads.
    pub fn accepted(self) -> Result<(), Problem> {
        let (detail, accepted) = match self {
            Uploads::Kept => return Ok(()),
            Uploads::Followed => (
                "this server is a follower and accepts no uploads (--follow-uploads)",
                "upload to the server that keeps the uploads",
            ),
            Uploads::Refused => (
                "this server accepts no uploads (--no-uploads)",
                "restart the server without --no-uploads",
            ),
        };
        Err(Problem::new(Kind::UploadsOff, detail).accepted(accepted))
    }
}

/// Properties that distinguish an upload from a later upload with the same id.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Edition {
    main: String,
    bytes: u64,
    modified: SystemTime,
}

/// The uploads that a follower has seen, by id.
#[derive(Debug, Default)]
pub struct Followed {
    known: BTreeMap<String, Edition>,
    /// Whether the folder could not be read the last time.
    is_unreadable: bool,
}

/// A change that the follower has to repeat.
enum Change {
    Load(Found),
    Remove(String),
}

/// An upload to load.
struct Found {
    id: String,
    source: Source,
    key: Option<String>,
    bytes: u64,
}

impl Followed {
    /// Looks at a root for the first time. Returns the uploads that are there.
    pub fn begin(root: &Path) -> (Vec<Earlier>, Followed) {
        let mut followed = Followed::default();
        let found = followed.look(root).into_iter().filter_map(|change| match change {
            Change::Load(Found { id, source, key, bytes }) => {
                Some(Earlier { id, source: Some(source), key, bytes, refusal: None })
            }
            Change::Remove(_) => None,
        });
        let found = found.collect();
        (found, followed)
    }

    /// Returns what has changed since the last look, removals first. A folder that cannot be read has not changed.
    fn look(&mut self, root: &Path) -> Vec<Change> {
        let present = match present(root) {
            Ok(present) => present,
            Err(error) => {
                if !std::mem::replace(&mut self.is_unreadable, true)
                    && (error.kind() != io::ErrorKind::NotFound || !self.known.is_empty())
                {
                    tracing::warn!(%error, folder = %root.join(FOLDER).display(), "cannot follow the uploads; known ones stay");
                }
                return Vec::new();
            }
        };
        self.is_unreadable = false;
        let (mut removals, mut loads) = (Vec::new(), Vec::new());
        self.known.retain(|id, _| {
            let stays = present.contains(id);
            if !stays {
                removals.push(Change::Remove(id.clone()));
            }
            stays
        });
        for id in present {
            let found = match read(root, &id) {
                Ok(found) => found,
                Err(error) if is_gone(&error) => None,
                // A disk that fails for a moment takes no scene away.
                Err(_) => continue,
            };
            let Some((record, edition)) = found else {
                // The upload was deleted, and another one may be in its place that its keeper has not loaded.
                if self.known.remove(&id).is_some() {
                    removals.push(Change::Remove(id));
                }
                continue;
            };
            match self.known.get(&id) {
                Some(known) if *known == edition => continue,
                Some(_) => removals.push(Change::Remove(id.clone())),
                None => {}
            }
            let source = record.source(root, &id);
            let Record { key, bytes, .. } = record;
            loads.push(Change::Load(Found { id: id.clone(), source, key, bytes }));
            self.known.insert(id, edition);
        }
        removals.extend(loads);
        removals
    }
}

/// Returns the ids of all uploads below a root.
fn present(root: &Path) -> io::Result<BTreeSet<String>> {
    let mut ids = BTreeSet::new();
    for entry in fs::read_dir(root.join(FOLDER))? {
        let entry = entry?;
        if let Ok(id) = valid_id(entry.file_name().to_string_lossy().into_owned())
            && entry.file_type()?.is_dir()
        {
            ids.insert(id);
        }
    }
    Ok(ids)
}

/// Reads an upload's record; `None` if its keeper has not loaded it yet.
fn read(root: &Path, id: &str) -> io::Result<Option<(Record, Edition)>> {
    let folder = folder_of(root, id);
    let record = Record::read(&folder)?;
    if !record.was_loaded {
        return Ok(None);
    }
    let modified = fs::metadata(folder.join(&record.main))?.modified()?;
    let edition = Edition { main: record.main.clone(), bytes: record.bytes, modified };
    Ok(Some((record, edition)))
}

/// Returns whether an upload's record or main file is not there any more, or is no record.
fn is_gone(error: &io::Error) -> bool {
    use io::ErrorKind::*;
    matches!(error.kind(), NotFound | NotADirectory | InvalidData | UnexpectedEof)
}

/// Returns whether an unknown scene is an upload that this server follows and is about to load.
pub fn is_coming(app: &App, id: &str) -> bool {
    let root = &app.settings.root;
    app.settings.uploads == Uploads::Followed
        && in_place(|| holds(root, id) && matches!(read(root, id), Ok(Some(_))))
}

/// Returns whether a scene is an upload that this server follows.
pub fn is_followed(app: &App, id: &str) -> bool {
    app.settings.uploads == Uploads::Followed && app.uploads.owner(id).is_some()
}

/// Refuses to remove an upload that another server keeps.
///
/// # Errors
/// The scene is such an upload.
pub fn refuse_removal(app: &App, id: &str) -> Result<(), Problem> {
    if !is_followed(app, id) {
        return Ok(());
    }
    let detail = format!("scene `{id}` is an upload that another server keeps (--follow-uploads)");
    Err(Problem::new(Kind::UploadsOff, detail)
        .accepted("DELETE at the server that keeps the uploads"))
}

/// Repeats the keeper's changes until the server drains. Loads one upload at a time, because each may need most of the memory. Since the keeper has loaded
/// them all, a load that fails is repeated: memory or the disk may have been short.
pub async fn follow(app: Arc<App>, mut followed: Followed) {
    let mut waiting = VecDeque::new();
    let mut tries = HashMap::new();
    let mut loading: Option<Loading> = None;
    while app.phase() != Phase::Draining {
        match &mut loading {
            Some(load) => {
                if tokio::time::timeout(PERIOD, load).await.is_ok() {
                    loading = None;
                }
            }
            None => tokio::time::sleep(PERIOD).await,
        }
        let root = app.settings.root.clone();
        let looked = tokio::task::spawn_blocking(move || {
            let changes = followed.look(&root);
            (followed, changes)
        });
        let Ok((now, changes)) = looked.await else { return };
        followed = now;
        for change in changes {
            match change {
                Change::Remove(id) => {
                    tries.remove(&id);
                    waiting.retain(|found: &Found| found.id != id);
                    remove(&app, id).await;
                }
                Change::Load(found) => waiting.push_back(found),
            }
        }
        while loading.is_none()
            && let Some(found) = waiting.pop_front()
        {
            // The id is free in a moment.
            if matches!(
                app.registry.get(&found.id),
                Some(Entry::Loading { .. } | Entry::Removing { .. })
            ) {
                waiting.push_back(found);
                break;
            }
            loading = begin(&app, found);
        }
        if loading.is_none() && waiting.is_empty() {
            loading = repeat(&app, &mut tries);
        }
    }
}

/// Begins to load an upload again whose load failed, if it is time. `tries` counts the repeated loads of each.
fn repeat(app: &Arc<App>, tries: &mut HashMap<String, u32>) -> Option<Loading> {
    let is_due = |(id, entry): &(String, Entry)| {
        let Entry::Failed { at, source: Some(_), .. } = entry else { return false };
        let pause = pause(tries.get(id).copied().unwrap_or_default());
        at.elapsed() >= pause && is_followed(app, id)
    };
    let (id, _) = app.registry.list().into_iter().find(is_due)?;
    let (reservation, source) = app.registry.retry(&id, app.engine.admission())?;
    tracing::info!(id, "an upload that could not be loaded is tried again");
    *tries.entry(id).or_default() += 1;
    Some(tokio::spawn(load(app.clone(), reservation, source, Origin::Kept)))
}

fn pause(tries: u32) -> Duration {
    FIRST_PAUSE.saturating_mul(1 << tries.min(16)).min(LONGEST_PAUSE)
}

/// Begins to load an upload, unless a scene of the root has its id.
fn begin(app: &Arc<App>, found: Found) -> Option<Loading> {
    let Found { id, source, key, bytes } = found;
    let is_loaded = |id: &str| app.engine.scene(id).is_ok();
    match app.registry.reserve(&id, app.engine.admission(), is_loaded) {
        Ok(reservation) => {
            let limits = app.rules().bounds.uploads;
            app.uploads.keep(&id, app.uploads.known(key.as_deref(), limits, bytes));
            Some(tokio::spawn(load(app.clone(), reservation, source, Origin::Kept)))
        }
        Err(problem) => {
            tracing::warn!(id, problem = problem.detail, "an upload is not followed");
            None
        }
    }
}

/// Removes a scene that was loaded from an upload.
async fn remove(app: &Arc<App>, id: String) {
    if app.uploads.owner(&id).is_none() {
        return;
    }
    if let Some(load) = app.registry.cancel(&id) {
        let _ = tokio::time::timeout(LONGEST_STEP, load.ended()).await;
    }
    let claim = app.registry.claim(&id, |id| app.engine.load_number(id));
    app.uploads.forget(&id);
    app.surveys.forget(&id);
    let engine = app.engine.clone();
    // A scene whose load failed or was cancelled is not in the engine.
    let _ = tokio::task::spawn_blocking(move || engine.remove(&id)).await;
    if let Some(claim) = claim {
        claim.finish(Ended::Gone);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::http::upload::store::{begin, finish};

    fn told(followed: &mut Followed, root: &Path) -> Vec<String> {
        let tell = |change| match change {
            Change::Load(found) => {
                assert_eq!(found.source.path, folder_of(root, &found.id).join("a.ply"));
                format!("+{}", found.id)
            }
            Change::Remove(id) => format!("-{id}"),
        };
        followed.look(root).into_iter().map(tell).collect()
    }

    fn upload(root: &Path, id: &str, content: &str) {
        let folder = folder_of(root, id);
        fs::create_dir_all(&folder).unwrap();
        fs::write(folder.join("a.ply"), content).unwrap();
        let bytes = content.len() as u64;
        Record::new("a.ply".into(), false, None, bytes).write(&folder).unwrap();
    }

    #[test]
    fn a_follower_repeats_what_the_keeper_did() {
        let root = tempfile::tempdir().unwrap();
        let root = root.path();
        let (found, mut followed) = Followed::begin(root);
        assert!(found.is_empty(), "no folder yet");
        upload(root, "one", "1");
        upload(root, "two", "1");
        fs::create_dir(root.join("uploads/.partial-1-1")).unwrap();
        assert!(told(&mut followed, root).is_empty(), "the keeper has loaded none");
        finish(root, "two").unwrap();
        assert_eq!(told(&mut followed, root), ["+two"]);
        finish(root, "one").unwrap();
        assert_eq!(told(&mut followed, root), ["+one"]);
        // A keeper that starts again loads everything anew, which changes nothing.
        begin(root, "one").unwrap();
        assert!(told(&mut followed, root).is_empty());
        // Another upload with the same id replaces the first.
        fs::remove_dir_all(folder_of(root, "two")).unwrap();
        upload(root, "two", "22");
        finish(root, "two").unwrap();
        fs::remove_dir_all(folder_of(root, "one")).unwrap();
        assert_eq!(told(&mut followed, root), ["-one", "-two", "+two"]);
        let (found, _) = Followed::begin(root);
        let ids: Vec<_> = found.iter().map(|upload| upload.id.as_str()).collect();
        assert_eq!(ids, ["two"]);
        // An upload that the keeper has not loaded replaces one that it has deleted.
        fs::remove_dir_all(folder_of(root, "two")).unwrap();
        upload(root, "two", "333");
        assert_eq!(told(&mut followed, root), ["-two"]);
        assert!(told(&mut followed, root).is_empty());
        finish(root, "two").unwrap();
        assert_eq!(told(&mut followed, root), ["+two"]);
        // A record that is none counts as a deletion.
        let record = folder_of(root, "two").join(".upload.json");
        let text = fs::read(&record).unwrap();
        fs::write(&record, "{").unwrap();
        assert_eq!(told(&mut followed, root), ["-two"]);
        fs::write(&record, text).unwrap();
        assert_eq!(told(&mut followed, root), ["+two"]);
        // A volume that is not mounted for a moment takes no scene away.
        fs::rename(root.join(FOLDER), root.join("away")).unwrap();
        assert!(told(&mut followed, root).is_empty());
        fs::rename(root.join("away"), root.join(FOLDER)).unwrap();
        assert!(told(&mut followed, root).is_empty());
    }

    #[test]
    fn refusals_name_the_flag() {
        assert!(Uploads::Kept.accepted().is_ok());
        for (uploads, flag) in
            [(Uploads::Followed, "--follow-uploads"), (Uploads::Refused, "--no-uploads")]
        {
            let problem = uploads.accepted().unwrap_err();
            assert_eq!(problem.status(), 503);
            assert!(problem.detail.contains(flag), "{}", problem.detail);
        }
    }
}
