//! Scenes and limits as callers see them.

use std::path::PathBuf;

use glam::DVec3;
use serde::Serialize;

use crate::math::Camera;
use crate::scene::fields::SceneField;

/// Limits that `GET /v1/limits` lists.
#[derive(Clone, Debug, Serialize, utoipa::ToSchema)]
pub struct Limits {
    pub max_pixels: u64,
    /// Pixels of all exposures of a frame with depth of field or motion blur.
    pub max_exposed_pixels: u64,
    pub max_side: u32,
    pub queue_capacity: usize,
    pub max_batch: usize,
    pub gpu_budget_bytes: u64,
    /// Host memory that loaded scenes, loading and baking may hold together, and what they hold now.
    pub host_memory_bytes: u64,
    pub host_memory_in_use_bytes: u64,
    pub max_vertices: u64,
    pub max_triangles: u64,
    pub max_texels: u64,
    pub max_decompressed_bytes: u64,
    pub max_nodes: u64,
    pub max_depth: u32,
    pub max_instances: u64,
    pub max_json_bytes: u64,
    /// Objects of a scene's JSON, whatever they are.
    pub max_json_objects: u64,
    /// Solids that one asset is made of, each counted as often as it is used.
    pub max_operands: u64,
}

/// A loaded scene as callers see it.
#[derive(Clone, Debug, Serialize, utoipa::ToSchema)]
pub struct SceneInfo {
    pub id: String,
    pub name: String,
    /// Grows with every change.
    pub revision: u64,
    /// World-space box: min and max corner, `null` when empty.
    pub bounds: Option<[[f64; 3]; 2]>,
    pub samples: u64,
    pub triangles: u64,
    /// Segments of lines.
    pub segments: u64,
    pub instances: u64,
    pub assets: Vec<AssetInfo>,
    /// Scalar fields of its points and lines, which frames can show and picks return.
    pub fields: Vec<SceneField>,
    /// Bytes that the scene needs on the GPU, and whether it is there now.
    pub gpu_bytes: u64,
    pub resident: bool,
    /// Whether normals and kernels of its samples are there. Those of large clouds are estimated when a frame needs them.
    pub estimates: Estimates,
    pub cameras: Vec<NamedCamera>,
    pub paths: Vec<String>,
    /// Names of top-level nodes, as `PATCH` takes them.
    pub nodes: Vec<String>,
    pub lights: usize,
    /// Lights that cast shadows.
    pub casting_lights: usize,
    /// Whether an image of surroundings lights the scene.
    pub environment: bool,
    /// Whether the scene has fog.
    pub fog: bool,
    /// Whether the scene has ambient occlusion.
    pub occlusion: bool,
    /// Which way is up: what a pose without `up` uses.
    pub up: [f64; 3],
    /// Why that way is up: a guess names its evidence.
    pub up_because: String,
    pub warnings: Vec<String>,
}

impl SceneInfo {
    /// Whether the scene has samples of its own. Point trees of its meshes have some, too.
    pub fn has_samples(&self) -> bool {
        self.samples > 0
    }
}

#[derive(Clone, Debug, Serialize, utoipa::ToSchema)]
pub struct AssetInfo {
    pub name: String,
    pub format: &'static str,
    pub samples: u64,
    pub triangles: u64,
    pub segments: u64,
    pub has_colors: bool,
    /// Colours were not in the file and show the intensity.
    pub shows_intensity: bool,
    pub has_normals: bool,
    /// Normals were not in the file and come from the neighbourhood.
    pub normals_estimated: bool,
}

#[derive(Clone, Debug, Serialize, utoipa::ToSchema)]
pub struct NamedCamera {
    pub name: String,
    pub eye: [f64; 3],
    pub target: [f64; 3],
    pub up: [f64; 3],
    /// Vertical field of view in degrees, of a perspective.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fov: Option<f64>,
    /// Height of the view in scene units, of an orthographic projection.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ortho_height: Option<f64>,
}

impl NamedCamera {
    pub fn new(name: &str, camera: &Camera) -> Self {
        Self {
            name: name.to_owned(),
            eye: camera.eye.into(),
            target: camera.target.into(),
            up: camera.up.into(),
            fov: camera.lens.fov_deg(),
            ortho_height: camera.lens.ortho_height(),
        }
    }
}

/// Source of a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Source {
    /// A scene file or an asset file.
    pub path: PathBuf,
    /// Folder to which file names in a scene are relative; `None`: the scene file's own.
    pub base: Option<PathBuf>,
    /// Up direction of a bare asset file, instead of [`EngineConfig::up`](super::EngineConfig::up).
    pub up: Option<DVec3>,
}

impl Source {
    /// Returns the source of a file whose names are relative to its own folder.
    pub fn at(path: impl Into<PathBuf>) -> Source {
        Source { path: path.into(), base: None, up: None }
    }
}

/// Identifies a scene at one revision.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SceneMark {
    /// Unique among all scenes of a process and their revisions.
    pub(super) uid: u64,
    pub revision: u64,
}

/// Number of a load. A scene keeps it while it is patched, and a scene that is loaded later under the same id has another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LoadNumber(pub(super) u64);

/// Changes to one top-level node; `None` leaves a property as it is.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NodePatch {
    pub world_from_node: Option<glam::DAffine3>,
    pub visible: Option<bool>,
}

/// Whether the samples of a scene have their normals and kernels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum EstimateState {
    /// All samples have normals and kernels.
    Complete,
    /// Not yet: no frame has needed them.
    Deferred,
    Running,
    /// They cannot be estimated; `reason` says why.
    Failed,
}

/// How far the estimate of a scene's normals and kernels is.
#[derive(Clone, Debug, PartialEq, Serialize, utoipa::ToSchema)]
pub struct Estimates {
    pub state: EstimateState,
    /// Part that is done, of 1.
    pub done: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
}
