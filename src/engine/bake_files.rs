//! Bakes the assets of a file into the cache, for the commands `bake` and `inspect`. Assets that would exceed the memory limit of
//! baking are built with temporary files beside the cache.

use std::collections::HashSet;
use std::path::Path;
use std::time::Instant;

use serde::Serialize;

use super::asset_cache::AssetCache;
use super::asset_keys::{AssetKeys, spilled_tree_key};
use super::error::{asset_error, scene_error};
use super::load::{check_path, load, load_one};
use super::loaded::Loaded;
use super::point_tree_cache::BakeSource;
use super::point_trees::{asset_tree, bake};
use super::{EngineConfig, EngineError, Source};
use crate::assets::{PointBlocks, ReadOptions};
use crate::bake::cache::BakeCache;
use crate::bake::external::{BakeFault, Memory, Packed, Phase, Work, grow_tree, pack_points};
use crate::bake::pack::{Counts, PackedGeometry};
use crate::bake::prepare;
use crate::bake::tree::TreeStatistics;
use crate::memory::Admission;
use crate::residency::model::AssetModel;
use crate::scene::{AssetSource, Scene};

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
        let elements = |asset: &AssetModel| asset.counts().elements();
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
    let Counts { samples, triangles, .. } = asset.counts();
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
            PackedGeometry::Triangles(mesh) => {
                told.triangles_beside += mesh.triangles.len() as u64;
                told.triangle_bytes += geometry.gpu_bytes();
            }
            // Lines are kept as they are.
            PackedGeometry::Lines(_) => {}
        }
    }
    told
}

/// Upper bound of the memory that reading a point and building its tree take, in bytes; measured.
const BYTES_A_POINT: u64 = 450;

/// A file of points, used as an asset of a scene, that is too large to be baked in memory.
pub struct Large {
    index: usize,
    file: PointBlocks,
}

/// Returns the assets of a scene that are too large.
pub fn large_assets(
    description: &Scene,
    options: &ReadOptions,
    cache: Option<&BakeCache>,
) -> Result<Vec<Large>, EngineError> {
    let Some(limit) = cache.and_then(BakeCache::bake_bytes) else { return Ok(Vec::new()) };
    let is_operand: HashSet<usize> =
        description.assets.iter().flat_map(|asset| asset.operands()).map(|o| o.asset).collect();
    let mut large = Vec::new();
    for (index, asset) in description.assets.iter().enumerate() {
        let AssetSource::File(source) = &asset.source else { continue };
        if source.sample.is_some() || source.features || is_operand.contains(&index) {
            continue;
        }
        // Errors of a file are reported by its reader.
        let Ok(Some(file)) = PointBlocks::open(&source.path, options) else { continue };
        if file.announced().saturating_mul(BYTES_A_POINT) > limit {
            large.push(Large { index, file });
        }
    }
    Ok(large)
}

/// Bakes each asset of a scene by itself, `large` ones with temporary files.
pub fn bake_apart(
    path: &Path,
    description: &Scene,
    large: &[Large],
    config: &EngineConfig,
    cache: &BakeCache,
    mut tell: impl FnMut(BakeEvent) + Send,
) -> Result<Vec<BakedAsset>, EngineError> {
    let unused = description.operands_only();
    let drawn: Vec<usize> = (0..description.assets.len()).filter(|&i| !unused[i]).collect();
    let (mut seen, mut keys) = (HashSet::new(), AssetKeys::default());
    let mut baked = Vec::with_capacity(drawn.len());
    for (done, &index) in drawn.iter().enumerate() {
        if !seen.insert(keys.of(description, index)?.digest) {
            continue;
        }
        let name = description.assets[index].name.as_str();
        tell(BakeEvent::Started { asset: name, done: done as u64, total: drawn.len() as u64 });
        let told = match large.iter().find(|large| large.index == index) {
            Some(large) => bake_large(name, &large.file, cache, &mut tell)
                .map_err(|fault| engine_error(name, cache, fault))?,
            None => {
                let asset = load_one(path, description, index, config)?;
                if asset.counts().elements() == 0 {
                    continue;
                }
                let began = Instant::now();
                let (tree, source) = bake(&asset, Some(cache))?;
                figures(name, &asset, &tree, source, began)
            }
        };
        tell(BakeEvent::Finished(&told));
        baked.push(told);
    }
    Ok(baked)
}

fn engine_error(name: &str, cache: &BakeCache, fault: BakeFault) -> EngineError {
    match fault {
        BakeFault::Asset(error) => asset_error(error),
        BakeFault::Pack(error) => asset_error(crate::assets::AssetError::Malformed {
            file: name.to_owned(),
            place: "positions".to_owned(),
            reason: error.to_string(),
        }),
        BakeFault::Io(source) => asset_error(crate::assets::AssetError::Io {
            file: format!("temporary files of `{name}` in {}", cache.folder().display()),
            source,
        }),
        fault @ BakeFault::Empty => EngineError::Internal(fault.to_string()),
    }
}

fn bake_large(
    name: &str,
    file: &PointBlocks,
    cache: &BakeCache,
    tell: &mut (impl FnMut(BakeEvent) + Send),
) -> Result<BakedAsset, BakeFault> {
    let began = Instant::now();
    let tell = parking_lot::Mutex::new(tell);
    let progress = |phase: Phase, done: f64| (tell.lock())(BakeEvent::Phase { phase, done });
    progress(Phase::Survey, 0.0);
    let survey = file.survey()?;
    let spill = cache.spill(survey.points)?;
    let memory = Memory::of_process(cache.bake_bytes().unwrap_or(Memory::LEAST));
    let work = Work::new(&spill, memory, &progress);
    let packed = pack_points(file, &survey, &work)?;
    let key = spilled_tree_key(&packed, &survey.bounds)?;
    let (source, tree) = match cache.figures(&key) {
        Some(figures) => (BakeSource::Cached, figures),
        None => {
            let (tree, figures) = grow_tree(Packed::Spilled(&packed), &work)?;
            let source = match cache.store_spilled(&key, &tree) {
                Ok(true) => BakeSource::Stored,
                Ok(false) => BakeSource::TooLarge,
                Err(error) => BakeSource::NotStored { reason: error.to_string() },
            };
            (source, figures)
        }
    };
    Ok(BakedAsset {
        name: name.to_owned(),
        samples: survey.points,
        triangles: 0,
        source,
        elapsed_ns: began.elapsed().as_nanos() as u64,
        tree,
        triangles_beside: 0,
        triangle_bytes: 0,
    })
}

#[cfg(test)]
mod tests;
