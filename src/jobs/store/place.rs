//! A job's own folder.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::jobs::book::{JobId, Record, Repeat};
use crate::jobs::spec::Spec;

const JOB: &str = "job.json";
/// What `job.json` is called from the removal of the job on.
const REMOVED: &str = "job.removed";
const FRAMES: &str = "frames";
const VIDEO: &str = "video.mp4";

/// What is kept of a job beside the database.
#[derive(Serialize, Deserialize)]
pub struct Kept {
    pub id: JobId,
    pub created_ms: u64,
    pub spec: Spec,
    #[serde(default)]
    pub owner: Option<String>,
    #[serde(default)]
    pub request_id: Option<String>,
    pub repeat: Option<Repeat>,
}

/// A job's own folder.
#[derive(Clone, Debug)]
pub struct Place {
    folder: PathBuf,
}

impl Place {
    pub(in crate::jobs) fn new(folder: PathBuf) -> Place {
        Place { folder }
    }

    pub(super) fn job_file(&self) -> PathBuf {
        self.file(JOB)
    }

    fn file(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    pub fn frames(&self) -> PathBuf {
        self.file(FRAMES)
    }

    pub fn manifest(&self) -> PathBuf {
        self.frames().join(crate::film::MANIFEST)
    }

    pub fn video(&self) -> PathBuf {
        self.file(VIDEO)
    }

    /// Makes the folder, with what the job can be found again by.
    ///
    /// # Errors
    /// Whatever keeps it from being written.
    pub fn prepare(&self, record: &Record) -> io::Result<()> {
        fs::create_dir_all(&self.folder)?;
        let kept = Kept {
            id: record.id,
            created_ms: record.created_ms,
            spec: record.spec.clone(),
            owner: record.owner.clone(),
            request_id: record.request_id.clone(),
            repeat: record.repeat.clone(),
        };
        let file = self.file(JOB);
        let text = serde_json::to_vec_pretty(&kept)?;
        if fs::read(&file).is_ok_and(|there| there == text) {
            return Ok(());
        }
        let part = self.file(".job.json.part");
        fs::write(&part, text)?;
        File::open(&part)?.sync_all()?;
        fs::rename(&part, &file)
    }

    pub(super) fn kept(&self) -> io::Result<Option<Kept>> {
        match fs::read(self.file(JOB)) {
            Ok(text) => Ok(Some(serde_json::from_slice(&text)?)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Bytes of all its files.
    pub fn bytes(&self) -> u64 {
        let of =
            |folder: &Path| self::sizes(folder).into_iter().map(|(_, bytes)| bytes).sum::<u64>();
        of(&self.folder) + of(&self.frames())
    }

    /// Names and lengths of the files with the frames.
    pub fn sizes(&self) -> Vec<(String, u64)> {
        sizes(&self.frames())
    }

    /// Removes the frames, but for what the manifest says of them.
    ///
    /// # Errors
    /// A file that cannot be removed.
    pub fn drop_frames(&self) -> io::Result<()> {
        for (name, _) in self.sizes() {
            if crate::film::shots::is_file_name(&name) {
                fs::remove_file(self.frames().join(name))?;
            }
        }
        Ok(())
    }

    /// Marks the job as removed, whatever the database says of it. Where the disk is full this needs no room, as a change of the
    /// database does.
    ///
    /// # Errors
    /// A folder that cannot be written.
    pub fn bury(&self) -> io::Result<()> {
        match fs::rename(self.file(JOB), self.file(REMOVED)) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                fs::create_dir_all(&self.folder)?;
                File::create(self.file(REMOVED)).map(drop)
            }
            renamed => renamed,
        }
    }

    /// Whether the job was removed.
    pub fn is_buried(&self) -> bool {
        self.file(REMOVED).exists()
    }

    /// Removes all but the mark that the job was removed.
    ///
    /// # Errors
    /// A file that cannot be removed.
    pub fn empty(&self) -> io::Result<()> {
        for item in fs::read_dir(&self.folder)? {
            let item = item?;
            if item.file_type()?.is_dir() {
                fs::remove_dir_all(item.path())?;
            } else if item.file_name() != REMOVED {
                fs::remove_file(item.path())?;
            }
        }
        Ok(())
    }

    /// Removes all of it.
    ///
    /// # Errors
    /// A file that cannot be removed.
    pub fn remove(&self) -> io::Result<()> {
        match fs::remove_dir_all(&self.folder) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
            _ => Ok(()),
        }
    }
}

/// Names and lengths of the files in a folder; none where there is no folder.
fn sizes(folder: &Path) -> Vec<(String, u64)> {
    let items = fs::read_dir(folder).into_iter().flatten().filter_map(Result::ok);
    items
        .filter_map(|item| {
            let found = item.metadata().ok().filter(fs::Metadata::is_file)?;
            Some((item.file_name().to_string_lossy().into_owned(), found.len()))
        })
        .collect()
}
