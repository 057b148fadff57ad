//! The scene description: what a scene file says, validated (floor 1).
//!
//! [`Scene`] mirrors the JSON after validation: names are resolved to indices, angles to matrices,
//! colours to linear RGB. [`Scene::instances`] walks the nodes, prototypes and repeats in order and
//! yields every instance of an asset with its f64 transform.
//!
//! How a file becomes a scene: [`load()`] reads it into the wire structures (unknown and repeated
//! keys are refused there), validation resolves and checks them place by place, and the graph of
//! prototypes is tested for cycles, depth and the number of instances before anything is unfolded.
//! [`json_schema`] describes the files for editors. A camera path may also lie in a file of its own ([`load_path`]); [`path`] says
//! what its camera is at any time.

mod assets;
pub mod clipping;
pub mod color;
mod effects;
pub mod fields;
mod graph;
mod instance_path;
mod instances;
mod load;
pub mod name;
pub mod path;
pub mod random;
pub mod recolor;
mod splats;
#[cfg(test)]
mod tests;
mod unique;
mod up;
mod validate;
mod wire;

pub use assets::{
    AsLines, AssetRef, AssetSource, CsgOperation, FileSource, MeshSampling, Operand, Solid,
};
pub use effects::{
    AmbientOcclusion, Discs, Environment, EnvironmentSource, EyeDome, Fog, FogLayer, Tone, ToneMap,
};
pub use instance_path::{InstancePath, InstancePaths, PathStep};
pub use load::{load, load_path, load_within, parse, parse_path};
pub use path::{CameraPath, Ease, Interpolation, PathKey, PathSampler};
pub use splats::{
    Blend, Filter, PAINT_LAYERS, PAINT_WIDTH_PERCENT, Painted, Painting, PullPush, PullPushWeights,
    Shading, Splats,
};
pub use unique::{DuplicateKey, check_keys};
pub use up::{Up, UpForm};
pub use validate::{LARGEST_COORDINATE, LARGEST_SCALE};
pub use wire::{json_schema, path_json_schema};

use glam::{DAffine3, DVec3};

use crate::math::{Bounds, Camera, SensorView};
use crate::memory::Interrupt;

/// A validated scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scene {
    pub name: String,
    pub assets: Vec<AssetRef>,
    pub materials: Vec<MaterialSpec>,
    pub prototypes: Vec<Prototype>,
    pub nodes: Vec<Node>,
    pub lights: Vec<Light>,
    /// Linear RGB and alpha of pixels that nothing covers.
    pub background: [f32; 4],
    pub environment: Option<Environment>,
    pub fog: Option<Fog>,
    pub occlusion: Option<AmbientOcclusion>,
    pub cameras: Vec<(String, Camera)>,
    pub paths: Vec<(String, CameraPath)>,
    /// World up, used where a request names none. `+y` unless the scene says otherwise.
    pub up: DVec3,
    /// Says where `up` is from, as an ending of "+z is up: it …".
    pub up_because: String,
    /// Box that the default view shows in place of the whole scene.
    pub subject: Option<Bounds>,
    /// View of the camera that took the points of a bare asset file, if the file tells it; the default view.
    pub sensor: Option<SensorView>,
    /// Horizontal direction, of unit length, to the scanner that took the points of a bare asset file from outside.
    pub front: Option<DVec3>,
    /// How samples are drawn where a request asks for splats.
    pub splats: Splats,
}

/// A subtree with a name, drawn wherever a node or another prototype asks for it.
#[derive(Clone, Debug, PartialEq)]
pub struct Prototype {
    pub name: String,
    pub children: Vec<Node>,
}

/// A node: a transform, what it draws, its children, how often.
#[derive(Clone, Debug, PartialEq)]
pub struct Node {
    pub name: Option<String>,
    pub parent_from_node: DAffine3,
    pub draws: Draws,
    pub children: Vec<Node>,
    pub repeat: Repeat,
    /// Index into [`Scene::materials`]; overrides the asset's own, also in everything below.
    pub material: Option<usize>,
    pub visible: bool,
}

impl Default for Node {
    fn default() -> Self {
        Self {
            name: None,
            parent_from_node: DAffine3::IDENTITY,
            draws: Draws::Nothing,
            children: Vec::new(),
            repeat: Repeat::Once,
            material: None,
            visible: true,
        }
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Draws {
    #[default]
    Nothing,
    /// Index into [`Scene::assets`].
    Asset(usize),
    /// Index into [`Scene::prototypes`].
    Prototype(usize),
}

/// Copies of a node, without listing them. Transforms apply as `parent · copy · node`, where a copy
/// moves, turns and scales about the node's own origin along the parent's axes.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Repeat {
    #[default]
    Once,
    /// `grid[0] · grid[1] · grid[2]` copies, `step` apart, the whole centred on the node.
    Grid { counts: [u32; 3], step: DVec3 },
    /// `count` copies, seeded and reproducible ([`random::SplitMix64`]), uniform in a box around the
    /// node. Each copy draws, in this order: offset x, y, z in units of `half_extent`, scale, angle.
    Scatter {
        count: u32,
        half_extent: DVec3,
        /// Uniform scale is drawn from this range.
        scale: [f64; 2],
        /// Turn about world up at random.
        turn: bool,
        seed: u64,
    },
}

/// Appearance that a node lays over its asset's own.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MaterialSpec {
    pub name: String,
    /// Linear RGB and alpha; `None` keeps the asset's.
    pub base_color: Option<[f32; 4]>,
    pub specular: Option<[f32; 3]>,
    pub shininess: Option<f32>,
    /// 0 to 1; with this or `roughness`, the metallic-roughness model of glTF takes the place of Phong's.
    pub metallic: Option<f32>,
    pub roughness: Option<f32>,
    /// 0 to 1: light that passes in place of being scattered below the surface; also of the metallic-roughness model.
    pub transmission: Option<f32>,
    /// Linear RGB of light that the surface gives off.
    pub emissive: Option<[f32; 3]>,
    pub unlit: Option<bool>,
    pub double_sided: Option<bool>,
}

impl MaterialSpec {
    /// Whether it makes surfaces reflect as the metallic-roughness model has it.
    pub fn is_physical(&self) -> bool {
        self.metallic.is_some() || self.roughness.is_some() || self.transmission.is_some()
    }

    /// Whether it makes surfaces reflect as Phong's model has it.
    pub fn is_phong(&self) -> bool {
        self.specular.is_some() || self.shininess.is_some()
    }

    /// The alpha of its colour; 1 where it has none.
    pub fn alpha(&self) -> f32 {
        self.base_color.map_or(1.0, |color| color[3])
    }

    /// Whether meshes of this material let what is behind them show through.
    pub fn is_translucent(&self) -> bool {
        self.alpha() < 1.0 || self.transmits()
    }

    /// Whether it lets light pass in place of scattering it.
    pub fn transmits(&self) -> bool {
        self.transmission.is_some_and(|share| share > 0.0)
    }
}

/// Lights of a scene that may cast shadows: each takes a frame of its own, seen from the light.
pub const MOST_CASTING_LIGHTS: usize = 4;

/// A light, colours linear and already multiplied by intensity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Light {
    Ambient {
        color: [f32; 3],
    },
    /// Shines from the eye along the view direction.
    Headlight {
        color: [f32; 3],
    },
    /// Comes from all directions, as the image of the scene's [`Environment`] has it. `color` is its mean over all directions.
    Surroundings {
        color: [f32; 3],
    },
    /// Parallel light travelling along `direction` (unit length).
    Sun {
        direction: DVec3,
        color: [f32; 3],
        /// The sun's angular diameter in degrees, where the sun casts shadows: their edges are as wide as it makes them.
        shadows: Option<f64>,
    },
    /// Falls off as `1 / (1 + (d / range)²)`; at `range` half is left.
    Point {
        position: DVec3,
        color: [f32; 3],
        range: f64,
        /// The radius of the ball that shines, where the light casts shadows: their edges are as wide as it makes them.
        shadows: Option<f64>,
    },
}

/// What decides the shadows that a light casts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Casting {
    /// Parallel light along `direction`, from a disc with an angular diameter in degrees.
    Sun { direction: DVec3, angle_deg: f64 },
    /// Light from a ball.
    Lamp { position: DVec3, radius: f64 },
}

impl Light {
    /// Lights of a scene that names none: a headlight (0.63) and ambient light (0.07). White that faces the eye stays below
    /// white, so that its shape is seen.
    pub fn default_pair() -> [Light; 2] {
        [Light::Headlight { color: [0.63; 3] }, Light::Ambient { color: [0.07; 3] }]
    }

    /// The shadows that it casts; `None` where it casts none.
    pub fn casting(&self) -> Option<Casting> {
        match *self {
            Light::Sun { direction, shadows, .. } => {
                shadows.map(|angle_deg| Casting::Sun { direction, angle_deg })
            }
            Light::Point { position, shadows, .. } => {
                shadows.map(|radius| Casting::Lamp { position, radius })
            }
            _ => None,
        }
    }

    pub fn casts_shadows(&self) -> bool {
        self.casting().is_some()
    }
}

/// One drawn copy of an asset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Instance {
    /// Index into [`Scene::assets`].
    pub asset: usize,
    pub world_from_asset: DAffine3,
    /// Index into [`Scene::materials`].
    pub material: Option<usize>,
    /// Index of the top-level node that it came from.
    pub node: usize,
}

/// Why a scene was refused.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    #[error("{file}: {source}")]
    Io { file: String, source: std::io::Error },
    /// `path` is the place in the file: `nodes[3].repeat.grid`.
    #[error("{file}: {path}: {reason}")]
    Invalid { file: String, path: String, reason: String },
    #[error("{file}: {what} ({found}) is over the limit of {limit}")]
    TooLarge { file: String, what: &'static str, found: u64, limit: u64 },
    /// Cancelled, or there is no memory for it.
    #[error(transparent)]
    Interrupted(#[from] Interrupt),
}

/// Bounds on what a scene may ask for.
#[derive(Clone, Debug)]
pub struct SceneLimits {
    pub max_nodes: u64,
    pub max_depth: u32,
    pub max_instances: u64,
    pub max_json_bytes: u64,
    /// Objects of a JSON text, whatever they are.
    pub max_json_objects: u64,
    /// Solids that one asset is made of, each counted as often as it is used.
    pub max_operands: u64,
}

impl Default for SceneLimits {
    fn default() -> Self {
        Self {
            max_nodes: 100_000,
            max_depth: 64,
            max_instances: 1 << 20,
            max_json_bytes: 64 << 20,
            max_json_objects: 1_000_000,
            max_operands: 4096,
        }
    }
}
