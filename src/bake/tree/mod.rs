//! Sequential point trees (Dachsbacher, Vogelgsang, Stamminger 2003): samples → a hierarchy of disks, laid out as a list that is
//! selected from without walking a tree.
//!
//! 1. *Hierarchy* ([`hierarchy`]). Samples, sorted along a Morton curve, are merged octree cell by octree cell, from the finest
//!    level up; cells with a single member pass through. An inner node is a disk with its children's mean normal and colour.
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
//! added), so that a promised error is kept; the sequence is sorted by place within bands of half an octave of `e_parent`, so
//! that chunks can be culled by the frustum, which the paper's order forbids (§3.7); each node carries two measures, its
//! error for disks that overlap and its size for samples that are drawn as one pixel each.
//!
//! A node's two words: of the error, then of the size, its own code (12 bits), its parent's (12 bits); and 8 bits above, of `δ` in
//! the first, of the level in the second. A code `c` stands for `base · 2^(−c/128)`, with 0 in a parent's place for no parent and
//! 4095 for none at all; `δ` counts in eighths of an octave below `base`. Rounding makes errors and distances larger, never
//! smaller, and the same number has the same code in both places.

mod hierarchy;
mod node;
mod sequence;

pub use sequence::{NO_PARENT, NONE, decode, decode_delta};

use crate::assets::PointCloud;

use super::pack::{Grid, KERNEL_DETAIL, PackError, PackedSamples, finite};
use crate::math::Bounds;

/// Builds the tree above samples with normals and kernels; what they lack is drawn as a facing disk, or not at all.
///
/// `errors` are what leaves stand for beyond themselves: a leaf is not drawn where its error, in units of the positions, is not
/// acceptable, because something finer is drawn there (triangles, or another tree). Without them leaves are exact.
///
/// # Errors
/// See [`PackError`].
pub fn build_tree(cloud: &PointCloud, errors: Option<&[f32]>) -> Result<PackedSamples, PackError> {
    finite(&cloud.positions)?;
    let longest = cloud.kernels.iter().flatten().map(node::kernel_length).fold(0.0f32, f32::max);
    let bounds = Bounds::of(cloud.positions.iter().copied());
    // Nodes lie within the leaves' disks, at most a disk outside of the box.
    let grown = bounds.grown(f64::from(2.0 * super::CUTOFF * longest));
    let grid = Grid::with_detail(&grown, f64::from(longest) * KERNEL_DETAIL)?;
    let tree = hierarchy::build(cloud, errors, &bounds);
    Ok(sequence::sequence(cloud, &tree, grid).0)
}

/// Whether a node is drawn, as shaders decide it. `word`: of its error, or of its size; `delta` is in the former. `base` in camera
/// units, `z` its depth, `lod` the error that may be accepted at depth 1.
pub fn is_drawn(word: u32, delta: u32, base: f32, lod: f32, z: f32) -> bool {
    let accepted = lod * z.max(0.0);
    let near = z * (1.0 - SLACK * z.signum()) - decode_delta(delta, base);
    let (own, parent) = (word & 0xfff, word >> 12 & 0xfff);
    decode(own, base) <= accepted && (parent == NO_PARENT || decode(parent, base) > lod * near)
}

/// What depths may be wrong by in f32, in parts of them.
pub const SLACK: f32 = 4e-6;

/// Figures of a built tree.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct TreeStatistics {
    pub leaves: u64,
    pub inner: u64,
    /// Nodes by height above the leaves.
    pub levels: Vec<u64>,
    /// Nodes by error, in octaves below the largest; the last entry counts those without.
    pub errors: Vec<u64>,
    pub chunks: u64,
    pub bytes: u64,
}

impl TreeStatistics {
    pub fn of(samples: &PackedSamples) -> TreeStatistics {
        let (mut levels, mut errors) = (Vec::new(), vec![0; 33]);
        for [error, size] in &samples.nodes {
            let level = (size >> 24) as usize;
            if levels.len() <= level {
                levels.resize(level + 1, 0);
            }
            levels[level] += 1;
            let code = error & 0xfff;
            errors[if code == NONE { 32 } else { (code / 128) as usize }] += 1;
        }
        let leaves = levels.first().copied().unwrap_or(0);
        let count = samples.nodes.len() as u64;
        TreeStatistics {
            leaves,
            inner: count - leaves,
            levels,
            errors,
            chunks: samples.chunks.len() as u64,
            bytes: count * (super::pack::SAMPLE_BYTES + super::pack::NODE_BYTES)
                + samples.clips.len() as u64 * super::pack::CLIP_BYTES,
        }
    }
}

#[cfg(test)]
mod tests;
