//! Keeps large packed clouds on disk, so that the next process need not read, sort or estimate them again.
//!
//! ```text
//! file ──identity──► note: hash of its content, and what else was read ──that hash──► packed samples, whole or without estimates
//! ```
//! Both are entries of the bake cache, and both keys contain [`crate::BUILD`]: another build may read, pack or estimate differently. A note
//! stands under what can be had of a file without reading all of it: device, inode, size, times of modification and of change, and a
//! hash of [`PROBES`] blocks spread over it. Writing to a file changes its times, and no program sets the time of change; replacing it
//! changes the inode; a restored or copied file has another time of change. What remains is a write within the last step of the file
//! system's clock, so that a note of a file that was changed just now is written a little later, if the file is still the same then.
//! Samples stand under the hash of the whole content, as in memory.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::PathBuf;
use std::sync::{Arc, OnceLock};
use std::time::{Duration, SystemTime};

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::EngineConfig;
use super::asset_cache::{Extras, ReadAsset};
use super::asset_keys::file_kind;
use super::uid::next_uid;
use crate::assets::FORMATS;
use crate::bake::cache::BakeCache;
use crate::bake::pack::{Counts, GeometryKind, PackedAsset, PackedGeometry};
use crate::math::Bounds;
use crate::memory::{Admission, Interrupt, Reservation};
use crate::residency::model::{AssetModel, Deferred};
use crate::residency::once::MadeOnce;
use crate::scene::{AssetRef, AssetSource};

/// Blocks of a file that its identity hashes, and bytes of each.
const PROBES: u64 = 64;
const PROBE_BYTES: u64 = 4096;
/// Bytes of a packed sample, including its share of a chunk.
const SAMPLE_BYTES: u64 = 24;

/// A file's content other than its samples. Notes are stored as TOML, which keeps every float, infinite ones too.
#[derive(Serialize, Deserialize)]
pub struct Note {
    pub digest: [u8; 32],
    format: String,
    has_colors: bool,
    shows_intensity: bool,
    has_normals: bool,
    normals_estimated: bool,
    lacks_normals: bool,
    samples: u64,
    bounds: Vec<Bounds>,
    extras: Extras,
}

/// The cache and a file's identity in it, for files whose samples may be kept.
#[derive(Clone)]
pub struct CloudEntry {
    cache: BakeCache,
    identity: [u8; 32],
    file: PathBuf,
    /// Whether the asset is bare; only then is its shape measured.
    is_bare: bool,
    /// See [`EngineConfig::estimate_at_once`].
    estimate_at_once: usize,
    /// See [`EngineConfig::settled_after`].
    settled_after: Duration,
}

impl CloudEntry {
    /// Identifies an asset's file; `None` for an asset made of several files, and without a cache.
    pub fn of(reference: &AssetRef, config: &EngineConfig, is_bare: bool) -> Option<CloudEntry> {
        let cache = config.bake_cache.clone()?;
        let AssetSource::File(source) = &reference.source else { return None };
        if source.sample.is_some() || source.features {
            return None;
        }
        let mut entry = CloudEntry {
            cache,
            identity: [0; 32],
            file: source.path.clone(),
            is_bare,
            estimate_at_once: config.estimate_at_once,
            settled_after: config.settled_after,
        };
        (entry.identity, _) = entry.identity().ok()??;
        Some(entry)
    }

    /// Returns whether the file is still the one whose identity was taken.
    fn is_same(&self) -> bool {
        matches!(self.identity(), Ok(Some((identity, _))) if identity == self.identity)
    }

    /// Waits until the file's last change is so old that another change would get a different time. Returns whether the file is
    /// still the same then.
    fn settles(&self) -> bool {
        let Ok(Some((_, age))) = self.identity() else { return false };
        std::thread::sleep(self.settled_after.saturating_sub(age));
        let now = self.identity();
        matches!(now, Ok(Some((identity, age))) if identity == self.identity && age >= self.settled_after)
    }

    pub fn note(&self, config: &EngineConfig) -> Option<Note> {
        let note: Note = toml::from_slice(&self.cache.load_note(&self.identity)?).ok()?;
        // Limits may be lower now; the reader then reports the error.
        (note.samples <= config.read.max_vertices).then_some(note)
    }

    /// Returns the kept asset, whole if possible; `None` where the cache no longer holds it.
    ///
    /// # Errors
    /// The load was cancelled, or there is no memory for the samples.
    pub fn asset(
        &self,
        name: &str,
        note: &Note,
        admission: &Admission,
    ) -> Result<Option<ReadAsset>, Interrupt> {
        let before = admission.held();
        admission.grow(name, note.samples.saturating_mul(SAMPLE_BYTES))?;
        let mut asset = self.load(name, note);
        if let Some(model) = asset.as_mut().and_then(|asset| Arc::get_mut(&mut asset.model)) {
            model.memory = admission.keep(model.gpu_bytes());
        }
        admission.shrink_to(before);
        Ok(asset)
    }

    fn load(&self, name: &str, note: &Note) -> Option<ReadAsset> {
        let format = FORMATS.iter().copied().find(|format| *format == note.format)?;
        let whole = self.cache.load(&samples_key(&note.digest, true));
        let is_whole = whole.is_some();
        let geometries = whole.or_else(|| self.cache.load(&samples_key(&note.digest, false)))?;
        let counts: Counts = geometries.iter().map(PackedGeometry::counts).sum();
        let fits = geometries.iter().all(|geometry| geometry.kind() == GeometryKind::Samples)
            && counts.samples == note.samples
            && note.bounds.len() == geometries.len()
            && note.extras.placements.iter().all(|placed| placed.geometry < geometries.len());
        if !fits {
            tracing::warn!(asset = name, "what was kept of a cloud does not fit its note");
            return None;
        }
        let deferred = Deferred { lacks_normals: note.lacks_normals, whole: MadeOnce::default() };
        let model = AssetModel {
            memory: Reservation::default(),
            uid: next_uid(),
            name: name.to_owned(),
            format,
            packed: PackedAsset { geometries, ..PackedAsset::default() },
            bounds: note.bounds.clone(),
            has_colors: note.has_colors,
            shows_intensity: note.shows_intensity,
            has_normals: note.has_normals,
            normals_estimated: note.normals_estimated,
            beside: Vec::new(),
            tree: MadeOnce::default(),
            outlined: OnceLock::new(),
            deferred: (!is_whole).then_some(deferred),
        };
        tracing::info!(asset = name, samples = note.samples, is_whole, "a large cloud was kept");
        Some(ReadAsset { model: Arc::new(model), extras: note.extras.clone(), digest: note.digest })
    }

    /// Prepares to keep an asset that was just read, if it is a large cloud and the file is unchanged.
    pub fn keep(&self, read: &ReadAsset) -> Option<UnwrittenCloud> {
        let deferred = read.model.deferred.as_ref()?;
        if !self.is_same() {
            return None;
        }
        let model = &read.model;
        let note = Note {
            digest: read.digest,
            format: model.format.to_owned(),
            has_colors: model.has_colors,
            shows_intensity: model.shows_intensity,
            has_normals: model.has_normals,
            normals_estimated: model.normals_estimated,
            lacks_normals: deferred.lacks_normals,
            samples: model.counts().samples,
            bounds: model.bounds.clone(),
            extras: read.extras.clone(),
        };
        let is_plain = model.packed.materials.is_empty()
            && model.packed.textures.is_empty()
            && FORMATS.contains(&model.format);
        is_plain.then(|| UnwrittenCloud { entry: self.clone(), note, model: model.clone() })
    }
}

/// A cloud to be written.
pub struct UnwrittenCloud {
    entry: CloudEntry,
    note: Note,
    model: Arc<AssetModel>,
}

impl UnwrittenCloud {
    /// Writes samples and note once the file has settled. A cache that cannot be written costs a warning, and the next process
    /// has to read the file again.
    pub fn write(self) {
        if !self.entry.settles() {
            return;
        }
        let cache = &self.entry.cache;
        let [points, whole] =
            [false, true].map(|is_whole| samples_key(&self.note.digest, is_whole));
        // The estimate may have finished first.
        let stored = match cache.holds(&whole) {
            true => Ok(true),
            false => cache.store(&points, &self.model.packed.geometries),
        };
        let written = stored.and_then(|stored| {
            let text = toml::to_string(&self.note).map_err(io::Error::other)?;
            if stored { cache.store_note(&self.entry.identity, text.as_bytes()) } else { Ok(()) }
        });
        if let Err(error) = written {
            let folder = cache.folder().display();
            tracing::warn!(asset = self.model.name, %folder, %error, "a large cloud cannot be kept");
        }
    }
}

/// Keeps an asset's samples with all normals and kernels in place of the samples without them.
pub fn keep_whole(cache: &BakeCache, digest: &[u8; 32], whole: &AssetModel) {
    match cache.store(&samples_key(digest, true), &whole.packed.geometries) {
        Ok(true) => cache.remove(&samples_key(digest, false)),
        Ok(false) => {}
        Err(error) => {
            let folder = cache.folder().display();
            tracing::warn!(asset = whole.name, %folder, %error, "a large cloud cannot be kept");
        }
    }
}

fn samples_key(digest: &[u8; 32], is_whole: bool) -> [u8; 32] {
    let kind: &[u8] = if is_whole { b"whole cloud\0" } else { b"points of a cloud\0" };
    let hasher = Sha256::new_with_prefix(kind).chain_update(crate::BUILD);
    hasher.chain_update(digest).finalize().into()
}

impl CloudEntry {
    /// Returns the file's identity and the age of its last change; `None` if it is no file. The identity differs between files,
    /// and before and after a change, and needs no reading of the whole file.
    #[cfg(unix)]
    fn identity(&self) -> io::Result<Option<([u8; 32], Duration)>> {
        use std::os::unix::fs::MetadataExt;
        let mut file = File::open(&self.file)?;
        let about = file.metadata()?;
        if !about.is_file() {
            return Ok(None);
        }
        let changed = Duration::new(about.ctime().max(0).unsigned_abs(), about.ctime_nsec() as u32);
        let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        let mut hasher = Sha256::new_with_prefix(b"note\0");
        hasher.update(crate::BUILD);
        hasher.update(file_kind(&self.file));
        hasher.update([u8::from(self.is_bare)]);
        hasher.update((self.estimate_at_once as u64).to_le_bytes());
        for number in [about.dev(), about.ino(), about.len()] {
            hasher.update(number.to_le_bytes());
        }
        for time in [about.mtime(), about.mtime_nsec(), about.ctime(), about.ctime_nsec()] {
            hasher.update(time.to_le_bytes());
        }
        let last = about.len().saturating_sub(PROBE_BYTES);
        let mut block = Vec::with_capacity(PROBE_BYTES as usize);
        for probe in 0..PROBES {
            let at = u128::from(last) * u128::from(probe) / u128::from(PROBES - 1);
            file.seek(SeekFrom::Start(at as u64))?;
            block.clear();
            (&mut file).take(PROBE_BYTES).read_to_end(&mut block)?;
            hasher.update(&block);
        }
        Ok(Some((hasher.finalize().into(), now.saturating_sub(changed))))
    }

    #[cfg(not(unix))]
    fn identity(&self) -> io::Result<Option<([u8; 32], Duration)>> {
        Ok(None)
    }
}

#[cfg(test)]
mod tests {
    use glam::{DAffine3, DVec3};

    use super::*;
    use crate::assets::Placement;
    use crate::bake::upright::{End, Shape};
    use crate::math::{Camera, Lens, Sensor, SensorView};

    #[test]
    fn a_stored_note_keeps_every_number() {
        let third = 1.0 / 3.0;
        let of = |lens| Camera {
            eye: DVec3::splat(1e300 * third),
            target: DVec3::new(-0.0, 5e-324, 4_567_890.123_456_79),
            up: DVec3::Y,
            lens,
        };
        let [near, far] =
            [Lens::Perspective { fov_deg: 40.0 * third }, Lens::Orthographic { height: 12.5 }]
                .map(of);
        let end = End { balance: -third, tilt: f64::INFINITY, ..End::default() };
        let shape = Shape { ends: [[end; 2]; 3], is_cloud: true, ..Shape::default() };
        let affine = DAffine3::from_scale(DVec3::splat(third));
        for sensor in [
            None,
            Some(Sensor::Place(DVec3::splat(-third))),
            Some(Sensor::View(SensorView { camera: near, aspect: third })),
        ] {
            let placed = Placement {
                name: "a \"b\"\n".to_owned(),
                geometry: 1,
                asset_from_geometry: affine,
            };
            let note = Note {
                digest: [255; 32],
                format: "ply".to_owned(),
                has_colors: true,
                shows_intensity: false,
                has_normals: false,
                normals_estimated: true,
                lacks_normals: true,
                samples: 1 << 40,
                bounds: vec![Bounds { min: DVec3::splat(-third), max: DVec3::ONE }, Bounds::EMPTY],
                extras: Extras {
                    placements: Arc::new(vec![placed]),
                    cameras: vec![("near".to_owned(), near), ("far".to_owned(), far)],
                    sensor,
                    shape: Some(shape),
                    warnings: vec!["a warning".to_owned()],
                },
            };
            let text = toml::to_string(&note).unwrap();
            let read: Note = toml::from_slice(text.as_bytes()).unwrap();
            assert_eq!(
                (read.digest, read.samples, &read.bounds),
                (note.digest, note.samples, &note.bounds)
            );
            let (kept, own) = (&read.extras, &note.extras);
            assert_eq!(
                (&kept.cameras, kept.sensor, kept.shape),
                (&own.cameras, own.sensor, own.shape)
            );
            assert_eq!(kept.warnings, own.warnings);
            let placed = &kept.placements[0];
            assert_eq!((&placed.name, placed.geometry), (&own.placements[0].name, 1));
            assert_eq!(placed.asset_from_geometry, affine);
        }
    }
}
