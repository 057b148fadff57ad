//! Keeps pipelines between processes: the list of used ones, and the driver's compiled code.
//!
//! There is one file per adapter, driver and version of this program. It is written atomically, and checked by its SHA-256. The
//! driver's part is empty if the driver has a cache of its own, as Mesa's does.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use sha2::{Digest, Sha256};

const MAGIC: &[u8; 8] = b"plpipe01";
const HASH_BYTES: usize = 32;
const HEAD_BYTES: usize = MAGIC.len() + HASH_BYTES + 8;
/// Largest file that is written or read.
const MOST_BYTES: u64 = 64 << 20;
/// Number of files of other adapters, drivers and versions that are kept.
const MOST_FILES: usize = 8;
const PREFIX: &str = "pipelines-";

/// Contents of a file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Kept {
    /// The used variants, in the encoding of the pipelines' owner.
    pub variants: Vec<u8>,
    /// Opaque data of the driver.
    pub driver: Vec<u8>,
}

/// The file of one adapter.
#[derive(Clone, Debug)]
pub struct PipelineStore {
    folder: PathBuf,
    path: PathBuf,
}

impl PipelineStore {
    /// Chooses the file without accessing the disk. `parts` is everything that must be equal for the file to be usable.
    pub fn new(folder: &Path, parts: &[&str]) -> PipelineStore {
        let mut hasher = Sha256::new();
        for part in parts {
            hasher.update((part.len() as u64).to_le_bytes());
            hasher.update(part.as_bytes());
        }
        let hash = hasher.finalize();
        let name: String = hash.iter().take(16).map(|byte| format!("{byte:02x}")).collect();
        let path = folder.join(format!("{PREFIX}{name}.bin"));
        PipelineStore { folder: folder.to_path_buf(), path }
    }

    /// Reads the file. A damaged file is removed with a warning.
    pub fn load(&self) -> Option<Kept> {
        let metadata = fs::symlink_metadata(&self.path).ok()?;
        let is_fit = metadata.is_file() && metadata.len() <= MOST_BYTES;
        let kept = is_fit.then(|| fs::read(&self.path).ok()).flatten().and_then(|b| decode(&b));
        if kept.is_none() {
            tracing::warn!(file = %self.path.display(), "damaged pipeline cache; removing it");
            let _ = fs::remove_file(&self.path);
        }
        kept
    }

    /// Replaces the file, and removes the oldest of the other files if there are too many.
    ///
    /// # Errors
    /// The folder cannot be written. The file is then unchanged.
    pub fn save(&self, kept: &Kept) -> io::Result<()> {
        let bytes = encode(kept);
        if bytes.len() as u64 > MOST_BYTES {
            return Ok(());
        }
        fs::create_dir_all(&self.folder)?;
        let mut file =
            tempfile::Builder::new().prefix(PREFIX).suffix(".tmp").tempfile_in(&self.folder)?;
        file.write_all(&bytes)?;
        file.as_file().sync_all()?;
        file.persist(&self.path).map_err(|error| error.error)?;
        self.prune()
    }

    fn prune(&self) -> io::Result<()> {
        let mut others: Vec<(SystemTime, PathBuf)> = Vec::new();
        for item in fs::read_dir(&self.folder)?.filter_map(Result::ok) {
            let is_ours = item.file_name().to_string_lossy().starts_with(PREFIX);
            let Ok(metadata) = item.metadata() else { continue };
            if is_ours && metadata.is_file() && item.path() != self.path {
                others.push((metadata.modified()?, item.path()));
            }
        }
        others.sort();
        for (_, path) in others.iter().rev().skip(MOST_FILES - 1) {
            let _ = fs::remove_file(path);
        }
        Ok(())
    }
}

fn encode(kept: &Kept) -> Vec<u8> {
    let mut body = (kept.variants.len() as u64).to_le_bytes().to_vec();
    body.extend(&kept.variants);
    body.extend(&kept.driver);
    let mut bytes = MAGIC.to_vec();
    bytes.extend(Sha256::digest(&body));
    bytes.extend(body);
    bytes
}

fn decode(bytes: &[u8]) -> Option<Kept> {
    let (head, rest) = bytes.split_at_checked(HEAD_BYTES)?;
    let (magic, head) = head.split_at(MAGIC.len());
    let (hash, length) = head.split_at(HASH_BYTES);
    let is_whole = Sha256::digest(&bytes[MAGIC.len() + HASH_BYTES..]).as_slice() == hash;
    if magic != MAGIC || !is_whole {
        return None;
    }
    let length = usize::try_from(u64::from_le_bytes(length.try_into().ok()?)).ok()?;
    let (variants, driver) = rest.split_at_checked(length)?;
    Some(Kept { variants: variants.to_vec(), driver: driver.to_vec() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_read_whole_or_removed() {
        let folder = tempfile::tempdir().unwrap();
        let store = PipelineStore::new(folder.path(), &["adapter", "driver"]);
        assert_eq!(store.load(), None);
        let kept = Kept { variants: b"[1]".to_vec(), driver: vec![7; 100] };
        store.save(&kept).unwrap();
        assert_eq!(store.load(), Some(kept.clone()));
        let whole = fs::read(&store.path).unwrap();
        for cut in [0, 7, HEAD_BYTES - 1, HEAD_BYTES, whole.len() - 1] {
            fs::write(&store.path, &whole[..cut]).unwrap();
            assert_eq!(store.load(), None, "cut at {cut}");
            assert!(!store.path.exists());
        }
        for place in [0, MAGIC.len(), HEAD_BYTES - 1, HEAD_BYTES, whole.len() - 1] {
            let mut bytes = whole.clone();
            bytes[place] ^= 1;
            fs::write(&store.path, bytes).unwrap();
            assert_eq!(store.load(), None, "changed at {place}");
        }
        store.save(&kept).unwrap();
        assert_eq!(store.load(), Some(kept));
    }

    #[test]
    fn other_adapters_have_other_files_and_few_stay() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("other.bake"), "x").unwrap();
        for number in 0..MOST_FILES + 3 {
            let store = PipelineStore::new(folder.path(), &["adapter", &number.to_string()]);
            store.save(&Kept::default()).unwrap();
            assert_eq!(store.load(), Some(Kept::default()));
        }
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), MOST_FILES + 1);
        let (a, b) = (["ab", "c"], ["a", "bc"]);
        let [a, b] = [a, b].map(|parts| PipelineStore::new(folder.path(), &parts));
        assert_ne!(a.path, b.path);
    }
}
