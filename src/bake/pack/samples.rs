//! Samples: points, splats and the nodes of point trees.
//!
//! Chunks of samples with clip lines come behind the others, and go into pages of their own.

mod unpack;

use std::borrow::Cow;
use std::io;
use std::ops::Range;

use glam::{DVec3, IVec3, Vec3};
use rayon::prelude::*;

use super::fields::{
    FIELD_WORDS, PackedField, Values, check_fields, pack_fields, value_words, values_at,
};
use super::kernel::{self, longer_axis};
use super::kind::{
    Arrays, LOOKED_AT, PackedKind, PageKind, STRAY_SHARE, Stream, StreamOf, TAIL_SHARE, holds,
};
use super::{
    CHUNK, GeometryKind, Grid, KERNEL_DETAIL, NodeRange, PackError, PackedChunk, Sides, finite,
    morton, octahedral, octahedral_decode, order, rgba_word,
};
use crate::assets::{Clip, Kernel, NEUTRAL, PointCloud};
use crate::math::Bounds;

pub(in crate::bake) use unpack::unpack_kernel;
pub use unpack::unpack_samples;

/// Bytes of a sample.
pub const SAMPLE_BYTES: u64 = 20;
/// Additional bytes of a sample with clip lines.
pub const CLIP_BYTES: u64 = 8;
/// Additional bytes of a sample that is a node of a point tree.
pub const NODE_BYTES: u64 = 8;
/// Bytes that packing a sample needs.
pub(super) const PACKING_BYTES: u64 = 40;
/// Fewer samples than this have no strays.
const LEAST_SAMPLES: u64 = 32;
/// Clouds of fewer samples are framed with their discs, which may be larger than the distances between them.
const FEW_SAMPLES: u64 = 256;
/// Standard deviations at which a disc ends.
const DISC_DEVIATIONS: f64 = 2.0;

/// A point cloud as the GPU holds it.
#[derive(Clone, Debug, Default)]
pub struct PackedSamples {
    pub grid: Grid,
    pub chunks: Vec<PackedChunk>,
    /// 21 bits a coordinate, relative to the chunk, x lowest.
    pub positions: Vec<[u32; 2]>,
    /// sRGB8 colour with alpha, and octahedral normal.
    pub attributes: Vec<[u32; 2]>,
    /// For each sample: logarithms of the axes' lengths, 11 bits each, and an angle.
    pub kernels: Vec<u32>,
    /// For each of the last samples: two clip lines.
    pub clips: Vec<[u32; 2]>,
    /// Point trees: the two words of each node, which decide whether it is drawn (see [`crate::bake::tree`]).
    pub nodes: Vec<[u32; 2]>,
    /// Scalar fields.
    pub fields: Vec<PackedField>,
    /// For each sample the codes of its fields, in [`value_words`] words.
    pub values: Vec<u32>,
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
    let fields = fields_of(cloud);
    let values = packed_values(cloud, &order);
    let mut out = PackedSamples {
        grid,
        chunks: Vec::new(),
        positions: vec![[0; 2]; count],
        attributes: vec![[0; 2]; count],
        kernels: vec![0; count],
        clips: vec![[0; 2]; count - clipped_first],
        nodes: Vec::new(),
        fields,
        values,
    };
    let (plain, with_lines) = order.split_at(clipped_first);
    let (positions, clipped_positions) = out.positions.split_at_mut(clipped_first);
    let (attributes, clipped_attributes) = out.attributes.split_at_mut(clipped_first);
    let (kernels, clipped_kernels) = out.kernels.split_at_mut(clipped_first);
    let pack = |run: &[u32], clipped| {
        let samples: Vec<Sample> =
            run.iter().map(|&i| Sample::of(cloud, &grid, i as usize)).collect();
        let translucent = samples.iter().any(Sample::is_translucent);
        let packed = pack_run(&grid, samples, clipped, cloud.oriented);
        PackedRun { chunk: PackedChunk { translucent, ..packed.chunk }, ..packed }
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

/// The fields of a cloud, packed.
pub(in crate::bake) fn fields_of(cloud: &PointCloud) -> Vec<PackedField> {
    pack_fields(&cloud.fields)
}

/// The words of all values, in this order of points.
pub(in crate::bake) fn packed_values(cloud: &PointCloud, order: &[u32]) -> Vec<u32> {
    let width = cloud.fields.width();
    let mut values = vec![0; width * order.len()];
    if width > 0 {
        let each = values.par_chunks_mut(width).with_min_len(1 << 12).zip(order);
        each.for_each(|(values, &point)| {
            values.copy_from_slice(cloud.fields.at(point as usize));
        });
    }
    values
}

/// The words of a point's values.
pub(in crate::bake) fn values_of(cloud: &PointCloud, point: usize) -> Values {
    values_at(&cloud.fields, point)
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
pub(in crate::bake) struct Sample<'a> {
    pub(in crate::bake) cell: IVec3,
    pub(in crate::bake) color: [u8; 4],
    pub(in crate::bake) normal: Vec3,
    pub(in crate::bake) shape: Shape,
    /// The clip lines, if the sample has any.
    pub(in crate::bake) clip: Option<&'a Clip>,
}

/// A sample's kernel, in the units of positions.
pub(in crate::bake) enum Shape {
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

    /// Whether something shows through it. The alpha of a node of a point tree says something else.
    pub(super) fn is_translucent(&self) -> bool {
        self.color[3] < 255
    }
}

/// Concatenates chunks of samples without scalar fields.
pub(in crate::bake) fn joined(grid: Grid, runs: Vec<PackedRun>) -> PackedSamples {
    let count = runs.iter().map(|run| run.positions.len()).sum();
    let clipped = runs.iter().map(|run| run.clips.len()).sum();
    let mut out = PackedSamples {
        grid,
        chunks: Vec::with_capacity(runs.len()),
        positions: Vec::with_capacity(count),
        attributes: Vec::with_capacity(count),
        kernels: Vec::with_capacity(count),
        clips: Vec::with_capacity(clipped),
        ..PackedSamples::default()
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
pub(in crate::bake) struct PackedRun {
    pub(in crate::bake) chunk: PackedChunk,
    pub(in crate::bake) positions: Vec<[u32; 2]>,
    pub(in crate::bake) attributes: Vec<[u32; 2]>,
    pub(in crate::bake) kernels: Vec<u32>,
    clips: Vec<[u32; 2]>,
}

impl PackedRun {
    /// Copies the chunk's words, except clip lines, to their final place.
    pub(super) fn put(
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
pub(in crate::bake) fn pack_run(
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
        translucent: false,
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

impl PackedSamples {
    /// The words of a sample's fields.
    pub fn values_of(&self, sample: usize) -> &[u32] {
        let words = value_words(&self.fields);
        &self.values[words * sample..words * (sample + 1)]
    }

    /// The first sample with clip lines; a chunk begins there.
    pub fn clipped_first(&self) -> u32 {
        self.positions.len().saturating_sub(self.clips.len()) as u32
    }
}

impl PackedKind for PackedSamples {
    fn grid(&self) -> &Grid {
        &self.grid
    }

    fn chunks(&self) -> &[PackedChunk] {
        &self.chunks
    }

    fn len(&self) -> usize {
        self.positions.len()
    }

    fn arrays(&self) -> Vec<&[u32]> {
        let PackedSamples {
            grid: _,
            chunks: _,
            positions,
            attributes,
            kernels,
            clips,
            nodes,
            fields,
            values,
        } = self;
        vec![
            positions.as_flattened(),
            attributes.as_flattened(),
            kernels,
            clips.as_flattened(),
            bytemuck::cast_slice(fields),
            values,
            nodes.as_flattened(),
        ]
    }

    fn widths() -> &'static [usize] {
        &[2, 2, 1, 2, FIELD_WORDS, 1, 2]
    }

    fn read(grid: Grid, chunks: Vec<PackedChunk>, arrays: &mut Arrays<'_>) -> io::Result<Self> {
        Ok(PackedSamples {
            grid,
            chunks,
            positions: arrays.rows()?,
            attributes: arrays.rows()?,
            kernels: arrays.words()?,
            clips: arrays.rows()?,
            fields: bytemuck::cast_slice(&arrays.rows::<FIELD_WORDS>()?).to_vec(),
            values: arrays.words()?,
            nodes: arrays.rows()?,
        })
    }

    fn check(&self) -> Result<(), &'static str> {
        let count = self.positions.len();
        holds(self.attributes.len() == count, "there are not as many attributes as positions")?;
        holds(self.kernels.len() == count, "there are not as many kernels as positions")?;
        let nodes = self.nodes.len();
        holds(nodes == 0 || nodes == count, "there are not as many nodes as positions")?;
        holds(self.clips.len() <= count, "there are more clip lines than samples")?;
        check_fields(&self.fields, count, self.values.len())?;
        let first = self.clipped_first();
        holds(
            self.clips.is_empty() || self.chunks.iter().any(|chunk| chunk.first == first),
            "no chunk begins with the first clipped sample",
        )
    }

    fn page(&self, chunk: &PackedChunk) -> PageKind {
        PageKind {
            nodes: !self.nodes.is_empty(),
            clipped: chunk.first >= self.clipped_first(),
            translucent: chunk.translucent,
            value_words: value_words(&self.fields) as u8,
            ..PageKind::plain(GeometryKind::Samples)
        }
    }

    fn streams(page: PageKind) -> Vec<Stream> {
        let stream = |name, words| Stream { name, words, of: StreamOf::Elements };
        let mut streams = vec![
            stream("positions", 2),
            stream("attributes", 2),
            stream("kernels", if page.nodes { 3 } else { 1 }),
        ];
        streams.extend(page.clipped.then_some(stream("clips", 2)));
        let words = usize::from(page.value_words);
        streams.extend((words > 0).then_some(stream("values", words)));
        streams
    }

    fn stream(&self, page: PageKind, name: &str, range: Range<usize>) -> Cow<'_, [u32]> {
        match name {
            "positions" => self.positions[range].as_flattened().into(),
            "attributes" => self.attributes[range].as_flattened().into(),
            // The words of a node stand beside its kernel.
            "kernels" if page.nodes => self.kernels[range.clone()]
                .iter()
                .zip(&self.nodes[range])
                .flat_map(|(&kernel, &[error, size])| [kernel, error, size])
                .collect(),
            "kernels" => self.kernels[range].into(),
            "values" => {
                let words = usize::from(page.value_words);
                self.values[words * range.start..words * range.end].into()
            }
            _ => {
                let first = self.clipped_first() as usize;
                self.clips[range.start - first..range.end - first].as_flattened().into()
            }
        }
    }

    fn list_first(&self, chunk: &PackedChunk) -> Option<u32> {
        // Samples with clip lines are a list of their own.
        let first = self.clipped_first();
        Some(if chunk.first >= first { first } else { 0 })
    }

    fn visit_elements(
        &self,
        chunk: &PackedChunk,
        range: Range<usize>,
        visit: &mut dyn FnMut(&[IVec3]),
    ) {
        self.positions[range].iter().for_each(|&words| visit(&[chunk.cell(words)]));
    }

    fn shortness(&self, range: Range<usize>) -> u32 {
        let codes = self.kernels[range].iter().filter_map(|&word| longer_axis(word));
        codes.min().map_or(255, |code| (code / 8).min(255))
    }

    fn median_kernel(&self) -> (f64, f64) {
        let longest = self.chunks.iter().map(longest_axis_of).collect();
        median(longest)
            .map_or((0.0, 0.0), |longest| (longest * self.grid.step, self.positions.len() as f64))
    }

    fn core(&self) -> Option<Bounds> {
        let count = self.positions.len() as u64;
        if count < LEAST_SAMPLES {
            return None;
        }
        let every = count.div_ceil(LOOKED_AT) as usize;
        let chosen = self.chunks.iter().flat_map(|chunk| {
            let range = chunk.elements().filter(|index| index % every == 0);
            range.map(|index| chunk.cell(self.positions[index]))
        });
        let cells: Vec<IVec3> = chosen.collect();
        let tail = (TAIL_SHARE * cells.len() as f64).ceil() as usize;
        let tail = tail.max(if count < 1000 { 1 } else { 4 });
        let mut core = Bounds::EMPTY;
        for axis in 0..3 {
            let mut values: Vec<i32> = cells.iter().map(|cell| cell[axis]).collect();
            let last = values.len() - 1;
            let (_, &mut low, _) = values.select_nth_unstable(tail);
            let (_, &mut high, _) = values.select_nth_unstable(last - tail);
            core.min[axis] = f64::from(low);
            core.max[axis] = f64::from(high);
        }
        Some(core)
    }

    fn weight(&self, _corners: &[DVec3]) -> f64 {
        1.0
    }

    fn stray_weight(&self) -> f64 {
        let count = self.positions.len();
        let least: u64 = if count < 1000 { 1 } else { 4 };
        least.max((STRAY_SHARE * count as f64) as u64) as f64
    }

    fn stray_gap(&self) -> f64 {
        if self.positions.len() < 10_000 { 1.5 } else { 0.5 }
    }

    fn corner_radius(&self) -> f64 {
        if self.positions.len() as u64 >= FEW_SAMPLES {
            return 0.0;
        }
        let of_chunk = |chunk: &PackedChunk| {
            let longest = longest_axis_of(chunk);
            let radius = move |&word: &u32| {
                longer_axis(word).map_or(0.0, |code| longest * (-f64::from(code) / 128.0).exp2())
            };
            self.kernels[chunk.elements()].iter().map(radius).collect::<Vec<f64>>()
        };
        let radii = self.chunks.iter().flat_map(of_chunk).collect();
        median(radii).map_or(0.0, |median| median * self.grid.step * DISC_DEVIATIONS)
    }
}

/// The longest axis of a chunk's kernels, in grid cells.
fn longest_axis_of(chunk: &PackedChunk) -> f64 {
    f64::from(chunk.kernel_base) * f64::from(1u32 << chunk.shift)
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    let middle = values.len() / 2;
    (middle < values.len()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

#[cfg(test)]
mod tests;
