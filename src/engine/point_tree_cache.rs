//! Point trees of assets, read from the cache on disk, or built and written to the cache.
//!
//! An entry's key is the hash of all inputs of its trees ([`super::asset_keys::tree_key`]). Trees over a scene's instances are built
//! quickly and not cached. If the cache cannot be written, bakes log a warning, and the next process has to build again. Trees that
//! would exceed the memory limit of baking are built with temporary files beside the cache.

use serde::Serialize;

use super::EngineError;
use super::asset_keys::tree_key;
use super::error::asset_error;
use super::watch::{Abandoned, Watch};
use crate::assets::AssetError;
use crate::bake::cache::BakeCache;
use crate::bake::external::{BakeFault, Memory, Packed, Phase, Work, grow_tree};
use crate::bake::pack::{GeometryKind, PackError, PackedGeometry, PackedSamples};
use crate::memory::{Interrupt, OutOfMemory};
use crate::residency::model::AssetModel;

/// Source of an asset's point trees, and whether they were stored.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(tag = "source", rename_all = "snake_case")]
pub enum BakeSource {
    /// Built; there is no cache.
    Built,
    /// Built, and written to the cache.
    Stored,
    /// Built; too large for the cache.
    TooLarge,
    /// Built; the cache cannot be written for this reason.
    NotStored { reason: String },
    /// Read from the cache.
    Cached,
    /// Made earlier and still in memory.
    Kept,
}

/// Bytes per sample for building the tree alone, beside the packed samples.
pub const BYTES_A_SAMPLE: u64 = 350;

/// Why there are no trees of an asset.
#[derive(Debug)]
pub(super) enum Halt {
    Pack(PackError),
    Abandoned,
    OutOfMemory(OutOfMemory),
}

impl From<PackError> for Halt {
    fn from(error: PackError) -> Halt {
        Halt::Pack(error)
    }
}

impl From<OutOfMemory> for Halt {
    fn from(error: OutOfMemory) -> Halt {
        Halt::OutOfMemory(error)
    }
}

impl From<Abandoned> for Halt {
    fn from(_: Abandoned) -> Halt {
        Halt::Abandoned
    }
}

impl Halt {
    /// Answer to callers: an error, or that nobody waits.
    pub fn outcome<T>(self, asset: &AssetModel) -> Result<Result<T, EngineError>, Abandoned> {
        match self {
            Halt::Pack(error) => Ok(Err(tree_error(asset, &error))),
            Halt::OutOfMemory(error) => Ok(Err(Interrupt::from(error).into())),
            Halt::Abandoned => Err(Abandoned),
        }
    }
}

pub(super) fn tree_error(asset: &AssetModel, error: &PackError) -> EngineError {
    asset_error(AssetError::Malformed {
        file: asset.name.clone(),
        place: "positions".to_owned(),
        reason: error.to_string(),
    })
}

/// Returns the geometries of an asset's trees: a tree for each of its own geometries, then the triangles of each mesh.
///
/// # Errors
/// Those of `build`.
pub(super) fn read_or_build(
    asset: &AssetModel,
    cache: Option<&BakeCache>,
    watch: &Watch<'_>,
    build: impl FnOnce() -> Result<Vec<PackedGeometry>, Halt>,
) -> Result<(Vec<PackedGeometry>, BakeSource), Halt> {
    // An asset with nothing to draw needs no entry.
    let Some(cache) = cache.filter(|_| asset.counts().elements() > 0) else {
        return Ok((build()?, BakeSource::Built));
    };
    let key = tree_key(asset);
    if let Some(found) = cache.load(&key) {
        match fits(asset, &found) {
            Ok(()) => return Ok((found, BakeSource::Cached)),
            Err(reason) => {
                tracing::warn!(asset = asset.name, reason, "cached point trees are built anew");
            }
        }
    }
    if let Some(built) = build_large(asset, cache, &key, watch)? {
        return Ok((built, BakeSource::Stored));
    }
    let built = build()?;
    let source = match cache.store(&key, &built) {
        Ok(true) => BakeSource::Stored,
        Ok(false) => BakeSource::TooLarge,
        Err(error) => {
            let folder = cache.folder().display();
            tracing::warn!(asset = asset.name, %folder, %error, "point trees cannot be cached");
            BakeSource::NotStored { reason: error.to_string() }
        }
    };
    Ok((built, source))
}

/// Checks that geometries can be an asset's trees, as far as drawing relies on it; otherwise returns what is wrong. Each geometry
/// has already been checked by itself.
fn fits(asset: &AssetModel, found: &[PackedGeometry]) -> Result<(), &'static str> {
    let own = &asset.packed.geometries;
    let meshes = own.iter().enumerate().filter_map(|(index, geometry)| {
        (geometry.kind() == GeometryKind::Triangles).then_some(index)
    });
    let meshes: Vec<usize> = meshes.collect();
    if found.len() != own.len() + meshes.len() {
        return Err("they are not as many as the asset has");
    }
    let (trees, triangles) = found.split_at(own.len());
    let is_tree = |geometry: &PackedGeometry| {
        geometry.samples().is_some_and(|samples| samples.nodes.len() == samples.positions.len())
    };
    let fits = |(geometry, own): (&PackedGeometry, &PackedGeometry)| match own.kind() {
        // Full detail is the last level.
        GeometryKind::Lines => {
            geometry.kind() == GeometryKind::Lines && geometry.len() >= own.len()
        }
        GeometryKind::Samples | GeometryKind::Triangles => is_tree(geometry),
    };
    if !trees.iter().zip(own).all(fits) {
        return Err("some samples are no nodes");
    }
    for (geometry, &index) in triangles.iter().zip(&meshes) {
        if geometry.kind() != GeometryKind::Triangles {
            return Err("a mesh's triangles are none");
        }
        if geometry.grid() != trees[index].grid() {
            return Err("a mesh's triangles and samples lie on different grids");
        }
    }
    let materials = asset.packed.materials.len();
    let known = |geometry: &PackedGeometry| {
        geometry.chunks().iter().all(|chunk| chunk.material as usize <= materials)
    };
    if !found.iter().all(known) {
        return Err("they name a material that is not there");
    }
    Ok(())
}

/// Builds the tree of an asset with temporary files, where building it in memory would exceed the limit, and reads the tree from
/// the cache to which it was written. `None` if the tree fits in memory.
pub fn build_large(
    asset: &AssetModel,
    cache: &BakeCache,
    key: &[u8; 32],
    watch: &Watch<'_>,
) -> Result<Option<Vec<PackedGeometry>>, Halt> {
    let [PackedGeometry::Samples(samples)] = &asset.packed.geometries[..] else { return Ok(None) };
    let count = samples.positions.len() as u64;
    let Some(limit) = cache.bake_bytes() else { return Ok(None) };
    if count.saturating_mul(BYTES_A_SAMPLE) <= limit || !samples.clips.is_empty() {
        return Ok(None);
    }
    match grow(samples, limit, cache, key, watch) {
        Ok(built) => Ok(built),
        Err(BakeFault::Pack(error)) => Err(error.into()),
        Err(_) if watch.check().is_err() => Err(Halt::Abandoned),
        Err(error) => {
            let folder = cache.folder().display();
            tracing::warn!(asset = asset.name, %folder, %error, "point trees are built in memory");
            Ok(None)
        }
    }
}

fn grow(
    samples: &PackedSamples,
    limit: u64,
    cache: &BakeCache,
    key: &[u8; 32],
    watch: &Watch<'_>,
) -> Result<Option<Vec<PackedGeometry>>, BakeFault> {
    let spill = cache.spill(samples.positions.len() as u64)?;
    let memory = Memory::of_part(limit);
    // Leaves take about half of the time.
    let progress = |phase: Phase, done: f64| match phase {
        Phase::Leaves => watch.tell(0.5 * done),
        Phase::Nodes => watch.tell(0.5 + 0.4 * done),
        _ => {}
    };
    let work = Work::new(&spill, memory, &progress).stopped_by(watch.stop_flag());
    let (tree, _) = grow_tree(Packed::Memory(samples), &work)?;
    let stored = cache.store_spilled(key, &tree)?;
    Ok(if stored { cache.load(key) } else { None })
}
