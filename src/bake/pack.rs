//! Packs geometries into the chunks that the GPU holds.
//!
//! [`kind`] lists the kinds of geometry and what each must provide; [`samples`], [`triangles`] and [`lines`] provide it.
//!
//! Positions become integers on a grid of the asset whose step is a power of two, about 2⁻²⁹ of the asset's size. That is finer
//! than f32 at the asset's edge, and differences are exact, so geometry near the eye keeps all its digits however far it is from
//! the asset's origin. Samples and triangles are sorted along a Morton curve and cut into chunks of at most 1024, the unit of
//! culling and of a workgroup. A sample's position is stored in 64 bits (3 × 21, relative to its chunk); a sample takes 20 bytes
//! with colour, normal and reconstruction kernel. Scalar fields of its file add 4 or 8 bytes. Samples with clip lines take 8 bytes more. They are stored in separate chunks
//! behind the others, so that samples without clip lines do not pay for them. A triangle takes 4 bytes and each of its vertices
//! 28. A segment of a line takes 8 bytes and each of its vertices 28.

mod fields;
mod kernel;
mod kind;
mod lines;
mod order;
mod pieces;
mod samples;
mod texture;
mod triangles;

pub(super) use fields::{CodeCounts, pack_field};
pub use fields::{Layout, PackedField, Values, value_words};
pub(super) use kernel::lengths as kernel_lengths;
pub use kernel::longer_axis;
pub use kind::{
    Arrays, Counts, GeometryKind, PackedGeometry, PackedKind, PageKind, Stream, StreamOf,
};
pub(super) use kind::{holds, read_words};
pub use lines::{
    BEGINS, DIRECTION_WORDS, ENDS, LINE_WORDS, LineEnd, LineVertex, PackedLines, Piece,
    pack_levels, pack_lines, unpack_lines,
};
pub(super) use pieces::Packing;
pub use samples::{
    CLIP_BYTES, NODE_BYTES, PackedSamples, SAMPLE_BYTES, pack_samples, unpack_samples,
};
pub(super) use samples::{
    PackedRun, Sample, Shape, fields_of, joined, pack_run, packed_values, unpack_kernel, values_of,
};
pub use texture::{PackedTexture, pack_texture, unpack_texture};
pub use triangles::{PackedMesh, VERTEX_WORDS, pack_hybrid, pack_mesh, unpack_mesh};

use std::ops::Range;

use glam::{DVec3, IVec3, Vec3};
use rayon::prelude::*;

use crate::assets::{Geometry, Material};
use crate::math::Bounds;

/// Maximum number of samples, triangles, segments or vertices in a chunk.
pub const CHUNK: usize = 1024;
/// The normal word that means no normal.
pub const NO_NORMAL: u32 = 0x8000_8000;
/// Minimum size of a cell relative to the longest kernel: shaders square the kernel's length in cells, and the square has to fit
/// into f32. The limit only matters where samples lie closer together than 10⁻⁹ of their kernels, or at one position.
pub(super) const KERNEL_DETAIL: f64 = 1.0 / (1u64 << 60) as f64;

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
    /// Samples: coordinates count in steps of 2^shift cells; 0 for other kinds.
    pub shift: u32,
    /// Triangles and lines: first vertex and number of vertices.
    pub vertex_first: u32,
    pub vertex_count: u32,
    /// Index into the asset's materials plus one, 0 for the default.
    pub material: u32,
    /// Samples: longest axis of a kernel, in steps of 2^shift cells. Lines: the largest radius, in cells.
    pub kernel_base: f32,
    /// Samples: what the normals say about the surface.
    pub sides: Sides,
    /// Surfaces behind all of its triangles, or behind some of its samples or segments, show through.
    pub translucent: bool,
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
    /// The chunk's elements in the geometry.
    pub fn elements(&self) -> Range<usize> {
        self.first as usize..(self.first + self.count) as usize
    }

    /// The chunk's vertices in the geometry.
    pub fn vertices(&self) -> Range<usize> {
        self.vertex_first as usize..(self.vertex_first + self.vertex_count) as usize
    }

    /// The cell of a sample of this chunk, from the words of its position.
    pub fn cell(&self, [low, high]: [u32; 2]) -> IVec3 {
        let word = u64::from(low) | u64::from(high) << 32;
        let q = [word, word >> 21, word >> 42].map(|v| (v & 0x1f_ffff) as i32);
        self.origin + IVec3::from(q) * (1 << self.shift)
    }
}

/// An error or size that no frame accepts. Where it is that of a parent, a node is drawn wherever it is fine enough.
pub const ALWAYS: f32 = 1e30;

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

/// A geometry that cannot be packed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PackError {
    #[error("coordinates span {extent:e} units; up to 1e30 can be drawn")]
    TooFar { extent: f64 },
    #[error("position {index} is not finite")]
    NotFinite { index: usize },
    #[error("the radius of vertex {index} is not a finite number of 0 or more")]
    Radius { index: usize },
    #[error("the normal of vertex {index} has no direction")]
    Normal { index: usize },
    #[error("strands do not cover the vertices in order, or an attribute has another length")]
    Strands,
    #[error("the levels of detail have more than 4,294,967,295 vertices")]
    TooMany,
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

/// The grid position of a vertex of a mesh or a line, whose words begin with it.
fn cell_of<const WORDS: usize>(words: &[u32; WORDS]) -> IVec3 {
    IVec3::new(words[0] as i32, words[1] as i32, words[2] as i32)
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

/// Bytes needed to pack a geometry: the sort's keys and order, and the packed copy.
pub fn packing_bytes(geometry: &Geometry) -> u64 {
    match geometry {
        Geometry::Points(cloud) => {
            let values = if cloud.fields.is_empty() { 0 } else { size_of::<Values>() as u64 };
            (samples::PACKING_BYTES + values) * cloud.positions.len() as u64
        }
        Geometry::Mesh(mesh) => triangles::packing_bytes(mesh),
        Geometry::Lines(lines) => lines::packing_bytes(lines),
    }
}

/// A packed asset, kept on the CPU so that the GPU can be refilled at any time.
#[derive(Clone, Debug, Default)]
pub struct PackedAsset {
    pub geometries: Vec<PackedGeometry>,
    pub materials: Vec<Material>,
    pub textures: Vec<PackedTexture>,
}

#[cfg(test)]
mod tests;
