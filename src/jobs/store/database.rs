//! Stores the records of jobs in redb, and recovers from disk errors.
//!
//! After a disk error redb refuses everything until the database is opened again. A database that has failed is therefore closed,
//! and reopened for one more try of the same change; if that fails too, the next change reopens it:
//!
//! ```text
//! open ──change fails──► closed ──reopen, try again──► open ──fails again──► closed, error returned
//!   ▲                                                   │
//!   └─────────────────────succeeds──────────────────────┘
//! ```

use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use redb::{
    Builder, Database, DatabaseError, ReadableDatabase, ReadableTable, TableDefinition, TableError,
};

use crate::jobs::book::{JobId, LARGEST_COUNT, Record};

/// Records as JSON, by job.
pub const JOBS: TableDefinition<'_, JobId, &[u8]> = TableDefinition::new("jobs");
/// Numbers by name: `last_id` is the largest id that a job was ever given.
const NUMBERS: TableDefinition<'_, &str, u64> = TableDefinition::new("numbers");
const LAST_ID: &str = "last_id";
/// Size of the database's cache.
const CACHE_BYTES: usize = 4 << 20;

/// Why a database cannot be used.
#[derive(Debug)]
pub enum Fault {
    Locked,
    /// A disk error, which may go away.
    Io(io::Error),
    Damaged(String),
}

impl From<redb::Error> for Fault {
    fn from(error: redb::Error) -> Fault {
        use io::ErrorKind::{InvalidData, UnexpectedEof};
        match error {
            redb::Error::DatabaseAlreadyOpen | redb::Error::LockProtocolMismatch => Fault::Locked,
            redb::Error::Io(error) if !matches!(error.kind(), InvalidData | UnexpectedEof) => {
                Fault::Io(error)
            }
            error @ redb::Error::PreviousIo => Fault::Io(io::Error::other(error)),
            other => Fault::Damaged(other.to_string()),
        }
    }
}

/// Opens a database, or creates it where there is none.
pub type Opener = Box<dyn Fn() -> Result<Database, DatabaseError> + Send + Sync>;

/// An opener of a database in a file.
pub fn file_opener(file: &Path) -> Opener {
    let file = file.to_owned();
    Box::new(move || builder().create(&file))
}

/// A builder with our settings.
pub fn builder() -> Builder {
    let mut builder = Database::builder();
    // Report bytes that something else changed as an error instead of trusting them.
    builder.set_cache_size(CACHE_BYTES).set_check_integrity_on_open(true);
    builder
}

/// A database that is reopened after errors.
pub struct Ledger {
    opener: Opener,
    /// `None` after an error.
    open: Option<Database>,
}

/// A change that is written atomically.
pub struct Change<'a> {
    pub put: Option<&'a Record>,
    pub forget: &'a [JobId],
}

/// The content of a database.
#[derive(Default)]
pub struct Content {
    pub records: Vec<Record>,
    pub last_id: JobId,
    /// Rows that this version cannot read, and the reasons.
    pub unreadable: Vec<(JobId, String)>,
}

impl Ledger {
    /// Opens or creates a database and reads all of it. Writes no record, because the disk may be full.
    pub fn open(opener: Opener) -> Result<(Ledger, Content), Fault> {
        let database = open(&opener)?;
        // In builds with debug assertions redb panics when its own checks find a contradiction.
        let content = match catch_unwind(AssertUnwindSafe(|| content(&database))) {
            Ok(found) => found?,
            Err(_) => return Err(contradiction()),
        };
        Ok((Ledger { opener, open: Some(database) }, content))
    }

    /// Applies a change atomically.
    pub fn apply(&mut self, change: &Change<'_>) -> Result<(), Fault> {
        if let Some(database) = self.open.take() {
            match apply(&database, change) {
                Ok(()) => {
                    self.open = Some(database);
                    return Ok(());
                }
                Err(error) => tracing::warn!(%error, "the job database failed; reopening it"),
            }
        }
        // The failed database has closed its file.
        let database = open(&self.opener)?;
        apply(&database, change)?;
        self.open = Some(database);
        Ok(())
    }

    #[cfg(test)]
    pub fn database(&self) -> &Database {
        self.open.as_ref().unwrap()
    }
}

fn contradiction() -> Fault {
    Fault::Damaged("it contradicts itself".to_owned())
}

fn open(opener: &Opener) -> Result<Database, Fault> {
    match catch_unwind(AssertUnwindSafe(opener)) {
        Ok(opened) => opened.map_err(|error| redb::Error::from(error).into()),
        Err(_) => Err(contradiction()),
    }
}

fn apply(database: &Database, change: &Change<'_>) -> Result<(), redb::Error> {
    let write = database.begin_write()?;
    {
        let mut jobs = write.open_table(JOBS)?;
        for &id in change.forget {
            jobs.remove(id)?;
        }
        if let Some(record) = change.put {
            let bytes = serde_json::to_vec(record).map_err(io::Error::other)?;
            jobs.insert(record.id, bytes.as_slice())?;
            let mut numbers = write.open_table(NUMBERS)?;
            let last = numbers.get(LAST_ID)?.map_or(0, |last| last.value());
            if record.id > last {
                numbers.insert(LAST_ID, record.id)?;
            }
        }
    }
    Ok(write.commit()?)
}

fn content(database: &Database) -> Result<Content, redb::Error> {
    let look = database.begin_read()?;
    let mut content = Content::default();
    match look.open_table(NUMBERS) {
        Ok(numbers) => {
            let last_id = numbers.get(LAST_ID)?.map_or(0, |last| last.value());
            // A larger number is damage.
            content.last_id = last_id.min(LARGEST_COUNT);
        }
        Err(TableError::TableDoesNotExist(_)) => {}
        Err(error) => return Err(error.into()),
    }
    let jobs = match look.open_table(JOBS) {
        Ok(jobs) => jobs,
        Err(TableError::TableDoesNotExist(_)) => return Ok(content),
        Err(error) => return Err(error.into()),
    };
    for row in jobs.iter()? {
        let (id, bytes) = row?;
        match serde_json::from_slice::<Record>(bytes.value()) {
            Ok(record) if record.id == id.value() => content.records.push(record),
            Ok(record) => {
                content.unreadable.push((id.value(), format!("it is that of job {}", record.id)));
            }
            Err(error) => content.unreadable.push((id.value(), error.to_string())),
        }
    }
    Ok(content)
}
