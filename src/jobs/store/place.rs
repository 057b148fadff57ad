//! A job's own folder.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::jobs::book::{JobId, Record, Repeat};
use crate::jobs::spec::Spec;

const JOB: &str = "job.json";
/// Name of `job.json` once the job is removed.
const REMOVED: &str = "job.removed";
const FRAMES: &str = "frames";
const VIDEO: &str = "video.mp4";

/// Content of `job.json`: what is stored of a job outside the database.
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

    pub(super) fn folder(&self) -> &Path {
        &self.folder
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

    /// Creates the folder with the file from which the job can be recovered.
    ///
    /// # Errors
    /// The folder or the file cannot be written.
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

    /// Returns the bytes of all files of the job.
    pub fn bytes(&self) -> u64 {
        let of =
            |folder: &Path| self::sizes(folder).into_iter().map(|(_, bytes)| bytes).sum::<u64>();
        of(&self.folder) + of(&self.frames())
    }

    /// Returns the names and lengths of the files in the folder of frames.
    pub fn sizes(&self) -> Vec<(String, u64)> {
        sizes(&self.frames())
    }

    /// Removes the frames, and keeps the manifest.
    ///
    /// # Errors
    /// A file cannot be removed.
    pub fn drop_frames(&self) -> io::Result<()> {
        for (name, _) in self.sizes() {
            if crate::film::shots::is_file_name(&name) {
                fs::remove_file(self.frames().join(name))?;
            }
        }
        Ok(())
    }

    /// Marks the job as removed, whatever the database says. This works on a full disk, because a rename needs no space, unlike a
    /// change of the database.
    ///
    /// # Errors
    /// The folder cannot be written.
    pub fn bury(&self) -> io::Result<()> {
        match fs::rename(self.file(JOB), self.file(REMOVED)) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                fs::create_dir_all(&self.folder)?;
                File::create(self.file(REMOVED)).map(drop)
            }
            renamed => renamed,
        }
    }

    /// Returns whether the job was removed.
    pub fn is_buried(&self) -> bool {
        self.file(REMOVED).exists()
    }

    /// Removes all but the mark of the removal.
    ///
    /// # Errors
    /// A file cannot be removed.
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

    /// Removes the whole folder.
    ///
    /// # Errors
    /// A file cannot be removed.
    pub fn remove(&self) -> io::Result<()> {
        match fs::remove_dir_all(&self.folder) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
            _ => Ok(()),
        }
    }
}

/// Returns the names and lengths of the files in a folder; none if there is no folder.
fn sizes(folder: &Path) -> Vec<(String, u64)> {
    let items = fs::read_dir(folder).into_iter().flatten().filter_map(Result::ok);
    items
        .filter_map(|item| {
            let found = item.metadata().ok().filter(fs::Metadata::is_file)?;
            Some((item.file_name().to_string_lossy().into_owned(), found.len()))
        })
        .collect()
}
