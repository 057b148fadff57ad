//! Point trees of more samples than fit into memory.
//!
//! Reading, estimating, packing and building give the same words as in memory. Only the order of the work differs, from one sort
//! to the next:
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
//! Records that do not fit into memory go to temporary files ([`spill`]), sorted in runs and merged ([`sort`]).

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
    /// I/O error of a temporary file.
    #[error(transparent)]
    Io(#[from] io::Error),
    #[error("there are no points")]
    Empty,
}

/// The phase of the work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// The first pass over a file.
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

/// Memory budget of the work, in bytes.
#[derive(Clone, Copy, Debug)]
pub struct Memory(usize);

/// Memory of the program itself, its threads and small buffers, in bytes.
const PROGRAM_BYTES: u64 = 40 << 20;

impl Memory {
    /// The smallest memory limit of a process, in bytes.
    pub const LEAST: u64 = 64 << 20;

    /// The budget of a process that may take this much in all.
    pub fn of_process(bytes: u64) -> Memory {
        Memory(bytes.max(Memory::LEAST).saturating_sub(PROGRAM_BYTES) as usize)
    }

    /// The budget of one task in a process that also does other work.
    pub fn of_part(bytes: u64) -> Memory {
        Memory::of_process(bytes.saturating_add(PROGRAM_BYTES))
    }

    /// Bytes for records that are being collected.
    fn to_sort(self) -> usize {
        self.0 / 5 * 2
    }

    /// Maximum number of points in a piece; the points of its margin may be as many.
    fn of_pieces(self) -> usize {
        (self.0 / PIECE_BYTES).max(1000)
    }

    /// Bytes for records that are read meanwhile.
    fn to_merge(self) -> usize {
        self.0 / 5
    }
}

/// Bytes per point of a piece during the neighbour search, including one point of the margin and its share of the waiting points.
const PIECE_BYTES: usize = 400;
/// Maximum bytes of temporary files per sample; a tree may have twice as many nodes as samples.
const DISK_BYTES: u64 = 400;

/// Maximum bytes of temporary files for this many samples.
pub fn disk_bytes(samples: u64) -> u64 {
    samples.saturating_mul(DISK_BYTES).saturating_add(64 << 20)
}

/// Environment of the work: temporary files, memory budget and progress callback, which gets a fraction of 1.
pub struct Work<'a> {
    spill: &'a Spill,
    memory: Memory,
    progress: &'a (dyn Fn(Phase, f64) + Sync),
    /// The last reported progress, in thousandths.
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

    /// Returns an error soon after `stop` has become true.
    pub fn stopped_by(self, stop: Option<&'a AtomicBool>) -> Work<'a> {
        Work { stop, ..self }
    }

    fn check(&self) -> io::Result<()> {
        let is_stopped = self.stop.is_some_and(|stop| stop.load(Ordering::Relaxed));
        if is_stopped { Err(io::Error::other("stopped before its end")) } else { Ok(()) }
    }

    /// Reports progress; may be called often.
    fn tell(&self, phase: Phase, done: f64) {
        let steps = (phase as u64) << 32 | (done * 1000.0) as u64;
        if self.told.swap(steps, Ordering::Relaxed) != steps {
            (self.progress)(phase, done);
        }
    }
}

/// Packs a file's points as [`super::pack::pack_samples`] does, with the attributes that [`super::prepare::prepare_geometry`]
/// gives them.
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

/// Builds the same tree as [`super::tree::build_tree`], from packed samples without clip lines, and its figures.
///
/// # Errors
/// See [`BakeFault`].
pub fn grow_tree(packed: Packed, work: &Work) -> Result<(Spilled, TreeStatistics), BakeFault> {
    tree::grow(packed, work)
}

#[cfg(test)]
mod tests;
