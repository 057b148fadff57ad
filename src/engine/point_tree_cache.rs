//! Bakes point trees asset by asset: reads them from the cache on disk, or builds them and writes them to the cache.
//!
//! An entry's key is the hash of all inputs of its trees ([`super::asset_keys::tree_key`]). Trees over a scene's instances are built
//! quickly and not cached. If the cache cannot be written, bakes log a warning, and the next process has to build again. Assets
//! that would exceed the memory limit of baking are built with temporary files beside the cache ([`large`]).

mod large;

use std::collections::HashSet;
use std::path::Path;
use std::time::Instant;

use serde::Serialize;

pub(super) use self::large::BYTES_A_SAMPLE;
use self::large::{bake_apart, build_large, large_assets};
use super::asset_keys::tree_key;
use super::bake_service::Watch;
use super::library::{AssetCache, Loaded, check_path, load, scene_error};
use super::point_trees::{Halt, asset_tree, bake};
use super::{EngineConfig, EngineError, Source};
use crate::bake::cache::BakeCache;
use crate::bake::external::Phase;
use crate::bake::pack::PackedGeometry;
use crate::bake::prepare;
use crate::bake::tree::TreeStatistics;
use crate::memory::Admission;
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

/// Statistics of an asset's point trees.
#[derive(Clone, Debug, Serialize)]
pub struct BakedAsset {
    pub name: String,
    /// Samples of the asset as it was read.
    pub samples: u64,
    pub triangles: u64,
    #[serde(flatten)]
    pub source: BakeSource,
    /// Time of reading or building, and of writing.
    pub elapsed_ns: u64,
    /// Statistics of all its trees together.
    pub tree: TreeStatistics,
    /// Triangles drawn where samples would be too coarse, and their bytes on the GPU.
    pub triangles_beside: u64,
    pub triangle_bytes: u64,
}

/// Progress of baking.
#[derive(Clone, Copy, Debug)]
pub enum BakeEvent<'a> {
    /// Counts samples and triangles of all assets, each asset once; or counts assets, where some are not read as a whole.
    Started {
        asset: &'a str,
        done: u64,
        total: u64,
    },
    /// Progress of one phase, from 0 to 1, of an asset that is built with temporary files.
    Phase {
        phase: Phase,
        done: f64,
    },
    Finished(&'a BakedAsset),
}

/// Bakes the assets of the scene file or asset file at `path` (below the configuration's root) into the cache, one after the
/// other. Nothing is kept in memory. Needs no GPU.
///
/// Files of points that would take more memory than the cache allows ([`BakeCache::bake_bytes`]) are not read as a whole.
///
/// # Errors
/// A scene that is refused; a geometry that no tree can be built of; temporary files that cannot be written.
pub fn bake_file(
    path: &Path,
    config: &EngineConfig,
    tell: impl FnMut(BakeEvent) + Send,
) -> Result<Vec<BakedAsset>, EngineError> {
    let path = check_path(path, &config.root)?;
    let cache = config.bake_cache.as_ref();
    let description = prepare::describe(&path, &config.root, &config.scene).map_err(scene_error)?;
    let large = large_assets(&description, &config.read, cache)?;
    match cache {
        Some(cache) if !large.is_empty() => {
            bake_apart(&path, &description, &large, config, cache, tell)
        }
        _ => {
            let (assets, admission) = (AssetCache::default(), Admission::new(&config.memory));
            let loaded = load("scene", &Source::at(path), config, &assets, &admission)?;
            loaded.into_whole(config)?.bake_each(cache, false, tell)
        }
    }
}

impl Loaded {
    /// Returns the trees of all drawable assets, each once. `keep` keeps them for frames, as [`Loaded::trees`] does.
    pub(super) fn bake_each(
        &self,
        cache: Option<&BakeCache>,
        keep: bool,
        mut tell: impl FnMut(BakeEvent),
    ) -> Result<Vec<BakedAsset>, EngineError> {
        let elements = |asset: &AssetModel| {
            let (samples, triangles) = asset.counts();
            samples + triangles
        };
        let mut seen = HashSet::new();
        // Another scene may have read the same file under another name.
        let names = self.info.assets.iter().map(|asset| asset.name.as_str());
        let assets: Vec<_> = self
            .model
            .assets
            .iter()
            .zip(names)
            .filter(|(asset, _)| seen.insert(asset.uid) && elements(asset) > 0)
            .collect();
        let total = assets.iter().map(|(asset, _)| elements(asset)).sum();
        let (mut done, mut baked) = (0, Vec::with_capacity(assets.len()));
        for (asset, name) in assets {
            tell(BakeEvent::Started { asset: name, done, total });
            let began = Instant::now();
            let told = if keep || asset.tree.get().is_some() {
                let (tree, source) = asset_tree(asset, cache)?;
                figures(name, asset, &tree, source, began)
            } else {
                let (tree, source) = bake(asset, cache)?;
                figures(name, asset, &tree, source, began)
            };
            tell(BakeEvent::Finished(&told));
            done += elements(asset);
            baked.push(told);
        }
        Ok(baked)
    }
}

fn figures(
    name: &str,
    asset: &AssetModel,
    tree: &AssetModel,
    source: BakeSource,
    began: Instant,
) -> BakedAsset {
    let (samples, triangles) = asset.counts();
    let mut told = BakedAsset {
        name: name.to_owned(),
        samples,
        triangles,
        source,
        elapsed_ns: began.elapsed().as_nanos() as u64,
        tree: TreeStatistics::default(),
        triangles_beside: 0,
        triangle_bytes: 0,
    };
    for geometry in &tree.packed.geometries {
        match geometry {
            PackedGeometry::Samples(samples) => {
                told.tree = told.tree.with(&TreeStatistics::of(samples));
            }
            PackedGeometry::Mesh(mesh) => {
                told.triangles_beside += mesh.triangles.len() as u64;
                told.triangle_bytes += geometry.gpu_bytes();
            }
        }
    }
    told
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
    let Some(cache) = cache.filter(|_| asset.counts() != (0, 0)) else {
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
        matches!(geometry, PackedGeometry::Mesh(_)).then_some(index)
    });
    let meshes: Vec<usize> = meshes.collect();
    if found.len() != own.len() + meshes.len() {
        return Err("they are not as many as the asset has");
    }
    let (trees, triangles) = found.split_at(own.len());
    let is_tree = |geometry: &PackedGeometry| match geometry {
        PackedGeometry::Samples(samples) => samples.nodes.len() == samples.positions.len(),
        PackedGeometry::Mesh(_) => false,
    };
    if !trees.iter().all(is_tree) {
        return Err("some samples are no nodes");
    }
    for (geometry, &index) in triangles.iter().zip(&meshes) {
        if !matches!(geometry, PackedGeometry::Mesh(_)) {
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

#[cfg(test)]
mod tests;
