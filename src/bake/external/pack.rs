//! Third phase: packs samples for the GPU, one chunk at a time.

use std::io;

use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;

use super::super::pack::{
    CHUNK, Grid, KERNEL_DETAIL, PackedChunk, PackedField, PackedRun, PackedSamples, Sample, Shape,
    Values, kernel_lengths, morton, pack_run, value_words,
};
use super::fit::Fits;
use super::points::Points;
use super::sort::{Sortable, Sorter};
use super::spill::{Spill, SpillFile};
use super::{BakeFault, Phase, Work};
use crate::math::Bounds;

/// Packed samples without clip lines, in files: the counterpart of [`PackedSamples`].
pub struct Spilled {
    pub grid: Grid,
    pub chunks: Vec<PackedChunk>,
    pub positions: SpillFile<[u32; 2]>,
    pub attributes: SpillFile<[u32; 2]>,
    pub kernels: SpillFile<u32>,
    /// Scalar fields, and their words.
    pub fields: Vec<PackedField>,
    pub values: SpillFile<u32>,
    /// Node words, for point trees.
    pub nodes: SpillFile<[u32; 2]>,
}

impl Spilled {
    fn new(grid: Grid, fields: &[PackedField], spill: &Spill) -> io::Result<Spilled> {
        Ok(Spilled {
            grid,
            chunks: Vec::new(),
            positions: spill.file()?,
            attributes: spill.file()?,
            kernels: spill.file()?,
            fields: fields.to_vec(),
            values: spill.file()?,
            nodes: spill.file()?,
        })
    }

    pub fn len(&self) -> u64 {
        self.positions.count()
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    fn add(&mut self, run: &PackedRun) -> io::Result<()> {
        self.chunks.push(PackedChunk { first: self.len() as u32, ..run.chunk });
        self.positions.extend(&run.positions)?;
        self.attributes.extend(&run.attributes)?;
        self.kernels.extend(&run.kernels)
    }

    /// Reads one chunk.
    pub(super) fn load(&self, chunk: &PackedChunk) -> io::Result<PackedSamples> {
        let range = u64::from(chunk.first)..u64::from(chunk.first + chunk.count);
        let words = value_words(&self.fields) as u64;
        Ok(PackedSamples {
            grid: self.grid,
            chunks: vec![PackedChunk { first: 0, ..*chunk }],
            positions: self.positions.load(range.clone())?,
            attributes: self.attributes.load(range.clone())?,
            kernels: self.kernels.load(range.clone())?,
            fields: self.fields.clone(),
            values: self.values.load(words * range.start..words * range.end)?,
            ..PackedSamples::default()
        })
    }
}

/// A record that comes with a sample.
pub(super) trait WithValues: Send + Sync {
    /// Codes of the sample's scalar fields.
    fn values(&self) -> Values;
}

impl WithValues for Values {
    fn values(&self) -> Values {
        *self
    }
}

/// Packs chunks in batches and passes them on, each with the records `T` that came with its samples.
pub(super) struct Packer<T> {
    pub(super) out: Spilled,
    oriented: bool,
    chunks: Vec<Vec<(T, Sample<'static>)>>,
}

/// Number of chunks packed at a time.
const BATCH: usize = 32;

impl<T: WithValues> Packer<T> {
    pub(super) fn new(
        grid: Grid,
        fields: &[PackedField],
        oriented: bool,
        spill: &Spill,
    ) -> io::Result<Packer<T>> {
        Ok(Packer { out: Spilled::new(grid, fields, spill)?, oriented, chunks: Vec::new() })
    }

    /// Adds a chunk. `given` receives each packed chunk with the index of its first sample and the records of its samples.
    pub(super) fn push(
        &mut self,
        chunk: Vec<(T, Sample<'static>)>,
        given: &mut impl FnMut(&PackedRun, u32, Vec<T>) -> io::Result<()>,
    ) -> io::Result<()> {
        self.chunks.push(chunk);
        if self.chunks.len() < BATCH { Ok(()) } else { self.flush(given) }
    }

    pub(super) fn flush(
        &mut self,
        given: &mut impl FnMut(&PackedRun, u32, Vec<T>) -> io::Result<()>,
    ) -> io::Result<()> {
        let (grid, oriented) = (self.out.grid, self.oriented);
        let runs: Vec<(PackedRun, Vec<T>)> = std::mem::take(&mut self.chunks)
            .into_par_iter()
            .map(|chunk| {
                let (of, samples) = chunk.into_iter().unzip();
                (pack_run(&grid, samples, false, oriented), of)
            })
            .collect();
        let words = value_words(&self.out.fields);
        for (run, of) in runs {
            let first = self.out.len() as u32;
            self.out.add(&run)?;
            for record in &of {
                self.out.values.extend_buffered(&record.values()[..words])?;
            }
            given(&run, first, of)?;
        }
        Ok(())
    }
}

/// A point's position along the final curve, known once the grid is.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Moved {
    place: u64,
    at: u32,
    index: u32,
}

impl Sortable for Moved {
    type Key = (u64, u32);

    fn key(&self) -> (u64, u32) {
        (self.place, self.index)
    }
}

/// Packs points with the estimates from their neighbours.
pub(super) fn pack(
    points: &Points,
    fits: &Fits,
    bounds: &Bounds,
    work: &Work,
) -> Result<Spilled, BakeFault> {
    let mut longest = 0.0f32;
    fits.each(points, work.memory.to_merge() / 2, |_, _, kernel| {
        let (u, v) = kernel_lengths(&kernel);
        longest = longest.max(u).max(v);
        Ok(())
    })?;
    let grid = Grid::with_detail(bounds, f64::from(longest) * KERNEL_DETAIL)?;
    let mut packer = Packer::new(grid, &points.fields, points.oriented, work.spill)?;
    let mut chunk = Vec::with_capacity(CHUNK);
    let total = points.file.count();
    let mut done = 0;
    let mut add = |values: Values, sample: Sample<'static>| {
        chunk.push((values, sample));
        done += 1;
        if chunk.len() == CHUNK || done == total {
            work.tell(Phase::Pack, done as f64 / total as f64);
            packer.push(std::mem::take(&mut chunk), &mut |_, _, _| Ok(()))?;
        }
        Ok(())
    };
    let sample = |point: &super::points::Point, normal, kernel| Sample {
        cell: grid.quantise(point.position()),
        color: points.color(point),
        normal,
        shape: Shape::Ellipse(kernel),
        clip: None,
    };
    if grid == points.grid {
        fits.each(points, work.memory.to_merge() / 2, |point, normal, kernel| {
            add(point.values, sample(point, normal, kernel))
        })?;
    } else {
        // Long kernels enlarge the cells of the grid, which changes the curve.
        let mut sorter = Sorter::new(work.spill, work.memory.to_sort(), work.memory.to_merge());
        let mut at = 0;
        points.file.each_block(|block| {
            for point in block {
                let place = morton(grid.quantise(point.position()));
                sorter.push(Moved { place, at, index: point.index })?;
                at += 1;
            }
            Ok(())
        })?;
        let sorted = sorter.finish()?;
        let mut walk = sorted.walk()?;
        while let Some(moved) = walk.next()? {
            let (point, normal, kernel) = fits.one(points, u64::from(moved.at))?;
            add(point.values, sample(&point, normal, kernel))?;
        }
    }
    packer.flush(&mut |_, _, _| Ok(()))?;
    packer.out.values.flush()?;
    Ok(packer.out)
}
