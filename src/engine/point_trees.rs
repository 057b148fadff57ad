//! Scenes of point trees: what `lod=spt` draws instead of a scene's assets as they are.
//!
//! A tree is built from an asset's packed samples when a frame first asks for it, or read from the cache on disk
//! ([`super::point_tree_cache`]), and kept with the asset, so that scenes and revisions share it. The scene of trees is a scene of its own to the GPU ([`SceneModel::trees`]): it comes and goes by itself.

use std::sync::{Arc, OnceLock};

use super::EngineError;
use super::instance_trees::{InstanceTreeScene, InstanceTrees};
use super::loaded::{Loaded, TreeScene};
use super::point_tree_cache::{BYTES_A_SAMPLE, BakeSource, Halt, read_or_build, tree_error};
use super::uid::next_uid;
use super::watch::{Abandoned, Watch};
use crate::assets::{MeshPart, Texture};
use crate::bake::cache::BakeCache;
use crate::bake::hybrid::{hybrid_mesh, is_watertight};
use crate::bake::line_levels::line_levels;
use crate::bake::pack::{
    ALWAYS, GeometryKind, PackError, PackedAsset, PackedGeometry, PackedMesh, PackedSamples,
    pack_hybrid, unpack_mesh, unpack_samples, unpack_texture,
};
use crate::bake::tree::{build_tree, build_tree_within};
use crate::math::Bounds;
use crate::memory::{Interrupt, Reservation};
use crate::plan::SceneFacts;
use crate::residency::instances::{Instances, RunMeter};
use crate::residency::model::{AssetModel, SceneModel};
use crate::residency::once::MadeOnce;

/// The trees of an asset, and where they came from.
type Grown = (Arc<AssetModel>, BakeSource);

/// The trees of an asset, made by whoever asks first, and where they came from.
pub(super) fn asset_tree(
    asset: &AssetModel,
    cache: Option<&BakeCache>,
) -> Result<Grown, EngineError> {
    match asset_tree_watched(asset, cache, &Watch::NONE) {
        Ok(grown) => grown,
        // Nobody could have told it to stop.
        Err(Abandoned) => Err(EngineError::Internal("baking was given up".into())),
    }
}

fn asset_tree_watched(
    asset: &AssetModel,
    cache: Option<&BakeCache>,
    watch: &Watch<'_>,
) -> Result<Result<Grown, EngineError>, Abandoned> {
    let mut source = BakeSource::Kept;
    let tree = asset.tree.get_or_try(
        || Ok(watch.check()?),
        || match bake_watched(asset, cache, watch) {
            Ok((tree, made)) => {
                source = made;
                Ok(Ok(Arc::new(tree)))
            }
            // The asset stays as it is, but memory may be free later.
            Err(Halt::Pack(error)) => Ok(Err(error)),
            Err(halt) => Err(halt),
        },
    );
    match tree {
        Ok(Ok(tree)) => Ok(Ok((tree.clone(), source))),
        Ok(Err(error)) => Ok(Err(tree_error(asset, error))),
        Err(halt) => halt.outcome(asset),
    }
}

/// Reads the trees of an asset from the cache, or builds them.
pub(super) fn bake(
    asset: &AssetModel,
    cache: Option<&BakeCache>,
) -> Result<(AssetModel, BakeSource), EngineError> {
    bake_watched(asset, cache, &Watch::NONE).or_else(|halt| match halt.outcome(asset) {
        Ok(outcome) => outcome,
        Err(Abandoned) => Err(EngineError::Internal("baking was given up".into())),
    })
}

fn bake_watched(
    asset: &AssetModel,
    cache: Option<&BakeCache>,
    watch: &Watch<'_>,
) -> Result<(AssetModel, BakeSource), Halt> {
    let began = std::time::Instant::now();
    let (geometries, source) = read_or_build(asset, cache, watch, || {
        let bytes = asset.counts().elements().saturating_mul(BYTES_A_SAMPLE);
        let what = format!("building the point trees of `{}`", asset.name);
        let _held = asset.memory.beside(&what, bytes)?;
        build(asset, watch)
    })?;
    let mut bounds = asset.bounds.clone();
    let mut beside = vec![None; asset.packed.geometries.len()];
    for (index, geometry) in asset.packed.geometries.iter().enumerate() {
        if geometry.kind() == GeometryKind::Triangles {
            beside[index] = Some(bounds.len());
            bounds.push(asset.bounds[index]);
        }
    }
    let packed = PackedAsset {
        geometries,
        materials: asset.packed.materials.clone(),
        textures: asset.packed.textures.clone(),
    };
    let mut tree = AssetModel {
        memory: Reservation::default(),
        uid: next_uid(),
        name: asset.name.clone(),
        packed,
        bounds,
        beside,
        tree: MadeOnce::default(),
        deferred: None,
        outlined: OnceLock::new(),
        ..*asset
    };
    let what = format!("the point trees of `{}`", asset.name);
    tree.memory = asset.memory.beside(&what, tree.gpu_bytes())?;
    let nodes = tree.counts().samples;
    let elapsed_ms = began.elapsed().as_millis() as u64;
    let from_cache = source == BakeSource::Cached;
    tracing::info!(asset = asset.name, nodes, elapsed_ms, from_cache, "point trees ready");
    Ok((tree, source))
}

/// For each geometry its tree, or the levels of its lines, and behind them the triangles of each mesh.
fn build(asset: &AssetModel, watch: &Watch<'_>) -> Result<Vec<PackedGeometry>, Halt> {
    let count = asset.packed.geometries.len();
    let mut geometries = Vec::with_capacity(count);
    let mut meshes = Vec::new();
    let textures: Vec<Texture> = asset.packed.textures.iter().map(unpack_texture).collect();
    for (index, geometry) in asset.packed.geometries.iter().enumerate() {
        watch.check()?;
        watch.tell(index as f64 / count as f64);
        geometries.push(match geometry {
            PackedGeometry::Samples(samples) => {
                PackedGeometry::Samples(build_tree(&unpack_samples(samples), None)?)
            }
            PackedGeometry::Triangles(packed) => {
                let (tree, triangles) = hybrid(asset, packed, asset.bounds[index], &textures)?;
                meshes.push(PackedGeometry::Triangles(triangles));
                PackedGeometry::Samples(tree)
            }
            PackedGeometry::Lines(lines) => PackedGeometry::Lines(line_levels(lines)?),
        });
    }
    watch.check()?;
    geometries.extend(meshes);
    Ok(geometries)
}

/// A mesh as a tree of samples, and its triangles on the same grid.
fn hybrid(
    asset: &AssetModel,
    packed: &PackedMesh,
    bounds: Bounds,
    textures: &[Texture],
) -> Result<(PackedSamples, PackedMesh), PackError> {
    let mesh = unpack_mesh(packed);
    match hybrid_mesh(&mesh, &asset.packed.materials, textures, MAX_SAMPLES) {
        Ok(hybrid) => {
            // Through a translucent surface, or what alpha cuts out of one, its far side is seen from behind.
            let cut = |part: &MeshPart| {
                let material = part.material.and_then(|m| asset.packed.materials.get(m as usize));
                material
                    .is_some_and(|material| material.alpha_cutoff.is_some() || material.translucent)
            };
            let closed = !mesh.parts.iter().any(cut) && is_watertight(&mesh);
            let stands = Some(&hybrid.stands[..]);
            let mut tree = build_tree_within(&hybrid.samples, stands, bounds, closed)?;
            for chunk in &mut tree.chunks {
                chunk.material = hybrid.material.map_or(0, |material| material + 1);
            }
            let triangles = pack_hybrid(&mesh, &asset.packed.materials, tree.grid, &hybrid.sides)?;
            Ok((tree, triangles))
        }
        Err(error) => {
            tracing::warn!(asset = asset.name, %error, "a mesh keeps all its triangles");
            let sides = vec![ALWAYS; mesh.triangles.len()];
            let tree = PackedSamples { grid: packed.grid, ..PackedSamples::default() };
            Ok((tree, pack_hybrid(&mesh, &asset.packed.materials, packed.grid, &sides)?))
        }
    }
}

impl Loaded {
    /// Returns the scene's point trees, if they are baked.
    ///
    /// # Errors
    /// A geometry that cannot be packed with its disks.
    pub fn trees(&self) -> Option<Result<TreeScene, EngineError>> {
        self.trees.get().cloned()
    }

    /// Reads the scene's point trees from `cache`, or builds them, which may take seconds. Stops when `watch` says so.
    pub fn bake_trees(
        &self,
        cache: Option<&BakeCache>,
        watch: &Watch<'_>,
    ) -> Result<Result<TreeScene, EngineError>, Abandoned> {
        let make = || match self.asset_trees(cache, watch)? {
            Ok(assets) => Ok(self.make_trees(assets)),
            // Memory may be free later.
            Err(EngineError::Interrupted(Interrupt::OutOfMemory(error))) => Err(error.into()),
            Err(error) => Ok(Err(error)),
        };
        match self.trees.get_or_try(|| Ok(watch.check()?), make) {
            Ok(made) => Ok(made.clone()),
            Err(Halt::OutOfMemory(error)) => Ok(Err(Interrupt::from(error).into())),
            Err(_) => Err(Abandoned),
        }
    }

    /// The trees of all assets.
    fn asset_trees(
        &self,
        cache: Option<&BakeCache>,
        watch: &Watch<'_>,
    ) -> Result<Result<Vec<Arc<AssetModel>>, EngineError>, Abandoned> {
        let size = |asset: &AssetModel| asset.counts().elements() as f64;
        let total = self.model.assets.iter().map(|asset| size(asset)).sum::<f64>().max(1.0);
        let (mut done, mut trees) = (0.0, Vec::with_capacity(self.model.assets.len()));
        for asset in &self.model.assets {
            let part = size(asset) / total;
            match asset_tree_watched(asset, cache, &watch.part(done, part))? {
                Ok((tree, _)) => trees.push(tree),
                Err(error) => return Ok(Err(error)),
            }
            done += part;
            watch.tell(done);
        }
        Ok(Ok(trees))
    }

    fn make_trees(&self, mut assets: Vec<Arc<AssetModel>>) -> Result<TreeScene, EngineError> {
        let before = self.trees_before.lock().take();
        let count = self.model.instances.len();
        let instances;
        let mut instance_trees = None;
        if count < LEAST_INSTANCES {
            // For trees, equal instances add up to other sums.
            let meter = RunMeter::new(&assets);
            let run = meter.run(self.model.instances.iter().copied().collect());
            instances = Instances::new(vec![Arc::new(run)]);
        } else {
            let began = std::time::Instant::now();
            let before = before.and_then(|before| before.instance_trees);
            let (over, made_scene) = InstanceTrees::over(&self.model, &assets, before.as_deref())?;
            let elapsed_ms = began.elapsed().as_millis() as u64;
            let InstanceTreeScene { nodes, blocks, made, .. } = made_scene;
            tracing::info!(
                scene = self.model.id,
                instances = count,
                nodes,
                blocks,
                made,
                elapsed_ms,
                "trees over instances built"
            );
            (assets, instances) = (made_scene.assets, made_scene.instances);
            instance_trees = Some(Arc::new(over));
        }
        let model = SceneModel {
            uid: next_uid(),
            id: SceneModel::tree_id(&self.model.id),
            assets,
            instances,
            trees: true,
            totals: OnceLock::new(),
            ..SceneModel::clone(&self.model)
        };
        let (counts, looks) = (model.counts(), model.looks());
        let facts = SceneFacts { trees: true, counts, looks, ..self.facts };
        Ok(TreeScene { model: Arc::new(model), facts, instance_trees })
    }

    /// The trees of this revision, or else of the last one before that had some.
    pub fn latest_trees(&self) -> Option<TreeScene> {
        match self.trees.get() {
            Some(Ok(trees)) => Some(trees.clone()),
            _ => self.trees_before.lock().clone(),
        }
    }
}

/// Samples of one mesh at most.
const MAX_SAMPLES: u64 = 1 << 28;

/// Scenes of fewer instances have no tree over them.
const LEAST_INSTANCES: usize = 16;
