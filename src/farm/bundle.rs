//! Scenes on their way to workers: their files go through the store, each under the hash of its content.

use std::collections::HashMap;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Component, Path, PathBuf};
use std::sync::{Arc, Weak};
use std::time::SystemTime;

use glam::DVec3;
use parking_lot::Mutex;

use super::messages::{Bundle, BundledFile};
use super::store::{Store, StoreError};
use crate::engine::{SceneFiles, Source};
use crate::film::manifest;

/// Number of files whose hashes are remembered.
const MOST_KNOWN: usize = 10_000;

/// Error of a scene on its way.
#[derive(Debug, thiserror::Error)]
pub enum BundleError {
    #[error("{}: {error}", file.display())]
    Io { file: PathBuf, error: io::Error },
    #[error("{}: the file lies outside the root or its name is not Unicode", .0.display())]
    Foreign(PathBuf),
    #[error("the scene has a file with the name `{0}`, which leads out of its folder")]
    Path(String),
    #[error("the store's copy of `{0}` is damaged; remove it from the store's `assets`")]
    Damaged(String),
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// Hash of a file, with the length and the time at which it was computed.
type Known = (u64, Option<SystemTime>, String);

/// Hashes of files, so that a large file is not read for every film.
#[derive(Default)]
pub struct Hashes(Mutex<HashMap<PathBuf, Known>>);

impl Hashes {
    /// Returns the length and the hash of a file. A large file takes a while, in which other tasks go on. Dropping the future
    /// ends the reading.
    async fn find(self: Arc<Hashes>, file: PathBuf) -> Result<(u64, String), BundleError> {
        let name = file.clone();
        // Lives as long as this future.
        let wanted = Arc::new(());
        let is_wanted = Arc::downgrade(&wanted);
        let hashed = tokio::task::spawn_blocking(move || self.of(&file, is_wanted)).await;
        drop(wanted);
        hashed
            .unwrap_or_else(|error| Err(io::Error::other(error)))
            .map_err(|error| BundleError::Io { file: name, error })
    }

    /// Returns the length and the hash of a file while they are wanted. Blocks.
    fn of(&self, file: &Path, is_wanted: Weak<()>) -> io::Result<(u64, String)> {
        let found = std::fs::metadata(file)?;
        let state = (found.len(), found.modified().ok());
        if let Some((bytes, modified, sha256)) = self.0.lock().get(file)
            && (*bytes, *modified) == state
        {
            return Ok((*bytes, sha256.clone()));
        }
        let source = Abandonable { source: File::open(file)?, is_wanted };
        let (bytes, sha256) = manifest::digest(source)?;
        let mut known = self.0.lock();
        if known.len() >= MOST_KNOWN {
            known.clear();
        }
        known.insert(file.to_owned(), (state.0, state.1, sha256.clone()));
        Ok((bytes, sha256))
    }
}

/// A file that is read while somebody holds what `is_wanted` points to.
struct Abandonable {
    source: File,
    is_wanted: Weak<()>,
}

impl Read for Abandonable {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.is_wanted.strong_count() == 0 {
            return Err(io::Error::other("nobody waits for the file any more"));
        }
        self.source.read(buffer)
    }
}

/// Puts the files of a scene below `root` into the store.
///
/// # Errors
/// A file cannot be read or stored.
pub async fn pack(
    root: &Path,
    files: &SceneFiles,
    hashes: &Arc<Hashes>,
    store: &Store,
) -> Result<Bundle, BundleError> {
    let relative = |path: &Path| {
        let inner = path.strip_prefix(root).ok().and_then(Path::to_str);
        inner.map(str::to_owned).ok_or_else(|| BundleError::Foreign(path.to_owned()))
    };
    let mut bundled = Vec::with_capacity(files.files.len());
    for file in &files.files {
        let (bytes, sha256) = hashes.clone().find(file.clone()).await?;
        store.put_asset(&sha256, file).await?;
        bundled.push(BundledFile { path: relative(file)?, bytes, sha256 });
    }
    Ok(Bundle {
        main: relative(&files.path)?,
        base: files.base.as_deref().map(relative).transpose()?,
        up: files.up.map(|up| up.to_array()),
        files: bundled,
    })
}

/// Writes the files of a scene from the store into a folder, and returns the scene's source there.
///
/// # Errors
/// A file is missing or damaged, or cannot be written.
pub async fn unpack(store: &Store, bundle: &Bundle, folder: &Path) -> Result<Source, BundleError> {
    for BundledFile { path, sha256, .. } in &bundle.files {
        let file = below(folder, path)?;
        let parent = file.parent().unwrap_or(folder);
        let made = tokio::fs::create_dir_all(parent).await;
        made.map_err(|error| BundleError::Io { file: parent.to_owned(), error })?;
        if store.asset(sha256, &file).await? != *sha256 {
            return Err(BundleError::Damaged(sha256.clone()));
        }
    }
    Ok(Source {
        path: below(folder, &bundle.main)?,
        base: bundle.base.as_deref().map(|base| below(folder, base)).transpose()?,
        up: bundle.up.map(DVec3::from_array),
    })
}

/// Returns a path below a folder.
pub(crate) fn below(folder: &Path, path: &str) -> Result<PathBuf, BundleError> {
    let is_inner = |part: Component<'_>| matches!(part, Component::Normal(_));
    if !Path::new(path).components().all(is_inner) {
        return Err(BundleError::Path(path.to_owned()));
    }
    Ok(folder.join(path))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn scenes_arrive_with_all_their_files() {
        let here = tempfile::tempdir().unwrap();
        let root = here.path().join("root");
        std::fs::create_dir_all(root.join("sub/deep")).unwrap();
        let store = Store::create(here.path().join("store").to_str().unwrap()).unwrap();
        let paths = ["sub/s.json", "sub/deep/a.ply"].map(|name| root.join(name));
        std::fs::write(&paths[0], "{}").unwrap();
        std::fs::write(&paths[1], "ply").unwrap();
        let files = SceneFiles {
            path: paths[0].clone(),
            base: Some(root.clone()),
            up: Some(DVec3::Z),
            files: paths.to_vec(),
        };
        let hashes = Arc::<Hashes>::default();
        let bundle = pack(&root, &files, &hashes, &store).await.unwrap();
        assert_eq!((bundle.main.as_str(), bundle.base.as_deref()), ("sub/s.json", Some("")));
        let there = here.path().join("there");
        let source = unpack(&store, &bundle, &there).await.unwrap();
        assert_eq!(source.path, there.join("sub/s.json"));
        assert_eq!((source.base, source.up), (Some(there.join("")), Some(DVec3::Z)));
        assert_eq!(std::fs::read(there.join("sub/deep/a.ply")).unwrap(), b"ply");
        // A file that has changed is another one.
        std::fs::write(&paths[1], "other").unwrap();
        let changed = pack(&root, &files, &hashes, &store).await.unwrap();
        assert_ne!(changed.files[1].sha256, bundle.files[1].sha256);
        let outer = SceneFiles { path: here.path().join("x"), ..files };
        assert!(matches!(pack(&root, &outer, &hashes, &store).await, Err(BundleError::Foreign(_))));
    }

    /// A pipe that nobody writes to is a file that takes long to read.
    #[cfg(unix)]
    #[tokio::test]
    async fn a_slow_file_holds_up_no_other_task() {
        let here = tempfile::tempdir().unwrap();
        let slow = here.path().join("slow.ply");
        let made = std::process::Command::new("mkfifo").arg(&slow).status().unwrap();
        assert!(made.success());
        let store = Store::create(here.path().join("store").to_str().unwrap()).unwrap();
        let files =
            SceneFiles { path: slow.clone(), base: None, up: None, files: vec![slow.clone()] };
        let hashes = Arc::<Hashes>::default();
        // A writer ends the read, which the runtime would otherwise wait for.
        let writer = std::thread::spawn(move || {
            std::thread::sleep(std::time::Duration::from_secs(2));
            std::fs::File::options().write(true).open(&slow).unwrap();
        });
        let began = std::time::Instant::now();
        let packed = pack(here.path(), &files, &hashes, &store);
        let waited = tokio::time::timeout(std::time::Duration::from_millis(50), packed).await;
        let took = began.elapsed();
        assert!(waited.is_err() && took < std::time::Duration::from_secs(1), "{took:?}");
        writer.join().unwrap();
    }

    /// The device is a file without an end. A runtime waits for its blocking threads when it is shut down.
    #[cfg(unix)]
    #[test]
    fn nothing_reads_a_file_that_nobody_waits_for() {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let began = std::time::Instant::now();
        let waited = runtime.block_on(async {
            let found = Arc::<Hashes>::default().find(PathBuf::from("/dev/zero"));
            tokio::time::timeout(std::time::Duration::from_millis(50), found).await
        });
        assert!(waited.is_err());
        runtime.shutdown_timeout(std::time::Duration::from_secs(20));
        let took = began.elapsed();
        assert!(took < std::time::Duration::from_secs(10), "{took:?}");
    }

    #[test]
    fn names_do_not_lead_out_of_the_folder() {
        let folder = Path::new("/scenes");
        assert_eq!(below(folder, "a/b.ply").unwrap(), Path::new("/scenes/a/b.ply"));
        for bad in ["../x", "a/../../x", "/etc/passwd"] {
            assert!(matches!(below(folder, bad), Err(BundleError::Path(_))), "{bad}");
        }
    }

    #[tokio::test]
    async fn damaged_assets_are_refused() {
        let here = tempfile::tempdir().unwrap();
        let store = Store::create(here.path().join("store").to_str().unwrap()).unwrap();
        let sha256 = manifest::checksum(b"something else");
        let assets = here.path().join("store/assets");
        std::fs::create_dir(&assets).unwrap();
        std::fs::write(assets.join(&sha256), "ply").unwrap();
        let files = vec![BundledFile { path: "a.ply".to_owned(), bytes: 3, sha256 }];
        let bundle = Bundle { main: "a.ply".to_owned(), base: None, up: None, files };
        let refused = unpack(&store, &bundle, &here.path().join("there")).await.unwrap_err();
        assert!(matches!(refused, BundleError::Damaged(_)), "{refused}");
    }
}
