//! The store that server and workers share besides messages: a folder, or a bucket of an S3-compatible service.
//!
//! | name | content | written by |
//! |---|---|---|
//! | `pointillist-store` | what tells this store from others, drawn at random | the first server |
//! | `assets/SHA256` | a file of a scene; removed a week after it was last stored, unless a film needs it | the server, once for all films |
//! | `films/FILM/order.json` | [`FilmOrder`]; stored again twice a day; removed first when the film is over | the server |
//! | `films/FILM/frames/TAG` | the image with this entity tag | workers |
//! | `films/FILM/tries/FIRST-LAST` | [`Tries`]: which workers began these frames, and how often | workers |
//! | `films/FILM/aside/NUMBER` | why a frame is set aside | workers |
//!
//! Frames carry their checksum, since a shared folder may keep half of a file after a power cut. Each operation is tried a few times.

use std::collections::{BTreeMap, HashSet};
use std::path::Path as FilePath;
use std::sync::{Arc, OnceLock};
use std::time::{Duration, SystemTime};

use bytes::Bytes;
use futures::{StreamExt, TryStreamExt};
use object_store::aws::AmazonS3Builder;
use object_store::local::LocalFileSystem;
use object_store::path::Path;
use object_store::prefix::PrefixStore;
use object_store::{ObjectMeta, ObjectStore, ObjectStoreExt, PutMode, PutPayload, WriteMultipart};
use serde::Deserialize;
use sha2::{Digest, Sha256};
use tokio::io::{AsyncReadExt, AsyncWriteExt};

use super::Said;
use super::messages::{Bundle, FilmOrder};
use super::tries::Tries;
use crate::engine::RequestId;
use crate::film::manifest::{are_digits, digits};

/// Name of the mark.
const MARK: &str = "pointillist-store";
/// Number of tries of an operation. The pause after each is twice as long as the one before.
const TRIES: u32 = 4;
const PAUSE: Duration = Duration::from_millis(100);
/// Bytes of a frame's checksum.
const SUM: usize = 32;
/// Bytes of a part of a large file that is uploaded.
const PART: usize = 8 << 20;
/// Age from which a scene's file that no film names is removed.
const KEPT: Duration = Duration::from_secs(7 * 24 * 3600);
/// Age from which a scene's file is stored again when a film needs it, so that it is not removed before the film's order is there.
const FRESH: Duration = Duration::from_secs(24 * 3600);
/// Age from which a film is removed that no server stores anything of. The queue has forgotten its runs by then.
const ABANDONED: Duration = Duration::from_secs(14 * 24 * 3600);
/// Requests that one listing or removal makes at a time.
const AT_ONCE: usize = 16;

/// The part of an order that tells which files a film needs. Daemons of other versions may share the store.
#[derive(Deserialize)]
struct Needs {
    scene: Bundle,
}

/// Films that are old enough to be removed, with the times of their newest objects.
pub type Suspects = BTreeMap<String, SystemTime>;

/// A handle of the store; clones share it.
#[derive(Clone)]
pub struct Store {
    objects: Arc<dyn ObjectStore>,
    name: Arc<str>,
    /// What the mark said when it was first read.
    id: Arc<OnceLock<String>>,
}

/// Error of the store.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    #[error("--store {store}: {error}")]
    Failed { store: Arc<str>, error: object_store::Error },
    #[error("--store {store}: expected s3://BUCKET/PREFIX or a folder: {error}")]
    Folder { store: Arc<str>, error: std::io::Error },
    #[error(
        "--store {0}: its file `{MARK}` is missing or has other content than before; mount the store's file system, or correct --store"
    )]
    Gone(Arc<str>),
}

impl StoreError {
    fn is_missing(&self) -> bool {
        matches!(self, StoreError::Failed { error: object_store::Error::NotFound { .. }, .. })
    }

    /// The folder may still be made. A URL that is not S3's never becomes one.
    fn lacks_folder(&self) -> bool {
        let not_found = std::io::ErrorKind::NotFound;
        matches!(self, StoreError::Folder { store, error } if error.kind() == not_found && !store.contains("://"))
    }
}

/// Objects of a film, by what their names say.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Listing {
    /// Tags of frames.
    pub frames: Vec<String>,
    /// Numbers of frames that are set aside.
    pub aside: Vec<u64>,
}

impl Store {
    /// Opens a store as [`Store::open`] does. A missing folder is created if the folder that it lies in exists.
    ///
    /// # Errors
    /// As for [`Store::open`], and the folder cannot be created.
    pub fn create(text: &str) -> Result<Store, StoreError> {
        if !text.starts_with("s3://")
            && let Err(error) = std::fs::create_dir(text)
            && error.kind() != std::io::ErrorKind::AlreadyExists
        {
            return Err(StoreError::Folder { store: text.into(), error });
        }
        Store::open(text)
    }

    /// Opens `s3://BUCKET/PREFIX`, with access from the usual `AWS_…` variables, or a folder.
    ///
    /// # Errors
    /// The text names neither, or the folder is missing.
    pub fn open(text: &str) -> Result<Store, StoreError> {
        let fail = |error| StoreError::Failed { store: text.into(), error };
        let objects: Arc<dyn ObjectStore> = if let Some(rest) = text.strip_prefix("s3://") {
            // Another crate may have chosen a provider of cryptography already, which is as good.
            let _ = tokio_rustls::rustls::crypto::ring::default_provider().install_default();
            let (bucket, prefix) = rest.split_once('/').unwrap_or((rest, ""));
            let s3 = AmazonS3Builder::from_env().with_bucket_name(bucket).build().map_err(fail)?;
            Arc::new(PrefixStore::new(s3, Path::from(prefix)))
        } else {
            let folder = FilePath::new(text);
            if let Err(error) = std::fs::read_dir(folder) {
                return Err(StoreError::Folder { store: text.into(), error });
            }
            let files = LocalFileSystem::new_with_prefix(folder).map_err(fail)?;
            // Workers and servers rely on a stored object, which must therefore outlast a power cut, as one in a bucket does.
            Arc::new(files.with_automatic_cleanup(true).with_fsync(true))
        };
        Ok(Store { objects, name: text.into(), id: Arc::default() })
    }

    /// Opens a store as [`Store::open`] does, once its folder exists.
    ///
    /// # Errors
    /// As for [`Store::open`], except that a missing folder is no error.
    pub async fn wait(text: &str) -> Result<Store, StoreError> {
        let said = Said::default();
        loop {
            match Store::open(text) {
                Err(error) if error.lacks_folder() => {
                    if said.is_due(text) {
                        tracing::warn!("the worker waits: {error}");
                    }
                }
                opened => return opened,
            }
            tokio::time::sleep(PAUSE).await;
        }
    }

    /// Returns the store's name, as it was given.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the store's mark, which is created if missing. For servers only.
    ///
    /// # Errors
    /// The store fails, as in all other operations.
    pub async fn claim(&self) -> Result<&str, StoreError> {
        if let Some(found) = self.find().await? {
            return Ok(found);
        }
        let own = RequestId::fresh().to_string();
        let mark = Path::from(MARK);
        let put = || {
            let content = PutPayload::from_bytes(own.clone().into());
            self.objects.put_opts(&mark, content, PutMode::Create.into())
        };
        let mut created = self.tried(put).await.map(drop);
        if let Err(StoreError::Failed {
            error: object_store::Error::NotImplemented { .. }, ..
        }) = created
        {
            // A service that knows no conditions: servers must not begin at the same moment.
            created = self.put(&mark, own.clone().into()).await;
        }
        match created {
            Ok(()) => Ok(self.id.get_or_init(|| own.clone())),
            // Another server was faster.
            Err(error) => self.find().await?.ok_or(error),
        }
    }

    /// Returns the store's mark; `None` if no server has used the store.
    pub async fn find(&self) -> Result<Option<&str>, StoreError> {
        if self.id.get().is_none()
            && let Some(found) = self.mark().await?
        {
            let _ = self.id.set(found);
        }
        Ok(self.id.get().map(String::as_str))
    }

    async fn mark(&self) -> Result<Option<String>, StoreError> {
        let text = self.get(&Path::from(MARK)).await?;
        Ok(text.map(|text| String::from_utf8_lossy(&text).trim().to_owned()))
    }

    /// Checks that the store still has the mark that was found.
    ///
    /// # Errors
    /// The store has another mark or none, as where its file system is no longer mounted.
    pub async fn check(&self) -> Result<(), StoreError> {
        let found = self.mark().await?;
        if found.is_some() && found.as_ref() == self.id.get() {
            return Ok(());
        }
        Err(StoreError::Gone(self.name.clone()))
    }

    /// Writes an object and removes it again, to find out whether that is allowed.
    pub async fn try_writing(&self) -> Result<(), StoreError> {
        let trial = Path::from("trials").join(RequestId::fresh().to_string());
        self.put(&trial, Bytes::from_static(b"trial")).await?;
        absent(self.tried(|| self.objects.delete(&trial)).await)?;
        Ok(())
    }

    /// Repeats an operation that fails, unless the object is missing.
    async fn tried<T, F: Future<Output = object_store::Result<T>>>(
        &self,
        mut operation: impl FnMut() -> F,
    ) -> Result<T, StoreError> {
        let mut tries = 1;
        loop {
            let error = match operation().await {
                Ok(value) => return Ok(value),
                Err(error) => self.failed(error),
            };
            if tries >= TRIES || error.is_missing() {
                return Err(error);
            }
            tracing::debug!(%error, "the store is asked again");
            tokio::time::sleep(PAUSE * (1 << tries)).await;
            tries += 1;
        }
    }

    fn failed(&self, error: object_store::Error) -> StoreError {
        StoreError::Failed { store: self.name.clone(), error }
    }

    async fn put(&self, name: &Path, bytes: Bytes) -> Result<(), StoreError> {
        self.tried(|| self.objects.put(name, PutPayload::from_bytes(bytes.clone()))).await?;
        Ok(())
    }

    async fn get(&self, name: &Path) -> Result<Option<Bytes>, StoreError> {
        let found = self.tried(|| async { self.objects.get(name).await?.bytes().await }).await;
        absent(found)
    }

    async fn has(&self, name: &Path) -> Result<bool, StoreError> {
        Ok(absent(self.tried(|| self.objects.head(name)).await)?.is_some())
    }

    /// Stores the description of a film.
    pub async fn put_order(&self, film: &str, order: Vec<u8>) -> Result<(), StoreError> {
        self.check().await?;
        self.put(&order_path(film), order.into()).await
    }

    /// Returns the description of a film; `None` if the film is over, or if the description is damaged. The server stores it again
    /// when it notices that workers drop the film's runs.
    pub async fn order(&self, film: &str) -> Result<Option<FilmOrder>, StoreError> {
        let Some(text) = self.get(&order_path(film)).await? else { return Ok(None) };
        let read = serde_json::from_slice(&text).inspect_err(|error| {
            tracing::warn!(film, %error, "a film's order in the store is damaged");
        });
        Ok(read.ok())
    }

    /// Stores a frame under its tag.
    pub async fn put_frame(&self, film: &str, tag: &str, image: &[u8]) -> Result<(), StoreError> {
        self.put(&frame_path(film, tag), seal(image)).await
    }

    /// Returns a frame; `None` if it is missing. A damaged frame is removed, so that it is drawn again.
    pub async fn frame(&self, film: &str, tag: &str) -> Result<Option<Bytes>, StoreError> {
        let name = frame_path(film, tag);
        let Some(sealed) = self.get(&name).await? else { return Ok(None) };
        let image = unseal(sealed);
        if image.is_none() {
            tracing::warn!(film, tag, "a frame in the store is damaged");
            absent(self.tried(|| self.objects.delete(&name)).await)?;
        }
        Ok(image)
    }

    /// Returns whether a frame is there.
    pub async fn has_frame(&self, film: &str, tag: &str) -> Result<bool, StoreError> {
        self.has(&frame_path(film, tag)).await
    }

    /// Changes the tries of a run, and returns them as they were before and as they are now.
    pub async fn change_tries(
        &self,
        film: &str,
        run: &str,
        change: impl FnOnce(&mut Tries),
    ) -> Result<(Tries, Tries), StoreError> {
        let name = film_path(film).join("tries").join(run);
        let text = self.get(&name).await?;
        let before = text.and_then(|text| serde_json::from_slice::<Tries>(&text).ok());
        let before = before.unwrap_or_default();
        let mut now = before.clone();
        change(&mut now);
        // Names and numbers always have a JSON text.
        let text = serde_json::to_vec(&now).unwrap_or_default();
        self.put(&name, text.into()).await?;
        Ok((before, now))
    }

    /// Records why a frame is set aside.
    pub async fn set_aside(&self, film: &str, frame: u64, why: &str) -> Result<(), StoreError> {
        self.put(&aside_path(film, frame), why.to_owned().into()).await
    }

    /// Returns why a frame is set aside.
    pub async fn why_aside(&self, film: &str, frame: u64) -> Result<Option<String>, StoreError> {
        let text = self.get(&aside_path(film, frame)).await?;
        Ok(text.map(|text| String::from_utf8_lossy(&text).into_owned()))
    }

    /// Lists what workers have stored of a film.
    pub async fn list(&self, film: &str) -> Result<Listing, StoreError> {
        let folder = film_path(film);
        let objects = || self.objects.list(Some(&folder)).map_ok(|found| found.location);
        let names: Vec<Path> = self.tried(|| objects().try_collect()).await?;
        let mut listing = Listing::default();
        for name in names {
            let parts: Vec<_> = name.parts().skip(2).collect();
            match parts.iter().map(AsRef::as_ref).collect::<Vec<&str>>()[..] {
                ["frames", tag] => listing.frames.push(tag.to_owned()),
                ["aside", number] => listing.aside.extend(number.parse::<u64>()),
                _ => {}
            }
        }
        Ok(listing)
    }

    /// Removes everything of a film, its description first.
    pub async fn remove(&self, film: &str) -> Result<(), StoreError> {
        let folder = film_path(film);
        let order = order_path(film);
        absent(self.tried(|| self.objects.delete(&order)).await)?;
        let names = self.objects.list(Some(&folder)).map_ok(|found| found.location);
        let removed = names.map_err(|error| self.failed(error));
        let delete =
            |name| async move { absent(self.tried(|| self.objects.delete(&name)).await).map(drop) };
        removed.try_for_each_concurrent(AT_ONCE, delete).await
    }

    /// Returns the objects of a film that has no order. A film with an order has no leftovers.
    pub async fn leftovers(&self, film: &str) -> Result<Vec<Path>, StoreError> {
        let folder = film_path(film);
        if self.has(&order_path(film)).await? {
            return Ok(Vec::new());
        }
        self.tried(|| self.objects.list(Some(&folder)).map_ok(|found| found.location).try_collect())
            .await
    }

    /// Removes leftovers of a film. If the film has an order again, as when a cancelled job is resumed, its objects stay.
    pub async fn remove_leftovers(&self, film: &str, names: Vec<Path>) -> Result<(), StoreError> {
        let order = order_path(film);
        let names = names.into_iter().filter(|name| *name != order).map(Ok);
        let delete = |name| {
            let order = &order;
            async move {
                if !self.has(order).await? {
                    absent(self.tried(|| self.objects.delete(&name)).await)?;
                }
                Ok(())
            }
        };
        futures::stream::iter(names).try_for_each_concurrent(AT_ONCE, delete).await
    }

    /// Removes films whose newest object is two weeks old at the time `now`, and was the newest in the call before, which left `suspects`.
    /// A clock that jumps therefore removes no film whose order is stored again between two calls. Returns the number of removed films.
    ///
    /// # Errors
    /// The store fails. If it fails for some films only, the other films are removed, and this is the first error.
    pub async fn clean_films(
        &self,
        now: SystemTime,
        suspects: &mut Suspects,
    ) -> Result<usize, StoreError> {
        self.check().await?;
        let films = Path::from("films");
        let note = |mut newest: Suspects, object: ObjectMeta| async move {
            let film = object.location.parts().nth(1);
            let film: &str = film.as_ref().map_or("", AsRef::as_ref);
            // Whatever else lies there is somebody else's.
            if are_digits(film, 32) {
                let at = SystemTime::from(object.last_modified);
                let known = newest.entry(film.to_owned()).or_insert(at);
                *known = at.max(*known);
            }
            Ok(newest)
        };
        let listed = self.tried(|| self.objects.list(Some(&films)).try_fold(Suspects::new(), note));
        let mut old = listed.await?;
        old.retain(|_, at| now.duration_since(*at).is_ok_and(|age| age >= ABANDONED));
        let before = std::mem::replace(suspects, old);
        let unchanged = suspects.iter().filter(|(film, at)| before.get(*film) == Some(*at));
        let abandoned: Vec<&String> = unchanged.map(|(film, _)| film).collect();
        let (mut removed, mut failed) = (0, None);
        for film in abandoned {
            match self.remove(film).await {
                Ok(()) => removed += 1,
                Err(error) => failed = failed.or(Some(error)),
            }
        }
        failed.map_or(Ok(removed), Err)
    }

    /// Removes scenes' files that no film needs and that are a week old at the time `now`. Returns their number. A film whose order is
    /// damaged needs none once the order is a day old: a server stores orders again twice a day, and stores the files before it draws on.
    ///
    /// # Errors
    /// The store fails, or a younger order is damaged; then nothing is removed.
    pub async fn clean(&self, now: SystemTime) -> Result<usize, StoreError> {
        self.check().await?;
        let assets = Path::from("assets");
        let assets: Vec<_> = self.tried(|| self.objects.list(Some(&assets)).try_collect()).await?;
        let is_old = |object: &ObjectMeta, age: Duration| {
            let at = SystemTime::from(object.last_modified);
            now.duration_since(at).is_ok_and(|since| since >= age)
        };
        let old = assets.into_iter().filter(|asset| is_old(asset, KEPT));
        // Whatever else lies there is somebody else's.
        let ours = old.map(|asset| asset.location).filter(is_asset);
        let mut old: Vec<Path> = ours.collect();
        if old.is_empty() {
            return Ok(0);
        }
        let films = Path::from("films");
        let films = self.tried(|| self.objects.list_with_delimiter(Some(&films))).await?;
        let mut needed = HashSet::new();
        for film in films.common_prefixes {
            let name = film.join("order.json");
            // The film may have ended.
            let Some(text) = self.get(&name).await? else { continue };
            let order: Needs = match serde_json::from_slice(&text) {
                Ok(order) => order,
                Err(error) => {
                    let found = absent(self.tried(|| self.objects.head(&name)).await)?;
                    if found.is_none_or(|found| is_old(&found, FRESH)) {
                        continue;
                    }
                    let source = format!("{name}: {error}").into();
                    return Err(
                        self.failed(object_store::Error::Generic { store: "order", source })
                    );
                }
            };
            needed.extend(order.scene.files.iter().map(|file| asset_path(&file.sha256)));
        }
        old.retain(|asset| !needed.contains(asset));
        let mut removed = 0;
        for asset in &old {
            // A film that has begun meanwhile has stored its files again.
            let found = absent(self.tried(|| self.objects.head(asset)).await)?;
            if found.is_some_and(|found| is_old(&found, KEPT)) {
                absent(self.tried(|| self.objects.delete(asset)).await)?;
                removed += 1;
            }
        }
        Ok(removed)
    }

    /// Stores a scene's file under its hash, unless it is there and was stored lately.
    pub async fn put_asset(&self, sha256: &str, file: &FilePath) -> Result<(), StoreError> {
        let name = asset_path(sha256);
        let found = absent(self.tried(|| self.objects.head(&name)).await)?;
        let age = found.map(|found| SystemTime::from(found.last_modified).elapsed());
        if age.is_some_and(|age| age.unwrap_or_default() < FRESH) {
            return Ok(());
        }
        self.tried(|| async {
            let mut source = tokio::fs::File::open(file).await.map_err(of_file)?;
            let mut upload = WriteMultipart::new(self.objects.put_multipart(&name).await?);
            let mut hasher = Sha256::new();
            loop {
                let mut part = Vec::with_capacity(PART);
                (&mut source).take(PART as u64).read_to_end(&mut part).await.map_err(of_file)?;
                if part.is_empty() {
                    break;
                }
                hasher.update(&part);
                upload.wait_for_capacity(2).await?;
                upload.write(&part);
            }
            if digits(&hasher.finalize()) != sha256 {
                upload.abort().await?;
                return Err(of_file(std::io::Error::other("the file changed while it was stored")));
            }
            upload.finish().await
        })
        .await?;
        Ok(())
    }

    /// Copies a scene's file out of the store, and returns its hash.
    pub async fn asset(&self, sha256: &str, file: &FilePath) -> Result<String, StoreError> {
        let name = asset_path(sha256);
        self.tried(|| async {
            let mut target = tokio::fs::File::create(file).await.map_err(of_file)?;
            let mut content = self.objects.get(&name).await?.into_stream();
            let mut hasher = Sha256::new();
            while let Some(piece) = content.next().await {
                let piece = piece?;
                hasher.update(&piece);
                target.write_all(&piece).await.map_err(of_file)?;
            }
            target.flush().await.map_err(of_file)?;
            Ok(digits(&hasher.finalize()))
        })
        .await
    }
}

fn of_file(error: std::io::Error) -> object_store::Error {
    object_store::Error::Generic { store: "file", source: Box::new(error) }
}

/// Turns the error of a missing object into `None`.
fn absent<T>(found: Result<T, StoreError>) -> Result<Option<T>, StoreError> {
    match found {
        Ok(value) => Ok(Some(value)),
        Err(error) if error.is_missing() => Ok(None),
        Err(error) => Err(error),
    }
}

fn film_path(film: &str) -> Path {
    Path::from("films").join(film)
}

fn order_path(film: &str) -> Path {
    film_path(film).join("order.json")
}

fn frame_path(film: &str, tag: &str) -> Path {
    film_path(film).join("frames").join(tag)
}

fn aside_path(film: &str, frame: u64) -> Path {
    film_path(film).join("aside").join(frame.to_string())
}

fn asset_path(sha256: &str) -> Path {
    Path::from("assets").join(sha256)
}

/// Returns whether an object is a scene's file, by its name.
fn is_asset(name: &Path) -> bool {
    let parts: Vec<_> = name.parts().collect();
    matches!(&parts[..], [_, hash] if are_digits(hash.as_ref(), 64))
}

/// Appends the checksum of an image.
fn seal(image: &[u8]) -> Bytes {
    [image, &Sha256::digest(image)].concat().into()
}

/// Removes the checksum; `None` if it is not the image's.
fn unseal(sealed: Bytes) -> Option<Bytes> {
    let length = sealed.len().checked_sub(SUM)?;
    let (image, sum) = (sealed.slice(..length), &sealed[length..]);
    (Sha256::digest(&image)[..] == *sum).then_some(image)
}

#[cfg(test)]
mod tests;
