//! Point trees of more samples than fit into memory.
//!
//! What is read, estimated, packed and built is what would be in memory, word for word; it only comes in another order, from one
//! sort to the next:
//!
//! ```text
//! points.rs   file → points along a Morton curve                    (sorted by place)
//! pieces.rs   → cells of the curve that are in memory at a time
//! fit.rs      → normals and kernels, a piece of the curve at a time
//! pack.rs     → packed samples, chunk by chunk: what the tree is keyed by
//! tree.rs     → leaves along the octree's curve                     (sorted by code)
//!             → nodes, each once its cell is complete               (sorted by band)
//!             → packed nodes, chunk by chunk                        (sorted by parent, and back)
//! ```
//!
//! Records that do not fit are in temporary files ([`spill`]), sorted in runs and merged ([`sort`]).

mod fit;
mod pack;
mod pieces;
mod points;
mod sort;
mod spill;
mod tree;

use std::io;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

pub use pack::Spilled;
pub use spill::{Spill, SpillFile};
pub use tree::Packed;

use super::pack::PackError;
use super::tree::TreeStatistics;
use crate::assets::{AssetError, PointBlocks, Survey};

/// Why a tree was not built.
#[derive(Debug, thiserror::Error)]
pub enum BakeFault {
    #[error(transparent)]
    Asset(#[from] AssetError),
    #[error(transparent)]
    Pack(#[from] PackError),
    /// Of the temporary files.
    #[error(transparent)]
    Io(#[from] io::Error),
    #[error("there are no points")]
    Empty,
}

/// What is being done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Going through a file for the first time.
    Survey,
    Read,
    Neighbors,
    Pack,
    Leaves,
    Measure,
    Nodes,
    Sequence,
}

impl Phase {
    pub const ALL: [Phase; 8] = [
        Phase::Survey,
        Phase::Read,
        Phase::Neighbors,
        Phase::Pack,
        Phase::Leaves,
        Phase::Measure,
        Phase::Nodes,
        Phase::Sequence,
    ];

    pub fn name(self) -> &'static str {
        match self {
            Phase::Survey => "surveying",
            Phase::Read => "reading",
            Phase::Neighbors => "estimating normals",
            Phase::Pack => "packing",
            Phase::Leaves => "sorting",
            Phase::Measure => "measuring",
            Phase::Nodes => "building",
            Phase::Sequence => "writing",
        }
    }
}

/// Bytes for what is being worked on.
#[derive(Clone, Copy, Debug)]
pub struct Memory(usize);

/// What the program itself, its threads and small buffers take.
const PROGRAM_BYTES: u64 = 40 << 20;

impl Memory {
    /// The least that a process may be held to, in bytes.
    pub const LEAST: u64 = 64 << 20;

    /// For a process that is to take this much in all.
    pub fn of_process(bytes: u64) -> Memory {
        Memory(bytes.max(Memory::LEAST).saturating_sub(PROGRAM_BYTES) as usize)
    }

    /// For a part of a process that does more.
    pub fn of_part(bytes: u64) -> Memory {
        Memory::of_process(bytes.saturating_add(PROGRAM_BYTES))
    }

    /// For records that are being collected.
    fn to_sort(self) -> usize {
        self.0 / 5 * 2
    }

    /// Points of a piece whose neighbours are being sought; those of its margin may be as many.
    fn of_pieces(self) -> usize {
        (self.0 / PIECE_BYTES).max(1000)
    }

    /// For those that are being read meanwhile.
    fn to_merge(self) -> usize {
        self.0 / 5
    }
}

/// Memory that a point of a piece takes while its neighbours are sought, with one of the margin and its share of what waits.
const PIECE_BYTES: usize = 400;
/// Bytes of temporary files a sample at most; nodes of a tree may be twice as many as samples.
const DISK_BYTES: u64 = 400;

/// Bytes of temporary files that so many samples take at most.
pub fn disk_bytes(samples: u64) -> u64 {
    samples.saturating_mul(DISK_BYTES).saturating_add(64 << 20)
}

/// Where work is done, with how much memory, and who is told how far it is: a part of 1.
pub struct Work<'a> {
    spill: &'a Spill,
    memory: Memory,
    progress: &'a (dyn Fn(Phase, f64) + Sync),
    /// What was told last, in thousandths.
    told: AtomicU64,
    stop: Option<&'a AtomicBool>,
}

impl<'a> Work<'a> {
    pub fn new(
        spill: &'a Spill,
        memory: Memory,
        progress: &'a (dyn Fn(Phase, f64) + Sync),
    ) -> Work<'a> {
        Work { spill, memory, progress, told: AtomicU64::new(u64::MAX), stop: None }
    }

    /// Fails soon after `stop` has become true.
    pub fn stopped_by(self, stop: Option<&'a AtomicBool>) -> Work<'a> {
        Work { stop, ..self }
    }

    fn check(&self) -> io::Result<()> {
        let is_stopped = self.stop.is_some_and(|stop| stop.load(Ordering::Relaxed));
        if is_stopped { Err(io::Error::other("stopped before its end")) } else { Ok(()) }
    }

    /// May be called as often as one likes.
    fn tell(&self, phase: Phase, done: f64) {
        let steps = (phase as u64) << 32 | (done * 1000.0) as u64;
        if self.told.swap(steps, Ordering::Relaxed) != steps {
            (self.progress)(phase, done);
        }
    }
}

/// A file's points as [`super::pack::pack_samples`] packs them, with the attributes that
/// [`super::prepare::prepare_geometry`] gives them.
///
/// # Errors
/// See [`BakeFault`].
pub fn pack_points(
    source: &PointBlocks,
    survey: &Survey,
    work: &Work,
) -> Result<Spilled, BakeFault> {
    let points = points::Points::read(source, survey, work)?;
    let fits = fit::Fits::of(&points, work)?;
    pack::pack(&points, &fits, &survey.bounds, work)
}

/// The tree that [`super::tree::build_tree`] builds of packed samples without clip lines, and its figures.
///
/// # Errors
/// See [`BakeFault`].
pub fn grow_tree(packed: Packed, work: &Work) -> Result<(Spilled, TreeStatistics), BakeFault> {
    tree::grow(packed, work)
}

#[cfg(test)]
mod tests;
