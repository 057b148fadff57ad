//! Where a reader's bytes come from: a file, the inside of a `.gz`, or memory.
//!
//! An [`Input`] knows how many bytes can follow at most, so that a header's counts are judged before
//! anything is allocated for them: a plain file has its length, a gzip stream at most 1032 times its
//! compressed length (deflate's best ratio) and never more than the configured limit.

use std::fs::File;
use std::io::{BufRead, BufReader, Cursor, Read};
use std::path::{Path, PathBuf};

use flate2::bufread::MultiGzDecoder;

use super::fault::OverLimit;
use super::{AssetError, NamedFiles, Progress, ReadOptions};
use crate::memory::{Admission, Interrupt};

/// Bytes that recognition looks at.
pub(super) const HEAD_BYTES: u64 = 8 << 10;
const BUFFER_BYTES: usize = 256 << 10;
/// A stream of unknown length is admitted in such pieces.
const PIECE_BYTES: u64 = 1 << 20;
/// Deflate cannot expand a byte to more than this.
pub(super) const DEFLATE_RATIO: u64 = 1032;
/// Vectors are reserved in full only up to this many entries when the bound is not exact.
const INEXACT_RESERVE: usize = 1 << 20;

/// A stream of bytes with what is known about it.
pub struct Input {
    pub reader: Box<dyn BufRead>,
    pub origin: Origin,
}

/// Origin and limits of a stream of bytes.
pub struct Origin {
    /// Begins every error message.
    pub name: String,
    /// No more bytes than this can come.
    pub max_bytes: u64,
    /// Whether exactly `max_bytes` bytes come; otherwise they come out of a gzip stream.
    pub exact: bool,
    /// Where files that the asset names are looked up; `None` when it has no place on a disk.
    pub folder: Option<Folder>,
    /// The first bytes, for recognition; the reader yields them too.
    pub head: Vec<u8>,
    /// Admission of the load that reads.
    pub admission: Admission,
}

impl Input {
    /// Opens a file, looking through gzip compression.
    ///
    /// # Errors
    /// The file cannot be read, is not a regular file, or its gzip stream is damaged at the start.
    pub fn open(path: &Path, name: &str, options: &ReadOptions) -> Result<Input, AssetError> {
        let fail = |source| AssetError::io(name, source);
        let metadata = std::fs::metadata(path).map_err(fail)?;
        if !metadata.is_file() {
            return Err(AssetError::unsupported(name, "is not a regular file"));
        }
        let file = File::open(path).map_err(fail)?;
        let length = metadata.len();
        let mut file = BufReader::with_capacity(
            BUFFER_BYTES,
            Reporting {
                inner: file,
                length,
                done: 0,
                next: 0,
                progress: options.progress.clone(),
                admission: options.admission.clone(),
            },
        );
        let compressed = file.fill_buf().map_err(fail)?.starts_with(&[0x1f, 0x8b]);
        let limit = options.max_decompressed_bytes;
        let (max_bytes, mut reader): (u64, Box<dyn BufRead>) = if compressed {
            let limited = Limited { inner: MultiGzDecoder::new(file), left: limit, limit };
            let reader = BufReader::with_capacity(BUFFER_BYTES, limited);
            (length.saturating_mul(DEFLATE_RATIO).min(limit), Box::new(reader))
        } else {
            (length, Box::new(file))
        };
        let mut head = Vec::new();
        (&mut reader).take(HEAD_BYTES).read_to_end(&mut head).map_err(fail)?;
        let reader = Box::new(Cursor::new(head.clone()).chain(reader));
        let folder = Folder::of(path, options);
        let name = name.to_owned();
        let admission = options.admission.clone();
        let origin = Origin { name, max_bytes, exact: !compressed, folder, head, admission };
        Ok(Input { reader, origin })
    }

    /// An asset that lies in memory, and so can name no other files.
    pub fn from_bytes(bytes: Vec<u8>, name: &str) -> Input {
        let origin = Origin {
            name: name.to_owned(),
            max_bytes: bytes.len() as u64,
            exact: true,
            folder: None,
            head: bytes.iter().take(HEAD_BYTES as usize).copied().collect(),
            admission: Admission::default(),
        };
        Input { reader: Box::new(Cursor::new(bytes)), origin }
    }

    /// Everything, for formats that need random access.
    ///
    /// # Errors
    /// Reading fails, or the stream passes its decompression limit.
    pub fn read_all(&mut self) -> Result<Vec<u8>, AssetError> {
        let Origin { name, max_bytes, exact, admission, .. } = &self.origin;
        let mut bytes = Vec::new();
        let mut meter = admission.meter(name);
        if *exact {
            meter.reach_exactly(*max_bytes)?;
            bytes.reserve(usize::try_from(*max_bytes).unwrap_or(0));
        }
        let fail = |source| AssetError::io(name, source);
        while (&mut self.reader).take(PIECE_BYTES).read_to_end(&mut bytes).map_err(fail)? > 0 {
            meter.reach(bytes.len() as u64)?;
        }
        Ok(bytes)
    }
}

impl Origin {
    /// Refuses a count of items of at least `item_bytes` each that the input cannot hold.
    ///
    /// # Errors
    /// [`AssetError::Malformed`] at `place`.
    pub fn check_count(&self, place: &str, count: u64, item_bytes: u64) -> Result<(), AssetError> {
        let needed = u128::from(count) * u128::from(item_bytes);
        if needed <= u128::from(self.max_bytes) {
            return Ok(());
        }
        let size = if self.exact { "has" } else { "can decompress to at most" };
        let most = self.max_bytes;
        let reason = format!(
            "declares {count}, which take at least {needed} bytes, but the file {size} {most}"
        );
        Err(AssetError::malformed(&self.name, place, reason))
    }

    /// How many entries to reserve for `count` that passed [`Origin::check_count`].
    pub fn reserve(&self, count: u64) -> usize {
        let count = usize::try_from(count).unwrap_or(usize::MAX);
        if self.exact { count } else { count.min(INEXACT_RESERVE) }
    }
}

/// Reports progress over the file's bytes, compressed or not.
struct Reporting<R> {
    inner: R,
    length: u64,
    done: u64,
    next: u64,
    progress: Progress,
    admission: Admission,
}

impl<R: Read> Read for Reporting<R> {
    fn read(&mut self, into: &mut [u8]) -> std::io::Result<usize> {
        self.admission.check().map_err(std::io::Error::other)?;
        let count = self.inner.read(into)?;
        self.done += count as u64;
        if self.done >= self.next && self.length > 0 {
            self.next = self.done + self.length / 128;
            self.progress.report((self.done as f64 / self.length as f64).min(1.0) as f32);
        }
        Ok(count)
    }
}

/// Fails rather than yield more than `limit` bytes.
struct Limited<R> {
    inner: R,
    left: u64,
    limit: u64,
}

impl<R: Read> Read for Limited<R> {
    fn read(&mut self, into: &mut [u8]) -> std::io::Result<usize> {
        let count = self.inner.read(into)?;
        match self.left.checked_sub(count as u64) {
            Some(left) => self.left = left,
            None => return Err(std::io::Error::other(OverLimit { limit: self.limit })),
        }
        Ok(count)
    }
}

/// Endings of the images that materials may name.
const IMAGES: [&str; 7] = [".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tga", ".gif"];

/// The files that an asset may name: relative, and below one root.
#[derive(Clone, Debug)]
pub struct Folder {
    /// The asset's own folder, canonical.
    base: PathBuf,
    /// Nothing outside is read, canonical.
    root: PathBuf,
    named: NamedFiles,
}

impl Folder {
    /// The folder of the asset at `path`; `None` when it (or the root) does not exist.
    pub fn of(path: &Path, options: &ReadOptions) -> Option<Folder> {
        let parent = match path.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent,
            _ => Path::new("."),
        };
        let base = parent.canonicalize().ok()?;
        let root = match &options.root {
            Some(root) => root.canonicalize().ok()?,
            None => base.clone(),
        };
        Some(Folder { base, root, named: options.named.clone() })
    }

    /// Name of the first image in the asset's folder, in alphabetical order.
    pub fn image(&self) -> Option<String> {
        let is_image = |name: &String| {
            let name = name.to_ascii_lowercase();
            IMAGES.iter().any(|kind| name.ends_with(kind))
        };
        let entries = std::fs::read_dir(&self.base).ok()?;
        let names = entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
        names.filter(is_image).min()
    }

    /// The file that `reference` names.
    ///
    /// # Errors
    /// A sentence for a warning: the reference is empty, absolute, a URL, leads out of the root
    /// (itself or through a link), or names nothing.
    pub fn resolve(&self, reference: &str) -> Result<PathBuf, String> {
        let reference = reference.trim().replace('\\', "/");
        if reference.is_empty() || reference.contains('\0') {
            return Err("names no file".to_owned());
        }
        let scheme = reference.split_once(':').map_or("", |(scheme, _)| scheme);
        if reference.contains("://") || ["http", "https", "file", "data"].contains(&scheme) {
            return Err("is a URL, and only relative files are read".to_owned());
        }
        let outside = || "leads out of the folder that may be read".to_owned();
        let joined = lexical(&self.base, &reference).ok_or_else(outside)?;
        if !joined.starts_with(&self.root) {
            return Err(outside());
        }
        let found = joined.canonicalize().map_err(|_| "does not exist".to_owned())?;
        if !found.starts_with(&self.root) {
            return Err(outside());
        }
        if !found.is_file() {
            return Err("is not a file".to_owned());
        }
        self.named.note(&found);
        Ok(found)
    }

    /// Like [`Folder::resolve`], trying the asset's own folder with the bare file name next: exporters
    /// like to write paths of the machine they ran on.
    ///
    /// # Errors
    /// As [`Folder::resolve`] for the reference itself.
    pub fn find(&self, reference: &str) -> Result<PathBuf, String> {
        self.resolve(reference).or_else(|reason| {
            let bare = reference.rsplit(['/', '\\']).next().unwrap_or(reference);
            self.resolve(bare).map_err(|_| reason)
        })
    }
}

/// `base/reference` without `.` and `..`, or `None` for an absolute reference.
fn lexical(base: &Path, reference: &str) -> Option<PathBuf> {
    use std::path::Component;
    let mut path = base.to_owned();
    for component in Path::new(reference).components() {
        match component {
            Component::Normal(part) => path.push(part),
            Component::CurDir => {}
            Component::ParentDir => {
                if !path.pop() {
                    return None;
                }
            }
            Component::RootDir | Component::Prefix(_) => return None,
        }
    }
    Some(path)
}

/// Why a file beside an asset was not read.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Unread {
    #[error(transparent)]
    Io(#[from] std::io::Error),
    #[error("has more than {limit} bytes")]
    TooLarge { found: u64, limit: u64 },
    #[error(transparent)]
    Interrupted(#[from] Interrupt),
}

/// The file's bytes, refused above `limit`.
///
/// # Errors
/// Errors of a file that cannot be read, is too large, or has no room in memory.
pub(crate) fn read_bounded(
    path: &Path,
    limit: u64,
    admission: &Admission,
) -> Result<Vec<u8>, Unread> {
    let file = File::open(path)?;
    let length = file.metadata()?.len();
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    admission.grow(&name, length.min(limit))?;
    let mut bytes = Vec::new();
    let read = file.take(limit.saturating_add(1)).read_to_end(&mut bytes)? as u64;
    if read > limit {
        return Err(Unread::TooLarge { found: length.max(read), limit });
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    fn gz(bytes: &[u8]) -> Vec<u8> {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
        encoder.write_all(bytes).unwrap();
        encoder.finish().unwrap()
    }

    #[test]
    fn gzip_is_looked_through_and_bounded() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.bin.gz");
        std::fs::write(&path, gz(&vec![7; 1 << 20])).unwrap();
        let options = ReadOptions::default();
        let mut input = Input::open(&path, "a", &options).unwrap();
        assert!(!input.origin.exact);
        assert_eq!(input.read_all().unwrap(), vec![7; 1 << 20]);

        let small = ReadOptions { max_decompressed_bytes: 100_000, ..ReadOptions::default() };
        let read = Input::open(&path, "a", &small).and_then(|mut input| input.read_all());
        let error = read.unwrap_err();
        assert!(matches!(error, AssetError::TooLarge { limit: 100_000, .. }), "{error}");
    }

    #[test]
    fn truncated_gzip_says_so() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.gz");
        let mut bytes = gz(&(0..200_000u32).flat_map(u32::to_le_bytes).collect::<Vec<u8>>());
        bytes.truncate(bytes.len() / 2);
        std::fs::write(&path, bytes).unwrap();
        let mut input = Input::open(&path, "a", &ReadOptions::default()).unwrap();
        let error = input.read_all().unwrap_err().to_string();
        assert!(error.starts_with("a: ") && error.contains("truncated"), "{error}");
    }

    #[test]
    fn references_stay_below_the_root() {
        let outer = tempfile::tempdir().unwrap();
        let inner = outer.path().join("inner");
        std::fs::create_dir(&inner).unwrap();
        std::fs::write(outer.path().join("secret.png"), b"x").unwrap();
        std::fs::write(inner.join("a b.png"), b"x").unwrap();
        let own = Folder::of(&inner.join("m.obj"), &ReadOptions::default()).unwrap();
        assert!(own.resolve("a b.png").is_ok());
        assert!(own.resolve(".\\a b.png").is_ok());
        assert!(own.find("C:\\textures\\a b.png").is_ok());
        assert!(own.find("/somewhere/else/a b.png").is_ok());
        for bad in ["../secret.png", "/etc/passwd", "http://x/a b.png", "", "no.png", "."] {
            assert!(own.resolve(bad).is_err(), "{bad}");
        }
        let wide = ReadOptions { root: Some(outer.path().to_owned()), ..ReadOptions::default() };
        let wide = Folder::of(&inner.join("m.obj"), &wide).unwrap();
        assert!(wide.resolve("../secret.png").is_ok());
        assert!(wide.resolve("../../secret.png").is_err());
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink(outer.path().join("secret.png"), inner.join("l.png"))
                .unwrap();
            assert!(own.resolve("l.png").is_err());
        }
    }

    #[test]
    fn progress_reaches_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        std::fs::write(&path, vec![1; 3 << 20]).unwrap();
        let last = std::sync::Arc::new(std::sync::Mutex::new(Vec::new()));
        let seen = last.clone();
        let options = ReadOptions {
            progress: Progress::new(move |f| seen.lock().unwrap().push(f)),
            ..ReadOptions::default()
        };
        Input::open(&path, "a", &options).unwrap().read_all().unwrap();
        let seen = last.lock().unwrap();
        assert!(seen.len() > 2 && seen.windows(2).all(|w| w[0] <= w[1]), "{seen:?}");
        assert_eq!(seen.last(), Some(&1.0));
    }
}
