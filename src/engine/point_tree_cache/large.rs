//! Builds the trees of assets with temporary files where building in memory would exceed the limit.

use std::collections::HashSet;
use std::path::Path;
use std::time::Instant;

use super::{BakeEvent, BakeSource, BakedAsset, figures};
use crate::assets::{PointBlocks, ReadOptions};
use crate::bake::cache::BakeCache;
use crate::bake::external::{BakeFault, Memory, Packed, Phase, Work, grow_tree, pack_points};
use crate::bake::pack::{PackedGeometry, PackedSamples};
use crate::engine::asset_keys::{AssetKeys, spilled_tree_key};
use crate::engine::bake_service::Watch;
use crate::engine::library::{asset_error, load_one};
use crate::engine::point_trees::{Halt, bake};
use crate::engine::{EngineConfig, EngineError};
use crate::residency::model::AssetModel;
use crate::scene::{AssetSource, Scene};

/// Upper bound of the memory that reading a point and building its tree take, in bytes; measured.
const BYTES_A_POINT: u64 = 450;
/// Bytes per sample for building the tree alone, beside the packed samples.
pub const BYTES_A_SAMPLE: u64 = 350;

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
                if asset.counts() == (0, 0) {
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
