//! Picks: which element of which instance a pixel shows, and where that is in the world.
//!
//! A pick draws the frame with `output=id`. Instead of the image, it reads three words for each pixel: the id of the instance, the chunk,
//! and the element in the chunk. The pass `identify` writes the chunk and the element, so a pick names exactly what the frame shows.
//! Positions are computed in f64 from the host's copy of the element: a sample's own position, or the point where the pixel's ray meets the
//! triangle or the line.

mod lines;

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};
use std::ops::Range;
use std::sync::Arc;

use glam::{DAffine3, DVec2, DVec3, IVec3};
use serde::Serialize;
use sha2::{Digest, Sha256};
use utoipa::ToSchema;

use self::lines::{Detail, Strands};
use super::loaded::{Loaded, node_name};
use super::resolved::ResolvedFrame;
use super::{EncodedFrame, Engine, EngineError, FrameRequest, FrameTicket, Origin};
use crate::bake::pack::{
    PackedGeometry, PackedLines, PackedMesh, PackedSamples, octahedral_decode,
};
use crate::encode::{FrameImage, ImageFormat};
use crate::math::View;
use crate::plan::Output;
use crate::residency::model::{AssetModel, ModelInstance, SceneModel};
use crate::scene::InstancePaths;
use crate::scene::color::{linear_from_srgb, srgb_from_linear};

/// Largest number of pixels in one pick.
pub const MOST_PIXELS: usize = 4096;
/// Number of words that are read back for each pixel.
const WORDS: usize = 3;
pub(super) const BYTES: u64 = 4 * WORDS as u64;
/// Number of the geometry for a pixel that shows nothing.
const NOTHING: u32 = u32::MAX;

/// The surface that a pixel shows.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct Pick {
    /// Column of the pixel, from the left.
    pub x: u32,
    /// Row of the pixel, from the top.
    pub y: u32,
    /// `null` where the pixel shows the background.
    pub hit: Option<Hit>,
}

/// An element that a pixel shows.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct Hit {
    pub kind: HitKind,
    /// World position: a sample's own position, or the point of the triangle or line behind the pixel's centre.
    pub position: [f64; 3],
    /// Distance between the positions that the element can be stored at, in scene units: digits below it mean nothing.
    pub resolution: f64,
    /// Distance from the eye.
    pub distance: f64,
    /// Distance along the viewing axis, as `output=depth` has it.
    pub depth: f64,
    /// World-space unit normal, turned towards the eye; `null` where the sample has none.
    pub normal: Option<[f64; 3]>,
    /// Values of the scalar fields of a sample, or of the place on a line. A node of a point tree has the mean of the samples that it stands
    /// for, and the class of most of them.
    pub fields: BTreeMap<String, f64>,
    /// sRGB colour without lights. A sample has its own colour, a segment the colour between its vertices, a triangle the product of
    /// vertex colour, material and nearest texel.
    pub color: [u8; 3],
    /// `null` for a node of a point tree that stands for several instances.
    pub instance: Option<PickedInstance>,
    /// Index of the geometry in its asset.
    pub geometry: u32,
    /// Where along its strand a line is hit; `null` for other elements.
    pub strand: Option<PickedStrand>,
    /// Chunk of the geometry, and index of the sample, triangle or segment in the geometry, in the order of drawing.
    pub chunk: u32,
    pub element: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum HitKind {
    /// A sample of a cloud or of a sampled surface.
    Point,
    /// A node of a point tree, which stands for one sample or for many.
    Node,
    Triangle,
    /// A segment of a line.
    Segment,
}

/// A place along a strand of a file of lines.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, ToSchema)]
pub struct PickedStrand {
    /// Number of the strand in its file, from 0.
    pub index: u32,
    /// Number of the vertex before the place, in the strand.
    pub vertex: u32,
    /// Share of the way from there to the next vertex, 0 to 1.
    pub share: f64,
}

/// An instance, by its id and by the nodes above it.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct PickedInstance {
    /// Number that `output=id` shows.
    pub id: u32,
    /// From a top-level node, as `PATCH` names it, to the node that draws the asset.
    pub path: Vec<PickedNode>,
    pub asset: String,
    /// Name of the part of the asset's file; empty where the file has none.
    pub part: String,
}

#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct PickedNode {
    /// The node's name, or its index where it has none.
    pub name: String,
    /// Index of the node among its siblings.
    pub index: usize,
    /// Number of the copy, where the node repeats; else 0.
    pub copy: u64,
}

/// Reads the answer of a pick.
pub struct Picker {
    loaded: Arc<Loaded>,
    model: Arc<SceneModel>,
    view: View,
    pixels: Arc<[[u32; 2]]>,
}

impl Engine {
    /// Queues a frame that tells what some of its pixels show. The [`Picker`] reads the frame that the ticket gives.
    ///
    /// # Errors
    /// The frame was not resolved with `output=id`, a pixel lies outside the frame, there are no pixels or more than [`MOST_PIXELS`], or the
    /// queue is full ([`EngineError::Busy`]).
    pub fn pick(
        &self,
        origin: impl Into<Origin>,
        frame: &ResolvedFrame,
        pixels: Vec<[u32; 2]>,
    ) -> Result<(FrameTicket, Picker), EngineError> {
        if frame.request.output != Output::Id || frame.request.format != ImageFormat::Raw {
            return Err(EngineError::Internal("a pick reads raw ids".into()));
        }
        check(&frame.request, &pixels)?;
        let pixels: Arc<[[u32; 2]]> = pixels.into();
        let digest = Sha256::digest(bytemuck::cast_slice(&pixels));
        let mut picking = frame.clone();
        picking.key = format!("{}{digest:?}", picking.key);
        picking.picks = pixels.clone();
        let plan = std::mem::take(&mut picking.drawing.plan);
        picking.drawing.plan = plan.with_identities();
        let (loaded, model, view) = (frame.scene.clone(), frame.model.clone(), frame.view);
        let ticket = self.queue(origin, Arc::new(picking))?;
        Ok((ticket, Picker { loaded, model, view, pixels }))
    }
}

/// Turns the request of a frame into the request that a pick draws. The output and the format of the given request do not matter.
pub fn request_of(request: FrameRequest) -> FrameRequest {
    FrameRequest { output: Output::Id, format: ImageFormat::Raw, ..request }
}

fn check(request: &FrameRequest, pixels: &[[u32; 2]]) -> Result<(), EngineError> {
    if pixels.is_empty() || pixels.len() > MOST_PIXELS {
        return Err(EngineError::BadParameter {
            parameter: "pixels",
            reason: format!("{} of them", pixels.len()),
            accepted: format!("1 to {MOST_PIXELS} pixels"),
        });
    }
    for (number, &[x, y]) in pixels.iter().enumerate() {
        for (parameter, value, side) in [("x", x, request.width), ("y", y, request.height)] {
            if value >= side && pixels.len() == 1 {
                return Err(EngineError::BadParameter {
                    parameter,
                    reason: format!("{value} lies outside the frame"),
                    accepted: format!("0 to {}", side - 1),
                });
            }
            if value >= side {
                return Err(EngineError::BadParameter {
                    parameter: "pixels",
                    reason: format!(
                        "{parameter} {value} of number {number}, counted from 0, lies outside the frame"
                    ),
                    accepted: format!("{parameter} of 0 to {}", side - 1),
                });
            }
        }
    }
    Ok(())
}

/// Converts the words that a pick has read back: an index into the table of chunks becomes a geometry and a chunk of that geometry.
/// Geometries are numbered asset by asset; `ranges` holds the range of chunks of each.
pub(super) fn image(count: usize, bytes: &[u8], ranges: &[Range<u32>]) -> FrameImage {
    let words: Vec<u32> = bytemuck::pod_collect_to_vec(bytes);
    let mut id = Vec::with_capacity(count * (WORDS + 1));
    for words in words.chunks_exact(WORDS) {
        let &[instance, chunk, element] = words else { continue };
        let geometry = ranges.iter().position(|range| range.contains(&chunk));
        let shown = geometry.filter(|_| element != 0);
        id.extend(match shown {
            Some(geometry) => {
                [instance, geometry as u32, chunk - ranges[geometry].start, element - 1]
            }
            None => [0, NOTHING, 0, 0],
        });
    }
    FrameImage::Id { width: WORDS as u32 + 1, height: count as u32, id }
}

impl Picker {
    /// Returns what the pixels show, in the order in which they were given.
    ///
    /// # Errors
    /// The frame belongs to another pick.
    pub fn read(&self, frame: &EncodedFrame) -> Result<Vec<Pick>, EngineError> {
        let words: Vec<u32> = bytemuck::pod_collect_to_vec(&frame.bytes);
        if words.len() != (WORDS + 1) * self.pixels.len() {
            return Err(EngineError::Internal("a pick has not as many words as pixels".into()));
        }
        let words = words.chunks_exact(WORDS + 1);
        let ids: HashSet<u32> = words.clone().map(|words| words[0]).filter(|&id| id != 0).collect();
        let all = self.model.instances.iter();
        let instances: HashMap<u32, &ModelInstance> =
            all.filter(|one| ids.contains(&one.id)).map(|one| (one.id, one)).collect();
        let paths = self.loaded.instance_paths();
        let strands = self.strands(words.clone());
        let picks = self.pixels.iter().zip(words).map(|(&[x, y], words)| Pick {
            x,
            y,
            hit: self.hit(
                words,
                DVec2::new(f64::from(x), f64::from(y)) + 0.5,
                &instances,
                &paths,
                strands.as_ref(),
            ),
        });
        Ok(picks.collect())
    }

    fn hit(
        &self,
        words: &[u32],
        pixel: DVec2,
        instances: &HashMap<u32, &ModelInstance>,
        paths: &InstancePaths<'_>,
        strands: Option<&HashMap<u32, Strands>>,
    ) -> Option<Hit> {
        let &[id, number, chunk, within] = words else { return None };
        let (asset, geometry) = self.geometry(number)?;
        let instance = instances.get(&id).copied();
        // A node over several instances belongs to none of them; its coordinates are those of the world.
        let world = instance.map_or(DAffine3::IDENTITY, |one| one.world_from_geometry);
        let packed = asset.packed.geometries.get(geometry)?;
        let record = packed.chunks().get(chunk as usize)?;
        let index = (record.first + within) as usize;
        let tint = instance
            .and_then(|one| self.model.materials.get(one.material?))
            .and_then(|material| material.base_color);
        let element = match packed {
            PackedGeometry::Samples(samples) => {
                let cell = record.cell(*samples.positions.get(index)?);
                sample(samples, index, cell, tint)?
            }
            PackedGeometry::Triangles(mesh) => {
                let (view, ray) = (&self.view, self.view.ray(pixel));
                let world_from_view = view.view_from_world.transpose();
                let way = world_from_view * view.towards(ray);
                let origin = view.at_depth(ray, 0.0);
                let ray = (view.eye + world_from_view * origin, way);
                triangle((asset, mesh), (chunk as usize, index), &world, ray, tint)?
            }
            PackedGeometry::Lines(lines) => {
                let (view, ray) = (&self.view, self.view.ray(pixel));
                let world_from_view = view.view_from_world.transpose();
                let way = world_from_view * view.towards(ray);
                let origin = view.eye + world_from_view * view.at_depth(ray, 0.0);
                let detail = strands.map_or(Detail::Full, |all| Detail::Levels(all.get(&number)));
                lines::segment(lines, (record, index), &world, (origin, way), tint, detail)?
            }
        };
        let position = world.transform_point3(element.local);
        let from_eye = self.view.to_view(position);
        let to_eye = self.view.view_from_world.transpose() * -self.view.towards(from_eye);
        let normal = turned(&world, element.normal, to_eye);
        let axes = world.matrix3;
        let scale = axes.x_axis.length().max(axes.y_axis.length()).max(axes.z_axis.length());
        Some(Hit {
            kind: element.kind,
            position: position.into(),
            resolution: packed.grid().step * f64::from(record.shift).exp2() * scale,
            distance: position.distance(self.view.eye),
            depth: -from_eye.z,
            normal: normal.map(Into::into),
            fields: element.fields,
            strand: element.strand,
            color: srgb(element.color),
            instance: instance.map(|_| self.instance(id, paths)),
            geometry: geometry as u32,
            chunk,
            element: index as u32,
        })
    }

    /// Returns the vertices of the strands that the pixels show, by the number of the geometry; `None` for a frame at full detail.
    fn strands<'w>(
        &self,
        pixels: impl Iterator<Item = &'w [u32]>,
    ) -> Option<HashMap<u32, Strands>> {
        if Arc::ptr_eq(&self.model, &self.loaded.model) {
            return None;
        }
        let mut wanted: HashMap<u32, BTreeSet<u32>> = HashMap::new();
        for words in pixels {
            let &[_, number, chunk, within] = words else { continue };
            let Some(PackedGeometry::Lines(lines)) = self.packed(number) else { continue };
            let Some(record) = lines.chunks.get(chunk as usize) else { continue };
            if let Some((strand, _)) = lines.strand_of((record.first + within) as usize) {
                wanted.entry(number).or_default().insert(strand);
            }
        }
        let found = wanted.into_iter().filter_map(|(number, wanted)| {
            Some((number, lines::strands(self.full_lines(number)?, &wanted)))
        });
        Some(found.collect())
    }

    fn packed(&self, number: u32) -> Option<&PackedGeometry> {
        let (asset, geometry) = self.geometry(number)?;
        asset.packed.geometries.get(geometry)
    }

    /// Returns the lines of a geometry at full detail. Levels of detail have the index of their geometry.
    fn full_lines(&self, number: u32) -> Option<&PackedLines> {
        let (asset, geometry) = self.geometry(number)?;
        let full = self.loaded.model.assets.iter().find(|full| full.name == asset.name)?;
        match full.packed.geometries.get(geometry)? {
            PackedGeometry::Lines(lines) => Some(lines),
            _ => None,
        }
    }

    /// Returns the asset and the index of the geometry with this number. Geometries are numbered asset by asset.
    fn geometry(&self, number: u32) -> Option<(&AssetModel, usize)> {
        let mut rest = number as usize;
        for asset in &self.model.assets {
            let count = asset.packed.geometries.len();
            if rest < count {
                return Some((asset, rest));
            }
            rest -= count;
        }
        None
    }

    fn instance(&self, id: u32, paths: &InstancePaths<'_>) -> PickedInstance {
        let Some(found) = paths.find(u64::from(id) - 1) else {
            return PickedInstance { id, path: vec![], asset: String::new(), part: String::new() };
        };
        let steps = found.steps.iter().map(|step| PickedNode {
            name: node_name(step.node, step.index),
            index: step.index,
            copy: step.copy,
        });
        let (asset, part) = self.loaded.placement_names(found.asset, found.placement);
        PickedInstance { id, path: steps.collect(), asset: asset.into(), part: part.into() }
    }
}

/// An element in the axes of its geometry. The colour is linear.
struct Element {
    kind: HitKind,
    local: DVec3,
    normal: DVec3,
    color: DVec3,
    /// Values of scalar fields.
    fields: BTreeMap<String, f64>,
    strand: Option<PickedStrand>,
}

/// The colour that an instance's material has in place of the asset's.
type Tint = Option<[f32; 4]>;

fn sample(samples: &PackedSamples, index: usize, cell: IVec3, tint: Tint) -> Option<Element> {
    let &[color, normal] = samples.attributes.get(index)?;
    Some(Element {
        kind: if samples.nodes.is_empty() { HitKind::Point } else { HitKind::Node },
        local: samples.grid.position(cell),
        normal: octahedral_decode(normal).as_dvec3(),
        color: linear(color) * base(tint.unwrap_or([1.0; 4])),
        fields: samples
            .fields
            .iter()
            .filter_map(|field| {
                let value = field.value(samples.values_of(index))?;
                Some((field.name().to_owned(), value))
            })
            .collect(),
        strand: None,
    })
}

/// The point of a triangle where a ray from the eye meets it.
fn triangle(
    (asset, mesh): (&AssetModel, &PackedMesh),
    (chunk, index): (usize, usize),
    world: &DAffine3,
    (eye, way): (DVec3, DVec3),
    tint: Tint,
) -> Option<Element> {
    let record = mesh.chunks.get(chunk)?;
    let word = *mesh.triangles.get(index)?;
    let corner = |shift: u32| {
        let vertex = mesh.vertices.get((record.vertex_first + (word >> shift & 0x3ff)) as usize)?;
        let cell = IVec3::new(vertex[0] as i32, vertex[1] as i32, vertex[2] as i32);
        Some((mesh.grid.position(cell), vertex))
    };
    let corners = [corner(0)?, corner(10)?, corner(20)?];
    let seen = corners.map(|(at, _)| world.transform_point3(at) - eye);
    let shares = shares(seen, way);
    let mix = |values: [DVec3; 3]| -> DVec3 {
        values.into_iter().zip(shares).map(|(value, share)| value * share).sum()
    };
    let places = corners.map(|(at, _)| at);
    let normals = corners.map(|(_, vertex)| octahedral_decode(vertex[4]).as_dvec3());
    let flat = (places[1] - places[0]).cross(places[2] - places[0]);
    let smooth = mix(normals);
    let uv = mix(corners.map(|(_, vertex)| {
        DVec3::new(f32::from_bits(vertex[5]).into(), f32::from_bits(vertex[6]).into(), 0.0)
    }));
    let number = (record.material as usize).checked_sub(1);
    let material = number.and_then(|number| asset.packed.materials.get(number));
    let texture = material.and_then(|m| asset.packed.textures.get(m.base_texture? as usize));
    let texel = texture.and_then(|texture| texture.nearest_texel(uv.truncate()));
    let color = mix(corners.map(|(_, vertex)| linear(vertex[3])))
        * base(tint.unwrap_or(material.map_or([1.0; 4], |material| material.base_color)))
        * texel.map_or(DVec3::ONE, linear);
    Some(Element {
        kind: HitKind::Triangle,
        local: mix(places),
        normal: if smooth == DVec3::ZERO { flat } else { smooth },
        color,
        fields: BTreeMap::new(),
        strand: None,
    })
}

/// Barycentric coordinates of the point where the ray from the origin along `way` meets a triangle, clamped to the triangle. The pixel
/// shows the triangle, so a point outside is a rounding error.
fn shares([a, b, c]: [DVec3; 3], way: DVec3) -> [f64; 3] {
    let volumes = [way.dot(b.cross(c)), way.dot(c.cross(a)), way.dot(a.cross(b))];
    let sign = volumes.iter().sum::<f64>().signum();
    let inside = volumes.map(|volume| (volume * sign).max(0.0));
    let sum: f64 = inside.iter().sum();
    // A triangle that is seen edge-on: its middle.
    if sum > 0.0 && sum.is_finite() { inside.map(|v| v / sum) } else { [1.0 / 3.0; 3] }
}

/// A normal in world space, towards the eye.
fn turned(world: &DAffine3, normal: DVec3, to_eye: DVec3) -> Option<DVec3> {
    let (x, y, z) = (world.matrix3.x_axis, world.matrix3.y_axis, world.matrix3.z_axis);
    // The cofactors turn normals as the inverse transpose does, up to a factor.
    let n = y.cross(z) * normal.x + z.cross(x) * normal.y + x.cross(y) * normal.z;
    let n = n.try_normalize()?;
    Some(if n.dot(to_eye) < 0.0 { -n } else { n })
}

fn linear(word: u32) -> DVec3 {
    let [r, g, b, _] = word.to_le_bytes();
    DVec3::from([r, g, b].map(|byte| linear_from_srgb(f64::from(byte) / 255.0)))
}

fn base([r, g, b, _]: [f32; 4]) -> DVec3 {
    DVec3::new(r.into(), g.into(), b.into())
}

fn srgb(color: DVec3) -> [u8; 3] {
    color.to_array().map(|linear| (srgb_from_linear(linear.clamp(0.0, 1.0)) * 255.0).round() as u8)
}
