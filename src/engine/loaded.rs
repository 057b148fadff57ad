//! Loaded scenes in host memory, and the changes made to them later.

use std::ops::Range;
use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

use glam::DVec3;
use parking_lot::Mutex;
use sha2::{Digest, Sha256};

use super::asset_keys::AssetKey;
use super::cloud_cache::UnwrittenCloud;
use super::framing::{self, SceneOutline};
use super::instance_trees::InstanceTrees;
use super::scene_files::SceneFiles;
use super::uid::next_uid;
use super::{
    AssetInfo, EngineConfig, EngineError, EstimateState, Estimates, NamedCamera, NodePatch,
    SceneInfo,
};
use crate::assets::Placement;
use crate::bake::environment::EnvironmentMap;
use crate::bake::pack::{Counts, GeometryKind, PackedGeometry};
use crate::bake::prepare;
use crate::bake::spacing::Patch;
use crate::bake::tree::Above;
use crate::math::framing::Shown;
use crate::math::{Bounds, Camera, CameraError, Lens, Projection};
use crate::memory::{Admission, Reservation};
use crate::plan::SceneFacts;
use crate::residency::fields::scene_fields;
use crate::residency::instances::{Instances, RunMeter};
use crate::residency::model::{AssetModel, Extent, ModelInstance, SceneModel};
use crate::residency::once::MadeOnce;
use crate::residency::spacing;
use crate::scene::clipping::ClipRegion;
use crate::scene::{CameraPath, InstancePaths, Light, Node, Scene};

/// How far splats usually reach, in distances between neighbouring samples.
const SPLAT_REACH: f64 = 2.0;

/// A scene and what was derived from it.
pub struct Loaded {
    pub model: Arc<SceneModel>,
    pub facts: SceneFacts,
    pub extent: Extent,
    /// Outline for the default view, computed on first use.
    pub(super) outline: OnceLock<SceneOutline>,
    /// Increases with each load; all revisions of a scene have the same.
    pub(super) order: u64,
    pub info: SceneInfo,
    /// See [`Loaded::patches`].
    pub(super) patches: [OnceLock<Vec<Patch>>; GeometryKind::ALL.len()],
    /// Hash of the description and of every file's content.
    pub digest: [u8; 32],
    /// The digest that the scene was loaded with, the same in all revisions.
    pub origin: [u8; 32],
    pub(super) description: Scene,
    /// The top-level nodes of each run of instances, the same in all revisions.
    pub(super) nodes: Arc<[Range<usize>]>,
    /// Memory of the description and of the list of instances.
    pub(super) _memory: Reservation,
    /// See [`Loaded::trees`].
    pub(super) trees: MadeOnce<Result<TreeScene, EngineError>>,
    /// Trees of the latest earlier revision that had some, until there are new ones.
    pub(super) trees_before: Mutex<Option<TreeScene>>,
    /// For each asset, the placements of its geometries.
    pub(super) placements: Vec<Arc<Vec<Placement>>>,
    /// For each asset, its content key.
    pub(super) keys: Vec<AssetKey>,
    /// The scene's file, or that of its only asset.
    pub(super) path: PathBuf,
    /// The files that the scene was read from; `None` after a patch.
    pub(super) files: Option<Arc<SceneFiles>>,
    /// Large clouds that were just read and are to be kept on disk.
    pub unwritten: Vec<UnwrittenCloud>,
}

/// The parts of a scene, as read.
pub struct Parts {
    pub id: String,
    pub revision: u64,
    pub description: Scene,
    pub assets: Vec<Arc<AssetModel>>,
    pub placements: Vec<Arc<Vec<Placement>>>,
    pub environment: Option<Arc<EnvironmentMap>>,
    pub warnings: Vec<String>,
    pub digest: [u8; 32],
    pub origin: [u8; 32],
    pub keys: Vec<AssetKey>,
    pub path: PathBuf,
    pub files: Option<Arc<SceneFiles>>,
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
            return Err(EngineError::OverLimit { what, found, limit: most, parameter: None });
        }
        runs.push(run);
    }
    Ok(Instances::new(runs))
}

/// Builds a scene from its parts: completely, or as `before` with one node changed.
pub fn build(
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
    let description = parts.description;
    let model = SceneModel {
        uid: next_uid(),
        id: parts.id,
        name: description.name.clone(),
        revision: parts.revision,
        assets: parts.assets,
        instances,
        materials: description.materials.clone(),
        lights: lights(&description, parts.environment.as_deref()),
        environment: parts.environment,
        background: description.background,
        fog: description.fog,
        occlusion: description.occlusion,
        cameras: description.cameras.clone(),
        up: description.up,
        splats: description.splats,
        trees: false,
        totals: OnceLock::new(),
    };
    let extent = model.extent();
    let info = describe(&model, &description, &extent.bounds, parts.warnings);
    Ok(Loaded {
        facts: facts(&model, &extent.bounds),
        model: Arc::new(model),
        extent,
        outline: OnceLock::new(),
        order: before.map_or_else(next_uid, |(loaded, _)| loaded.order),
        info,
        patches: Default::default(),
        digest: parts.digest,
        origin: parts.origin,
        description,
        nodes,
        _memory: admission.keep(admission.held()),
        trees: MadeOnce::default(),
        trees_before: Mutex::new(before.and_then(|(loaded, _)| loaded.latest_trees())),
        placements: parts.placements,
        keys: parts.keys,
        path: parts.path,
        files: parts.files,
        unwritten: Vec::new(),
    })
}

/// Lines are sparse where their area is below this share of the square over the scene's longest side.
const SPARSE_LINES: f64 = 0.25;

/// The lights of a scene, that of its surroundings among them.
fn lights(description: &Scene, environment: Option<&EnvironmentMap>) -> Vec<Light> {
    let around = environment.map(|map| Light::Surroundings { color: map.mean });
    around.into_iter().chain(description.lights.iter().copied()).collect()
}

fn casting_lights(model: &SceneModel) -> usize {
    model.lights.iter().filter(|light| light.casts_shadows()).count()
}

fn facts(model: &SceneModel, bounds: &Bounds) -> SceneFacts {
    let counts = model.counts();
    let size = if bounds.is_empty() { DVec3::ZERO } else { bounds.max - bounds.min };
    let looks = model.looks();
    SceneFacts {
        counts,
        has_normals: model.assets.iter().any(|asset| asset.has_normals),
        lights: model.lights.len() as u32,
        casting_lights: casting_lights(model) as u32,
        environment: model.environment.is_some(),
        shows_environment: model.environment.as_ref().is_some_and(|map| map.shown),
        fog: model.fog.is_some(),
        occlusion: model.occlusion.is_some(),
        layered_fog: model.fog.is_some_and(|fog| fog.layer.is_some()),
        sparse_lines: counts.segments > 0
            && model.line_area() < SPARSE_LINES * size.max_element().powi(2),
        trees: false,
        translucent: std::array::from_fn(|number| {
            let has_translucent =
                |asset: &Arc<AssetModel>| asset.has_translucent(GeometryKind::ALL[number]);
            looks.translucent_overrides[number] || model.assets.iter().any(has_translucent)
        }),
        looks,
    }
}

pub fn node_name(node: &Node, index: usize) -> String {
    node.name.clone().unwrap_or_else(|| index.to_string())
}

/// The index of the top-level node with a name.
fn node_index(description: &Scene, name: &str) -> Option<usize> {
    let mut names = description.nodes.iter().enumerate();
    names.find(|(index, node)| node_name(node, *index) == name).map(|(index, _)| index)
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
        segments: counts.segments,
        instances: counts.instances,
        assets: model
            .assets
            .iter()
            .zip(&description.assets)
            .map(|(asset, reference)| {
                let Counts { samples, triangles, segments, .. } = asset.counts();
                AssetInfo {
                    // Another scene may have read the same file under another name.
                    name: reference.name.clone(),
                    format: asset.format,
                    samples,
                    triangles,
                    segments,
                    has_colors: asset.has_colors,
                    shows_intensity: asset.shows_intensity,
                    has_normals: asset.has_normals,
                    normals_estimated: asset.normals_estimated,
                }
            })
            .collect(),
        fields: scene_fields(&model.assets),
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
        lights: description.lights.len(),
        casting_lights: casting_lights(model),
        environment: model.environment.is_some(),
        fog: model.fog.is_some(),
        occlusion: model.occlusion.is_some(),
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
        let index = node_index(&self.description, node).ok_or_else(|| {
            EngineError::UnknownNode { scene: self.model.id.clone(), node: node.to_owned() }
        })?;
        let mut parts = self.parts();
        let changed = &mut parts.description.nodes[index];
        if let Some(transform) = patch.world_from_node {
            changed.parent_from_node = transform;
        }
        if let Some(visible) = patch.visible {
            changed.visible = visible;
        }
        let hasher = Sha256::new_with_prefix(self.digest);
        parts.digest = hasher.chain_update(format!("{node}{patch:?}")).finalize().into();
        parts.revision += 1;
        parts.files = None;
        build(parts, config, Some((self, index)), &Admission::new(&config.memory))
    }

    /// Returns the parts that it was built from.
    pub(super) fn parts(&self) -> Parts {
        Parts {
            id: self.model.id.clone(),
            revision: self.model.revision,
            description: self.description.clone(),
            assets: self.model.assets.clone(),
            placements: self.placements.clone(),
            environment: self.model.environment.clone(),
            warnings: self.info.warnings.clone(),
            digest: self.digest,
            origin: self.origin,
            keys: self.keys.clone(),
            path: self.path.clone(),
            files: self.files.clone(),
        }
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

    /// Returns a camera path that the scene names.
    pub fn camera_path(&self, name: &str) -> Result<CameraPath, EngineError> {
        let found = self.description.paths.iter().find(|(known, _)| known == name);
        found.map(|(_, path)| path.clone()).ok_or_else(|| EngineError::BadParameter {
            parameter: "path",
            reason: format!("the scene has no path `{name}`"),
            accepted: if self.info.paths.is_empty() {
                "a path in JSON, since this scene names none".to_owned()
            } else {
                self.info.paths.join(", ")
            },
        })
    }

    /// Returns the top-level node with a name.
    pub fn node(&self, name: &str) -> Option<&Node> {
        node_index(&self.description, name).map(|index| &self.description.nodes[index])
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

    /// Returns the positions and spacing of its elements of one kind in patches, measured on first use.
    pub fn patches(&self, kind: GeometryKind) -> &[Patch] {
        self.patches[kind as usize].get_or_init(|| spacing::patches(&self.model, kind))
    }

    /// Whether some sample ends at a clip line.
    pub fn has_clip_lines(&self) -> bool {
        let geometries = self.model.assets.iter().flat_map(|asset| &asset.packed.geometries);
        geometries.filter_map(PackedGeometry::samples).any(|samples| !samples.clips.is_empty())
    }

    /// Returns the up direction.
    pub fn up(&self) -> DVec3 {
        if self.model.up == DVec3::ZERO { DVec3::Y } else { self.model.up }
    }

    fn outline(&self) -> &SceneOutline {
        self.outline.get_or_init(|| SceneOutline::of(&self.model))
    }

    /// Returns the least and the largest height of the scene along its up direction; strays do not count.
    pub fn heights(&self) -> [f64; 2] {
        self.outline().range(self.up().normalize_or(DVec3::Y))
    }

    /// Returns the default view: the sensor's where the file has one, else a view of everything but strays, as large as the frame
    /// allows; of the boxes of `clip` whose inside is shown, where there are such boxes. Without `up` it uses the scene's up direction. Without `lens` an orthographic camera has the height that the scene needs.
    ///
    /// # Errors
    /// An `up` that is zero or not finite; a field of view that no camera has.
    pub fn fit(
        &self,
        aspect: f64,
        up_given: Option<DVec3>,
        lens: Option<Lens>,
        projection: Option<Projection>,
        clip: Option<&ClipRegion>,
    ) -> Result<Camera, CameraError> {
        // These checks do not depend on the eye's position.
        let anywhere = Camera {
            eye: DVec3::ZERO,
            target: DVec3::ONE,
            up: up_given.unwrap_or_else(|| self.up()),
            lens: lens.unwrap_or(framing::LENS),
        };
        anywhere.view(1, 1)?;
        if let (Some(sensor), None) = (&self.description.sensor, up_given) {
            let seen = sensor.camera_for(aspect);
            return Ok(Camera { lens: lens.unwrap_or(seen.lens), ..seen });
        }
        let outline = match self.description.subject {
            Some(subject) => &SceneOutline::around(&subject),
            None => self.outline(),
        };
        let clipped = clip.and_then(|clip| outline.clipped(clip));
        let outline = clipped.as_ref().unwrap_or(outline);
        let front = self.description.front.filter(|_| up_given.is_none());
        let reach = SPLAT_REACH * spacing::usual(self.patches(GeometryKind::Samples));
        let shown = match (lens, projection) {
            (Some(Lens::Orthographic { height }), _) => Shown::Orthographic(Some(height)),
            (_, Some(Projection::Orthographic)) => Shown::Orthographic(None),
            (lens, _) => {
                Shown::Perspective(lens.and_then(|lens| lens.fov_deg()).unwrap_or(framing::FOV_DEG))
            }
        };
        Ok(outline.camera(anywhere.up, front, (shown, aspect, reach)))
    }
}

/// A scene of trees, and what a plan depends on in it.
#[derive(Clone)]
pub struct TreeScene {
    pub model: Arc<SceneModel>,
    pub facts: SceneFacts,
    /// The trees over its instances, where there are enough of them.
    pub instance_trees: Option<Arc<InstanceTrees>>,
}
