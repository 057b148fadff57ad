//! The state folder: all that outlives a process, and all of jobs that touches files.
//!
//! ```text
//! STATE/.lock             held by the daemon that works here
//! STATE/jobs.redb         a record for each job (redb: a change is there whole, or not at all)
//! STATE/jobs/7/job.json   what job 7 is to do: enough to find it again should the database be lost
//! STATE/jobs/7/frames/    see `film`
//! STATE/jobs/7/video.mp4
//! ```
//!
//! A job is in the database before its folder is made. One that is removed has its `job.json` renamed to `job.removed` before
//! anything else, which needs no room on the disk; then its record goes, then its files. So a folder with `job.removed` is that of
//! a job that is gone, whatever the database says; one with `job.json` that the database does not know is a job whose record was
//! lost; and one with neither is what something left over that was interrupted. A database that cannot be read is set aside under
//! another name; jobs are then found again from their folders, as failed ones that can be resumed, because what state they were in is not known.
//!
//! A record that cannot be written, for want of room say, is owed: [`Store::owed`] tells of which, for somebody to try again.

mod database;
mod place;

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use parking_lot::Mutex;

pub use self::place::Place;

use self::database::{Change, Content, Fault, Ledger, Opener, file_opener};
use super::book::{Failure, FailureKind, JobId, Made, Record, State};

const LOCK: &str = ".lock";
const DATABASE: &str = "jobs.redb";
const FOLDERS: &str = "jobs";

/// Why a state folder cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum StateError {
    #[error("the state folder {} is another daemon's, which is running; give this one its own with --state", folder.display())]
    Locked { folder: PathBuf },
    #[error("the state folder {} cannot be used: {}: {error}", folder.display(), file.display())]
    Io { folder: PathBuf, file: PathBuf, error: io::Error },
    #[error("the job database failed: {0}")]
    Database(String),
}

/// The folder, which is this process's.
pub struct Store {
    books: Mutex<Books>,
    folder: PathBuf,
    _lock: File,
}

struct Books {
    ledger: Ledger,
    /// Whose records in the database are not as they should be.
    owed: BTreeSet<JobId>,
}

/// What was found in a folder.
pub struct Opened {
    pub store: Store,
    pub records: Vec<Record>,
    /// No job has had a greater number.
    pub last_id: JobId,
    /// What somebody should know of, for the log.
    pub warnings: Vec<String>,
}

/// The user's own state folder: `$XDG_STATE_HOME/pointillist`, else `$HOME/.local/state/pointillist`; none where neither variable is an
/// absolute path.
pub fn default_folder() -> Option<PathBuf> {
    let absolute =
        |name| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let states =
        absolute("XDG_STATE_HOME").or_else(|| Some(absolute("HOME")?.join(".local/state")))?;
    Some(states.join("pointillist"))
}

impl Store {
    /// Makes the folder where it is not there, and takes it for this process.
    ///
    /// # Errors
    /// [`StateError::Locked`], or a folder that cannot be written. A damaged database is no error: see the module.
    pub fn open(folder: &Path, now_ms: u64) -> Result<Opened, StateError> {
        Store::open_with(folder, now_ms, || file_opener(&folder.join(DATABASE)))
    }

    /// The same, with a database that is opened in another way.
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
        let lock = File::options().create(true).append(true).open(&name).map_err(failed(&name))?;
        match lock.try_lock() {
            Ok(()) => {}
            Err(fs::TryLockError::WouldBlock) => {
                return Err(StateError::Locked { folder: folder.to_owned() });
            }
            Err(fs::TryLockError::Error(error)) => return Err(failed(&name)(error)),
        }
        let mut warnings = Vec::new();
        let file = folder.join(DATABASE);
        let told = |fault| state_error(folder, fault);
        let (ledger, content) = match Ledger::open(opener()) {
            Err(Fault::Damaged(reason)) => {
                let aside = aside(&file, now_ms);
                fs::rename(&file, &aside).map_err(failed(&file))?;
                warnings.push(format!(
                    "the job database is damaged ({reason}); it is kept as {}, and jobs are found again from their folders",
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
            warnings.push(format!("the record of job {id} cannot be read: {reason}"));
            last_id = last_id.max(*id);
        }
        store
            .find_again(&mut records, &mut last_id, now_ms, &mut warnings)
            .map_err(failed(&folders))?;
        Ok(Opened { store, records, last_id, warnings })
    }

    /// Looks through the folders of jobs for such as the records do not tell of.
    fn find_again(
        &self,
        records: &mut Vec<Record>,
        last_id: &mut JobId,
        now_ms: u64,
        warnings: &mut Vec<String>,
    ) -> io::Result<()> {
        for item in fs::read_dir(self.folder.join(FOLDERS))? {
            let Some(id) = item?.file_name().to_str().and_then(|name| name.parse::<JobId>().ok())
            else {
                continue;
            };
            *last_id = (*last_id).max(id);
            let place = self.place(id);
            if place.is_buried() {
                records.retain(|record| record.id != id);
                match self.keep(id, || None) {
                    Ok(()) => place.remove()?,
                    Err(error) => warnings.push(format!("job {id} was removed: {error}")),
                }
                continue;
            }
            if records.iter().any(|record| record.id == id) {
                continue;
            }
            match place.kept() {
                Ok(Some(kept)) => {
                    warnings.push(format!(
                        "job {id} was found again from its folder; it can be resumed"
                    ));
                    let detail = "the record of this job was lost and found again from its folder; resume it to go on with it";
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
                Ok(None) => place.remove()?,
                // Not ours to remove.
                Err(error) => warnings.push(format!("{}: {error}", place.job_file().display())),
            }
        }
        Ok(())
    }

    /// Writes a job's record as it is by now, which `look` tells: `None` when the job is no more. Changes that others make meanwhile
    /// are written after this one. When it fails the job is among those that are [owed](Store::owed).
    ///
    /// # Errors
    /// A database that cannot be written.
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
                    tracing::error!(job = id, %error, "a job's record cannot be kept; it is tried again");
                }
                Err(error)
            }
        }
    }

    /// Marks a job as removed, through whatever happens from now on.
    ///
    /// # Errors
    /// A folder that cannot be written.
    pub fn bury(&self, id: JobId) -> Result<(), StateError> {
        let place = self.place(id);
        place.bury().map_err(|error| StateError::Io {
            folder: self.folder.clone(),
            file: place.job_file(),
            error,
        })
    }

    /// Jobs whose records in the database are not as they should be.
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

/// A name for a file that is set aside.
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
