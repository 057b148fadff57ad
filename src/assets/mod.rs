//! Readers: one file per format, each turning bytes into the same few structures (floor 1).
//!
//! [`read`] looks at the file's content first and at its extension second, and returns an [`Asset`]:
//! geometries ([`PointCloud`], [`Mesh`], [`Polylines`]), materials, textures, and the placements that a format with
//! its own node hierarchy (glTF) asks for. Coordinates stay in f64 as the file has them.
//!
//! No reader allocates more than the file's length can justify, whatever its header says, and every
//! error names the file, the element and the property at fault.

mod base64;
mod blocks;
mod corners;
mod dispatch;
pub mod e57;
mod environment;
mod fault;
pub mod fields;
#[cfg(test)]
mod first;
pub mod gltf;
pub mod hair;
pub mod input;
pub mod las;
pub mod obj;
pub mod off;
pub mod pcd;
pub mod ply;
mod points;
mod polygon;
pub mod ptx;
mod quiet;
pub mod stl;
mod strands;
pub mod swc;
pub mod tck;
mod texture;
pub(crate) mod tidy;
mod tokens;
mod translucent;
pub mod trk;
pub mod trx;
pub mod vtk;
pub mod warnings;
pub mod xyz;

use std::ops::Range;
use std::path::PathBuf;

use glam::{DAffine3, DVec3, Vec2, Vec3};
use serde::{Deserialize, Serialize};

pub use self::blocks::{PointBlocks, Survey};
#[cfg(any(test, fuzzing))]
pub(crate) use self::dispatch::goes_by_extension;
pub use self::dispatch::{FORMATS, is_supported_extension, read, stands_alone};
pub use self::environment::EnvironmentImage;
pub use self::fields::{Field, Fields};
pub(crate) use self::strands::direction_colors;
use crate::math::{Bounds, Camera, Sensor};
use crate::memory::{Admission, Interrupt};

/// Everything that one file holds.
#[derive(Clone, Debug, Default)]
pub struct Asset {
    pub geometries: Vec<Geometry>,
    pub materials: Vec<Material>,
    pub textures: Vec<Texture>,
    /// Which geometry stands where. A format without a hierarchy has one placement, the identity.
    pub placements: Vec<Placement>,
    /// Cameras that the file itself names.
    pub cameras: Vec<(String, Camera)>,
    /// The one sensor that took all points, where the file tells of it.
    pub sensor: Option<Sensor>,
    /// Parts that were skipped or repaired, one sentence each (a missing texture, non-finite points …).
    pub warnings: Vec<String>,
    /// Format as recognised: `ply`, `las`, `laz`, `obj`, …
    pub format: &'static str,
}

/// A geometry's place in its file.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Placement {
    pub name: String,
    /// Index into [`Asset::geometries`].
    pub geometry: usize,
    pub asset_from_geometry: DAffine3,
}

#[derive(Clone, Debug)]
pub enum Geometry {
    Points(PointCloud),
    Mesh(Mesh),
    Lines(Polylines),
}

/// sRGB colour of points to which neither a colour nor another attribute gives one.
pub const NEUTRAL: [u8; 4] = [204, 204, 204, 255];

/// Samples without connectivity. Every optional vector is as long as `positions`.
#[derive(Clone, Debug, Default)]
pub struct PointCloud {
    pub positions: Vec<DVec3>,
    /// sRGB with straight alpha.
    pub colors: Option<Vec<[u8; 4]>>,
    /// Unit length, or zero where unknown.
    pub normals: Option<Vec<Vec3>>,
    /// Normals tell outside from inside; those that are estimated from neighbours alone do not.
    pub oriented: bool,
    /// Scalar fields, by different names.
    pub fields: Fields,
    /// In asset units, positive.
    pub radii: Option<Vec<f32>>,
    pub kernels: Option<Vec<Kernel>>,
    /// [`Clip::NONE`] where a sample keeps its whole kernel.
    pub clips: Option<Vec<Clip>>,
}

impl PointCloud {
    /// The scalar field with a name.
    pub fn field(&self, name: &str) -> Option<&Field> {
        self.fields.list().iter().find(|field| field.name == name)
    }

    /// The value of a scalar field at a point; `None` where it has none.
    pub fn value(&self, name: &str, point: usize) -> Option<f64> {
        self.field(name)?.value(self.fields.at(point))
    }

    /// The values of a scalar field, NaN where a point has none; `None` without such a field.
    pub fn values_of(&self, name: &str) -> Option<Vec<f64>> {
        let field = self.field(name)?;
        let points = (0..self.fields.points()).map(|point| self.fields.at(point));
        Some(points.map(|words| field.value(words).unwrap_or(f64::NAN)).collect())
    }

    /// Whether a clip line cuts something off a sample.
    pub fn is_clipped(&self, sample: usize) -> bool {
        self.clips.as_ref().is_some_and(|clips| clips[sample].lines.iter().any(Option::is_some))
    }
}

/// A sample's reconstruction kernel: an elliptical Gaussian in its tangent plane (Zwicker 2004, §3).
///
/// `u` and `v` are orthogonal, in asset units; their lengths are its standard deviations. A point of the tangent plane has
/// kernel coordinates `(s, t)` where it is `position + s · u + t · v`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Kernel {
    pub u: Vec3,
    pub v: Vec3,
}

/// The part of a kernel that is kept at sharp features (Zwicker 2004, §5).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Clip {
    pub lines: [Option<ClipLine>; 2],
    /// With two lines: keep what either keeps (a reflex corner) rather than what both keep.
    pub either: bool,
}

/// A line in kernel coordinates. It keeps the side where `normal · (s, t) ≥ offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClipLine {
    /// Unit length.
    pub normal: Vec2,
    pub offset: f32,
}

impl Clip {
    pub const NONE: Clip = Clip { lines: [None; 2], either: false };

    /// Whether the point with kernel coordinates `at` is kept.
    pub fn keeps(&self, at: Vec2) -> bool {
        let mut sides = self.lines.iter().flatten().map(|line| line.normal.dot(at) >= line.offset);
        if self.either && self.lines.iter().all(Option::is_some) {
            sides.any(|kept| kept)
        } else {
            sides.all(|kept| kept)
        }
    }
}

/// Indexed triangles. Every optional vector is as long as `positions`.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    pub positions: Vec<DVec3>,
    pub triangles: Vec<[u32; 3]>,
    /// sRGB with straight alpha.
    pub colors: Option<Vec<[u8; 4]>>,
    /// Unit length, or zero where unknown.
    pub normals: Option<Vec<Vec3>>,
    /// Texture coordinates with (0, 0) at the image's **top left**.
    pub uvs: Option<Vec<Vec2>>,
    /// Runs of triangles with one material, covering `triangles` in order; empty means no material.
    pub parts: Vec<MeshPart>,
}

/// A run of triangles that shares a material.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MeshPart {
    /// Number of triangles in the run.
    pub triangles: u32,
    /// Index into [`Asset::materials`].
    pub material: Option<u32>,
}

/// Strands of straight segments with a width: tubes, or ribbons where there are normals. Every optional vector is as long as
/// `positions`.
#[derive(Clone, Debug, Default)]
pub struct Polylines {
    /// Vertices, strand after strand.
    pub positions: Vec<DVec3>,
    /// The first vertex of each strand, ascending, and behind them the number of vertices. A strand has two vertices or more.
    pub strands: Vec<u32>,
    /// Radii of tubes or half the widths of ribbons, in asset units, finite and not negative; `None` where the file has none.
    pub radii: Option<Vec<f32>>,
    /// Normals of ribbons, of unit length; `None` makes tubes.
    pub normals: Option<Vec<Vec3>>,
    /// sRGB with straight alpha.
    pub colors: Option<Vec<[u8; 4]>>,
    /// Scalar fields of the vertices, by different names.
    pub fields: Fields,
}

impl Polylines {
    /// The largest radius; 0 without radii.
    pub fn widest(&self) -> f64 {
        let radii = self.radii.iter().flatten();
        f64::from(radii.copied().filter(|radius| radius.is_finite()).fold(0.0, f32::max))
    }

    /// The segments: each strand's, in order, by the number of their first vertex. The vertex behind it is their second.
    pub fn segments(&self) -> impl Iterator<Item = u32> {
        self.strands.windows(2).flat_map(|ends| ends[0]..ends[1].saturating_sub(1))
    }

    /// The vertices of the strand that a vertex belongs to.
    pub fn strand_of(&self, vertex: u32) -> Range<usize> {
        let after = self.strands.partition_point(|&first| first <= vertex);
        let end = self.strands.get(after).copied().unwrap_or(0);
        let first = after.checked_sub(1).map_or(0, |before| self.strands[before]);
        first as usize..end as usize
    }

    /// The unit direction of a ribbon's width at a vertex of `strand`: normal × tangent, where the tangent is that of the chord between
    /// the vertices before and behind it. Neighbouring segments therefore share their corners. Zero where there is none.
    pub fn side(&self, normals: &[Vec3], vertex: usize, strand: Range<usize>) -> DVec3 {
        let before = vertex.saturating_sub(1).max(strand.start);
        let after = (vertex + 1).min(strand.end - 1);
        let normal = normals[vertex].as_dvec3();
        let across = |from: usize, to: usize| {
            normal.cross(self.positions[to] - self.positions[from]).normalize_or_zero()
        };
        // Where a ribbon turns back by 180°, its chord has no direction.
        [across(before, after), across(vertex, after), across(before, vertex)]
            .into_iter()
            .find(|&side| side != DVec3::ZERO)
            .unwrap_or(DVec3::ZERO)
    }
}

/// Surface appearance: Phong's model, or the metallic-roughness model of glTF where [`Material::physical`] is there.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    pub name: String,
    /// **Linear** RGB and alpha, multiplied with vertex colour and texture.
    pub base_color: [f32; 4],
    /// Index into [`Asset::textures`].
    pub base_texture: Option<u32>,
    /// Linear specular colour of Phong's model; of other materials, that under a node's material of Phong's model.
    pub specular: [f32; 3],
    /// Phong exponent, ≥ 1.
    pub shininess: f32,
    /// Metallic-roughness reflection in place of Phong's.
    pub physical: Option<Physical>,
    /// Linear RGB of light that the surface gives off under any lights, from 0; the factor of [`Material::emissive_map`].
    pub emissive: [f32; 3],
    /// Index into [`Asset::textures`].
    pub emissive_map: Option<u32>,
    /// Normals in tangent space, red along increasing u and green along decreasing v.
    pub normal_map: Option<ScaledMap>,
    /// Its red channel is the share of ambient light that reaches the surface; the factor says how much of what is missing counts.
    pub occlusion_map: Option<ScaledMap>,
    /// Drawn from both sides; when false, triangles that face away are culled.
    pub double_sided: bool,
    /// Never shaded, whatever the lights.
    pub unlit: bool,
    /// Fragments with less alpha are not there; `None` draws everything.
    pub alpha_cutoff: Option<f32>,
    /// Surfaces behind it show through: by 1 − alpha where it [blends](Material::blends), and by [`Physical::transmission`].
    pub translucent: bool,
}

/// Metallic-roughness reflection (glTF 2.0, appendix B).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Physical {
    /// 0 for dielectrics to 1 for metals.
    pub metallic: f32,
    /// Perceptual roughness, 0 to 1: the square root of the α of the GGX distribution.
    pub roughness: f32,
    /// Reflectance at normal incidence where the surface is not metallic, linear RGB.
    pub dielectric: [f32; 3],
    /// Reflectance at grazing angles there, 1 but for KHR_materials_specular.
    pub grazing: f32,
    /// Index into [`Asset::textures`]; green is a factor of the roughness, blue of the metallic value.
    pub map: Option<u32>,
    /// Share of the light that is not reflected which passes the surface in place of being scattered below it (KHR_materials_transmission);
    /// 0 for metals. Surfaces that let light pass are [`Material::translucent`].
    pub transmission: f32,
    /// Index into [`Asset::textures`]; red is a factor of the transmission.
    pub transmission_map: Option<u32>,
    /// What the volume behind the surface leaves of the light that passes, linear RGB (KHR_materials_volume).
    pub volume: [f32; 3],
}

/// Reflectance at normal incidence of most dielectrics: that of an index of refraction of 1.5.
pub const DIELECTRIC: f32 = 0.04;

impl Default for Physical {
    fn default() -> Self {
        Self {
            metallic: 0.0,
            roughness: 1.0,
            dielectric: [DIELECTRIC; 3],
            grazing: 1.0,
            map: None,
            transmission: 0.0,
            transmission_map: None,
            volume: [1.0; 3],
        }
    }
}

/// The largest factor of light that a surface gives off.
pub const MOST_EMISSIVE: f32 = 1e6;

/// A texture of data, and how much it counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScaledMap {
    /// Index into [`Asset::textures`].
    pub texture: u32,
    pub factor: f32,
}

impl Material {
    /// Whether maps say from place to place how its surface reflects, or what light the surface gives off.
    pub fn varies(&self) -> bool {
        let reflects = self.physical.is_some_and(|own| own.map.is_some());
        reflects || self.emissive_map.is_some()
    }

    /// Whether a surface of its colour looks otherwise under another material: it is a metal, gives off light or is not lit.
    pub fn differs(&self) -> bool {
        let is_metal = self.physical.is_some_and(|own| own.metallic > 0.0);
        is_metal || self.unlit || self.emissive != [0.0; 3]
    }

    /// Whether alpha says how much it hides. Otherwise it is there wholly where [`Material::alpha_cutoff`] leaves it.
    pub fn blends(&self) -> bool {
        self.alpha_cutoff == Some(LEAST_ALPHA)
    }

    /// Whether light passes it in place of being scattered.
    pub fn transmits(&self) -> bool {
        !self.unlit && self.physical.is_some_and(|own| own.transmission > 0.0)
    }

    /// Whether textures tell more of it than its colour.
    pub fn has_maps(&self) -> bool {
        let own =
            self.physical.is_some_and(|own| own.map.is_some() || own.transmission_map.is_some());
        own || self.emissive_map.is_some()
            || self.normal_map.is_some()
            || self.occlusion_map.is_some()
    }
}

/// Least alpha of translucent fragments, the cut-off of materials that [blend](Material::blends): white with less over black stays black in
/// eight bits.
pub const LEAST_ALPHA: f32 = 1.0 / 8192.0;

impl Default for Material {
    fn default() -> Self {
        Self {
            name: String::new(),
            base_color: [1.0; 4],
            base_texture: None,
            specular: [0.0; 3],
            shininess: 1.0,
            physical: None,
            emissive: [0.0; 3],
            emissive_map: None,
            normal_map: None,
            occlusion_map: None,
            double_sided: true,
            unlit: false,
            alpha_cutoff: None,
            translucent: false,
        }
    }
}

/// An image, decoded.
#[derive(Clone, Debug)]
pub struct Texture {
    pub name: String,
    pub width: u32,
    pub height: u32,
    /// `width · height` texels with straight alpha, row by row from the top.
    pub rgba: Vec<[u8; 4]>,
    pub wrap: [Wrap; 2],
    pub filter: Filter,
    pub encoding: Encoding,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Wrap {
    #[default]
    Repeat,
    Mirror,
    Clamp,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Filter {
    /// Trilinear.
    #[default]
    Linear,
    Nearest,
}

/// What the bytes of a texture's red, green and blue stand for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Encoding {
    /// Colours.
    #[default]
    Srgb,
    /// Values from 0 to 1 as they are.
    Linear,
}

/// Bounds on what a reader may take in, and where it reports.
#[derive(Clone)]
pub struct ReadOptions {
    /// More points or vertices than this are refused.
    pub max_vertices: u64,
    /// More triangles than this are refused.
    pub max_triangles: u64,
    /// Texels of all textures together.
    pub max_texels: u64,
    /// Bytes after decompression (`.gz`, LAZ, PCD, TRX).
    pub max_decompressed_bytes: u64,
    /// Files that the asset names (MTL, textures, glTF buffers) are only read below this folder;
    /// `None` allows the asset's own folder only.
    pub root: Option<PathBuf>,
    pub progress: Progress,
    /// The files that assets name are noted here when they are found.
    pub named: NamedFiles,
    /// Memory is reserved here before it is allocated; reading ends when this is cancelled.
    pub admission: Admission,
}

impl Default for ReadOptions {
    fn default() -> Self {
        Self {
            max_vertices: 1 << 31,
            max_triangles: 1 << 31,
            max_texels: 1 << 28,
            max_decompressed_bytes: 16 << 30,
            root: None,
            progress: Progress::none(),
            named: NamedFiles::default(),
            admission: Admission::default(),
        }
    }
}

/// Files that assets of a load have named, such as materials, textures and buffers; clones share the list.
#[derive(Clone, Debug, Default)]
pub struct NamedFiles(std::sync::Arc<parking_lot::Mutex<std::collections::BTreeSet<PathBuf>>>);

impl NamedFiles {
    fn note(&self, file: &std::path::Path) {
        self.0.lock().insert(file.to_owned());
    }

    /// Returns all files so far.
    pub fn list(&self) -> Vec<PathBuf> {
        self.0.lock().iter().cloned().collect()
    }
}

/// Called now and then with the fraction done in 0..=1.
#[derive(Clone)]
pub struct Progress(Option<std::sync::Arc<dyn Fn(f32) + Send + Sync>>);

impl Progress {
    pub fn none() -> Self {
        Self(None)
    }

    pub fn new(report: impl Fn(f32) + Send + Sync + 'static) -> Self {
        Self(Some(std::sync::Arc::new(report)))
    }

    pub fn report(&self, fraction: f32) {
        if let Some(report) = &self.0 {
            report(fraction);
        }
    }
}

/// Why a file was refused. The text always begins with the file's name.
#[derive(Debug, thiserror::Error)]
pub enum AssetError {
    #[error("{file}: {source}")]
    Io { file: String, source: std::io::Error },
    /// Not a format this program reads; `reason` says what would be accepted.
    #[error("{file}: {reason}")]
    Unsupported { file: String, reason: String },
    /// Damaged or lying content: `place` names element, index and property (`vertex 17, property x`).
    #[error("{file}: {place}: {reason}")]
    Malformed { file: String, place: String, reason: String },
    #[error("{file}: {what} ({found}) is over the limit of {limit}")]
    TooLarge { file: String, what: &'static str, found: u64, limit: u64 },
    /// Cancelled, or there is no memory for it.
    #[error(transparent)]
    Interrupted(#[from] Interrupt),
}

impl Asset {
    /// An asset of one geometry at the identity.
    pub fn single(format: &'static str, name: &str, geometry: Geometry) -> Asset {
        Asset {
            geometries: vec![geometry],
            placements: vec![Placement {
                name: name.to_owned(),
                geometry: 0,
                asset_from_geometry: DAffine3::IDENTITY,
            }],
            format,
            ..Asset::default()
        }
    }

    /// The box around every placement.
    pub fn bounds(&self) -> Bounds {
        let boxes: Vec<Bounds> = self.geometries.iter().map(Geometry::bounds).collect();
        self.placements.iter().fold(Bounds::EMPTY, |all, placement| {
            all.union(boxes[placement.geometry].transformed(&placement.asset_from_geometry))
        })
    }
}

impl Geometry {
    pub fn bounds(&self) -> Bounds {
        let bounds = Bounds::of(self.positions().iter().copied());
        match self {
            Geometry::Lines(lines) => bounds.grown(lines.widest()),
            _ => bounds,
        }
    }

    pub fn positions(&self) -> &[DVec3] {
        match self {
            Geometry::Points(cloud) => &cloud.positions,
            Geometry::Mesh(mesh) => &mesh.positions,
            Geometry::Lines(lines) => &lines.positions,
        }
    }
}
