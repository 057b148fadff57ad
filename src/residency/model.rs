//! A scene as it is drawn: packed assets and the flat list of their instances, in host memory. From this the GPU can be
//! filled at any time, after an eviction as after a lost device.

use std::collections::HashMap;
use std::sync::{Arc, OnceLock};

use glam::{DAffine3, DMat3, DVec3};

use super::instances::Instances;
use super::layout::{GpuEntry, GpuInstance, INSTANCE_GROUP, INSTANCE_MIRRORED, two_floats};
use super::once::MadeOnce;
use super::{Looks, slots};
use crate::assets::Material;
use crate::bake::environment::EnvironmentMap;
use crate::bake::outline::Outline;
use crate::bake::pack::{Counts, GeometryKind, Grid, PackError, PackedAsset, PackedGeometry};
use crate::bake::prepare::{AssetTraits, has_metals};
use crate::bake::tree::Above;
use crate::math::{Bounds, Camera};
use crate::memory::Reservation;
use crate::scene::{AmbientOcclusion, Fog, Light, MaterialSpec, Splats};

/// One file's packed contents, shared by the scenes that draw it.
#[derive(Debug)]
pub struct AssetModel {
    /// Differs for every asset of this process.
    pub uid: u64,
    pub name: String,
    pub format: &'static str,
    pub packed: PackedAsset,
    /// Box of each geometry as the file has it; chunks lie on a grid and may reach a little farther.
    pub bounds: Vec<Bounds>,
    pub has_colors: bool,
    pub shows_intensity: bool,
    pub has_normals: bool,
    pub normals_estimated: bool,
    /// For point trees: for each geometry the one that is drawn wherever it is, on the same grid: a mesh's triangles beside its
    /// samples.
    pub beside: Vec<Option<usize>>,
    /// The host memory that the asset holds.
    pub memory: Reservation,
    /// The asset as point trees, once a frame has asked for it.
    pub tree: MadeOnce<Result<Arc<AssetModel>, PackError>>,
    /// Answer of [`AssetModel::outlines`], once it was asked for.
    pub outlined: OnceLock<Vec<Outline>>,
    /// Missing attributes of its samples, if there are any.
    pub deferred: Option<Deferred>,
}

/// Missing attributes of an asset whose samples are drawn as points before their kernels are estimated.
#[derive(Debug, Default)]
pub struct Deferred {
    /// Some sample has no normal either.
    pub lacks_normals: bool,
    /// The asset with everything, once somebody has needed it.
    pub whole: MadeOnce<Arc<AssetModel>>,
}

/// Where a scene's samples are and how wide they are, in world units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extent {
    pub bounds: Bounds,
    /// Standard deviation of kernels along their longer axis, of a median chunk of each geometry, on average over instances.
    pub kernel: f64,
}

/// One drawn copy of one geometry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ModelInstance {
    pub asset: usize,
    pub geometry: usize,
    pub world_from_geometry: DAffine3,
    /// Index into [`SceneModel::materials`].
    pub material: Option<usize>,
    /// Number that the id output shows.
    pub id: u32,
    /// For scenes of point trees: what stands above it as a whole, in world units.
    pub above: Above,
}

/// Everything that drawing a scene needs.
#[derive(Clone, Debug)]
pub struct SceneModel {
    /// Differs for every scene and every revision of it in this process.
    pub uid: u64,
    pub id: String,
    pub name: String,
    pub revision: u64,
    pub assets: Vec<Arc<AssetModel>>,
    pub instances: Instances,
    pub materials: Vec<MaterialSpec>,
    pub lights: Vec<Light>,
    /// Linear RGB, straight alpha.
    pub background: [f32; 4],
    /// Surroundings that light the scene.
    pub environment: Option<Arc<EnvironmentMap>>,
    pub fog: Option<Fog>,
    pub occlusion: Option<AmbientOcclusion>,
    pub cameras: Vec<(String, Camera)>,
    pub up: DVec3,
    /// How samples are drawn where splats are asked for.
    pub splats: Splats,
    /// Assets are point trees: frames take the detail that they show.
    pub trees: bool,
    /// Result of [`SceneModel::counts`].
    pub totals: OnceLock<Counts>,
}

impl AssetModel {
    /// A geometry, and what is drawn wherever it is.
    pub fn drawn_with(&self, geometry: usize) -> impl Iterator<Item = usize> + use<> {
        let beside = self.beside.get(geometry).copied().flatten();
        std::iter::once(geometry).chain(beside)
    }

    /// The outline of each geometry, computed by the first call.
    pub fn outlines(&self) -> &[Outline] {
        self.outlined.get_or_init(|| Outline::of_all(&self.packed.geometries))
    }

    /// Whether something shows through some of its elements of a kind.
    pub fn has_translucent(&self, kind: GeometryKind) -> bool {
        let geometries = self.packed.geometries.iter().filter(|geometry| geometry.kind() == kind);
        geometries.flat_map(|geometry| geometry.chunks()).any(|chunk| chunk.translucent)
    }

    /// Attributes that its file has.
    pub fn traits(&self) -> AssetTraits {
        let geometries = &self.packed.geometries;
        let mut chunks = geometries.iter().flat_map(|geometry| geometry.chunks());
        AssetTraits {
            format: self.format,
            has_colors: self.has_colors,
            shows_intensity: self.shows_intensity,
            has_normals: self.has_normals,
            normals_estimated: self.normals_estimated,
            has_triangles: geometries.iter().any(|g| g.kind() == GeometryKind::Triangles),
            has_lines: geometries.iter().any(|g| g.kind() == GeometryKind::Lines),
            has_materials: chunks.any(|chunk| chunk.material != 0),
            has_metals: has_metals(&self.packed.materials),
        }
    }

    /// For each geometry the longest axis of a kernel in a median chunk, in its own units, and how many samples there are.
    pub(super) fn kernels(&self) -> Vec<(f64, f64)> {
        self.packed.geometries.iter().map(|geometry| geometry.median_kernel()).collect()
    }

    /// Counts of the whole file, instances not counted.
    pub fn counts(&self) -> Counts {
        self.packed.geometries.iter().map(PackedGeometry::counts).sum()
    }

    /// Bytes of its pages on the GPU.
    pub fn gpu_bytes(&self) -> u64 {
        let geometries: u64 = self.packed.geometries.iter().map(PackedGeometry::gpu_bytes).sum();
        let textures: u64 =
            self.packed.textures.iter().map(|texture| texture.texels.len() as u64 * 4).sum();
        geometries + textures
    }
}

/// Ends the identifier of a scene of point trees.
const TREES: &str = ":spt";

impl SceneModel {
    /// Identifier of the point trees of a scene on the GPU.
    pub fn tree_id(scene: &str) -> String {
        format!("{scene}{TREES}")
    }

    /// The scene that an identifier belongs to, its own or that of its point trees.
    pub fn scene_of(id: &str) -> &str {
        id.strip_suffix(TREES).unwrap_or(id)
    }

    pub fn geometry(&self, instance: &ModelInstance) -> &PackedGeometry {
        &self.assets[instance.asset].packed.geometries[instance.geometry]
    }

    /// Totals over all instances, added up once.
    pub fn counts(&self) -> Counts {
        *self.totals.get_or_init(|| self.instances.totals())
    }

    /// Area of its lines seen from the side, in square world units. Lengths and widths are those of the longest axis of an instance.
    pub fn line_area(&self) -> f64 {
        let mut areas = HashMap::new();
        let area = |instance: &ModelInstance| {
            let &ModelInstance { asset, geometry, world_from_geometry: world, .. } = instance;
            let PackedGeometry::Lines(lines) = &self.assets[asset].packed.geometries[geometry]
            else {
                return 0.0;
            };
            let own = *areas.entry((asset, geometry)).or_insert_with(|| lines.area());
            let axes = world.matrix3;
            let [x, y, z] = [axes.x_axis, axes.y_axis, axes.z_axis].map(DVec3::length_squared);
            own * x.max(y).max(z)
        };
        self.instances.iter().map(area).sum()
    }

    /// The material that an instance has of its own.
    pub(super) fn override_of(&self, instance: &ModelInstance) -> Option<&MaterialSpec> {
        instance.material.and_then(|number| self.materials.get(number))
    }

    /// Whether an instance has a translucent colour of its own. Light passes the surfaces of meshes alone in place of being scattered.
    pub(super) fn shows_through(&self, instance: &ModelInstance) -> bool {
        let is_mesh = self.geometry(instance).kind() == GeometryKind::Triangles;
        let own = self.override_of(instance);
        own.is_some_and(|own| own.alpha() < 1.0 || (is_mesh && own.is_translucent()))
    }

    /// Whether some instance of a kind of geometry has a translucent colour of its own.
    pub fn has_translucent_overrides(&self, kind: GeometryKind) -> bool {
        let is_of_kind = |instance: &&ModelInstance| self.geometry(instance).kind() == kind;
        self.materials.iter().any(MaterialSpec::is_translucent)
            && self.instances.iter().filter(is_of_kind).any(|own| self.shows_through(own))
    }

    /// The materials of all assets.
    pub fn asset_materials(&self) -> impl Iterator<Item = &Material> + Clone {
        self.assets.iter().flat_map(|asset| &asset.packed.materials)
    }

    /// Kinds of appearance that it has.
    pub fn looks(&self) -> Looks {
        let black = [0.0; 3];
        let (materials, own) = (self.asset_materials(), &self.materials);
        let maps = materials.clone().any(Material::has_maps);
        // Thin lines and ribbons have Phong's model, whatever their material. So has every surface of a node whose material has one of its keys.
        let has_phong = self.counts().segments > 0 || own.iter().any(MaterialSpec::is_phong);
        // An unlit surface shows no highlight, unless a node's material lights it.
        let is_lit =
            |one: &Material| !one.unlit || own.iter().any(|spec| spec.unlit == Some(false));
        let shines = materials.clone().any(|one| {
            one.specular != black && is_lit(one) && (has_phong || one.physical.is_none())
        });
        let is_polished = |spec: &MaterialSpec| spec.specular.is_some_and(|one| one != black);
        let gives_off = |spec: &MaterialSpec| spec.emissive.is_some_and(|one| one != black);
        Looks {
            textures: maps || materials.clone().any(|one| one.base_texture.is_some()),
            overrides: !own.is_empty() && self.instances.iter().any(|one| one.material.is_some()),
            translucent_overrides: std::array::from_fn(|number| {
                self.has_translucent_overrides(GeometryKind::ALL[number])
            }),
            specular: shines || own.iter().any(is_polished),
            physical: materials.clone().any(|one| one.physical.is_some())
                || own.iter().any(MaterialSpec::is_physical),
            emissive: materials.clone().any(|one| one.emissive != black)
                || own.iter().any(gives_off),
            transmits: materials.clone().any(Material::transmits)
                || own.iter().any(MaterialSpec::transmits),
            maps,
            unlit: materials.clone().any(|one| one.unlit),
            point_lights: self.lights.iter().any(|light| matches!(light, Light::Point { .. })),
        }
    }

    /// Where its samples are and how wide.
    pub fn extent(&self) -> Extent {
        Extent { bounds: self.instances.bounds(), kernel: self.instances.mean_kernel() }
    }

    /// Bytes of everything that the scene needs on the GPU, shared assets counted once.
    pub fn gpu_bytes(&self) -> u64 {
        self.asset_bytes() + self.list_bytes()
    }

    /// Bytes of its assets, each counted once.
    pub fn asset_bytes(&self) -> u64 {
        let mut seen = std::collections::BTreeSet::new();
        self.assets
            .iter()
            .filter(|asset| seen.insert(asset.uid))
            .map(|asset| asset.gpu_bytes())
            .sum()
    }

    /// Bytes of its own lists of instances and chunks and of its surroundings, assets left aside.
    pub fn list_bytes(&self) -> u64 {
        let surroundings = self.environment.as_ref().map_or(0, |map| map.bytes());
        if self.trees {
            return surroundings + self.group_bytes();
        }
        let counts = self.counts();
        surroundings
            + counts.instances * size_of::<GpuInstance>() as u64
            + counts.chunks * size_of::<GpuEntry>() as u64
    }

    /// Bytes of its instances and of groups of them, where it is one of point trees or becomes one.
    pub fn group_bytes(&self) -> u64 {
        slots::bytes(if self.trees {
            slots::groups_of(&self.instances)
        } else {
            self.instances.len().div_ceil(INSTANCE_GROUP)
        })
    }
}

/// The transposed cofactors of a matrix, which are its inverse times its determinant, scaled to 1; zero where more than one
/// direction is lost.
fn unit_cofactors(m: &DMat3) -> DMat3 {
    let (x, y, z) = (m.x_axis, m.y_axis, m.z_axis);
    let cofactors = DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y)).transpose();
    let most = cofactors.to_cols_array().into_iter().fold(0.0, |most, v| v.abs().max(most));
    if most > 0.0 && most.is_finite() { cofactors * (1.0 / most) } else { DMat3::ZERO }
}

/// The record of an instance, computed in f64.
pub fn gpu_instance(
    grid: &Grid,
    world_from_geometry: &DAffine3,
    material: u32,
    id: u32,
) -> GpuInstance {
    let linear = world_from_geometry.matrix3 * grid.step;
    let origin = world_from_geometry.transform_point3(grid.origin);
    let inverse = linear.inverse();
    let usable = inverse.to_cols_array().iter().all(|v| v.is_finite() && v.abs() < 1e36);
    // A flattened geometry has normals too: the cofactors turn them as the inverse would, up to a factor.
    let inverse = if usable { inverse } else { unit_cofactors(&linear) };
    let row = |v: DVec3| v.as_vec3().to_array();
    let rows = inverse.transpose();
    let split = origin.to_array().map(two_floats);
    let is_mirrored = world_from_geometry.matrix3.determinant() < 0.0;
    GpuInstance {
        axis_x: row(linear.x_axis),
        axis_y: row(linear.y_axis),
        axis_z: row(linear.z_axis),
        inverse_x: row(rows.x_axis),
        inverse_y: row(rows.y_axis),
        inverse_z: row(rows.z_axis),
        origin_hi: split.map(|(hi, _)| hi),
        origin_lo: split.map(|(_, lo)| lo),
        material,
        id,
        flags: if is_mirrored { INSTANCE_MIRRORED } else { 0 },
        reach: grid.reach as f32,
        ..GpuInstance::default()
    }
}
