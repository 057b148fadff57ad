//! Sequential point trees (Dachsbacher, Vogelgsang, Stamminger 2003): samples → a hierarchy of disks, laid out as a list that is
//! selected from without walking a tree.
//!
//! 1. *Hierarchy* ([`hierarchy`]). Samples, sorted along a Morton curve, are merged octree cell by octree cell, each as soon as
//!    all of it has been seen ([`stack`]); cells with a single member pass through. An inner node is a disk with its children's mean
//!    normal and colour.
//! 2. *Errors* ([`node`]). What may be seen of the difference between a node's disk and the leaves below it. Errors do not
//!    decrease on the way up.
//! 3. *Sequence* ([`sequence`]). Nodes are sorted by their parents' errors, descending, and cut into chunks. Where `T(z)` is the
//!    error that may be accepted at depth `z`, a node is drawn where
//!
//!    ```text
//!    e ≤ T(z)   and   T(z − δ) < e_parent
//!    ```
//!
//!    with `δ` the way to its parent: the topmost acceptable node above a leaf passes both, so every leaf has a drawn
//!    ancestor-or-self. A view needs the chunks with `e_parent > T(z_near − δ)`.
//!
//! Beyond the paper: errors are bounds with respect to the leaves and not to the children alone (each level passes on what it
//! added), so that a promised error is kept; the sequence keeps the curve's order within bands of half an octave of `e_parent`, so
//! that chunks can be culled by the frustum, which the paper's order forbids (§3.7), and sorting is dealing out to bands; each node carries two measures, its
//! error for disks that overlap and its size for samples that are drawn as one pixel each.
//!
//! A node's two words, from the lowest bit on: of the error, then of the size, its own code (11 bits) and its parent's (11 bits). Then
//! in the first `δ` (4 bits), the node's tilt (4) and two bits of its parent's, in the second the level (5), how far the leaves'
//! normals are from the node's (3, [`cone_sine`]) and the other two. A code `c` stands for `base · 2^(−c/64)`, with 0 in a parent's
//! place for no parent and 2047 for none at all; `δ` counts in quarters of an octave below twice the parent's size. Rounding makes
//! errors and distances larger, never smaller, and the same number has the same code in both places. [`tilt`] is what errors are
//! by the angle that a node is seen at, and why a child knows its parent's.

/// What trees are made of, for those who make them otherwise.
pub(in crate::bake) mod parts {
    pub use super::coverage::{Matter, around_point, byte};
    pub use super::hierarchy::Cells;
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

use coverage::Matter;
pub use coverage::{EXACT, probability};
pub use sequence::{
    CODE, CODE_BITS, LEVEL_SHIFT, NO_PARENT, NONE, SORTED, cone_sine, decode, decode_delta,
};
pub use tilt::{SIDEWAYS, UNTILTED, share_seen};

use glam::{DVec3, Vec3};

use crate::assets::PointCloud;

use super::pack::{
    Grid, KERNEL_DETAIL, PackError, PackedChunk, PackedSamples, Sides, finite, unpack_samples,
};
use crate::math::Bounds;

/// Of what is built from the same asset: a part of the key that trees are cached by. It must be raised whenever the trees of some
/// asset change, whichever file that happens in: of this folder, [`super::hybrid`], `bake/rasterise.rs`, [`super::pack`].
pub const BAKING_VERSION: u32 = 8;
/// Hash of what this version bakes of the assets of `tree/version.rs`, whose test fails where trees have changed and this has not.
#[cfg(test)]
const BAKING_DIGEST: &str = "7f08157e3776f688";

/// Builds the tree above samples with normals and kernels; what they lack is drawn as a facing disk, or not at all.
///
/// `stands` are what leaves stand for beyond themselves: a leaf is not drawn where its error is not acceptable, because
/// something finer is drawn there (triangles, or another tree). Without them leaves are exact.
///
/// # Errors
/// See [`PackError`].
pub fn build_tree(
    cloud: &PointCloud,
    stands: Option<&[Measures]>,
) -> Result<PackedSamples, PackError> {
    build_tree_within(cloud, stands, Bounds::EMPTY, false)
}

/// As [`build_tree`], on a grid that holds the box `also` as well, and of a surface that is `closed` or may not be.
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

/// The tree above leaves that are trees themselves. Each leaf has a node here as well, which is drawn where the root of its tree would
/// be: from afar thousands of them are a chunk of nodes and not as many instances. For each leaf, in an order in which neighbours in
/// space are neighbours: its number, and what stands above what its own tree draws, which is this node.
///
/// # Errors
/// See [`PackError`].
pub fn build_crowd(
    roots: &PointCloud,
    stands: &[Measures],
) -> Result<(PackedSamples, Vec<(u32, Above)>), PackError> {
    let (mut tree, grid) = raise(roots, Some(stands), Bounds::EMPTY, Matter::Crowd)?;
    // Whether what is below is in play is asked of the errors from all sides.
    tree.nodes.iter_mut().for_each(node::Node::see_alike);
    let (packed, _) = sequence::sequence(roots, &tree, grid, 0);
    let (base, step) = (sequence::base_of(&tree, grid), grid.step as f32);
    // Shaders compute these anew, and may round otherwise.
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

/// An error, and what stands for it where samples are drawn as one pixel each, in units of the positions; the area that is there, 0 of
/// what is as large as its kernel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Measures {
    pub error: f32,
    pub size: f32,
    pub area: f32,
}

/// The node above a tree as a whole: its measures, and the way to its centre, in world units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Above {
    pub error: f32,
    pub size: f32,
    pub delta: f32,
}

impl Above {
    /// There is none.
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
    // Nodes lie within the leaves' disks, at most a disk outside of the box.
    let grown = bounds.grown(f64::from(2.0 * super::CUTOFF * longest));
    let grid = Grid::with_detail(&grown.union(also), f64::from(longest) * KERNEL_DETAIL)?;
    Ok((hierarchy::build(cloud, stands, &bounds, matter), grid))
}

/// A node as an eye sees it, in camera units.
#[derive(Clone, Copy, Debug)]
pub struct Seen {
    /// Depth along the viewing axis.
    pub z: f32,
    /// Distance from the eye.
    pub far: f32,
    /// Of the angle between its normal and the way to the eye; [`UNTILTED`] where errors are the same from all sides.
    pub cosine: f32,
}

/// Whether a node is drawn, as shaders decide it. `measure`: 0 by its error, 1 by its size; `base` in camera units, `lod` the error
/// that may be accepted at depth 1 of the viewing axis.
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
    /// `None` of an empty tree.
    pub fn of(tree: &PackedSamples) -> Option<Root> {
        let roots =
            tree.nodes.iter().position(|[error, _]| error >> CODE_BITS & CODE == NO_PARENT)?;
        let chunk = tree.chunks.iter().rfind(|chunk| chunk.first as usize <= roots)?;
        let cloud = unpack_samples(&PackedSamples {
            chunks: vec![PackedChunk { first: 0, count: 1, ..*chunk }],
            positions: vec![tree.positions[roots]],
            attributes: vec![tree.attributes[roots]],
            kernels: vec![tree.kernels[roots]],
            clips: Vec::new(),
            nodes: vec![tree.nodes[roots]],
            ..PackedSamples { grid: tree.grid, ..PackedSamples::default() }
        });
        let step = tree.grid.step as f32;
        let value = |word: u32| decode(word & CODE, chunk.range.base) * step;
        let [error, size] = tree.nodes[roots];
        let radius = super::CUTOFF * cloud.kernels.map_or(0.0, |k| node::kernel_length(&k[0]));
        let [_, _, _, byte] = tree.attributes[roots][0].to_le_bytes();
        let disk = coverage::OWN * std::f32::consts::PI * radius * radius;
        let area = coverage::area(byte, value(size)).unwrap_or(disk);
        Some(Root {
            position: cloud.positions[0],
            normal: cloud.normals.map_or(Vec3::ZERO, |normals| normals[0]),
            color: cloud.colors.map_or([255; 4], |colors| colors[0]),
            radius,
            measures: Measures { error: value(error), size: value(size), area },
        })
    }
}

/// What depths may be wrong by in f32, in parts of them.
pub const SLACK: f32 = 4e-6;

/// Figures of a built tree.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct TreeStatistics {
    pub leaves: u64,
    pub inner: u64,
    /// Nodes by height above the leaves.
    pub levels: Vec<u64>,
    /// Nodes by error, in octaves below `base`: entry `i` counts errors in `(base · 2^−(i+1), base · 2^−i]`. The last entry counts
    /// those without.
    pub errors: Vec<u64>,
    /// What errors count from, in units of the positions: twice the largest error or size. Of several trees the largest.
    pub base: f32,
    pub chunks: u64,
    /// On the GPU.
    pub bytes: u64,
}

impl TreeStatistics {
    pub fn of(samples: &PackedSamples) -> TreeStatistics {
        let mut statistics = TreeStatistics::default();
        statistics.add(&samples.nodes);
        statistics.finish(&samples.grid, &samples.chunks, samples.clips.len() as u64);
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

    /// Once all nodes have been counted.
    pub(in crate::bake) fn finish(&mut self, grid: &Grid, chunks: &[PackedChunk], clips: u64) {
        let count: u64 = self.levels.iter().sum();
        self.leaves = self.levels.first().copied().unwrap_or(0);
        self.inner = count - self.leaves;
        self.base =
            chunks.iter().map(|chunk| chunk.range.base).fold(0.0, f32::max) * grid.step as f32;
        self.chunks = chunks.len() as u64;
        self.bytes = count * (super::pack::SAMPLE_BYTES + super::pack::NODE_BYTES)
            + clips * super::pack::CLIP_BYTES;
    }

    /// Both together. Errors stay in octaves below the base of the tree that each is in.
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
