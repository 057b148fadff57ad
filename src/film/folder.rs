//! A folder of frames on disk: everything that touches files.
//!
//! Files are written atomically: under another name in the same folder, synced to disk, then renamed. Only one process at a time
//! draws into a folder. It holds a lock that ends with the process, however the process ends.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use super::manifest::{self, Header, Record, Records};
use super::{FilmError, MANIFEST};
use crate::lock::Locked;

/// Locked while a process draws into the folder. The file stays afterwards.
const LOCK: &str = ".frames.lock";
/// Prefix and suffix of the names of files that are being written.
const WRITING: [&str; 2] = [".", ".part"];

/// A folder that is locked for this process.
pub struct Folder {
    path: PathBuf,
    manifest: Option<File>,
    _lock: Locked,
}

fn failed(file: &Path) -> impl FnOnce(io::Error) -> FilmError + use<> {
    let file = file.to_owned();
    |error| FilmError::Io { file, error }
}

impl Folder {
    /// Creates the folder if it is missing, locks it, and removes unfinished files of a killed process.
    ///
    /// # Errors
    /// The folder cannot be created or listed; [`FilmError::Locked`].
    pub fn open(path: &Path) -> Result<Folder, FilmError> {
        fs::create_dir_all(path).map_err(failed(path))?;
        let name = path.join(LOCK);
        let opened = File::options().create(true).append(true).open(&name);
        let lock = opened.and_then(Locked::attempt).map_err(failed(&name))?;
        let lock = lock.ok_or_else(|| FilmError::Locked { folder: path.to_owned() })?;
        for item in fs::read_dir(path).map_err(failed(path))? {
            let item = item.map_err(failed(path))?;
            let name = item.file_name();
            let name = name.to_string_lossy();
            let [before, after] = WRITING;
            let inner = name.strip_prefix(before).and_then(|name| name.strip_suffix(after));
            if inner.is_some_and(|name| name == MANIFEST || super::shots::is_file_name(name)) {
                fs::remove_file(item.path()).map_err(failed(&item.path()))?;
            }
        }
        Ok(Folder { path: path.to_owned(), manifest: None, _lock: lock })
    }

    /// Returns the records of earlier runs.
    ///
    /// # Errors
    /// The manifest cannot be read, or the file is not a manifest.
    pub fn records(&self) -> Result<Records, FilmError> {
        let file = self.path.join(MANIFEST);
        match fs::read(&file) {
            Ok(text) => {
                manifest::parse(&text).map_err(|reason| FilmError::Foreign { file, reason })
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Records::new()),
            Err(error) => Err(failed(&file)(error)),
        }
    }

    /// Returns whether a record's file exists, with the length and the checksum of the record.
    pub fn is_intact(&self, record: &Record) -> bool {
        let path = self.path.join(&record.file);
        let is_candidate = fs::symlink_metadata(&path)
            .is_ok_and(|found| found.is_file() && found.len() == record.bytes);
        // A file that cannot be read is drawn again. If it cannot be written either, that is an error.
        let sum = || File::open(&path).and_then(manifest::digest);
        is_candidate && sum().is_ok_and(|(_, sha256)| sha256 == record.sha256)
    }

    pub fn holds(&self, file: &str) -> bool {
        self.path.join(file).is_file()
    }

    /// Writes the manifest anew, in the order of `records`. [`Folder::note`] then appends lines.
    ///
    /// # Errors
    /// The manifest cannot be written.
    pub fn begin<'a>(
        &mut self,
        header: &Header,
        records: impl IntoIterator<Item = &'a Record>,
    ) -> Result<(), FilmError> {
        let file = self.path.join(MANIFEST);
        let text = manifest::text(header, records)
            .map_err(|error| failed(&file)(io::Error::other(error)))?;
        self.put(MANIFEST, &text)?;
        self.sync()?;
        let opened = File::options().append(true).open(&file);
        self.manifest = Some(opened.map_err(failed(&file))?);
        Ok(())
    }

    /// Writes a file atomically, in place of an existing one.
    ///
    /// # Errors
    /// The file cannot be written. An existing file is then unchanged.
    pub fn put(&self, name: &str, bytes: &[u8]) -> Result<(), FilmError> {
        let file = self.path.join(name);
        let [before, after] = WRITING;
        let written = self.path.join(format!("{before}{name}{after}"));
        let write = || {
            let mut out = File::create(&written)?;
            out.write_all(bytes)?;
            out.sync_all()?;
            fs::rename(&written, &file)
        };
        write().map_err(|error| {
            // The unfinished file is of no use. If it cannot be removed now, the next run removes it.
            let _ = fs::remove_file(&written);
            failed(&file)(error)
        })
    }

    /// Appends the line of a frame whose file is in place. If a power cut loses the line, the frame is drawn again.
    ///
    /// # Errors
    /// The line cannot be written.
    pub fn note(&mut self, record: &Record) -> Result<(), FilmError> {
        let name = self.path.join(MANIFEST);
        let line = manifest::line(record).map_err(io::Error::other);
        let written = match &mut self.manifest {
            Some(file) => line.and_then(|line| file.write_all(&line)),
            None => Err(io::Error::other("the manifest was not begun")),
        };
        written.map_err(failed(&name))
    }

    /// Syncs the folder's entries to disk, where the system can.
    fn sync(&self) -> Result<(), FilmError> {
        #[cfg(unix)]
        File::open(&self.path).and_then(|folder| folder.sync_all()).map_err(failed(&self.path))?;
        Ok(())
    }
}

/// Reads the manifest of a folder without locking the folder.
///
/// # Errors
/// The manifest cannot be read, or the file is not a manifest.
pub fn records(folder: &Path) -> Result<Records, FilmError> {
    let file = folder.join(MANIFEST);
    let text = fs::read(&file).map_err(failed(&file))?;
    manifest::parse(&text).map_err(|reason| FilmError::Foreign { file, reason })
}

/// Removes everything that runs have put into a folder, and nothing else.
///
/// # Errors
/// [`FilmError::Locked`], or a file cannot be removed.
pub fn remove(folder: &Path) -> Result<(), FilmError> {
    // Opening the folder also removes unfinished files.
    let held = Folder::open(folder)?;
    for record in held.records()?.values() {
        let file = folder.join(&record.file);
        match fs::remove_file(&file) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                return Err(failed(&file)(error));
            }
            _ => {}
        }
    }
    for name in [MANIFEST, LOCK] {
        let file = folder.join(name);
        fs::remove_file(&file).map_err(failed(&file))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::encode::ImageFormat;
    use crate::plan::Output;

    fn header() -> Header {
        Header {
            manifest: manifest::VERSION,
            scene: "s".to_owned(),
            fps: 30.0,
            frames: 2,
            width: 1,
            height: 1,
            output: Output::Color,
            format: ImageFormat::Raw,
        }
    }

    fn record(file: &str, contents: &[u8]) -> Record {
        Record {
            frame: 0,
            t: 0.0,
            file: file.to_owned(),
            bytes: contents.len() as u64,
            sha256: manifest::checksum(contents),
            tag: "1".to_owned(),
        }
    }

    #[test]
    fn frames_are_whole_or_not_there() {
        let at = tempfile::tempdir().unwrap();
        let path = at.path().join("deep/frames");
        let mut folder = Folder::open(&path).unwrap();
        assert!(folder.records().unwrap().is_empty());
        folder.begin(&header(), []).unwrap();
        let good = record("frame-00000.raw", b"four");
        assert!(!folder.is_intact(&good));
        folder.put(&good.file, b"more than four").unwrap();
        folder.put(&good.file, b"four").unwrap();
        folder.note(&good).unwrap();
        assert!(folder.is_intact(&good) && folder.holds(&good.file));
        assert_eq!(folder.records().unwrap(), Records::from([(0, good.clone().into())]));
        fs::write(path.join(&good.file), b"fouR").unwrap();
        assert!(!folder.is_intact(&good));
        fs::write(path.join(&good.file), b"fou").unwrap();
        assert!(!folder.is_intact(&good));
        // A file that cannot be put in place gives an error with its name, and leaves nothing behind.
        fs::create_dir(path.join("frame-00001.raw")).unwrap();
        let refused = folder.put("frame-00001.raw", b"x").unwrap_err().to_string();
        assert!(refused.contains("frame-00001.raw"), "{refused}");
        assert!(!path.join(".frame-00001.raw.part").exists());
    }

    #[test]
    fn one_process_at_a_time() {
        let at = tempfile::tempdir().unwrap();
        let first = Folder::open(at.path()).unwrap();
        assert!(matches!(Folder::open(at.path()), Err(FilmError::Locked { .. })));
        drop(first);
        assert!(Folder::open(at.path()).is_ok());
    }

    #[test]
    fn what_was_being_written_goes_and_what_is_not_ours_stays() {
        let at = tempfile::tempdir().unwrap();
        for name in [".frame-00007.png.part", ".frames.jsonl.part", ".mine.part", "frame-00007.png"]
        {
            fs::write(at.path().join(name), "x").unwrap();
        }
        let folder = Folder::open(at.path()).unwrap();
        let left = [".frame-00007.png.part", ".frames.jsonl.part", ".mine.part", "frame-00007.png"]
            .map(|name| folder.holds(name));
        assert_eq!(left, [false, false, true, true]);
        fs::write(at.path().join(MANIFEST), "my notes\n").unwrap();
        let refused = folder.records().unwrap_err().to_string();
        assert!(refused.contains("frames.jsonl: this is not a manifest"), "{refused}");
    }
}
