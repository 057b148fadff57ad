//! The last phases: build the tree above packed samples and write its nodes in sequence.
//!
//! Leaves arrive in Morton order, and each inner node is built as soon as its cell is complete, so memory holds only one path
//! from the root down ([`Stack`]). There are two passes over the tree: codes count from the largest measure, which must be known
//! first. Nodes are sorted by their bands and packed as they arrive. Afterwards they are sorted by their parents to find the
//! distance to each parent.

use std::io;

use bytemuck::{Pod, Zeroable};
use glam::{IVec3, Vec3};

use super::super::CUTOFF;
use super::super::pack::{
    Grid, KERNEL_DETAIL, Layout, PackedChunk, PackedField, PackedRun, PackedSamples, Sample, Shape,
    Sides, Values, octahedral_decode, unpack_kernel,
};
use super::super::tree::parts::{
    Cells, Codes, Cutter, Matter, Node, Stack, Tilts, around_point, base_from, byte, delta_bits,
    kernel_length, measures_of, range_of, reach_behind, shared_level, way_length, words,
};
use super::super::tree::{CODE, CODE_BITS, Measures, TreeStatistics};
use super::pack::{Packer, Spilled, WithValues};
use super::sort::{Sortable, Sorted, Sorter};
use super::spill::SpillFile;
use super::{BakeFault, Phase, Work};
use crate::assets::Kernel;
use crate::math::Bounds;

/// Packed samples without clip lines, the input of a tree.
#[derive(Clone, Copy)]
pub enum Packed<'a> {
    Spilled(&'a Spilled),
    Memory(&'a PackedSamples),
}

impl Packed<'_> {
    fn grid(self) -> Grid {
        match self {
            Packed::Spilled(samples) => samples.grid,
            Packed::Memory(samples) => samples.grid,
        }
    }

    fn fields(&self) -> &[PackedField] {
        match self {
            Packed::Spilled(samples) => &samples.fields,
            Packed::Memory(samples) => &samples.fields,
        }
    }

    fn chunks(&self) -> &[PackedChunk] {
        match self {
            Packed::Spilled(samples) => &samples.chunks,
            Packed::Memory(samples) => &samples.chunks,
        }
    }

    /// Calls `take` with each sample, in order, with its grid cell but without its code.
    fn each(self, mut take: impl FnMut(Leaf) -> io::Result<()>) -> io::Result<()> {
        let mut sample = 0;
        for chunk in self.chunks() {
            let loaded;
            let (samples, range) = match self {
                Packed::Memory(samples) => (samples, chunk.elements()),
                Packed::Spilled(samples) => {
                    loaded = samples.load(chunk)?;
                    (&loaded, 0..chunk.count as usize)
                }
            };
            let step = self.grid().step as f32 * (chunk.shift as f32).exp2();
            for at in range {
                let cell = chunk.cell(samples.positions[at]).into();
                let [color, normal] = samples.attributes[at];
                let (kernel, base) = (samples.kernels[at], chunk.kernel_base * step);
                let mut values = Values::default();
                values
                    .iter_mut()
                    .zip(samples.values_of(at))
                    .for_each(|(value, word)| *value = *word);
                take(Leaf { code: 0, cell, sample, color, normal, kernel, base, values })?;
                sample += 1;
            }
        }
        Ok(())
    }
}

/// A packed sample.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Leaf {
    /// Morton code in the octree.
    code: u64,
    /// Cell on the samples' grid.
    cell: [i32; 3],
    sample: u32,
    color: u32,
    normal: u32,
    kernel: u32,
    base: f32,
    values: Values,
}

impl Sortable for Leaf {
    type Key = (u64, u32);

    fn key(&self) -> (u64, u32) {
        (self.code, self.sample)
    }
}

impl Leaf {
    fn kernel(&self) -> Kernel {
        unpack_kernel(self.kernel, self.normal, self.base)
    }

    fn node(&self, grid: &Grid) -> Node {
        let leaf = Node::leaf(
            grid.position(self.cell.into()),
            octahedral_decode(self.normal),
            self.color.to_le_bytes(),
            &self.kernel(),
            false,
            Measures::default(),
            Matter::Points,
        );
        Node { values: self.values, ..leaf }
    }
}

/// A node to be placed in the sequence.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Ranked {
    /// Rank along the curve, after all nodes below it.
    rank: u32,
    /// The parent's rank, or [`NO_RANK`].
    parent: u32,
    cell: [i32; 3],
    color: u32,
    normal: [f32; 3],
    /// A leaf's kernel; of an inner node, `u.x` is the disk's standard deviation.
    u: [f32; 3],
    v: [f32; 3],
    is_leaf: u32,
    words: [u32; 2],
    values: Values,
}

impl WithValues for Ranked {
    fn values(&self) -> Values {
        self.values
    }
}

const NO_RANK: u32 = u32::MAX;

impl Ranked {
    fn codes(&self) -> Codes {
        let part = |word: u32, shift: u32| (word >> shift & CODE) as u16;
        let [error, size] = self.words;
        Codes {
            error: part(error, 0),
            size: part(size, 0),
            error_parent: part(error, CODE_BITS),
            size_parent: part(size, CODE_BITS),
        }
    }

    fn sample(&self) -> Sample<'static> {
        let shape = match self.is_leaf {
            0 => Shape::Circle(self.u[0]),
            _ => Shape::Ellipse(Kernel { u: self.u.into(), v: self.v.into() }),
        };
        Sample {
            cell: self.cell.into(),
            color: self.color.to_le_bytes(),
            normal: self.normal.into(),
            shape,
            clip: None,
        }
    }
}

impl Sortable for Ranked {
    type Key = (u16, u32);

    fn key(&self) -> (u16, u32) {
        (self.codes().band(), self.rank)
    }
}

/// A node without a parent yet, with its sample if it is a leaf.
struct Open {
    node: Node,
    rank: u32,
    leaf: Option<Leaf>,
}

/// Builds the tree above leaves. `found` receives each node once its parent is known, with the parent's rank and node.
fn raise(
    leaves: &Sorted<Leaf>,
    grid: &Grid,
    layout: &Layout,
    mut found: impl FnMut(&Open, Option<(u32, &Node)>) -> io::Result<()>,
) -> io::Result<()> {
    let mut failed = Ok(());
    let mut rank = 0;
    let mut next = || {
        rank += 1;
        rank - 1
    };
    let mut stack: Stack<Open> = Stack::new();
    let mut last = None;
    let mut walk = leaves.walk()?;
    let mut merge = |members: &[Open], rank: u32| {
        let mut children = [&members[0].node; super::super::tree::parts::CHILDREN];
        children.iter_mut().zip(members).for_each(|(child, member)| *child = &member.node);
        let node = Node::above(&children[..members.len().min(children.len())], layout);
        for member in members {
            if failed.is_ok() {
                failed = found(member, Some((rank, &node)));
            }
        }
        Open { node, rank, leaf: None }
    };
    while let Some(leaf) = walk.next()? {
        let level = last.map_or(0, |last| shared_level(last, leaf.code));
        stack.advance(level, &mut |members: &[Open]| merge(members, next()));
        stack.put(Open { node: leaf.node(grid), rank: next(), leaf: Some(leaf) });
        last = Some(leaf.code);
    }
    let root = stack.finish(&mut |members: &[Open]| merge(members, next()));
    failed?;
    root.map_or(Ok(()), |root| found(&root, None))
}

/// Builds the tree above packed samples, and its figures.
pub(super) fn grow(packed: Packed, work: &Work) -> Result<(Spilled, TreeStatistics), BakeFault> {
    let samples = packed.grid();
    let (mut bounds, mut longest, mut count) = (Bounds::EMPTY, 0.0f32, 0u64);
    packed.each(|leaf| {
        bounds = bounds.union(Bounds::of([samples.position(leaf.cell.into())]));
        longest = longest.max(kernel_length(&leaf.kernel()));
        count += 1;
        Ok(())
    })?;
    let grown = bounds.grown(f64::from(2.0 * CUTOFF * longest));
    let grid = Grid::with_detail(&grown, f64::from(longest) * KERNEL_DETAIL)?;
    let (sort_bytes, merge_bytes) = (work.memory.to_sort(), work.memory.to_merge());
    let mut sorter = Sorter::new(work.spill, sort_bytes, merge_bytes);
    let cells = Cells::of(&bounds);
    packed.each(|leaf| {
        work.tell(Phase::Leaves, f64::from(leaf.sample) / count as f64);
        work.check()?;
        sorter.push(Leaf { code: cells.code(samples.position(leaf.cell.into())), ..leaf })
    })?;
    let leaves = sorter.finish()?;
    let mut most = 0.0f32;
    // Values do not change measures.
    raise(&leaves, &samples, &Layout::default(), |open, _| {
        work.tell(
            Phase::Measure,
            f64::from(open.leaf.map_or(0, |leaf| leaf.sample)) / count as f64,
        );
        most = most.max(open.node.error.max(open.node.size));
        Ok(())
    })?;
    let base = base_from(most, grid.step as f32);
    let layout = Layout::of(packed.fields());
    let nodes = ranked(&leaves, &samples, &layout, &grid, base, work)?;
    drop(leaves);
    let oriented = packed.chunks().iter().any(|chunk| chunk.sides != Sides::Unknown);
    let sequence = Sequence::of(nodes, grid, packed.fields(), oriented, work)?;
    sequence.with_parents(base, work)
}

/// Returns all nodes, sorted by their bands.
fn ranked(
    leaves: &Sorted<Leaf>,
    samples: &Grid,
    layout: &Layout,
    grid: &Grid,
    base: f32,
    work: &Work,
) -> io::Result<Sorted<Ranked>> {
    let mut sorter = Sorter::new(work.spill, work.memory.to_sort(), work.memory.to_merge());
    let mut done = 0u64;
    raise(leaves, samples, layout, |Open { node, rank, leaf }, parent| {
        done += u64::from(leaf.is_some());
        work.tell(Phase::Nodes, done as f64 / leaves.len() as f64);
        work.check()?;
        let step = grid.step as f32;
        let above = parent.map(|(_, parent)| measures_of(parent, step));
        let codes = Codes::of(measures_of(node, step), above, base, step);
        let tilts = Tilts::of(node, parent.map(|(_, parent)| parent));
        let [r, g, b] = node.color.to_array().map(|v| (v + 0.5) as u8);
        let around = Node { around: around_point(parent.is_none()), ..*node };
        let alpha = byte(&around, measures_of(node, step).size);
        let kernel = match leaf {
            Some(leaf) => leaf.kernel(),
            None => Kernel { u: Vec3::new(node.radius / CUTOFF, 0.0, 0.0), v: Vec3::ZERO },
        };
        sorter.push(Ranked {
            rank: *rank,
            parent: parent.map_or(NO_RANK, |(rank, _)| rank),
            cell: grid.quantise(node.position).into(),
            color: u32::from_le_bytes([r, g, b, alpha]),
            normal: node.normal.into(),
            u: kernel.u.into(),
            v: kernel.v.into(),
            is_leaf: u32::from(leaf.is_some()),
            words: words(codes, node, tilts),
            values: node.values,
        })
    })?;
    sorter.finish()
}

/// A node's cell, for the node itself and for its children.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Placed {
    /// Rank of the node (`child` is 0) or of its parent.
    rank: u32,
    /// 0, or one plus the child's index in the sequence.
    child: u32,
    cell: [i32; 3],
}

impl Sortable for Placed {
    type Key = (u32, u32);

    fn key(&self) -> (u32, u32) {
        (self.rank, self.child)
    }
}

/// The distance of a node's parent.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Way {
    place: u32,
    length: f32,
}

impl Sortable for Way {
    type Key = u32;

    fn key(&self) -> u32 {
        self.place
    }
}

/// Nodes in sequence, without the distances to their parents.
struct Sequence {
    out: Spilled,
    words: SpillFile<[u32; 2]>,
    placed: Sorted<Placed>,
    /// The root's index.
    root: u32,
}

impl Sequence {
    fn of(
        nodes: Sorted<Ranked>,
        grid: Grid,
        fields: &[PackedField],
        oriented: bool,
        work: &Work,
    ) -> io::Result<Sequence> {
        let mut sorter = Sorter::new(work.spill, work.memory.to_sort(), work.memory.to_merge());
        let mut words = work.spill.file()?;
        let mut root = 0;
        let total = nodes.len() as f64;
        let mut place = |run: &PackedRun, first: u32, nodes: Vec<Ranked>| {
            work.tell(Phase::Sequence, f64::from(first) / total);
            for ((node, &position), at) in nodes.iter().zip(&run.positions).zip(first..) {
                let cell = run.chunk.cell(position).into();
                sorter.push(Placed { rank: node.rank, child: 0, cell })?;
                match node.parent {
                    NO_RANK => root = at,
                    rank => sorter.push(Placed { rank, child: at + 1, cell })?,
                }
                words.push(node.words)?;
            }
            Ok(())
        };
        let mut packer = Packer::new(grid, fields, oriented, work.spill)?;
        let (mut cutter, mut chunks) = (Cutter::new(), Vec::new());
        let with_samples =
            |chunk: Vec<Ranked>| chunk.into_iter().map(|node| (node, node.sample())).collect();
        let mut walk = nodes.walk()?;
        while let Some(node) = walk.next()? {
            cutter.push(node, node.codes(), &mut |chunk| chunks.push(chunk));
            for chunk in chunks.drain(..) {
                packer.push(with_samples(chunk), &mut place)?;
            }
        }
        cutter.finish(&mut |chunk| chunks.push(chunk));
        for chunk in chunks {
            packer.push(with_samples(chunk), &mut place)?;
        }
        packer.flush(&mut place)?;
        packer.out.values.flush()?;
        words.flush()?;
        Ok(Sequence { out: packer.out, words, placed: sorter.finish()?, root })
    }

    fn with_parents(self, base: f32, work: &Work) -> Result<(Spilled, TreeStatistics), BakeFault> {
        let Sequence { mut out, words, placed, root } = self;
        let mut sorter = Sorter::new(work.spill, work.memory.to_sort(), work.memory.to_merge());
        sorter.push(Way { place: root, length: 0.0 })?;
        let mut parent = IVec3::ZERO;
        let mut walk = placed.walk()?;
        while let Some(Placed { child, cell, .. }) = walk.next()? {
            match child {
                0 => parent = cell.into(),
                _ => {
                    let length = way_length(IVec3::from(cell) - parent);
                    sorter.push(Way { place: child - 1, length })?;
                }
            }
        }
        drop(placed);
        let ways = sorter.finish()?;
        let (mut walk, mut words) = (ways.walk()?, words.walk(0..words.count(), 1 << 18));
        let mut statistics = TreeStatistics::default();
        let mut chunk = Vec::new();
        for number in 0..out.chunks.len() {
            chunk.clear();
            for _ in 0..out.chunks[number].count {
                let (Some(way), Some([error, size])) = (walk.next()?, words.next()?) else { break };
                let way = delta_bits(way.length, size >> CODE_BITS & CODE, base);
                chunk.push([error | way, size]);
            }
            out.nodes.extend(&chunk)?;
            out.chunks[number].range = range_of(&chunk, base);
            statistics.add(&chunk);
        }
        reach_behind(&mut out.chunks);
        statistics.finish(&out.grid, &out.chunks, 4 * out.values.count());
        work.tell(Phase::Sequence, 1.0);
        Ok((out, statistics))
    }
}
