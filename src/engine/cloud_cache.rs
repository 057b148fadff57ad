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

use glam::{DAffine3, DVec3};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::EngineConfig;
use super::asset_cache::ReadAsset;
use super::asset_keys::file_kind;
use super::uid::next_uid;
use crate::assets::{FORMATS, Placement};
use crate::bake::cache::BakeCache;
use crate::bake::pack::{Counts, GeometryKind, PackedAsset, PackedGeometry};
use crate::bake::upright::{End, Shape};
use crate::math::{Bounds, Camera, Lens, Sensor, SensorView};
use crate::memory::{Admission, Interrupt, Reservation};
use crate::residency::model::{AssetModel, Deferred};
use crate::residency::once::MadeOnce;
use crate::scene::{AssetRef, AssetSource};

/// Blocks of a file that its identity hashes, and bytes of each.
const PROBES: u64 = 64;
const PROBE_BYTES: u64 = 4096;
/// Bytes of a packed sample, including its share of a chunk.
const SAMPLE_BYTES: u64 = 24;

/// A file's content other than its samples. Floats are stored as bit patterns, because JSON does not preserve all of them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Note {
    pub digest: [u8; 32],
    format: String,
    has_colors: bool,
    shows_intensity: bool,
    has_normals: bool,
    normals_estimated: bool,
    lacks_normals: bool,
    samples: u64,
    bounds: Vec<[u64; 6]>,
    placements: Vec<(String, usize, [u64; 12])>,
    cameras: Vec<(String, [u64; 10])>,
    sensor: Option<KeptSensor>,
    shape: Option<KeptShape>,
    warnings: Vec<String>,
}

/// A [`Sensor`] with its floats as bits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
enum KeptSensor {
    /// Camera and aspect.
    View([u64; 10], u64),
    Place([u64; 3]),
}

impl KeptSensor {
    fn of(sensor: &Sensor) -> KeptSensor {
        match sensor {
            Sensor::View(view) => {
                KeptSensor::View(camera_bits(&view.camera), view.aspect.to_bits())
            }
            Sensor::Place(place) => KeptSensor::Place(bits(place.to_array())),
        }
    }

    fn sensor(&self) -> Sensor {
        match self {
            KeptSensor::View(bits, aspect) => {
                Sensor::View(SensorView { camera: camera(bits), aspect: f64::from_bits(*aspect) })
            }
            KeptSensor::Place(bits) => Sensor::Place(vec3(bits)),
        }
    }
}

/// A [`Shape`] with its floats as bits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct KeptShape {
    extent: [u64; 3],
    symmetry: [u64; 3],
    ends: [[[u64; 8]; 2]; 3],
    is_cloud: bool,
    lightness: u64,
}

impl KeptShape {
    fn of(shape: &Shape) -> KeptShape {
        let Shape { extent, symmetry, ends, is_cloud, lightness } = *shape;
        let end = |end: End| {
            let End {
                footprint,
                balance,
                contact,
                flat,
                flat_footprint,
                centroid_height,
                opening,
                tilt,
            } = end;
            bits([
                footprint,
                balance,
                contact,
                flat,
                flat_footprint,
                centroid_height,
                opening,
                tilt,
            ])
        };
        KeptShape {
            extent: bits(extent),
            symmetry: bits(symmetry),
            ends: ends.map(|both| both.map(end)),
            is_cloud,
            lightness: lightness.to_bits(),
        }
    }

    fn shape(&self) -> Shape {
        let end = |bits: [u64; 8]| {
            let [footprint, balance, contact, flat, flat_footprint, centroid_height, opening, tilt] =
                bits.map(f64::from_bits);
            End {
                footprint,
                balance,
                contact,
                flat,
                flat_footprint,
                centroid_height,
                opening,
                tilt,
            }
        };
        Shape {
            extent: self.extent.map(f64::from_bits),
            symmetry: self.symmetry.map(f64::from_bits),
            ends: self.ends.map(|both| both.map(end)),
            is_cloud: self.is_cloud,
            lightness: f64::from_bits(self.lightness),
        }
    }
}

/// The bits of a camera's numbers: eye, target, up, and the field of view of a perspective or the negative height of an orthographic view.
fn camera_bits(c: &Camera) -> [u64; 10] {
    let (eye, target, up) = (c.eye, c.target, c.up);
    let lens = match c.lens {
        Lens::Perspective { fov_deg } => fov_deg,
        Lens::Orthographic { height } => -height,
    };
    bits([eye.x, eye.y, eye.z, target.x, target.y, target.z, up.x, up.y, up.z, lens])
}

fn camera(bits: &[u64; 10]) -> Camera {
    let [eye, target, up] = [&bits[..3], &bits[3..6], &bits[6..9]].map(vec3);
    let lens = match f64::from_bits(bits[9]) {
        height if height < 0.0 => Lens::Orthographic { height: -height },
        fov_deg => Lens::Perspective { fov_deg },
    };
    Camera { eye, target, up, lens }
}

fn bits<const N: usize>(numbers: [f64; N]) -> [u64; N] {
    numbers.map(f64::to_bits)
}

fn vec3(bits: &[u64]) -> DVec3 {
    DVec3::from_slice(&bits.iter().map(|&bits| f64::from_bits(bits)).collect::<Vec<f64>>())
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
        let note: Note = serde_json::from_slice(&self.cache.load_note(&self.identity)?).ok()?;
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
            && note.placements.iter().all(|&(_, geometry, _)| geometry < geometries.len());
        if !fits {
            tracing::warn!(asset = name, "what was kept of a cloud does not fit its note");
            return None;
        }
        let bounds = note.bounds.iter().map(|b| Bounds { min: vec3(&b[..3]), max: vec3(&b[3..]) });
        let deferred = Deferred { lacks_normals: note.lacks_normals, whole: MadeOnce::default() };
        let model = AssetModel {
            memory: Reservation::default(),
            uid: next_uid(),
            name: name.to_owned(),
            format,
            packed: PackedAsset { geometries, ..PackedAsset::default() },
            bounds: bounds.collect(),
            has_colors: note.has_colors,
            shows_intensity: note.shows_intensity,
            has_normals: note.has_normals,
            normals_estimated: note.normals_estimated,
            beside: Vec::new(),
            tree: MadeOnce::default(),
            outlined: OnceLock::new(),
            deferred: (!is_whole).then_some(deferred),
        };
        let placement = |(name, geometry, affine): &(String, usize, [u64; 12])| Placement {
            name: name.clone(),
            geometry: *geometry,
            asset_from_geometry: DAffine3::from_cols_array(&affine.map(f64::from_bits)),
        };
        tracing::info!(asset = name, samples = note.samples, is_whole, "a large cloud was kept");
        Some(ReadAsset {
            model: Arc::new(model),
            placements: Arc::new(note.placements.iter().map(placement).collect()),
            cameras: note.cameras.iter().map(|(name, bits)| (name.clone(), camera(bits))).collect(),
            sensor: note.sensor.as_ref().map(KeptSensor::sensor),
            shape: note.shape.as_ref().map(KeptShape::shape),
            warnings: note.warnings.clone(),
            digest: note.digest,
        })
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
            bounds: model
                .bounds
                .iter()
                .map(|b| bits([b.min.x, b.min.y, b.min.z, b.max.x, b.max.y, b.max.z]))
                .collect(),
            placements: read
                .placements
                .iter()
                .map(|p| {
                    let affine = bits(p.asset_from_geometry.to_cols_array());
                    (p.name.clone(), p.geometry, affine)
                })
                .collect(),
            cameras: read
                .cameras
                .iter()
                .map(|(name, camera)| (name.clone(), camera_bits(camera)))
                .collect(),
            sensor: read.sensor.as_ref().map(KeptSensor::of),
            shape: read.shape.as_ref().map(KeptShape::of),
            warnings: read.warnings.clone(),
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
            let text = serde_json::to_vec(&self.note).map_err(io::Error::other)?;
            if stored { cache.store_note(&self.entry.identity, &text) } else { Ok(()) }
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
    use super::*;

    #[test]
    fn kept_cameras_have_their_projection() {
        for lens in [Lens::Perspective { fov_deg: 40.0 }, Lens::Orthographic { height: 12.5 }] {
            let own = Camera { eye: DVec3::ONE, target: DVec3::ZERO, up: DVec3::Y, lens };
            assert_eq!(camera(&camera_bits(&own)), own);
        }
    }
}
