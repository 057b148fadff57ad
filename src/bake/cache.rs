//! A folder of baked geometries, so that each geometry is baked once and only read later.
//!
//! An entry is a file named after its key, which stands for everything that decides the baked result: the asset's bytes and the
//! options. [`entry`] describes its layout.
//!
//! *Writing.* A temporary file beside the entry is filled, synchronised and renamed. A reader sees a whole entry or none, and of
//! two writers the later one wins.
//!
//! *Reading.* Nothing in a file is used before its length and its SHA-256 have been verified. Then every length and index that a
//! shader would follow is checked as well. An entry that fails is removed and baked again.
//!
//! *Notes* are small texts under keys of their own, with a SHA-256 before them; they count as entries.
//!
//! *Eviction.* The modification time of an entry is the time of its last use: reading refreshes it. After each write, the least
//! recently used entries are removed until the rest fits (LRU). Files with other names are left alone.

mod check;
mod entry;
#[cfg(any(test, fuzzing))]
mod fuzzing;
mod record;

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, BufWriter, Read, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use sha2::{Digest, Sha256};

use self::entry::{Entry, Refusal, SpilledEntry};
#[cfg(any(test, fuzzing))]
pub(crate) use self::fuzzing::TARGETS as FUZZ_TARGETS;
#[cfg(test)]
pub(crate) use self::fuzzing::entries as fuzz_entries;
use super::external::{Spill, Spilled, disk_bytes};
use super::pack::PackedGeometry;
use super::tree::TreeStatistics;

/// Version of an entry's bytes and of their meaning. Raise it with every change of the layout, of the records of [`super::pack`]
/// or of the codes of [`super::tree`]. The result of baking has a version of its own in the key
/// ([`super::tree::BAKING_VERSION`]). The crate's version is not part of an entry, so a release that changes none of these keeps
/// its users' folders.
pub const FORMAT_VERSION: u32 = 7;

const EXTENSION: &str = "bake";
const NOTE_EXTENSION: &str = "note";
const MOST_NOTE_BYTES: u64 = 1 << 20;
const WRITING_PREFIX: &str = "writing-";
const WRITING_SUFFIX: &str = ".tmp";
/// Age at which a temporary file counts as left over from a crash: no writer takes this long.
const ABANDONED: Duration = Duration::from_secs(24 * 60 * 60);

/// A folder of baked geometries.
#[derive(Clone, Debug)]
pub struct BakeCache {
    folder: PathBuf,
    max_bytes: u64,
    bake_bytes: Option<u64>,
}

/// An entry in the folder.
struct Found {
    path: PathBuf,
    bytes: u64,
    used: SystemTime,
}

impl BakeCache {
    /// Creates the cache object without touching the disk. `max_bytes` limits the total size of all entries.
    pub fn new(folder: impl Into<PathBuf>, max_bytes: u64) -> BakeCache {
        BakeCache { folder: folder.into(), max_bytes, bake_bytes: None }
    }

    /// The folder of the entries; it may not exist yet.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Maximum total size of all entries, in bytes.
    pub fn max_bytes(&self) -> u64 {
        self.max_bytes
    }

    /// Sets the memory limit of a build, in bytes; larger builds use temporary files in this folder.
    #[must_use]
    pub fn with_bake_bytes(self, bytes: Option<u64>) -> BakeCache {
        BakeCache { bake_bytes: bytes, ..self }
    }

    /// The memory limit of a build: the given value, else half of the memory that is free now, if the system reports it.
    pub fn bake_bytes(&self) -> Option<u64> {
        self.bake_bytes.or_else(|| {
            let info = fs::read_to_string("/proc/meminfo").ok()?;
            let free = info.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
            let kib: u64 = free.trim().strip_suffix("kB")?.trim().parse().ok()?;
            Some(kib * 512)
        })
    }

    /// The folder and limit for the temporary files of a tree with this many samples.
    ///
    /// # Errors
    /// Fails if the folder cannot be created.
    pub fn spill(&self, samples: u64) -> io::Result<Spill> {
        fs::create_dir_all(&self.folder)?;
        Ok(Spill::new(&self.folder, disk_bytes(samples)))
    }

    /// The user's cache folder: `$XDG_CACHE_HOME/pointillist`, else `$HOME/.cache/pointillist`; `None` if neither variable is an
    /// absolute path.
    pub fn default_folder() -> Option<PathBuf> {
        user_folder(std::env::var_os("XDG_CACHE_HOME"), std::env::var_os("HOME"))
    }

    /// Tells whether there is a file for this key, damaged or not.
    pub fn holds(&self, key: &[u8; 32]) -> bool {
        self.path(key).is_file()
    }

    /// Loads the geometries for this key if a whole and undamaged entry of [`FORMAT_VERSION`] exists. Any other file in its place
    /// is removed, with a warning. Materials belong to the asset: the caller checks that it has those which chunks name.
    pub fn load(&self, key: &[u8; 32]) -> Option<Vec<PackedGeometry>> {
        let path = self.path(key);
        match read(&path, key) {
            Ok(geometries) => {
                touch(&path);
                Some(geometries)
            }
            Err(Refusal::Io(error)) if error.kind() == io::ErrorKind::NotFound => None,
            // The file may be intact and only temporarily unreadable.
            Err(Refusal::Io(error)) => {
                tracing::warn!(file = %path.display(), %error, "a baked geometry cannot be read");
                None
            }
            Err(reason) => {
                tracing::warn!(file = %path.display(), %reason, "a baked geometry is removed");
                // If another process has just put an intact entry in its place, that one is removed and baked once more.
                remove(&path);
                None
            }
        }
    }

    /// The figures of the point tree for this key, if it is the only geometry of a whole and undamaged entry of
    /// [`FORMAT_VERSION`]. The tree is not read into memory, and any other file stays in place.
    pub fn figures(&self, key: &[u8; 32]) -> Option<TreeStatistics> {
        let path = self.path(key);
        let found = open(&path).and_then(|(mut file, bytes)| entry::figures(&mut file, bytes, key));
        found.ok().inspect(|_| touch(&path))
    }

    /// Writes the entry for this key, replacing an existing one, and evicts others to make room. An entry larger than `max_bytes`
    /// is not written. Returns whether it was written.
    ///
    /// # Errors
    /// Returns `InvalidInput` for geometries that [`BakeCache::load`] would refuse, or the I/O error if the folder cannot be
    /// created, written or listed. The previous entry then stays intact.
    pub fn store(&self, key: &[u8; 32], geometries: &[PackedGeometry]) -> io::Result<bool> {
        let entry = Entry::of(geometries)
            .map_err(|refusal| io::Error::new(io::ErrorKind::InvalidInput, refusal))?;
        self.write(key, entry.bytes(), |out| entry.write(out, key))
    }

    /// Does the same as [`BakeCache::store`] for a single point tree that lies in files.
    ///
    /// # Errors
    /// As [`BakeCache::store`].
    pub fn store_spilled(&self, key: &[u8; 32], tree: &Spilled) -> io::Result<bool> {
        let entry = SpilledEntry::of(tree)
            .map_err(|refusal| io::Error::new(io::ErrorKind::InvalidInput, refusal))?;
        self.write(key, entry.bytes(), |out| entry.write(out, key))
    }

    /// The note for this key, if an undamaged one exists.
    pub fn load_note(&self, key: &[u8; 32]) -> Option<Vec<u8>> {
        let path = self.path(key).with_extension(NOTE_EXTENSION);
        let (file, bytes) = open(&path).ok()?;
        let mut read = Vec::new();
        file.take(MOST_NOTE_BYTES).read_to_end(&mut read).ok()?;
        let (hash, text) = read.split_first_chunk::<32>()?;
        if read.len() as u64 != bytes || Sha256::digest(text)[..] != hash[..] {
            tracing::warn!(file = %path.display(), "a note is damaged, and removed");
            remove(&path);
            return None;
        }
        touch(&path);
        Some(text.to_vec())
    }

    /// Writes the note for this key, replacing an existing one.
    ///
    /// # Errors
    /// As [`BakeCache::store`].
    pub fn store_note(&self, key: &[u8; 32], text: &[u8]) -> io::Result<()> {
        if text.len() as u64 + 32 > MOST_NOTE_BYTES {
            return Ok(());
        }
        let path = self.path(key).with_extension(NOTE_EXTENSION);
        self.write_file(&path, |out| {
            out.write_all(&Sha256::digest(text))?;
            out.write_all(text)
        })
    }

    /// Removes a note. Returns whether it was there.
    pub fn remove_note(&self, key: &[u8; 32]) -> bool {
        fs::remove_file(self.path(key).with_extension(NOTE_EXTENSION)).is_ok()
    }

    /// Removes an entry, if it is there.
    pub fn remove(&self, key: &[u8; 32]) {
        remove(&self.path(key));
    }

    fn write(
        &self,
        key: &[u8; 32],
        bytes: u64,
        write: impl FnOnce(&mut BufWriter<&mut File>) -> io::Result<()>,
    ) -> io::Result<bool> {
        if bytes > self.max_bytes {
            tracing::debug!(bytes, "a baked geometry is too large to be kept");
            return Ok(false);
        }
        self.write_file(&self.path(key), write)?;
        Ok(true)
    }

    fn write_file(
        &self,
        path: &Path,
        write: impl FnOnce(&mut BufWriter<&mut File>) -> io::Result<()>,
    ) -> io::Result<()> {
        fs::create_dir_all(&self.folder)?;
        // The file is removed when dropped, which happens on errors.
        let mut file = tempfile::Builder::new()
            .prefix(WRITING_PREFIX)
            .suffix(WRITING_SUFFIX)
            .tempfile_in(&self.folder)?;
        let mut out = BufWriter::new(file.as_file_mut());
        write(&mut out)?;
        out.into_inner().map_err(io::IntoInnerError::into_error)?.sync_all()?;
        file.persist(path).map_err(|error| error.error)?;
        self.make_room(path)
    }

    fn path(&self, key: &[u8; 32]) -> PathBuf {
        let name: String = key.iter().map(|byte| format!("{byte:02x}")).collect();
        self.folder.join(name).with_extension(EXTENSION)
    }

    /// Removes leftovers of crashed writers, and the least recently used entries; `newest` counts as the most recent.
    fn make_room(&self, newest: &Path) -> io::Result<()> {
        let mut entries = Vec::new();
        for item in fs::read_dir(&self.folder)? {
            let item = item?;
            // The file has been removed meanwhile, or is not ours.
            let Ok(metadata) = item.metadata() else { continue };
            let Some(kind) = NameKind::of(&item.file_name().to_string_lossy()) else { continue };
            if !metadata.is_file() {
                continue;
            }
            let used = metadata.modified()?;
            match kind {
                NameKind::Entry => {
                    entries.push(Found { path: item.path(), bytes: metadata.len(), used });
                }
                NameKind::Writing if used.elapsed().is_ok_and(|age| age > ABANDONED) => {
                    remove(&item.path());
                }
                NameKind::Writing => {}
            }
        }
        for path in surplus(entries, self.max_bytes, newest) {
            remove(&path);
        }
        Ok(())
    }
}

/// The entries to evict so that the others take at most `max_bytes`: the least recently used first, `newest` last.
fn surplus(mut entries: Vec<Found>, max_bytes: u64, newest: &Path) -> Vec<PathBuf> {
    let mut bytes: u64 = entries.iter().map(|entry| entry.bytes).sum();
    // The file system's timestamps may be too coarse to order the newest.
    entries.sort_by(|a, b| {
        (a.path == newest, a.used, &a.path).cmp(&(b.path == newest, b.used, &b.path))
    });
    let goes = |entry: &Found| {
        let over = bytes > max_bytes;
        bytes -= if over { entry.bytes } else { 0 };
        over
    };
    let count = entries.iter().map(goes).take_while(|&over| over).count();
    entries.into_iter().take(count).map(|entry| entry.path).collect()
}

/// Files of a cache, by their names.
enum NameKind {
    Entry,
    Writing,
}

impl NameKind {
    fn of(name: &str) -> Option<NameKind> {
        if name.starts_with(WRITING_PREFIX) && name.ends_with(WRITING_SUFFIX) {
            return Some(NameKind::Writing);
        }
        let (key, extension) = name.split_once('.')?;
        let is_key = key.len() == 64 && key.bytes().all(|c| matches!(c, b'0'..=b'9' | b'a'..=b'f'));
        (is_key && [EXTENSION, NOTE_EXTENSION].contains(&extension)).then_some(NameKind::Entry)
    }
}

fn user_folder(xdg: Option<OsString>, home: Option<OsString>) -> Option<PathBuf> {
    let absolute = |value: Option<OsString>| value.map(PathBuf::from).filter(|p| p.is_absolute());
    let caches = absolute(xdg).or_else(|| Some(absolute(home)?.join(".cache")))?;
    Some(caches.join("pointillist"))
}

fn read(path: &Path, key: &[u8; 32]) -> Result<Vec<PackedGeometry>, Refusal> {
    let (mut file, bytes) = open(path)?;
    entry::read(&mut file, bytes, key)
}

/// Opens an entry's file; returns it with its length.
fn open(path: &Path) -> Result<(File, u64), Refusal> {
    // This check precedes opening: opening a pipe would block.
    if !fs::symlink_metadata(path)?.is_file() {
        return Err(Refusal::Foreign);
    }
    let file = File::open(path)?;
    let bytes = file.metadata()?.len();
    Ok((file, bytes))
}

/// Refreshes an entry's time of last use. If that fails, the entry is only evicted earlier.
fn touch(path: &Path) {
    let touched = File::options()
        .write(true)
        .open(path)
        .and_then(|file| file.set_modified(SystemTime::now()));
    if let Err(error) = touched {
        tracing::debug!(file = %path.display(), %error, "a baked geometry's use cannot be noted");
    }
}

fn remove(path: &Path) {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            tracing::warn!(file = %path.display(), %error, "a file of the cache cannot be removed");
        }
        _ => {}
    }
}

#[cfg(test)]
mod tests;
