//! Scenes of point trees: what `lod=spt` draws instead of a scene's assets as they are.
//!
//! A tree is built from an asset's packed samples when a frame first asks for it, or read from the cache on disk
//! ([`super::baking`]), and kept with the asset, so that scenes and revisions share it. The scene of trees is a scene of its own to the GPU ([`SceneModel::trees`]): it comes and goes by itself.

use std::collections::HashMap;
use std::sync::{Arc, OnceLock};

use glam::{DAffine3, DMat3, DVec3, Vec3};

use super::EngineError;
use super::baking::{BakeSource, read_or_build};
use super::library::{Loaded, asset_error, next_uid};
use crate::assets::{AssetError, MeshPart, PointCloud, Texture};
use crate::bake::cache::BakeCache;
use crate::bake::hybrid::{hybrid_mesh, is_watertight};
use crate::bake::pack::{
    PackError, PackedAsset, PackedGeometry, PackedMesh, PackedSamples, pack_hybrid, unpack_mesh,
    unpack_samples, unpack_texture,
};
use crate::bake::tree::{Above, Measures, Root, build_crowd, build_tree, build_tree_within};
use crate::bake::{CUTOFF, circle};
use crate::math::Bounds;
use crate::plan::SceneFacts;
use crate::residency::model::{AssetModel, ModelInstance, SceneModel};
use crate::scene::color::{linear_from_srgb, srgb_from_linear};

/// A scene of trees, and what a plan depends on in it.
#[derive(Clone)]
pub struct TreeScene {
    pub model: Arc<SceneModel>,
    pub facts: SceneFacts,
}

/// The trees of an asset, made by whoever asks first, and where they came from.
pub(super) fn asset_tree(
    asset: &AssetModel,
    cache: Option<&BakeCache>,
) -> Result<(Arc<AssetModel>, BakeSource), EngineError> {
    let mut source = BakeSource::Kept;
    let tree = asset.tree.get_or_init(|| {
        let (tree, made) = bake(asset, cache)?;
        source = made;
        Ok(Arc::new(tree))
    });
    match tree {
        Ok(tree) => Ok((tree.clone(), source)),
        Err(error) => Err(tree_error(asset, error)),
    }
}

pub(super) fn tree_error(asset: &AssetModel, error: &PackError) -> EngineError {
    asset_error(AssetError::Malformed {
        file: asset.name.clone(),
        place: "positions".to_owned(),
        reason: error.to_string(),
    })
}

/// Reads the trees of an asset from the cache, or builds them.
pub(super) fn bake(
    asset: &AssetModel,
    cache: Option<&BakeCache>,
) -> Result<(AssetModel, BakeSource), PackError> {
    let began = std::time::Instant::now();
    let (geometries, source) = read_or_build(asset, cache, || build(asset))?;
    let mut bounds = asset.bounds.clone();
    let mut beside = vec![None; asset.packed.geometries.len()];
    for (index, geometry) in asset.packed.geometries.iter().enumerate() {
        if matches!(geometry, PackedGeometry::Mesh(_)) {
            beside[index] = Some(bounds.len());
            bounds.push(asset.bounds[index]);
        }
    }
    let packed = PackedAsset {
        geometries,
        materials: asset.packed.materials.clone(),
        textures: asset.packed.textures.clone(),
    };
    let tree = AssetModel {
        uid: next_uid(),
        name: asset.name.clone(),
        packed,
        bounds,
        beside,
        tree: OnceLock::new(),
        ..*asset
    };
    let (nodes, _) = tree.counts();
    let elapsed_ms = began.elapsed().as_millis() as u64;
    let from_cache = source == BakeSource::Cached;
    tracing::info!(asset = asset.name, nodes, elapsed_ms, from_cache, "point trees ready");
    Ok((tree, source))
}

/// For each geometry its tree, and behind them the triangles of each mesh.
fn build(asset: &AssetModel) -> Result<Vec<PackedGeometry>, PackError> {
    let mut geometries = Vec::with_capacity(asset.packed.geometries.len());
    let mut meshes = Vec::new();
    let textures: Vec<Texture> = asset.packed.textures.iter().map(unpack_texture).collect();
    for (index, geometry) in asset.packed.geometries.iter().enumerate() {
        geometries.push(match geometry {
            PackedGeometry::Samples(samples) => {
                PackedGeometry::Samples(build_tree(&unpack_samples(samples), None)?)
            }
            PackedGeometry::Mesh(packed) => {
                let (tree, triangles) = hybrid(asset, packed, asset.bounds[index], &textures)?;
                meshes.push(PackedGeometry::Mesh(triangles));
                PackedGeometry::Samples(tree)
            }
        });
    }
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
            // Through what alpha cuts out of a surface its far side is seen from behind.
            let cut = |part: &MeshPart| {
                let material = part.material.and_then(|m| asset.packed.materials.get(m as usize));
                material.is_some_and(|material| material.alpha_cutoff.is_some())
            };
            let closed = !mesh.parts.iter().any(cut) && is_watertight(&mesh);
            let stands = Some(&hybrid.stands[..]);
            let tree = build_tree_within(&hybrid.samples, stands, bounds, closed)?;
            let triangles = pack_hybrid(&mesh, tree.grid, &hybrid.sides)?;
            Ok((tree, triangles))
        }
        Err(error) => {
            tracing::warn!(asset = asset.name, %error, "a mesh keeps all its triangles");
            let sides = vec![ALWAYS; mesh.triangles.len()];
            let tree = PackedSamples { grid: packed.grid, ..PackedSamples::default() };
            Ok((tree, pack_hybrid(&mesh, packed.grid, &sides)?))
        }
    }
}

impl Loaded {
    /// Whether [`Loaded::trees`] costs nothing.
    pub fn has_trees(&self) -> bool {
        self.trees.get().is_some()
    }

    /// The scene's point trees, read from `cache` or built when they are first asked for: that may take seconds.
    ///
    /// # Errors
    /// A geometry that cannot be packed with its disks.
    pub fn trees(&self, cache: Option<&BakeCache>) -> Result<TreeScene, EngineError> {
        self.trees.get_or_init(|| self.make_trees(cache)).clone()
    }

    fn make_trees(&self, cache: Option<&BakeCache>) -> Result<TreeScene, EngineError> {
        let trees = self.model.assets.iter().map(|asset| Ok(asset_tree(asset, cache)?.0));
        let mut assets = trees.collect::<Result<Vec<_>, EngineError>>()?;
        let mut instances = self.model.instances.clone();
        if instances.len() >= LEAST_CROWD {
            instances = self.crowd(&mut assets, &instances)?;
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
        let has_samples = model.counts().samples > 0;
        let facts = SceneFacts { trees: true, has_samples, ..self.facts };
        Ok(TreeScene { model: Arc::new(model), facts })
    }

    /// Sorts instances by place and puts a tree over them, an asset and an instance of its own: from afar whole groups of them
    /// are a few nodes.
    fn crowd(
        &self,
        assets: &mut Vec<Arc<AssetModel>>,
        instances: &[ModelInstance],
    ) -> Result<Vec<ModelInstance>, EngineError> {
        let began = std::time::Instant::now();
        let mut known: HashMap<(usize, usize), Option<Root>> = HashMap::new();
        let mut roots = PointCloud { oriented: true, ..PointCloud::default() };
        let (mut normals, mut colors, mut kernels) = (Vec::new(), Vec::new(), Vec::new());
        let (mut stands, mut owners) = (Vec::new(), Vec::new());
        for (number, instance) in instances.iter().enumerate() {
            let packed = &assets[instance.asset].packed.geometries[instance.geometry];
            let key = (instance.asset, instance.geometry);
            let root = known.entry(key).or_insert_with(|| match packed {
                PackedGeometry::Samples(tree) => Root::of(tree),
                PackedGeometry::Mesh(_) => None,
            });
            let Some(root) = root else { continue };
            let map = &instance.world_from_geometry;
            let position = map.transform_point3(root.position);
            let scale = stretch(&map.matrix3) as f32;
            if !(position.is_finite() && scale.is_finite()) {
                continue;
            }
            roots.positions.push(position);
            let normal = turned(&map.matrix3, root.normal);
            normals.push(normal);
            colors.push(self.painted(instance, root.color));
            kernels.push(circle(normal, root.radius * scale / CUTOFF));
            let Measures { error, size } = root.measures;
            stands.push(Measures { error: error * scale, size: size * scale });
            owners.push(number);
        }
        roots.normals = Some(normals);
        roots.colors = Some(colors);
        roots.kernels = Some(kernels);
        let (packed, above) = build_crowd(&roots, &stands).map_err(|error| {
            EngineError::Internal(format!("a tree over the instances cannot be built: {error}"))
        })?;
        let mut sorted = Vec::with_capacity(instances.len() + 1);
        let mut seen = vec![false; instances.len()];
        for (root, above) in above {
            let number = owners[root as usize];
            seen[number] = true;
            sorted.push(ModelInstance { above, ..instances[number] });
        }
        // What is not a tree stands by itself.
        sorted.extend(seen.iter().zip(instances).filter(|(seen, _)| !**seen).map(|(_, i)| *i));
        let nodes = packed.nodes.len() as u64;
        if nodes > 0 {
            let bounds = Bounds::of(roots.positions.iter().copied());
            sorted.push(ModelInstance {
                asset: assets.len(),
                geometry: 0,
                world_from_geometry: DAffine3::IDENTITY,
                material: None,
                id: 0,
                above: Above::NOTHING,
            });
            assets.push(Arc::new(AssetModel {
                uid: next_uid(),
                name: "instances".to_owned(),
                format: "crowd",
                packed: PackedAsset {
                    geometries: vec![PackedGeometry::Samples(packed)],
                    materials: Vec::new(),
                    textures: Vec::new(),
                },
                bounds: vec![bounds],
                has_colors: true,
                has_normals: true,
                normals_estimated: false,
                beside: Vec::new(),
                tree: OnceLock::new(),
            }));
        }
        let elapsed_ms = began.elapsed().as_millis() as u64;
        tracing::info!(
            scene = self.model.id,
            instances = owners.len(),
            nodes,
            elapsed_ms,
            "tree over instances built"
        );
        Ok(sorted)
    }

    /// The color of an instance's root under its material.
    fn painted(&self, instance: &ModelInstance, color: [u8; 4]) -> [u8; 4] {
        let material = instance.material.and_then(|index| self.model.materials.get(index));
        let Some(base) = material.and_then(|material| material.base_color) else { return color };
        let channel = |i: usize| {
            let linear = linear_from_srgb(f64::from(color[i]) / 255.0) * f64::from(base[i]);
            (srgb_from_linear(linear.clamp(0.0, 1.0)) * 255.0).round() as u8
        };
        [channel(0), channel(1), channel(2), color[3]]
    }
}

/// No error that is accepted is larger.
const ALWAYS: f32 = 1e30;
/// Samples of one mesh at most.
const MAX_SAMPLES: u64 = 1 << 28;

/// Scenes of fewer instances have no tree over them.
const LEAST_CROWD: usize = 16;

/// The longest that a map makes a unit vector: its largest singular value, from above.
fn stretch(map: &DMat3) -> f64 {
    let square = map.transpose() * *map;
    // Gershgorin's circles; exact for what turns and scales evenly.
    let row = |v: DVec3| v.abs().element_sum();
    row(square.x_axis).max(row(square.y_axis)).max(row(square.z_axis)).sqrt()
}

/// A unit normal under a map; zero stays zero.
fn turned(map: &DMat3, normal: Vec3) -> Vec3 {
    let (x, y, z) = (map.x_axis, map.y_axis, map.z_axis);
    let cofactors = DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y));
    let sign = map.determinant().signum();
    (cofactors * normal.as_dvec3() * sign).try_normalize().map_or(Vec3::ZERO, |n| n.as_vec3())
}
