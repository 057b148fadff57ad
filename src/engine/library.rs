//! Loaded scenes in host memory: reading, baking, packing, and the changes made to them later.

use std::collections::{BTreeMap, HashMap};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, OnceLock, Weak};

use glam::DVec3;
use parking_lot::Mutex;
use sha2::{Digest, Sha256};

use super::bakes::{Abandoned, Watch};
use super::framing::{self, SceneOutline};
use super::kept::{Keeping, Kept};
use super::keys::{AssetKey, AssetKeys, digest_file, digest_packed};
use super::trees::TreeScene;
use super::{
    AssetInfo, EngineConfig, EngineError, EstimateState, Estimates, NamedCamera, NodePatch,
    SceneInfo, Source,
};
use crate::assets::warnings::condensed;
use crate::assets::{AssetError, Geometry, Placement, PointCloud, ReadOptions};
use crate::bake::CUTOFF;
use crate::bake::assemble::{AssembleError, Assembler, Prepared};
use crate::bake::estimate::{EstimateError, lacks_normals, pack_estimated};
use crate::bake::pack::{PackedAsset, PackedGeometry, pack_mesh, pack_samples, pack_texture};
use crate::bake::prepare::{self, AssetTraits, Outlook};
use crate::bake::spacing::Patch;
use crate::bake::tree::Above;
use crate::bake::upright::Shape;
use crate::math::{Bounds, Camera, CameraError, Sensor};
use crate::memory::{Admission, Reservation};
use crate::plan::SceneFacts;
use crate::residency::instances::{Instances, RunMeter};
use crate::residency::model::{AssetModel, Deferred, Extent, ModelInstance, SceneModel};
use crate::residency::once::MadeOnce;
use crate::residency::spacing;
use crate::scene::{AssetRef, CameraPath, InstancePaths, Light, Node, Scene, SceneError};

/// How far splats usually reach, in distances between neighbouring samples.
const SPLAT_REACH: f64 = 2.0;

static NEXT_UID: AtomicU64 = AtomicU64::new(1);

/// Returns a number that no asset and no scene of this process has had.
pub fn next_uid() -> u64 {
    NEXT_UID.fetch_add(1, Ordering::Relaxed)
}

/// A scene and what was derived from it.
pub struct Loaded {
    pub model: Arc<SceneModel>,
    pub facts: SceneFacts,
    pub extent: Extent,
    /// Outline for the default view, computed on first use.
    outline: OnceLock<SceneOutline>,
    /// Increases with each load; all revisions of a scene have the same.
    order: u64,
    pub info: SceneInfo,
    /// See [`Loaded::patches`].
    patches: OnceLock<Vec<Patch>>,
    /// Hash of the description and of every file's content.
    pub digest: [u8; 32],
    description: Scene,
    /// The top-level nodes of each run of instances, the same in all revisions.
    nodes: Arc<[Range<usize>]>,
    /// Memory of the description and of the list of instances.
    _memory: Reservation,
    /// See [`Loaded::trees`].
    pub(super) trees: MadeOnce<Result<TreeScene, EngineError>>,
    /// Trees of the latest earlier revision that had some, until there are new ones.
    pub(super) trees_before: Mutex<Option<TreeScene>>,
    /// For each asset, the placements of its geometries.
    placements: Vec<Arc<Vec<Placement>>>,
    /// For each asset, its content key.
    keys: Vec<AssetKey>,
    /// The scene's file, or that of its only asset.
    path: PathBuf,
    /// Large clouds that were just read and are to be kept on disk.
    pub kept: Vec<Kept>,
}

struct CachedAsset {
    model: Weak<AssetModel>,
    placements: Arc<Vec<Placement>>,
    cameras: Vec<(String, Camera)>,
    sensor: Option<Sensor>,
    shape: Option<Shape>,
    warnings: Vec<String>,
}

/// An asset after reading, shared between scenes.
pub struct ReadAsset {
    pub model: Arc<AssetModel>,
    pub placements: Arc<Vec<Placement>>,
    pub cameras: Vec<(String, Camera)>,
    pub sensor: Option<Sensor>,
    /// Measured only for bare assets.
    pub shape: Option<Shape>,
    pub warnings: Vec<String>,
    pub digest: [u8; 32],
}

/// All loaded scenes, and the assets that they share.
#[derive(Default)]
pub struct Library {
    scenes: BTreeMap<String, Arc<Loaded>>,
}

/// Assets by content, so that scenes that draw the same file share it.
#[derive(Default)]
pub struct AssetCache {
    assets: Mutex<HashMap<[u8; 32], CachedAsset>>,
}

impl AssetCache {
    /// Returns the asset of a key, reading it if no scene draws it yet.
    fn get_or_read(
        &self,
        AssetKey { digest, alone }: AssetKey,
        is_bare: bool,
        read: impl FnOnce() -> Result<ReadAsset, EngineError>,
    ) -> Result<ReadAsset, EngineError> {
        if alone
            && let Some(found) = self.assets.lock().get(&digest)
            && let Some(model) = found.model.upgrade()
            // A scene file does not measure the shapes of its assets.
            && (found.shape.is_some() || !is_bare)
        {
            return Ok(ReadAsset {
                model,
                placements: found.placements.clone(),
                cameras: found.cameras.clone(),
                sensor: found.sensor,
                shape: found.shape,
                warnings: found.warnings.clone(),
                digest,
            });
        }
        let read = read()?;
        if alone {
            let mut cached = self.assets.lock();
            cached.retain(|_, asset| asset.model.strong_count() > 0);
            cached.insert(
                digest,
                CachedAsset {
                    model: Arc::downgrade(&read.model),
                    placements: read.placements.clone(),
                    cameras: read.cameras.clone(),
                    sensor: read.sensor,
                    shape: read.shape,
                    warnings: read.warnings.clone(),
                },
            );
        }
        Ok(read)
    }

    /// Replaces incomplete assets by whole ones, for scenes that are loaded from now on.
    pub fn complete(&self) {
        for asset in self.assets.lock().values_mut() {
            let Some(held) = asset.model.upgrade() else { continue };
            if let Some(whole) = held.deferred.as_ref().and_then(|deferred| deferred.whole.get()) {
                asset.model = Arc::downgrade(whole);
            }
        }
    }
}

impl Library {
    pub fn get(&self, id: &str) -> Option<Arc<Loaded>> {
        self.scenes.get(id).cloned()
    }

    pub fn holds(&self, id: &str) -> bool {
        self.scenes.contains_key(id)
    }

    /// Returns all scenes in the order in which they were loaded.
    pub fn all(&self) -> Vec<Arc<Loaded>> {
        let mut scenes: Vec<Arc<Loaded>> = self.scenes.values().cloned().collect();
        scenes.sort_by_key(|loaded| loaded.order);
        scenes
    }

    pub fn insert(&mut self, loaded: Loaded) {
        self.scenes.insert(loaded.model.id.clone(), Arc::new(loaded));
    }

    /// Replaces `old` by `new` if `old` is still there, and returns whether it was.
    pub fn replace(&mut self, old: &Arc<Loaded>, new: Loaded) -> bool {
        match self.scenes.get_mut(&old.model.id) {
            Some(held) if Arc::ptr_eq(held, old) => {
                *held = Arc::new(new);
                true
            }
            _ => false,
        }
    }

    pub fn remove(&mut self, id: &str) -> Option<Arc<Loaded>> {
        self.scenes.remove(id)
    }
}

pub fn asset_error(error: AssetError) -> EngineError {
    match error {
        AssetError::Interrupted(interrupt) => interrupt.into(),
        error => EngineError::Asset(Arc::new(error)),
    }
}

pub fn scene_error(error: SceneError) -> EngineError {
    match error {
        SceneError::Interrupted(interrupt) => interrupt.into(),
        error => EngineError::Scene(Arc::new(error)),
    }
}

/// Reads a scene file or a bare asset and packs all that it draws.
pub fn load(
    id: &str,
    Source { path, base, up }: &Source,
    config: &EngineConfig,
    cache: &AssetCache,
    admission: &Admission,
) -> Result<Loaded, EngineError> {
    let is_scene = prepare::is_scene_file(path);
    let mut hasher = Sha256::new();
    if is_scene {
        let file = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        hasher.update(digest_file(path, &file, admission).map_err(asset_error)?);
    }
    let mut description =
        prepare::describe_within(path, base.as_deref(), &config.root, &config.scene, admission)
            .map_err(scene_error)?;
    let described = admission.held();
    let mut assets = Vec::new();
    let mut placements = Vec::new();
    let mut warnings = Vec::new();
    let mut outlook = Outlook { up: up.or(config.up), bounds: Bounds::EMPTY, ..Outlook::default() };
    let mut shape = None;
    let options = admitted(config, admission);
    let mut assembler = Assembler::new(path, &description, &options);
    let mut keys = AssetKeys::within(admission);
    let operands_only = description.operands_only();
    let shares_operands = description.assets.iter().any(|asset| !asset.operands().is_empty());
    let most = config.estimate_at_once;
    let mut asset_keys = Vec::with_capacity(description.assets.len());
    let mut kept = Vec::new();
    for (index, reference) in description.assets.iter().enumerate() {
        let keeping = Keeping::of(reference, config, !is_scene).filter(|_| !operands_only[index]);
        let note = keeping.as_ref().and_then(|keeping| keeping.note(config));
        if let Some(note) = &note {
            keys.know(index, note.digest);
        }
        let key = keys.of(&description, index)?;
        asset_keys.push(key);
        // An asset that is only an operand draws nothing, and must not be cached as its file's content.
        let asset = if operands_only[index] {
            let prepared = assembler.asset(index)?;
            pack_asset(reference, prepared, key.digest, Completeness::Points, admission)
                .map_err(Stop::error)?
        } else {
            let known = keeping.as_ref().zip(note.as_ref());
            let mut was_read = false;
            let asset = cache.get_or_read(key, !is_scene, || {
                if let Some((keeping, note)) = known
                    && let Some(asset) = keeping.asset(&reference.name, note, admission)?
                {
                    return Ok(asset);
                }
                was_read = true;
                read_asset(reference, (index, most), &mut assembler, key, admission)
            })?;
            if was_read && key.alone {
                kept.extend(keeping.and_then(|keeping| keeping.keep(&asset)));
            }
            asset
        };
        if !shares_operands {
            // Free what reading and packing reserved. The asset keeps its own memory.
            admission.shrink_to(described);
        }
        hasher.update(asset.digest);
        warnings.extend(asset.warnings.iter().map(|text| (reference.name.clone(), text.clone())));
        if description.cameras.is_empty() {
            description.cameras.extend(asset.cameras.iter().cloned());
        }
        shape = shape.or(asset.shape);
        outlook.sensor = outlook.sensor.or(asset.sensor);
        for placement in asset.placements.iter() {
            let own = asset.model.bounds[placement.geometry];
            outlook.bounds = outlook.bounds.union(own.transformed(&placement.asset_from_geometry));
        }
        assets.push(asset.model);
        placements.push(asset.placements);
    }
    if !is_scene {
        let traits: Vec<AssetTraits> = assets.iter().map(|asset| asset.traits()).collect();
        outlook.shape = shape.as_ref();
        prepare::adapt_bare_asset(&mut description, &traits, &outlook);
    }
    let mut warnings = condensed(warnings);
    warnings.extend(assets.iter().filter_map(|asset| strays(asset)));
    let splats = &description.splats;
    if f64::from(splats.cutoff) * f64::from(splats.width) < f64::from(CUTOFF) {
        warnings.push(format!(
            "splats end at {} standard deviations; estimated kernels close a surface from {CUTOFF} on",
            splats.cutoff * splats.width
        ));
    }
    if description.lights.iter().any(|light| matches!(light, Light::Sun { shadows: true, .. })) {
        warnings.push("lights ask for shadows, which this version does not draw".to_owned());
    }
    let digest = hasher.finalize().into();
    let id = id.to_owned();
    drop(assembler);
    admission.shrink_to(described);
    let parts = Parts {
        id,
        revision: 1,
        description,
        assets,
        placements,
        warnings,
        digest,
        keys: asset_keys,
        path: path.to_owned(),
    };
    Ok(Loaded { kept, ..build(parts, config, None, admission)? })
}

/// Returns the options for reading files: below the root, and within the load's memory.
fn admitted(config: &EngineConfig, admission: &Admission) -> ReadOptions {
    let mut options = config.read.clone();
    options.root.get_or_insert_with(|| config.root.clone());
    options.admission = admission.clone();
    options
}

/// Reads a single asset of a scene file or a bare asset, and estimates everything that it lacks.
pub fn load_one(
    path: &Path,
    description: &Scene,
    index: usize,
    config: &EngineConfig,
) -> Result<Arc<AssetModel>, EngineError> {
    let admission = Admission::new(&config.memory);
    let key = AssetKeys::within(&admission).of(description, index)?;
    let asset = (index, key);
    whole_asset(path, description, asset, config, &Watch::NONE, &admission).map_err(Stop::error)
}

/// Does the work of [`load_one`]; stops when `watch` says so.
fn whole_asset(
    path: &Path,
    description: &Scene,
    (index, key): (usize, AssetKey),
    config: &EngineConfig,
    watch: &Watch<'_>,
    admission: &Admission,
) -> Result<Arc<AssetModel>, Stop> {
    let options = admitted(config, admission);
    let mut assembler = Assembler::new(path, description, &options);
    let reference = &description.assets[index];
    let read = assembler.asset_without_estimates(index, config.estimate_at_once);
    let prepared = read.map_err(|error| Stop::Failed(error.into()))?;
    watch.check()?;
    watch.tell(READING);
    let watch = watch.part(READING, 1.0 - READING);
    let whole = Completeness::Whole(&watch);
    Ok(pack_asset(reference, prepared, key.digest, whole, admission)?.model)
}

/// Share of reading in the time of reading and estimating.
const READING: f64 = 0.1;

/// How complete an asset must be.
#[derive(Clone, Copy)]
enum Completeness<'a> {
    /// Only the data for drawing points without lights.
    Points,
    Whole(&'a Watch<'a>),
}

/// Reason why there is no asset.
enum Stop {
    Failed(EngineError),
    Abandoned,
}

impl Stop {
    fn error(self) -> EngineError {
        match self {
            Stop::Failed(error) => error,
            Stop::Abandoned => EngineError::Internal("estimating was given up".into()),
        }
    }
}

impl From<Abandoned> for Stop {
    fn from(_: Abandoned) -> Stop {
        Stop::Abandoned
    }
}

/// Returns the warning about points of an asset that the default view leaves out.
fn strays(asset: &AssetModel) -> Option<String> {
    let outlines = asset.outlines();
    let strays: u64 = outlines.iter().map(|outline| outline.strays).sum();
    let farthest = outlines.iter().map(|outline| outline.farthest_stray).fold(0.0, f64::max);
    let (samples, triangles) = asset.counts();
    let (name, all) = (&asset.name, samples + triangles);
    let what = if triangles > 0 { "triangles" } else { "points" };
    (strays > 0).then(|| {
        format!(
            "{name}: {strays} of {all} {what} lie far from the rest, up to {farthest:.3e} units; the default view leaves them outside its frame"
        )
    })
}

impl From<AssembleError> for EngineError {
    fn from(error: AssembleError) -> Self {
        match error {
            AssembleError::Asset(error) => asset_error(error),
            AssembleError::Interrupted(interrupt) => interrupt.into(),
            AssembleError::Scene(error) => scene_error(error),
        }
    }
}

fn read_asset(
    reference: &AssetRef,
    (index, most): (usize, usize),
    assembler: &mut Assembler,
    AssetKey { digest, alone }: AssetKey,
    admission: &Admission,
) -> Result<ReadAsset, EngineError> {
    let prepared = assembler.asset_without_estimates(index, most)?;
    let packed = pack_asset(reference, prepared, digest, Completeness::Points, admission);
    let mut read = packed.map_err(Stop::error)?;
    if !alone {
        let mut hasher = Sha256::new_with_prefix(digest);
        digest_packed(&mut hasher, &read.model.packed);
        read.digest = hasher.finalize().into();
    }
    Ok(read)
}

fn pack_asset(
    reference: &AssetRef,
    Prepared { mut asset, traits, lacking, shape }: Prepared,
    digest: [u8; 32],
    completeness: Completeness<'_>,
    admission: &Admission,
) -> Result<ReadAsset, Stop> {
    let mut geometries = Vec::with_capacity(asset.geometries.len());
    let bounds = asset.geometries.iter().map(prepare::drawn_bounds).collect();
    let (mut deferred, mut estimated) = (None, 0.0);
    let total = lacking.iter().map(|&number| size(&asset.geometries[number])).sum::<f64>();
    for (number, geometry) in asset.geometries.iter_mut().enumerate() {
        let granted = admission.grow(&reference.label(), packing_bytes(geometry));
        granted.map_err(|interrupt| Stop::Failed(interrupt.into()))?;
        let taken = std::mem::replace(geometry, Geometry::Points(PointCloud::default()));
        let packed = match (taken, completeness) {
            (Geometry::Mesh(mesh), _) => pack_mesh(&mesh).map(PackedGeometry::Mesh),
            (Geometry::Points(cloud), Completeness::Whole(watch)) if lacking.contains(&number) => {
                let part = cloud.positions.len() as f64 / total;
                let watch = watch.part(estimated, part);
                estimated += part;
                match pack_estimated(cloud, watch.stop_flag(), &|done| watch.tell(done)) {
                    Ok(samples) => Ok(PackedGeometry::Samples(samples)),
                    Err(EstimateError::Pack(error)) => Err(error),
                    Err(EstimateError::Stopped) => return Err(Stop::Abandoned),
                }
            }
            (Geometry::Points(cloud), _) => {
                if lacking.contains(&number) {
                    let deferred: &mut Deferred = deferred.get_or_insert_default();
                    deferred.lacks_normals |= lacks_normals(&cloud);
                }
                pack_samples(&cloud).map(PackedGeometry::Samples)
            }
        };
        geometries.push(packed.map_err(|error| {
            Stop::Failed(asset_error(AssetError::Malformed {
                file: reference.label(),
                place: "positions".to_owned(),
                reason: error.to_string(),
            }))
        })?);
    }
    let textures = asset.textures.iter().map(pack_texture).collect();
    let mut model = AssetModel {
        memory: Reservation::default(),
        uid: next_uid(),
        name: reference.name.clone(),
        format: asset.format,
        packed: PackedAsset { geometries, materials: asset.materials, textures },
        bounds,
        has_colors: traits.has_colors,
        shows_intensity: traits.shows_intensity,
        has_normals: traits.has_normals,
        normals_estimated: traits.normals_estimated,
        beside: Vec::new(),
        tree: MadeOnce::default(),
        deferred,
        outlined: OnceLock::new(),
    };
    model.memory = admission.keep(model.gpu_bytes());
    Ok(ReadAsset {
        model: Arc::new(model),
        placements: Arc::new(asset.placements),
        cameras: asset.cameras,
        sensor: asset.sensor,
        shape,
        warnings: asset.warnings,
        digest,
    })
}

/// Bytes needed to pack a geometry: the sort's keys and order, and the packed copy.
fn packing_bytes(geometry: &Geometry) -> u64 {
    match geometry {
        Geometry::Points(cloud) => 40 * cloud.positions.len() as u64,
        Geometry::Mesh(mesh) => 48 * mesh.positions.len() as u64 + 72 * mesh.triangles.len() as u64,
    }
}

fn size(geometry: &Geometry) -> f64 {
    geometry.positions().len() as f64
}

/// The parts of a scene, as read.
struct Parts {
    id: String,
    revision: u64,
    description: Scene,
    assets: Vec<Arc<AssetModel>>,
    placements: Vec<Arc<Vec<Placement>>>,
    warnings: Vec<String>,
    digest: [u8; 32],
    keys: Vec<AssetKey>,
    path: PathBuf,
}

/// Bytes of an instance, including its temporary entries while the list is made.
const INSTANCE_BYTES: u64 = 2 * size_of::<ModelInstance>() as u64;

/// Largest number of instances in a run of top-level nodes, unless the run is one node.
const RUN: u64 = 4096;

/// Lists the instances of a description in runs. Runs of `before`, the last revision, are reused unless they have the changed
/// node.
fn unfold(
    parts: &Parts,
    nodes: &[Range<usize>],
    before: Option<(&Instances, usize)>,
    most: u64,
) -> Result<Instances, EngineError> {
    let unfolding = parts.description.unfolding();
    let meter = RunMeter::new(&parts.assets);
    let mut next = 1u64;
    let mut runs = Vec::with_capacity(nodes.len());
    for (index, nodes) in nodes.iter().enumerate() {
        let kept = before.filter(|(_, changed)| !nodes.contains(changed));
        let kept = kept.and_then(|(before, _)| before.runs().get(index));
        let run = match kept {
            Some(run) if run.members.first().is_none_or(|first| u64::from(first.id) == next) => {
                run.clone()
            }
            // The numbers shift when an earlier run has changed its length.
            Some(run) => Arc::new(run.numbered_from(next as u32)),
            None => {
                let instances = unfolding.instances(nodes.clone());
                let placed = prepare::placed_instances(instances, &parts.placements);
                let members = placed.zip(next..).map(|(placed, id)| ModelInstance {
                    asset: placed.asset,
                    geometry: placed.geometry,
                    world_from_geometry: placed.world_from_geometry,
                    material: placed.material,
                    id: id as u32,
                    above: Above::NOTHING,
                });
                // One instance over the limit is enough to detect the excess.
                let room = usize::try_from((most + 2).saturating_sub(next)).unwrap_or(usize::MAX);
                Arc::new(meter.run(members.take(room).collect()))
            }
        };
        next += run.members.len() as u64;
        if next - 1 > most {
            let (what, found) = ("instances", next - 1);
            return Err(EngineError::OverLimit { what, found, limit: most });
        }
        runs.push(run);
    }
    Ok(Instances::new(runs))
}

/// Builds a scene from its parts: completely, or as `before` with one node changed.
fn build(
    parts: Parts,
    config: &EngineConfig,
    before: Option<(&Loaded, usize)>,
    admission: &Admission,
) -> Result<Loaded, EngineError> {
    let nodes = match before {
        Some((loaded, _)) => loaded.nodes.clone(),
        None => parts.description.node_runs(RUN).into(),
    };
    let known = before.map(|(loaded, changed)| (&loaded.model.instances, changed));
    let listed = parts.description.instance_count().saturating_mul(INSTANCE_BYTES);
    admission.grow("a list of instances", listed)?;
    let instances = unfold(&parts, &nodes, known, config.scene.max_instances)?;
    let Parts { id, revision, description, assets, placements, warnings, digest, keys, path } =
        parts;
    let model = SceneModel {
        uid: next_uid(),
        id,
        name: description.name.clone(),
        revision,
        assets,
        instances,
        materials: description.materials.clone(),
        lights: description.lights.clone(),
        background: description.background,
        cameras: description.cameras.clone(),
        up: description.up,
        splats: description.splats,
        trees: false,
        totals: OnceLock::new(),
    };
    let extent = model.extent();
    let info = describe(&model, &description, &extent.bounds, warnings);
    Ok(Loaded {
        facts: facts(&model),
        model: Arc::new(model),
        extent,
        outline: OnceLock::new(),
        order: before.map_or_else(next_uid, |(loaded, _)| loaded.order),
        info,
        patches: OnceLock::new(),
        digest,
        description,
        nodes,
        _memory: admission.keep(admission.held()),
        trees: MadeOnce::default(),
        trees_before: Mutex::new(before.and_then(|(loaded, _)| loaded.latest_trees())),
        placements,
        keys,
        path,
        kept: Vec::new(),
    })
}

fn facts(model: &SceneModel) -> SceneFacts {
    let counts = model.counts();
    SceneFacts {
        has_samples: counts.samples > 0,
        has_triangles: counts.triangles > 0,
        lights: model.lights.len() as u32,
        trees: false,
        chunks: counts.chunks,
    }
}

pub fn node_name(node: &Node, index: usize) -> String {
    node.name.clone().unwrap_or_else(|| index.to_string())
}

fn describe(
    model: &SceneModel,
    description: &Scene,
    bounds: &Bounds,
    warnings: Vec<String>,
) -> SceneInfo {
    let counts = model.counts();
    SceneInfo {
        id: model.id.clone(),
        name: model.name.clone(),
        revision: model.revision,
        bounds: (!bounds.is_empty()).then(|| [bounds.min.into(), bounds.max.into()]),
        samples: counts.samples,
        triangles: counts.triangles,
        instances: counts.instances,
        assets: model
            .assets
            .iter()
            .zip(&description.assets)
            .map(|(asset, reference)| {
                let (samples, triangles) = asset.counts();
                AssetInfo {
                    // Another scene may have read the same file under another name.
                    name: reference.name.clone(),
                    format: asset.format,
                    samples,
                    triangles,
                    has_colors: asset.has_colors,
                    shows_intensity: asset.shows_intensity,
                    has_normals: asset.has_normals,
                    normals_estimated: asset.normals_estimated,
                }
            })
            .collect(),
        gpu_bytes: model.gpu_bytes(),
        resident: false,
        estimates: Estimates { state: EstimateState::Complete, done: 1.0, reason: None },
        cameras: model
            .cameras
            .iter()
            .map(|(name, camera)| NamedCamera::new(name, camera))
            .collect(),
        paths: description.paths.iter().map(|(name, _)| name.clone()).collect(),
        nodes: description
            .nodes
            .iter()
            .enumerate()
            .map(|(index, node)| node_name(node, index))
            .collect(),
        lights: model.lights.len(),
        up: if model.up == DVec3::ZERO { DVec3::Y } else { model.up }.into(),
        up_because: description.up_because.clone(),
        warnings,
    }
}

impl Loaded {
    /// Returns the scene with one top-level node changed, at the next revision.
    pub fn patched(
        &self,
        node: &str,
        patch: &NodePatch,
        config: &EngineConfig,
    ) -> Result<Loaded, EngineError> {
        let mut description = self.description.clone();
        let index = description
            .nodes
            .iter()
            .enumerate()
            .position(|(index, candidate)| node_name(candidate, index) == node)
            .ok_or_else(|| EngineError::UnknownNode {
                scene: self.model.id.clone(),
                node: node.to_owned(),
            })?;
        if let Some(transform) = patch.world_from_node {
            description.nodes[index].parent_from_node = transform;
        }
        if let Some(visible) = patch.visible {
            description.nodes[index].visible = visible;
        }
        let mut hasher = Sha256::new();
        hasher.update(self.digest);
        hasher.update(format!("{node}{patch:?}"));
        let parts = Parts {
            id: self.model.id.clone(),
            revision: self.model.revision + 1,
            description,
            assets: self.model.assets.clone(),
            placements: self.placements.clone(),
            warnings: self.info.warnings.clone(),
            digest: hasher.finalize().into(),
            keys: self.keys.clone(),
            path: self.path.clone(),
        };
        build(parts, config, Some((self, index)), &Admission::new(&config.memory))
    }

    /// Returns the load's number, which all revisions of a scene share and no later scene of the same id has.
    pub fn load(&self) -> u64 {
        self.order
    }

    /// Returns whether all samples have normals and kernels.
    pub fn is_whole(&self) -> bool {
        self.model.assets.iter().all(|asset| asset.deferred.is_none())
    }

    /// Returns whether some sample has no normal yet.
    pub fn lacks_normals(&self) -> bool {
        let deferred = self.model.assets.iter().filter_map(|asset| asset.deferred.as_ref());
        deferred.into_iter().any(|deferred| deferred.lacks_normals)
    }

    /// Reads the files of assets that lack normals or kernels again and estimates these. [`Loaded::completed`] then returns the
    /// scene with them.
    pub fn estimate(
        &self,
        config: &EngineConfig,
        watch: &Watch<'_>,
    ) -> Result<Result<(), EngineError>, Abandoned> {
        let lacking = || {
            let assets = self.model.assets.iter().enumerate();
            assets.filter_map(|(index, asset)| Some((index, asset, asset.deferred.as_ref()?)))
        };
        let size = |asset: &AssetModel| asset.counts().0 as f64;
        let total = lacking().map(|(_, asset, _)| size(asset)).sum::<f64>().max(1.0);
        let mut done = 0.0;
        for (index, asset, deferred) in lacking() {
            let part = size(asset) / total;
            let watch = watch.part(done, part);
            let made = deferred
                .whole
                .get_or_try(|| Ok(watch.check()?), || self.whole_asset(index, config, &watch));
            match made {
                Ok(_) => {}
                Err(Stop::Failed(error)) => return Ok(Err(error)),
                Err(Stop::Abandoned) => return Err(Abandoned),
            }
            done += part;
        }
        Ok(Ok(()))
    }

    /// Returns the scene with everything that its samples lack. Blocks.
    pub fn into_whole(self, config: &EngineConfig) -> Result<Loaded, EngineError> {
        match self.estimate(config, &Watch::NONE) {
            Ok(estimated) => estimated?,
            Err(Abandoned) => return Err(Stop::Abandoned.error()),
        }
        Ok(self.completed(config)?.unwrap_or(self))
    }

    /// Returns the assets with estimates, each with the hash of its content.
    pub fn estimated(&self) -> Vec<([u8; 32], Arc<AssetModel>)> {
        let whole = |asset: &Arc<AssetModel>| asset.deferred.as_ref()?.whole.get().cloned();
        let assets = self.model.assets.iter().zip(&self.keys);
        // The cache finds assets by the content of one file.
        let alone = assets.filter(|(_, key)| key.alone);
        alone.filter_map(|(asset, key)| Some((key.digest, whole(asset)?))).collect()
    }

    fn whole_asset(
        &self,
        index: usize,
        config: &EngineConfig,
        watch: &Watch<'_>,
    ) -> Result<Arc<AssetModel>, Stop> {
        if let Some(latch) = &config.estimate_latch {
            latch.pass(watch)?;
        }
        let (began, key) = (std::time::Instant::now(), self.keys[index]);
        let admission = Admission::new(&config.memory);
        let found =
            AssetKeys::within(&admission).of(&self.description, index).map_err(Stop::Failed)?;
        if found.digest != key.digest {
            return Err(Stop::Failed(asset_error(AssetError::Malformed {
                file: self.description.assets[index].label(),
                place: "file".to_owned(),
                reason: "has changed since the scene was loaded, so that its normals and kernels \
                    cannot be estimated; delete the scene and load it again"
                    .to_owned(),
            })));
        }
        let asset = (index, key);
        let whole = whole_asset(&self.path, &self.description, asset, config, watch, &admission)?;
        let elapsed_ms = began.elapsed().as_millis() as u64;
        let (samples, _) = whole.counts();
        tracing::info!(asset = whole.name, samples, elapsed_ms, "normals and kernels estimated");
        Ok(whole)
    }

    /// Returns the scene with incomplete assets replaced by whole ones, at the same revision; `None` while these are not there,
    /// or where nothing was lacking.
    pub fn completed(&self, config: &EngineConfig) -> Result<Option<Loaded>, EngineError> {
        let whole = |asset: &Arc<AssetModel>| match &asset.deferred {
            Some(deferred) => deferred.whole.get().cloned(),
            None => Some(asset.clone()),
        };
        let assets: Option<Vec<_>> = self.model.assets.iter().map(whole).collect();
        let Some(assets) = assets.filter(|_| !self.is_whole()) else { return Ok(None) };
        let parts = Parts {
            id: self.model.id.clone(),
            revision: self.model.revision,
            description: self.description.clone(),
            assets,
            placements: self.placements.clone(),
            warnings: self.info.warnings.clone(),
            digest: self.digest,
            keys: self.keys.clone(),
            path: self.path.clone(),
        };
        let whole = build(parts, config, None, &Admission::new(&config.memory))?;
        Ok(Some(Loaded { order: self.order, ..whole }))
    }

    /// Returns a camera path that the scene names.
    pub fn camera_path(&self, name: &str) -> Result<CameraPath, EngineError> {
        let found = self.description.paths.iter().find(|(known, _)| known == name);
        found.map(|(_, path)| path.clone()).ok_or_else(|| EngineError::BadParameter {
            parameter: "path",
            reason: format!("the scene has no path `{name}`"),
            accepted: if self.info.paths.is_empty() {
                "a path of one's own: this scene names none".to_owned()
            } else {
                self.info.paths.join(", ")
            },
        })
    }

    /// Returns what finds the nodes above its instances.
    pub fn instance_paths(&self) -> InstancePaths<'_> {
        let placements = self.placements.iter().map(|placed| placed.len() as u64).collect();
        InstancePaths::new(&self.description, placements)
    }

    /// Returns the names of an asset and of one of its placements.
    pub fn placement_names(&self, asset: usize, placement: usize) -> (&str, &str) {
        let asset_name = self.description.assets.get(asset).map_or("", |asset| &asset.name);
        let placed = self.placements.get(asset).and_then(|placed| placed.get(placement));
        (asset_name, placed.map_or("", |placed| &placed.name))
    }

    /// Returns the positions and spacing of its samples in patches, measured on first use.
    pub fn patches(&self) -> &[Patch] {
        self.patches.get_or_init(|| spacing::patches(&self.model))
    }

    /// Returns the up direction.
    pub fn up(&self) -> DVec3 {
        if self.model.up == DVec3::ZERO { DVec3::Y } else { self.model.up }
    }

    /// Returns the default view: the sensor's where the file has one, else a view of everything but strays, as large as the frame
    /// allows. Without `up` it uses the scene's up direction.
    ///
    /// # Errors
    /// An `up` that is zero or not finite; a field of view that no camera has.
    pub fn fit(
        &self,
        aspect: f64,
        up_given: Option<DVec3>,
        fov_deg: Option<f64>,
    ) -> Result<Camera, CameraError> {
        // These checks do not depend on the eye's position.
        let anywhere = Camera {
            eye: DVec3::ZERO,
            target: DVec3::ONE,
            up: up_given.unwrap_or_else(|| self.up()),
            fov_deg: fov_deg.unwrap_or(framing::FOV_DEG),
        };
        anywhere.view(1, 1)?;
        if let (Some(sensor), None) = (&self.description.sensor, up_given) {
            let seen = sensor.camera_for(aspect);
            return Ok(Camera { fov_deg: fov_deg.unwrap_or(seen.fov_deg), ..seen });
        }
        let outline = self.outline.get_or_init(|| SceneOutline::of(&self.model));
        let front = self.description.front.filter(|_| up_given.is_none());
        let reach = SPLAT_REACH * spacing::usual(self.patches());
        Ok(outline.camera(anywhere.up, front, (anywhere.fov_deg, aspect, reach)))
    }
}

/// Makes a path absolute and checks that it is inside the root.
pub fn check_path(path: &Path, root: &Path) -> Result<PathBuf, EngineError> {
    let display = path
        .file_name()
        .map_or_else(|| path.display().to_string(), |n| n.to_string_lossy().into_owned());
    let io = |source| asset_error(AssetError::Io { file: display.clone(), source });
    let path = path.canonicalize().map_err(io)?;
    let root = root.canonicalize().map_err(io)?;
    if !path.starts_with(&root) {
        return Err(asset_error(AssetError::Unsupported {
            file: display,
            reason: "lies outside the scene root".to_owned(),
        }));
    }
    if !path.is_file() {
        // A pipe would be waited for, for ever.
        let reason = if path.is_dir() {
            "is a folder; name one file in it: a scene (.json), or a file of points or triangles"
        } else {
            "is no regular file; write a pipe's content to a file first"
        };
        let reason = reason.to_owned();
        return Err(asset_error(AssetError::Unsupported { file: display, reason }));
    }
    Ok(path)
}
