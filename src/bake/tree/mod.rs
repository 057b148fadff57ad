//! Sequential point trees (Dachsbacher, Vogelgsang, Stamminger 2003): a hierarchy of disks above samples, laid out as a list. The
//! renderer selects nodes from the list without walking a tree.
//!
//! 1. *Hierarchy* ([`hierarchy`]). Samples are sorted along a Morton curve and merged per octree cell. A cell is merged as soon
//!    as its last member has arrived ([`stack`]); a cell with a single member adds no node. An inner node is a disk with its
//!    children's mean normal and colour.
//! 2. *Errors* ([`node`]). A node's error bounds the visible difference between its disk and the leaves below it. Errors do not
//!    decrease towards the root.
//! 3. *Sequence* ([`sequence`]). Nodes are sorted by their parents' errors, descending, and cut into chunks. With `T(z)` the
//!    error accepted at depth `z`, a node is drawn where
//!
//!    ```text
//!    e ≤ T(z)   and   T(z − δ) < e_parent
//!    ```
//!
//!    with `δ` the distance to its parent. The topmost acceptable node above a leaf passes both tests, so every leaf has a drawn
//!    ancestor-or-self. A view needs the chunks with `e_parent > T(z_near − δ)`.
//!
//! This implementation differs from the paper in three points. Errors are bounds with respect to the leaves and not to the
//! children alone (each level passes on what it added), so a promised error is kept. The sequence keeps the Morton order within
//! bands of half an octave of `e_parent`, then of an octave of the parent's size and of the node's own size: chunks, and their parts of 64
//! nodes, can be culled by the frustum, which the paper's order forbids (§3.7), and by the normals of their nodes (§3.10 has a list
//! for each direction instead). Sorting is a bucket sort by band. Each node carries two measures: its error, for disks that overlap, and its size, for samples
//! that are drawn as one pixel each.
//!
//! A node is two words. The lowest 22 bits of the first word hold the codes of the error, those of the second word the codes of
//! the size: the node's own code (11 bits), then its parent's (11 bits). Above them the first word has `δ` (4 bits), the node's
//! tilt (4) and two bits of its parent's tilt; the second word has the level (5), the spread of the leaves' normals around the
//! node's normal (3, [`cone_sine`]) and the other two bits of the parent's tilt. A code `c` stands for `base · 2^(−c/64)`. Code 0
//! in a parent's place means no parent, and 2047 stands for zero. `δ` counts in quarters of an octave below twice the parent's
//! size. Rounding makes errors and distances larger, never smaller, and equal numbers have equal codes in both places. [`tilt`]
//! describes how the error depends on the viewing angle, and why a child stores its parent's tilt.

/// The building blocks of trees, for builders outside this module (the external build).
pub(in crate::bake) mod parts {
    pub use super::coverage::{around_point, byte};
    pub use super::hierarchy::Cells;
    pub use super::node::Matter;
    pub use super::node::{Node, kernel_length};
    pub use super::sequence::{
        Codes, Cutter, Tilts, base_from, delta_bits, measures_of, range_of, reach_behind,
        way_length, words,
    };
    pub use super::stack::{CHILDREN, Stack, shared_level};
}

mod coverage;
mod hierarchy;
mod node;
mod sequence;
mod stack;
mod tilt;

pub use coverage::{EXACT, FILLS, probability};
use node::Matter;
pub use sequence::{
    CODE, CODE_BITS, LEVEL_SHIFT, NO_PARENT, NONE, SORTED, cone_sine, decode, decode_delta,
};
pub use tilt::{SIDEWAYS, UNTILTED, share_seen};

use glam::{DVec3, Vec3};

use crate::assets::PointCloud;

use super::pack::{
    CLIP_BYTES, Grid, KERNEL_DETAIL, PackError, PackedChunk, PackedSamples, Sides, finite,
    unpack_samples,
};
use crate::math::Bounds;

/// Version of the trees that are built from an asset: part of the key that trees are cached by. Raise it whenever the trees of
/// some asset change, wherever the change is: in this folder, [`super::hybrid`], [`super::line_levels`],
/// `bake/rasterise.rs` or [`super::pack`].
pub const BAKING_VERSION: u32 = 19;
/// Hash of the trees that this version bakes from the assets of `tree/version.rs`. Its test fails if the trees change and the
/// version does not.
#[cfg(test)]
const BAKING_DIGEST: &str = "eddb35ab4f07eeea";

/// Builds the tree above samples with normals and kernels. A sample without a normal is drawn as a facing disk, one without a
/// kernel not at all.
///
/// `stands` are the measures of what each leaf replaces (triangles, or another tree). Where a leaf's error is not acceptable, the
/// leaf is not drawn and the finer representation is. Without `stands` leaves are exact.
///
/// # Errors
/// See [`PackError`].
pub fn build_tree(
    cloud: &PointCloud,
    stands: Option<&[Measures]>,
) -> Result<PackedSamples, PackError> {
    build_tree_within(cloud, stands, Bounds::EMPTY, false)
}

/// Does the same as [`build_tree`] on a grid that also holds the box `also`; `closed` says that the surface is known to be
/// closed.
///
/// # Errors
/// See [`PackError`].
pub fn build_tree_within(
    cloud: &PointCloud,
    stands: Option<&[Measures]>,
    also: Bounds,
    closed: bool,
) -> Result<PackedSamples, PackError> {
    let matter = match (stands, closed) {
        (None, _) => Matter::Points,
        (Some(_), true) => Matter::Closed,
        (Some(_), false) => Matter::Open,
    };
    let (tree, grid) = raise(cloud, stands, also, matter)?;
    let (mut packed, _) = sequence::sequence(cloud, &tree, grid, 0);
    if closed && cloud.oriented {
        packed.chunks.iter_mut().for_each(|chunk| chunk.sides = Sides::Closed);
    }
    Ok(packed)
}

/// Builds the tree above leaves that are trees themselves. Each leaf is a node here, drawn in place of the root of its own tree,
/// so thousands of distant instances become one chunk of nodes. Also returns for each leaf its number and the [`Above`] of its
/// tree, which is this leaf node. The leaves are in Morton order, so neighbours in the list are neighbours in space.
///
/// # Errors
/// See [`PackError`].
pub fn build_over_instances(
    roots: &PointCloud,
    stands: &[Measures],
) -> Result<(PackedSamples, Vec<(u32, Above)>), PackError> {
    let (mut tree, grid) = raise(roots, Some(stands), Bounds::EMPTY, Matter::Instances)?;
    // The test that activates the tree below a leaf uses errors that do not depend on the viewing angle.
    tree.nodes.iter_mut().for_each(node::Node::see_alike);
    let (packed, _) = sequence::sequence(roots, &tree, grid, 0);
    let (base, step) = (sequence::base_of(&tree, grid), grid.step as f32);
    // Shaders recompute these values and may round differently.
    let up = |value: f32| (value * 1.001).min(f32::MAX);
    let above = tree.samples.iter().zip(&tree.nodes).map(|(&sample, leaf)| {
        let measures = sequence::measures_of(leaf, step);
        let above = Above {
            error: up(sequence::rounded(measures.error, base, step)),
            size: up(sequence::rounded(measures.size, base, step)),
            delta: up(4.0 * step),
        };
        (sample, above)
    });
    Ok((packed, above.collect()))
}

/// What a leaf stands for: its error, its size (the measure used where samples are drawn as one pixel each), both in units of the positions, its
/// area, and the largest angle between its normal and those of what it stands for, in radians. An area of 0 means the area of the kernel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Measures {
    pub error: f32,
    pub size: f32,
    pub area: f32,
    pub cone: f32,
}

/// The node above a whole tree: its measures, and the distance to its centre, in world units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Above {
    pub error: f32,
    pub size: f32,
    pub delta: f32,
}

impl Above {
    /// The tree has no node above it.
    pub const NOTHING: Above = Above { error: f32::MAX, size: f32::MAX, delta: 0.0 };
}

fn raise(
    cloud: &PointCloud,
    stands: Option<&[Measures]>,
    also: Bounds,
    matter: Matter,
) -> Result<(hierarchy::Tree, Grid), PackError> {
    finite(&cloud.positions)?;
    let longest = cloud.kernels.iter().flatten().map(node::kernel_length).fold(0.0f32, f32::max);
    let bounds = Bounds::of(cloud.positions.iter().copied());
    // Nodes lie within the leaves' disks, so at most one disk outside the box.
    let grown = bounds.grown(f64::from(2.0 * super::CUTOFF * longest));
    let grid = Grid::with_detail(&grown.union(also), f64::from(longest) * KERNEL_DETAIL)?;
    Ok((hierarchy::build(cloud, stands, &bounds, matter), grid))
}

/// A node as seen from the eye, in camera units.
#[derive(Clone, Copy, Debug)]
pub struct Seen {
    /// Depth along the viewing axis.
    pub z: f32,
    /// Distance from the eye.
    pub far: f32,
    /// Cosine of the angle between the node's normal and the direction to the eye; [`UNTILTED`] if the error does not depend on
    /// the angle.
    pub cosine: f32,
}

/// Tells whether a node is drawn, by the same test as the shaders. `measure` selects error (0) or size (1); `base` is in camera
/// units, `lod` is the accepted error at depth 1 along the viewing axis.
pub fn is_drawn(words: [u32; 2], measure: usize, base: f32, lod: f32, seen: Seen) -> bool {
    let accepted = |z: f32, far: f32| {
        let near = z.max(0.0);
        lod * near * (near / far.max(f32::MIN_POSITIVE))
    };
    let Seen { z, far, cosine } = seen;
    let (own, parent) = (words[measure] & CODE, words[measure] >> CODE_BITS & CODE);
    let [own_tilt, parent_tilt] = tilt::of_words(words);
    let share = share_seen(own_tilt, cosine, 0.0);
    if decode(own, base) * share > accepted(z, far) {
        return false;
    }
    let (delta, slack) = (decode_delta(words, base), SLACK * far);
    let turn = delta / far.max(f32::MIN_POSITIVE) + tilt::SLACK;
    let share = share_seen(parent_tilt, cosine, turn);
    let least = accepted(z - delta - slack, far + delta + slack);
    parent == NO_PARENT || decode(parent, base) * share > least
}

/// The root of a tree: its disk and its measures.
#[derive(Clone, Debug)]
pub struct Root {
    pub position: DVec3,
    /// Zero where the disk faces the eye.
    pub normal: Vec3,
    pub color: [u8; 4],
    pub radius: f32,
    pub measures: Measures,
}

impl Root {
    /// Returns the root of a tree; `None` if the tree is empty.
    pub fn of(tree: &PackedSamples) -> Option<Root> {
        let roots =
            tree.nodes.iter().position(|[error, _]| error >> CODE_BITS & CODE == NO_PARENT)?;
        let chunk = tree.chunks.iter().rfind(|chunk| chunk.first as usize <= roots)?;
        let cloud = unpack_samples(&PackedSamples {
            chunks: vec![PackedChunk { first: 0, count: 1, ..*chunk }],
            positions: vec![tree.positions[roots]],
            attributes: vec![tree.attributes[roots]],
            kernels: vec![tree.kernels[roots]],
            nodes: vec![tree.nodes[roots]],
            grid: tree.grid,
            ..PackedSamples::default()
        });
        let step = tree.grid.step as f32;
        let value = |word: u32| decode(word & CODE, chunk.range.base) * step;
        let [error, size] = tree.nodes[roots];
        let radius = super::CUTOFF * cloud.kernels.map_or(0.0, |k| node::kernel_length(&k[0]));
        let [_, _, _, byte] = tree.attributes[roots][0].to_le_bytes();
        let disk = node::OWN * std::f32::consts::PI * radius * radius;
        let area = coverage::area(byte, value(size)).unwrap_or(disk);
        Some(Root {
            position: cloud.positions[0],
            normal: cloud.normals.map_or(Vec3::ZERO, |normals| normals[0]),
            color: cloud.colors.map_or([255; 4], |colors| colors[0]),
            radius,
            measures: Measures {
                error: value(error),
                size: value(size),
                area,
                cone: std::f32::consts::PI,
            },
        })
    }
}

/// Relative error of depths in f32.
pub const SLACK: f32 = 4e-6;

/// Figures of a built tree.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct TreeStatistics {
    pub leaves: u64,
    pub inner: u64,
    /// Nodes by height above the leaves.
    pub levels: Vec<u64>,
    /// Nodes by error, in octaves below `base`: entry `i` counts errors in `(base · 2^−(i+1), base · 2^−i]`. The last entry
    /// counts nodes without an error.
    pub errors: Vec<u64>,
    /// The error that code 0 stands for, in units of the positions: twice the largest error or size. For several trees, the
    /// largest base.
    pub base: f32,
    pub chunks: u64,
    /// Bytes on the GPU.
    pub bytes: u64,
}

impl TreeStatistics {
    pub fn of(samples: &PackedSamples) -> TreeStatistics {
        let mut statistics = TreeStatistics::default();
        statistics.add(&samples.nodes);
        let beside = CLIP_BYTES * samples.clips.len() as u64 + 4 * samples.values.len() as u64;
        statistics.finish(&samples.grid, &samples.chunks, beside);
        statistics
    }

    /// Counts some nodes, by their words.
    pub(in crate::bake) fn add(&mut self, nodes: &[[u32; 2]]) {
        self.errors.resize(33, 0);
        for [error, size] in nodes {
            let level = (size >> LEVEL_SHIFT & 31) as usize;
            if self.levels.len() <= level {
                self.levels.resize(level + 1, 0);
            }
            self.levels[level] += 1;
            let code = error & CODE;
            self.errors[if code == NONE { 32 } else { (code / 64) as usize }] += 1;
        }
    }

    /// Fills in the totals after all nodes have been counted. `beside`: bytes of clip lines and values.
    pub(in crate::bake) fn finish(&mut self, grid: &Grid, chunks: &[PackedChunk], beside: u64) {
        let count: u64 = self.levels.iter().sum();
        self.leaves = self.levels.first().copied().unwrap_or(0);
        self.inner = count - self.leaves;
        self.base =
            chunks.iter().map(|chunk| chunk.range.base).fold(0.0, f32::max) * grid.step as f32;
        self.chunks = chunks.len() as u64;
        self.bytes = count * (super::pack::SAMPLE_BYTES + super::pack::NODE_BYTES) + beside;
    }

    /// Adds the figures of another tree. Errors stay in octaves below the base of their own tree.
    pub fn with(mut self, other: &TreeStatistics) -> TreeStatistics {
        let add = |sums: &mut Vec<u64>, more: &[u64]| {
            sums.resize(sums.len().max(more.len()), 0);
            sums.iter_mut().zip(more).for_each(|(sum, more)| *sum += more);
        };
        add(&mut self.levels, &other.levels);
        add(&mut self.errors, &other.errors);
        self.base = self.base.max(other.base);
        self.leaves += other.leaves;
        self.inner += other.inner;
        self.chunks += other.chunks;
        self.bytes += other.bytes;
        self
    }
}

#[cfg(test)]
mod tests;
#[cfg(test)]
mod version;
