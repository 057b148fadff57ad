//! The records of jobs in redb, through disks that fill up.
//!
//! After an error of the disk redb refuses everything until it is opened anew. So a database that has failed is let go of, opened
//! again for the next change, and that change is tried once more:
//!
//! ```text
//! open ──change fails──► let go ──the same change, again──► opened ──it fails again──► let go, and told
//!   ▲                                                         │
//!   └───────────────────────────it goes───────────────────────┘
//! ```

use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use redb::{
    Builder, Database, DatabaseError, ReadableDatabase, ReadableTable, TableDefinition, TableError,
};

use crate::jobs::book::{JobId, Record};

/// Records as JSON, by job.
pub const JOBS: TableDefinition<'_, JobId, &[u8]> = TableDefinition::new("jobs");
/// Numbers by name: `last_id`, the greatest that was ever given to a job.
const NUMBERS: TableDefinition<'_, &str, u64> = TableDefinition::new("numbers");
const LAST_ID: &str = "last_id";
/// Of the database in memory.
const CACHE_BYTES: usize = 4 << 20;

/// Why a database cannot be used.
#[derive(Debug)]
pub enum Fault {
    Locked,
    /// The disk's, so that it may go another time.
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

/// How a database is opened, or made where there is none.
pub type Opener = Box<dyn Fn() -> Result<Database, DatabaseError> + Send + Sync>;

/// One that is a file.
pub fn file_opener(file: &Path) -> Opener {
    let file = file.to_owned();
    Box::new(move || builder().create(&file))
}

/// With the settings that all of ours have.
pub fn builder() -> Builder {
    let mut builder = Database::builder();
    // Bytes that something else changed are an error then, and not believed.
    builder.set_cache_size(CACHE_BYTES).set_check_integrity_on_open(true);
    builder
}

/// A database that comes back after errors.
pub struct Ledger {
    opener: Opener,
    /// None after an error.
    open: Option<Database>,
}

/// What is to be written at once.
pub struct Change<'a> {
    pub put: Option<&'a Record>,
    pub forget: &'a [JobId],
}

/// What a database holds.
#[derive(Default)]
pub struct Content {
    pub records: Vec<Record>,
    pub last_id: JobId,
    /// Rows that are no records of this version.
    pub unreadable: Vec<(JobId, String)>,
}

impl Ledger {
    /// Opens a database, makes it where there is none, and reads all of it. Of ours nothing is written yet: there may be no room.
    pub fn open(opener: Opener) -> Result<(Ledger, Content), Fault> {
        let database = open(&opener)?;
        // What its own checks call impossible is a panic in builds with debug assertions.
        let content = match catch_unwind(AssertUnwindSafe(|| content(&database))) {
            Ok(found) => found?,
            Err(_) => return Err(contradiction()),
        };
        Ok((Ledger { opener, open: Some(database) }, content))
    }

    /// Makes a change, which is there whole from now on, or not at all.
    pub fn apply(&mut self, change: &Change<'_>) -> Result<(), Fault> {
        if let Some(database) = self.open.take() {
            match apply(&database, change) {
                Ok(()) => {
                    self.open = Some(database);
                    return Ok(());
                }
                Err(error) => tracing::warn!(%error, "the job database failed and is opened again"),
            }
        }
        // The failed one has let go of its file.
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
            content.last_id = numbers.get(LAST_ID)?.map_or(0, |last| last.value());
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
