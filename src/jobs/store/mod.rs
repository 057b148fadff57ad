//! The state folder: everything that outlives a process, and all disk access of jobs.
//!
//! ```text
//! STATE/.lock             held by the server that uses this folder
//! STATE/jobs.redb         a record for each job (redb: every change is atomic)
//! STATE/jobs/7/job.json   specification of job 7: enough to recover the job if the database is lost
//! STATE/jobs/7/frames/    see `film`
//! STATE/jobs/7/video.mp4
//! ```
//!
//! A job's record is in the database before its folder is created. When a job is removed, its `job.json` is first renamed to
//! `job.removed`, which needs no space on the disk; then its record is deleted, then its files. Therefore:
//!
//! - A folder with `job.removed` belongs to a removed job, whatever the database says.
//! - A folder with `job.json` that the database does not know belongs to a job whose record was lost.
//! - A folder with neither is left over from an interrupted operation.
//!
//! A database that cannot be read is set aside under another name. Jobs are then recovered from their folders, as failed jobs
//! that can be resumed, because their states are unknown.
//!
//! A record that cannot be written, because the disk is full for example, is owed: [`Store::owed`] lists these jobs for a later
//! try.

mod database;
mod place;

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use parking_lot::Mutex;

pub use self::place::Place;

use self::database::{Change, Content, Fault, Ledger, Opener, file_opener};
use super::book::{Failure, FailureKind, JobId, LARGEST_COUNT, Made, Record, State};
use crate::lock::Locked;

const LOCK: &str = ".lock";
const DATABASE: &str = "jobs.redb";
const FOLDERS: &str = "jobs";

/// Why a state folder cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum StateError {
    #[error("another running server uses the state folder {}; give this server its own folder with --state", folder.display())]
    Locked { folder: PathBuf },
    #[error("cannot use the state folder {}: {}: {error}", folder.display(), file.display())]
    Io { folder: PathBuf, file: PathBuf, error: io::Error },
    #[error("the job database failed: {0}")]
    Database(String),
}

/// The state folder, locked for this process.
pub struct Store {
    books: Mutex<Books>,
    folder: PathBuf,
    _lock: Locked,
}

struct Books {
    ledger: Ledger,
    /// Jobs whose records in the database are out of date.
    owed: BTreeSet<JobId>,
}

/// The content of a state folder.
pub struct Opened {
    pub store: Store,
    pub records: Vec<Record>,
    /// The largest id that a job ever had.
    pub last_id: JobId,
    /// Messages for the log.
    pub warnings: Vec<String>,
}

/// The user's own state folder: `$XDG_STATE_HOME/pointillist`, else `$HOME/.local/state/pointillist`; `None` if neither variable
/// is an absolute path.
pub fn default_folder() -> Option<PathBuf> {
    let absolute =
        |name| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let states =
        absolute("XDG_STATE_HOME").or_else(|| Some(absolute("HOME")?.join(".local/state")))?;
    Some(states.join("pointillist"))
}

impl Store {
    /// Creates the folder if it is missing, and locks it for this process.
    ///
    /// # Errors
    /// [`StateError::Locked`], or the folder cannot be written. A damaged database is no error: see the module.
    pub fn open(folder: &Path, now_ms: u64) -> Result<Opened, StateError> {
        Store::open_with(folder, now_ms, || file_opener(&folder.join(DATABASE)))
    }

    /// As [`Store::open`], with another way to open the database.
    fn open_with(
        folder: &Path,
        now_ms: u64,
        opener: impl Fn() -> Opener,
    ) -> Result<Opened, StateError> {
        let failed = |file: &Path| {
            let (folder, file) = (folder.to_owned(), file.to_owned());
            move |error| StateError::Io { folder, file, error }
        };
        let folders = folder.join(FOLDERS);
        make_private(&folders).map_err(failed(&folders))?;
        let name = folder.join(LOCK);
        let opened = File::options().create(true).append(true).open(&name);
        let lock = opened.and_then(Locked::attempt).map_err(failed(&name))?;
        let lock = lock.ok_or_else(|| StateError::Locked { folder: folder.to_owned() })?;
        let mut warnings = Vec::new();
        let file = folder.join(DATABASE);
        let told = |fault| state_error(folder, fault);
        let (ledger, content) = match Ledger::open(opener()) {
            Err(Fault::Damaged(reason)) => {
                let aside = aside(&file, now_ms);
                fs::rename(&file, &aside).map_err(failed(&file))?;
                warnings.push(format!(
                    "the job database is damaged ({reason}); it was renamed to {}, and jobs are recovered from their folders",
                    aside.display()
                ));
                Ledger::open(opener()).map_err(told)?
            }
            opened => opened.map_err(told)?,
        };
        let books = Mutex::new(Books { ledger, owed: BTreeSet::new() });
        let store = Store { books, folder: folder.to_owned(), _lock: lock };
        let Content { mut records, mut last_id, unreadable } = content;
        for (id, reason) in &unreadable {
            warnings.push(format!("cannot read the record of job {id}: {reason}"));
            last_id = last_id.max((*id).min(LARGEST_COUNT));
        }
        store
            .find_again(&mut records, &mut last_id, now_ms, &mut warnings, Place::remove)
            .map_err(failed(&folders))?;
        Ok(Opened { store, records, last_id, warnings })
    }

    /// Compares the folders of jobs with the records: adds lost jobs, and finishes interrupted removals. `remove` is
    /// [`Place::remove`]; a folder that cannot be removed stays for the next start.
    fn find_again(
        &self,
        records: &mut Vec<Record>,
        last_id: &mut JobId,
        now_ms: u64,
        warnings: &mut Vec<String>,
        remove: impl Fn(&Place) -> io::Result<()>,
    ) -> io::Result<()> {
        let leftover = |place: &Place| {
            let failed = |error| {
                format!(
                    "cannot remove what is left of a removed job: {}: {error}",
                    place.folder().display()
                )
            };
            remove(place).err().map(failed)
        };
        for item in fs::read_dir(self.folder.join(FOLDERS))? {
            let id = item?.file_name().to_str().and_then(|name| name.parse::<JobId>().ok());
            let Some(id) = id.filter(|id| *id <= LARGEST_COUNT) else { continue };
            *last_id = (*last_id).max(id);
            let place = self.place(id);
            if place.is_buried() {
                records.retain(|record| record.id != id);
                match self.keep(id, || None) {
                    Ok(()) => warnings.extend(leftover(&place)),
                    Err(error) => warnings.push(format!("job {id} was removed: {error}")),
                }
                continue;
            }
            if records.iter().any(|record| record.id == id) {
                continue;
            }
            match place.kept() {
                Ok(Some(kept)) => {
                    warnings
                        .push(format!("job {id} was recovered from its folder; it can be resumed"));
                    let detail = "the record of this job was lost, and the job was recovered from its folder; resume it to continue";
                    let failure =
                        Failure { kind: FailureKind::Recovered, detail: detail.to_owned() };
                    let record = Record {
                        id,
                        spec: kept.spec,
                        owner: kept.owner,
                        request_id: kept.request_id,
                        repeat: kept.repeat,
                        state: State::Failed(failure),
                        made: Made::default(),
                        created_ms: kept.created_ms,
                        since_ms: now_ms,
                        turn: id,
                        drawn: 0,
                    };
                    if let Err(error) = self.keep(id, || Some(record.clone())) {
                        warnings.push(format!("job {id}: {error}"));
                    }
                    records.push(record);
                }
                Ok(None) => warnings.extend(leftover(&place)),
                // The folder stays, because it may hold files of somebody else.
                Err(error) => warnings.push(format!("{}: {error}", place.job_file().display())),
            }
        }
        Ok(())
    }

    /// Writes the current record of a job, which `look` returns; `None` deletes the record. Concurrent changes of the job are
    /// written after this one. If writing fails, the job becomes [owed](Store::owed).
    ///
    /// # Errors
    /// The database cannot be written.
    pub fn keep(&self, id: JobId, look: impl FnOnce() -> Option<Record>) -> Result<(), StateError> {
        let mut books = self.books.lock();
        let found = look();
        let forget = [id];
        let change = match &found {
            Some(record) => Change { put: Some(record), forget: &[] },
            None => Change { put: None, forget: &forget },
        };
        match books.ledger.apply(&change) {
            Ok(()) => {
                books.owed.remove(&id);
                Ok(())
            }
            Err(fault) => {
                let error = state_error(&self.folder, fault);
                if books.owed.insert(id) {
                    tracing::error!(job = id, %error, "cannot store a job's record; retrying");
                }
                Err(error)
            }
        }
    }

    /// Marks a job as removed, so that it stays removed even if the process dies.
    ///
    /// # Errors
    /// The folder cannot be written.
    pub fn bury(&self, id: JobId) -> Result<(), StateError> {
        let place = self.place(id);
        place.bury().map_err(|error| StateError::Io {
            folder: self.folder.clone(),
            file: place.job_file(),
            error,
        })
    }

    /// Returns the jobs whose records in the database are out of date.
    pub fn owed(&self) -> Vec<JobId> {
        self.books.lock().owed.iter().copied().collect()
    }

    pub fn folder(&self) -> &Path {
        &self.folder
    }

    pub fn place(&self, id: JobId) -> Place {
        Place::new(self.folder.join(FOLDERS).join(id.to_string()))
    }
}

fn state_error(folder: &Path, fault: Fault) -> StateError {
    let folder = folder.to_owned();
    match fault {
        Fault::Locked => StateError::Locked { folder },
        Fault::Io(error) => StateError::Io { file: folder.join(DATABASE), folder, error },
        Fault::Damaged(reason) => StateError::Database(reason),
    }
}

/// Returns the name under which a damaged file is set aside.
fn aside(file: &Path, now_ms: u64) -> PathBuf {
    let mut name = file.as_os_str().to_owned();
    name.push(format!(".damaged-{now_ms}"));
    PathBuf::from(name)
}

fn make_private(folder: &Path) -> io::Result<()> {
    let mut builder = fs::DirBuilder::new();
    builder.recursive(true);
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    builder.create(folder)
}

#[cfg(test)]
mod tests;
