//! Packs clouds one piece at a time, as their samples' normals and kernels become known.

use std::ops::Range;

use glam::Vec3;
use rayon::prelude::*;

use super::{
    CHUNK, Grid, PackError, PackedChunk, PackedSamples, Sample, Shape, fields_of, finite, kernel,
    morton, order, pack_run, packed_values,
};
use crate::assets::{Kernel, NEUTRAL, PointCloud};

/// A cloud without clip lines that is being packed into chunks.
pub(in crate::bake) struct Packing<'a> {
    cloud: &'a PointCloud,
    order: Vec<u32>,
    longest: f32,
    out: PackedSamples,
}

impl<'a> Packing<'a> {
    /// Sorts the points along the curve of `grid`.
    ///
    /// # Errors
    /// Fails if a position is not finite.
    pub(in crate::bake) fn new(
        cloud: &'a PointCloud,
        grid: Grid,
    ) -> Result<Packing<'a>, PackError> {
        finite(&cloud.positions)?;
        let count = cloud.positions.len();
        let key = |index: usize| morton(grid.quantise(cloud.positions[index]));
        let (order, _) = order::by_key(count, u64::MAX, key);
        let out = PackedSamples {
            grid,
            chunks: Vec::with_capacity(count.div_ceil(CHUNK)),
            positions: vec![[0; 2]; count],
            attributes: vec![[0; 2]; count],
            kernels: vec![0; count],
            fields: fields_of(cloud),
            ..PackedSamples::default()
        };
        Ok(Packing { cloud, order, longest: 0.0, out })
    }

    /// The points' indices in the order of the curve.
    pub(in crate::bake) fn take_order(&mut self) -> Vec<u32> {
        std::mem::take(&mut self.order)
    }

    pub(in crate::bake) fn grid(&self) -> Grid {
        self.out.grid
    }

    /// The longest axis of a kernel so far.
    pub(in crate::bake) fn longest(&self) -> f32 {
        self.longest
    }

    /// Packs the next chunks, with the normal and kernel of each point by its index along the curve.
    pub(in crate::bake) fn fill(
        &mut self,
        order: &[u32],
        chunks: Range<usize>,
        of: impl Fn(usize) -> (Vec3, Kernel) + Sync,
    ) {
        let (cloud, grid) = (self.cloud, self.out.grid);
        let ranks = chunks.start * CHUNK..order.len().min(chunks.end * CHUNK);
        let PackedSamples { positions, attributes, kernels, .. } = &mut self.out;
        let filled: Vec<(PackedChunk, f32)> = order[ranks.clone()]
            .par_chunks(CHUNK)
            .zip(positions[ranks.clone()].par_chunks_mut(CHUNK))
            .zip(attributes[ranks.clone()].par_chunks_mut(CHUNK))
            .zip(kernels[ranks].par_chunks_mut(CHUNK))
            .zip(chunks)
            .map(|((((run, positions), attributes), kernels), chunk)| {
                let first = chunk * CHUNK;
                let mut longest = 0.0f32;
                let sample = |(&index, rank): (&u32, usize)| {
                    let index = index as usize;
                    let (normal, kernel) = of(rank);
                    let (u, v) = kernel::lengths(&kernel);
                    longest = longest.max(u).max(v);
                    Sample {
                        cell: grid.quantise(cloud.positions[index]),
                        color: cloud.colors.as_ref().map_or(NEUTRAL, |colors| colors[index]),
                        normal,
                        shape: Shape::Ellipse(kernel),
                        clip: None,
                    }
                };
                let samples: Vec<Sample> = run.iter().zip(first..).map(sample).collect();
                let translucent = samples.iter().any(Sample::is_translucent);
                let packed = pack_run(&grid, samples, false, cloud.oriented);
                let chunk = packed.put(positions, attributes, kernels);
                (PackedChunk { first: first as u32, translucent, ..chunk }, longest)
            })
            .collect();
        for (chunk, longest) in filled {
            self.out.chunks.push(chunk);
            self.longest = self.longest.max(longest);
        }
    }

    /// Returns the samples, whose order along the curve is `order`; call it after all chunks are filled.
    pub(in crate::bake) fn finish(mut self, order: &[u32]) -> PackedSamples {
        self.out.values = packed_values(self.cloud, order);
        self.out
    }
}
