//! Packs geometries into the chunks that the GPU holds.
//!
//! Positions become integers on a grid of the asset whose step is a power of two, about 2⁻²⁹ of the asset's size. That is finer
//! than f32 at the asset's edge, and differences are exact, so geometry near the eye keeps all its digits however far it is from
//! the asset's origin. Samples and triangles are sorted along a Morton curve and cut into chunks of at most 1024, the unit of
//! culling and of a workgroup. A sample's position is stored in 64 bits (3 × 21, relative to its chunk); a sample takes 20 bytes
//! with colour, normal and reconstruction kernel. Samples with clip lines take 8 bytes more. They are stored in separate chunks
//! behind the others, so that samples without clip lines do not pay for them. A triangle takes 4 bytes and each of its vertices
//! 28.

mod kernel;
mod order;
mod pieces;
mod texture;
mod unpack;

pub(super) use kernel::lengths as kernel_lengths;
pub use kernel::longer_axis;
pub(super) use pieces::Packing;
pub use texture::{PackedTexture, pack_texture, unpack_texture};
pub(super) use unpack::unpack_kernel;
pub use unpack::{unpack_mesh, unpack_samples};

use glam::{DVec3, I64Vec3, IVec3, Vec3};
use rayon::prelude::*;

use super::colors::NEUTRAL;
use crate::assets::{Clip, Kernel, Material, Mesh, PointCloud};
use crate::math::Bounds;

/// Maximum number of samples, triangles or vertices in a chunk.
pub const CHUNK: usize = 1024;
/// `shift` of a chunk of triangles.
pub const TRIANGLES: u32 = u32::MAX;
/// The normal word that means no normal.
pub const NO_NORMAL: u32 = 0x8000_8000;
/// Bytes of a sample.
pub const SAMPLE_BYTES: u64 = 20;
/// Additional bytes of a sample with clip lines.
pub const CLIP_BYTES: u64 = 8;
/// Additional bytes of a sample that is a node of a point tree.
pub const NODE_BYTES: u64 = 8;
/// Minimum size of a cell relative to the longest kernel: shaders square the kernel's length in cells, and the square has to fit
/// into f32. The limit only matters where samples lie closer together than 10⁻⁹ of their kernels, or at one position.
pub(super) const KERNEL_DETAIL: f64 = 1.0 / (1u64 << 60) as f64;
/// Words of a mesh vertex: grid position, colour, normal, texture coordinates.
pub const VERTEX_WORDS: usize = 7;

/// The grid on which positions are stored: `local = origin + step · grid`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Grid {
    pub origin: DVec3,
    pub step: f64,
    /// Largest absolute coordinate in use.
    pub reach: i32,
}

/// Up to [`CHUNK`] neighbouring samples or triangles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PackedChunk {
    /// Minimum corner of the box, in grid cells.
    pub origin: IVec3,
    /// Size of the box in grid cells.
    pub extent: IVec3,
    /// First sample or triangle.
    pub first: u32,
    pub count: u32,
    /// Samples: coordinates count in steps of 2^shift cells; [`TRIANGLES`] for triangles.
    pub shift: u32,
    /// Triangles: first vertex and number of vertices.
    pub vertex_first: u32,
    pub vertex_count: u32,
    /// Index into the asset's materials plus one, 0 for the default.
    pub material: u32,
    /// Samples: longest axis of a kernel, in steps of 2^shift cells.
    pub kernel_base: f32,
    /// Samples: what the normals say about the surface.
    pub sides: Sides,
    /// Point trees: bounds of the nodes or triangles in the chunk.
    pub range: NodeRange,
}

/// Information that the normals of samples give about the surface.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u32)]
pub enum Sides {
    /// Nothing: a normal may point to either side.
    #[default]
    Unknown = 0,
    /// Normals point outwards.
    Oriented = 1,
    /// Normals point outwards and the surface is closed: its back is never seen from outside.
    Closed = 2,
}

impl PackedChunk {
    /// The cell of a sample of this chunk, from the words of its position.
    pub fn cell(&self, [low, high]: [u32; 2]) -> IVec3 {
        let word = u64::from(low) | u64::from(high) << 32;
        let q = [word, word >> 21, word >> 42].map(|v| (v & 0x1f_ffff) as i32);
        self.origin + IVec3::from(q) * (1 << self.shift)
    }
}

/// Bounds over the nodes of a chunk of a point tree, or over the triangles that its leaves stand for. Lengths are in grid cells.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NodeRange {
    /// The base of the codes of errors, sizes and distances: see [`crate::bake::tree`].
    pub base: f32,
    /// The largest error of a parent, in this chunk and those behind it; for triangles, their longest side.
    pub error_parent: f32,
    /// The largest size of a parent, likewise.
    pub size_parent: f32,
    /// The smallest error and size of a node.
    pub error_least: f32,
    pub size_least: f32,
    /// The longest distance from a node to its parent, in this chunk and those behind it.
    pub delta_most: f32,
}

/// A point cloud as the GPU holds it.
#[derive(Clone, Debug, Default)]
pub struct PackedSamples {
    pub grid: Grid,
    pub chunks: Vec<PackedChunk>,
    /// 21 bits a coordinate, relative to the chunk, x lowest.
    pub positions: Vec<[u32; 2]>,
    /// sRGB8 colour and octahedral normal.
    pub attributes: Vec<[u32; 2]>,
    /// For each sample: logarithms of the axes' lengths, 11 bits each, and an angle.
    pub kernels: Vec<u32>,
    /// For each sample from `clipped_first` on: two clip lines.
    pub clips: Vec<[u32; 2]>,
    /// The first sample with clip lines; a chunk begins there.
    pub clipped_first: u32,
    /// Point trees: the two words of each node, which decide whether it is drawn (see [`crate::bake::tree`]).
    pub nodes: Vec<[u32; 2]>,
}

/// A mesh as the GPU holds it.
#[derive(Clone, Debug)]
pub struct PackedMesh {
    pub grid: Grid,
    pub chunks: Vec<PackedChunk>,
    pub vertices: Vec<[u32; VERTEX_WORDS]>,
    /// Three 10-bit indices into the chunk's vertices.
    pub triangles: Vec<u32>,
}

/// A geometry that cannot be packed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PackError {
    #[error("coordinates span {extent:e} units; up to 1e30 can be drawn")]
    TooFar { extent: f64 },
    #[error("position {index} is not finite")]
    NotFinite { index: usize },
}

impl Grid {
    /// The grid of a box: 2²⁹ cells or fewer across its longest side.
    ///
    /// # Errors
    /// Fails if the box is not finite or longer than 1e30.
    pub fn of(bounds: &Bounds) -> Result<Grid, PackError> {
        Grid::with_detail(bounds, 0.0)
    }

    /// The grid of a box, with cells no smaller than `detail`.
    pub(super) fn with_detail(bounds: &Bounds, detail: f64) -> Result<Grid, PackError> {
        let extent = bounds.extent().max_element();
        if !(extent.is_finite() && extent < 1e30 && bounds.centre().abs().max_element() < 1e30) {
            return Err(PackError::TooFar { extent });
        }
        let origin = bounds.centre();
        // Below this step the coordinates themselves have no more digits.
        let least = (origin.abs().max_element() * f64::EPSILON).max(1e-30).max(detail);
        let step = (extent / f64::from(1 << 29)).max(least).log2().ceil().exp2();
        let reach = (0.5 * extent / step).ceil() as i32 + 1;
        Ok(Grid { origin, step, reach })
    }

    /// The nearest grid point.
    pub fn quantise(&self, position: DVec3) -> IVec3 {
        // The inverse of a power of two is exact.
        let cells = (position - self.origin) * (1.0 / self.step);
        IVec3::new(nearest(cells.x), nearest(cells.y), nearest(cells.z))
    }

    /// The position of a grid point.
    pub fn position(&self, cell: IVec3) -> DVec3 {
        self.origin + cell.as_dvec3() * self.step
    }
}

/// The nearest integer; halves round away from zero. On targets without a rounding instruction, `round` would be a function call.
fn nearest(value: f64) -> i32 {
    let whole = value as i32;
    let rest = value - f64::from(whole);
    whole.saturating_add(i32::from(rest >= 0.5) - i32::from(rest <= -0.5))
}

/// Spreads the lower 21 bits of `v`, two zeros after each.
pub fn spread(v: u64) -> u64 {
    let mut x = v & 0x1f_ffff;
    x = (x | x << 32) & 0x001f_0000_0000_ffff;
    x = (x | x << 16) & 0x001f_0000_ff00_00ff;
    x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
    x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
    (x | x << 2) & 0x1249_2492_4924_9249
}

/// Morton code of a cell, from the upper 21 of 30 bits per coordinate.
pub(super) fn morton(cell: IVec3) -> u64 {
    let part = |v: i32| spread((i64::from(v) + (1 << 29)).clamp(0, (1 << 30) - 1) as u64 >> 9);
    part(cell.x) | part(cell.y) << 1 | part(cell.z) << 2
}

/// Encodes a unit vector as two signed 16-bit numbers (octahedral map); [`NO_NORMAL`] for zero or non-finite vectors.
pub fn octahedral(normal: Vec3) -> u32 {
    let sum = normal.abs().element_sum();
    if !(sum > 0.0 && sum.is_finite()) {
        return NO_NORMAL;
    }
    let n = normal / sum;
    let sign = |v: f32| if v >= 0.0 { 1.0 } else { -1.0 };
    let (x, y) = if n.z < 0.0 {
        ((1.0 - n.y.abs()) * sign(n.x), (1.0 - n.x.abs()) * sign(n.y))
    } else {
        (n.x, n.y)
    };
    let snorm = |v: f32| nearest(f64::from(v.clamp(-1.0, 1.0) * 32767.0)) as i16 as u16;
    u32::from(snorm(x)) | u32::from(snorm(y)) << 16
}

/// Decodes a normal word to a unit vector with the shaders' own steps; zero for [`NO_NORMAL`].
pub fn octahedral_decode(word: u32) -> Vec3 {
    if word == NO_NORMAL {
        return Vec3::ZERO;
    }
    let part = |half: u32| (f32::from(half as u16 as i16) / 32767.0).max(-1.0);
    let (x, y) = (part(word), part(word >> 16));
    let mut n = Vec3::new(x, y, 1.0 - x.abs() - y.abs());
    let t = (-n.z).max(0.0);
    n.x += if n.x >= 0.0 { -t } else { t };
    n.y += if n.y >= 0.0 { -t } else { t };
    n / n.length()
}

fn rgba_word(color: [u8; 4]) -> u32 {
    u32::from_le_bytes(color)
}

pub(super) fn finite(positions: &[DVec3]) -> Result<(), PackError> {
    match positions.par_iter().position_first(|p| !p.is_finite()) {
        Some(index) => Err(PackError::NotFinite { index }),
        None => Ok(()),
    }
}

/// Packs a cloud. Missing colours are a light grey.
///
/// # Errors
/// See [`PackError`].
pub fn pack_samples(cloud: &PointCloud) -> Result<PackedSamples, PackError> {
    finite(&cloud.positions)?;
    let bounds = Bounds::of_all(&cloud.positions);
    let grid = Grid::with_detail(&bounds, f64::from(longest_axis(cloud)) * KERNEL_DETAIL)?;
    let count = cloud.positions.len();
    // Samples with clip lines come behind the others.
    let key = |index: usize| {
        let place = morton(grid.quantise(cloud.positions[index]));
        place | if cloud.is_clipped(index) { CLIPPED } else { 0 }
    };
    let (order, clipped_first) = order::by_key(count, CLIPPED, key);
    let mut out = PackedSamples {
        grid,
        chunks: Vec::new(),
        positions: vec![[0; 2]; count],
        attributes: vec![[0; 2]; count],
        kernels: vec![0; count],
        clips: vec![[0; 2]; count - clipped_first],
        clipped_first: clipped_first as u32,
        nodes: Vec::new(),
    };
    let (plain, with_lines) = order.split_at(clipped_first);
    let (positions, clipped_positions) = out.positions.split_at_mut(clipped_first);
    let (attributes, clipped_attributes) = out.attributes.split_at_mut(clipped_first);
    let (kernels, clipped_kernels) = out.kernels.split_at_mut(clipped_first);
    let pack = |run: &[u32], clipped| {
        let samples = run.iter().map(|&i| Sample::of(cloud, &grid, i as usize)).collect();
        pack_run(&grid, samples, clipped, cloud.oriented)
    };
    let mut chunks: Vec<PackedChunk> = plain
        .par_chunks(CHUNK)
        .zip(positions.par_chunks_mut(CHUNK))
        .zip(attributes.par_chunks_mut(CHUNK))
        .zip(kernels.par_chunks_mut(CHUNK))
        .map(|(((run, positions), attributes), kernels)| {
            pack(run, false).put(positions, attributes, kernels)
        })
        .collect();
    chunks.par_extend(
        with_lines
            .par_chunks(CHUNK)
            .zip(clipped_positions.par_chunks_mut(CHUNK))
            .zip(clipped_attributes.par_chunks_mut(CHUNK))
            .zip(clipped_kernels.par_chunks_mut(CHUNK))
            .zip(out.clips.par_chunks_mut(CHUNK))
            .map(|((((run, positions), attributes), kernels), clips)| {
                let packed = pack(run, true);
                clips.copy_from_slice(&packed.clips);
                packed.put(positions, attributes, kernels)
            }),
    );
    let mut first = 0;
    for chunk in &mut chunks {
        chunk.first = first;
        first += chunk.count;
    }
    out.chunks = chunks;
    Ok(out)
}

/// Flag in the sort key of samples with clip lines.
const CLIPPED: u64 = 1 << 63;

/// The longest axis of a kernel.
fn longest_axis(cloud: &PointCloud) -> f32 {
    let Some(kernels) = &cloud.kernels else { return 0.0 };
    let longest = kernels.par_iter().map(|kernel| {
        let (u, v) = kernel::lengths(kernel);
        u.max(v)
    });
    longest.reduce(|| 0.0, f32::max)
}

/// A sample to be packed into a chunk.
pub(super) struct Sample<'a> {
    pub(super) cell: IVec3,
    pub(super) color: [u8; 4],
    pub(super) normal: Vec3,
    pub(super) shape: Shape,
    /// The clip lines, if the sample has any.
    pub(super) clip: Option<&'a Clip>,
}

/// A sample's kernel, in the units of positions.
pub(super) enum Shape {
    Ellipse(Kernel),
    /// A circle across the normal, with this standard deviation.
    Circle(f32),
}

impl<'a> Sample<'a> {
    fn of(cloud: &'a PointCloud, grid: &Grid, index: usize) -> Sample<'a> {
        let kernel = cloud.kernels.as_ref().map_or(Kernel::default(), |kernels| kernels[index]);
        Sample {
            cell: grid.quantise(cloud.positions[index]),
            color: cloud.colors.as_ref().map_or(NEUTRAL, |colors| colors[index]),
            normal: cloud.normals.as_ref().map_or(Vec3::ZERO, |normals| normals[index]),
            shape: Shape::Ellipse(kernel),
            clip: cloud.clips.as_ref().map(|clips| &clips[index]),
        }
    }
}

/// Concatenates chunks.
pub(super) fn joined(grid: Grid, runs: Vec<PackedRun>, clipped_first: u32) -> PackedSamples {
    let count = runs.iter().map(|run| run.positions.len()).sum();
    let mut out = PackedSamples {
        grid,
        chunks: Vec::with_capacity(runs.len()),
        positions: Vec::with_capacity(count),
        attributes: Vec::with_capacity(count),
        kernels: Vec::with_capacity(count),
        clips: Vec::with_capacity(count.saturating_sub(clipped_first as usize)),
        clipped_first,
        nodes: Vec::new(),
    };
    for run in runs {
        out.chunks.push(PackedChunk { first: out.positions.len() as u32, ..run.chunk });
        out.positions.extend(run.positions);
        out.attributes.extend(run.attributes);
        out.kernels.extend(run.kernels);
        out.clips.extend(run.clips);
    }
    out
}

/// One chunk and its samples.
pub(super) struct PackedRun {
    pub(super) chunk: PackedChunk,
    pub(super) positions: Vec<[u32; 2]>,
    pub(super) attributes: Vec<[u32; 2]>,
    pub(super) kernels: Vec<u32>,
    clips: Vec<[u32; 2]>,
}

impl PackedRun {
    /// Copies the chunk's words, except clip lines, to their final place.
    fn put(
        self,
        positions: &mut [[u32; 2]],
        attributes: &mut [[u32; 2]],
        kernels: &mut [u32],
    ) -> PackedChunk {
        positions.copy_from_slice(&self.positions);
        attributes.copy_from_slice(&self.attributes);
        kernels.copy_from_slice(&self.kernels);
        self.chunk
    }
}

/// Packs up to [`CHUNK`] samples: all with clip lines if `clipped`, else all without.
pub(super) fn pack_run(
    grid: &Grid,
    samples: Vec<Sample>,
    clipped: bool,
    oriented: bool,
) -> PackedRun {
    let low = samples.iter().map(|sample| sample.cell).fold(IVec3::MAX, IVec3::min);
    let high = samples.iter().map(|sample| sample.cell).fold(IVec3::MIN, IVec3::max);
    let longest = (high - low).max_element() as u32;
    // The greatest coordinate must stay below 2^21 after rounding to the nearest step.
    let mut shift = (32 - longest.leading_zeros()).saturating_sub(21);
    if round_shift(longest as i32, shift) >= 1 << 21 {
        shift += 1;
    }
    let place = |cell: IVec3| {
        let q = (cell - low).to_array().map(|v| u64::from(round_shift(v, shift)));
        let word = q[0] | q[1] << 21 | q[2] << 42;
        [word as u32, (word >> 32) as u32]
    };
    let attributes: Vec<[u32; 2]> =
        samples.iter().map(|sample| [rgba_word(sample.color), octahedral(sample.normal)]).collect();
    // Factor to the units of the stored coordinates.
    let scale = (1.0 / (grid.step * f64::from(1u32 << shift))) as f32;
    let scaled = |kernel: &Kernel| Kernel { u: kernel.u * scale, v: kernel.v * scale };
    let lengths: Vec<(f32, f32)> = samples
        .iter()
        .map(|sample| match &sample.shape {
            Shape::Ellipse(kernel) => kernel::lengths(&scaled(kernel)),
            Shape::Circle(deviation) => {
                let length = deviation * scale;
                if length.is_finite() { (length, length) } else { (0.0, 0.0) }
            }
        })
        .collect();
    let kernel_base = lengths.iter().fold(0.0f32, |most, &(u, v)| most.max(u).max(v));
    let each = || samples.iter().zip(&attributes);
    let kernels =
        each().zip(&lengths).map(|((sample, &[_, normal]), &lengths)| match &sample.shape {
            Shape::Ellipse(kernel) => {
                let normal = octahedral_decode(normal);
                kernel::kernel_word(&scaled(kernel), lengths, normal, kernel_base)
            }
            Shape::Circle(_) => kernel::circle_word(lengths.0, kernel_base),
        });
    let clips = each().filter(|_| clipped).map(|(sample, &[_, normal])| {
        let kernel = match &sample.shape {
            Shape::Ellipse(kernel) => scaled(kernel),
            Shape::Circle(_) => Kernel::default(),
        };
        kernel::clip_words(sample.clip.unwrap_or(&Clip::NONE), &kernel, octahedral_decode(normal))
    });
    let chunk = PackedChunk {
        origin: low,
        extent: high - low + IVec3::splat(1 << shift >> 1),
        first: 0,
        count: samples.len() as u32,
        shift,
        vertex_first: 0,
        vertex_count: 0,
        material: 0,
        kernel_base,
        sides: if oriented { Sides::Oriented } else { Sides::Unknown },
        range: NodeRange::default(),
    };
    PackedRun {
        chunk,
        positions: samples.iter().map(|sample| place(sample.cell)).collect(),
        kernels: kernels.collect(),
        clips: clips.collect(),
        attributes,
    }
}

fn round_shift(v: i32, shift: u32) -> u32 {
    if shift == 0 { v as u32 } else { (v as u32 + (1 << (shift - 1))) >> shift }
}

/// Packs a mesh; vertices shared between chunks are stored in each.
///
/// # Errors
/// See [`PackError`].
pub fn pack_mesh(mesh: &Mesh) -> Result<PackedMesh, PackError> {
    let grid = Grid::of(&Bounds::of(mesh.positions.iter().copied()))?;
    pack_triangles(mesh, grid, None)
}

/// Packs a mesh for a point tree. `sides` are the errors up to which triangles are drawn, in mesh units. Triangles are sorted by
/// `sides` in bands of half an octave, so that a frame finds the triangles that it needs. `grid` is the grid of the samples that
/// stand in for the triangles, and holds the whole mesh.
///
/// # Errors
/// See [`PackError`].
pub fn pack_hybrid(mesh: &Mesh, grid: Grid, sides: &[f32]) -> Result<PackedMesh, PackError> {
    pack_triangles(mesh, grid, Some(sides))
}

fn pack_triangles(mesh: &Mesh, grid: Grid, sides: Option<&[f32]>) -> Result<PackedMesh, PackError> {
    finite(&mesh.positions)?;
    let cells: Vec<IVec3> = mesh.positions.par_iter().map(|&p| grid.quantise(p)).collect();
    let mut materials = vec![0u32; mesh.triangles.len()];
    let mut at = 0;
    for part in &mesh.parts {
        let end = (at + part.triangles as usize).min(materials.len());
        materials[at..end].fill(part.material.map_or(0, |m| m + 1));
        at = end;
    }
    let longest = sides.map_or(0.0, |sides| sides.iter().copied().fold(0.0, f32::max));
    // The longest triangles come first.
    let band = |index: usize| {
        let side = sides.map_or(0.0, |sides| sides[index]);
        if side > 0.0 { (2.0 * (longest / side).log2()) as u32 } else { u32::MAX }
    };
    let mut order: Vec<(u32, u32, u64, u32)> = mesh
        .triangles
        .par_iter()
        .enumerate()
        .map(|(index, corners)| {
            let sum: I64Vec3 = corners.iter().map(|&v| cells[v as usize].as_i64vec3()).sum();
            (band(index), materials[index], morton((sum / 3).as_ivec3()), index as u32)
        })
        .collect();
    order.par_sort_unstable();
    let mut packer = MeshPacker {
        mesh,
        cells: &cells,
        stamp: vec![(u32::MAX, 0); mesh.positions.len()],
        out: PackedMesh {
            grid,
            chunks: Vec::new(),
            vertices: Vec::with_capacity(mesh.positions.len()),
            triangles: Vec::with_capacity(order.len()),
        },
    };
    let mut last = 0;
    for &(band, material, _, index) in &order {
        let split = band != last && packer.out.chunks.last().is_some_and(|c| c.count >= 256);
        packer.add(material, mesh.triangles[index as usize], split);
        last = band;
    }
    packer.finish_boxes();
    if let Some(sides) = sides {
        let mut behind = 0.0f32;
        for chunk in packer.out.chunks.iter_mut().rev() {
            let range = chunk.first as usize..(chunk.first + chunk.count) as usize;
            let own = order[range].iter().map(|&(.., index)| sides[index as usize]);
            behind = own.fold(behind, f32::max);
            // The bound covers this chunk and those behind it, as for nodes.
            chunk.range.error_parent = behind / grid.step as f32;
            chunk.range.size_parent = chunk.range.error_parent;
        }
    }
    Ok(packer.out)
}

struct MeshPacker<'a> {
    mesh: &'a Mesh,
    cells: &'a [IVec3],
    /// For every vertex of the mesh: the last chunk that took it, and its index there.
    stamp: Vec<(u32, u32)>,
    out: PackedMesh,
}

impl MeshPacker<'_> {
    fn add(&mut self, material: u32, corners: [u32; 3], split: bool) {
        let current = self.out.chunks.len() as u32;
        let fits = self.out.chunks.last().is_some_and(|chunk| {
            let fresh =
                corners.iter().filter(|&&v| self.stamp[v as usize].0 != current - 1).count();
            !split
                && chunk.material == material
                && (chunk.count as usize) < CHUNK
                && chunk.vertex_count as usize + fresh <= CHUNK
        });
        if !fits {
            self.out.chunks.push(PackedChunk {
                origin: IVec3::ZERO,
                extent: IVec3::ZERO,
                first: self.out.triangles.len() as u32,
                count: 0,
                shift: TRIANGLES,
                vertex_first: self.out.vertices.len() as u32,
                vertex_count: 0,
                material,
                kernel_base: 0.0,
                sides: Sides::Unknown,
                range: NodeRange::default(),
            });
        }
        let number = self.out.chunks.len() as u32 - 1;
        let mut word = 0;
        for (place, &v) in corners.iter().enumerate() {
            let (owner, local) = self.stamp[v as usize];
            let local = if owner == number {
                local
            } else {
                let vertex = self.vertex(v as usize);
                self.out.vertices.push(vertex);
                let chunk = &mut self.out.chunks[number as usize];
                let local = chunk.vertex_count;
                chunk.vertex_count += 1;
                self.stamp[v as usize] = (number, local);
                local
            };
            word |= local << (10 * place);
        }
        self.out.triangles.push(word);
        self.out.chunks[number as usize].count += 1;
    }

    fn vertex(&self, v: usize) -> [u32; VERTEX_WORDS] {
        let cell = self.cells[v];
        let color = self.mesh.colors.as_ref().map_or(u32::MAX, |colors| rgba_word(colors[v]));
        let normal = self.mesh.normals.as_ref().map_or(NO_NORMAL, |normals| octahedral(normals[v]));
        let uv = self.mesh.uvs.as_ref().map_or([0.0; 2], |uvs| {
            let uv = uvs[v];
            if uv.is_finite() { uv.to_array() } else { [0.0; 2] }
        });
        [
            cell.x as u32,
            cell.y as u32,
            cell.z as u32,
            color,
            normal,
            uv[0].to_bits(),
            uv[1].to_bits(),
        ]
    }

    fn finish_boxes(&mut self) {
        for chunk in &mut self.out.chunks {
            let first = chunk.vertex_first as usize;
            let run = &self.out.vertices[first..first + chunk.vertex_count as usize];
            let cell = |v: &[u32; VERTEX_WORDS]| IVec3::new(v[0] as i32, v[1] as i32, v[2] as i32);
            let low = run.iter().map(cell).fold(IVec3::MAX, IVec3::min);
            let high = run.iter().map(cell).fold(IVec3::MIN, IVec3::max);
            chunk.origin = low;
            chunk.extent = high - low;
        }
    }
}

/// A packed asset, kept on the CPU so that the GPU can be refilled at any time.
#[derive(Clone, Debug, Default)]
pub struct PackedAsset {
    pub geometries: Vec<PackedGeometry>,
    pub materials: Vec<Material>,
    pub textures: Vec<PackedTexture>,
}

#[derive(Clone, Debug)]
pub enum PackedGeometry {
    Samples(PackedSamples),
    Mesh(PackedMesh),
}

impl PackedGeometry {
    pub fn grid(&self) -> &Grid {
        match self {
            PackedGeometry::Samples(samples) => &samples.grid,
            PackedGeometry::Mesh(mesh) => &mesh.grid,
        }
    }

    pub fn chunks(&self) -> &[PackedChunk] {
        match self {
            PackedGeometry::Samples(samples) => &samples.chunks,
            PackedGeometry::Mesh(mesh) => &mesh.chunks,
        }
    }

    /// Bytes of GPU pages.
    pub fn gpu_bytes(&self) -> u64 {
        match self {
            PackedGeometry::Samples(samples) => {
                samples.positions.len() as u64 * SAMPLE_BYTES
                    + samples.clips.len() as u64 * CLIP_BYTES
                    + samples.nodes.len() as u64 * NODE_BYTES
            }
            PackedGeometry::Mesh(mesh) => {
                mesh.vertices.len() as u64 * 4 * VERTEX_WORDS as u64
                    + mesh.triangles.len() as u64 * 4
            }
        }
    }
}
