//! Lays the hierarchy out as a list: order, chunks, codes.

use glam::IVec3;
use rayon::prelude::*;

use super::super::CUTOFF;
use super::super::pack::{
    ALWAYS, CHUNK, Grid, NodeRange, PackedChunk, PackedRun, PackedSamples, Sample, Shape,
    fields_of, joined, pack_run, value_words,
};
use super::hierarchy::Tree;
use super::node::Node;
use super::{Measures, coverage, tilt};
use crate::assets::{Kernel, PointCloud};

/// Bits of a code, and the mask of a code in a word.
pub const CODE_BITS: u32 = 11;
pub const CODE: u32 = (1 << CODE_BITS) - 1;
/// Position of `δ` in the first word, and of the level and the cone in the second.
const DELTA_SHIFT: u32 = 2 * CODE_BITS;
pub const LEVEL_SHIFT: u32 = 2 * CODE_BITS;
const CONE_SHIFT: u32 = LEVEL_SHIFT + 5;
/// The code of an error or size of zero.
pub const NONE: u32 = CODE;
/// The code in a parent's place that means no parent.
pub const NO_PARENT: u32 = 0;
/// Codes per octave, for errors and sizes and for distances.
pub(super) const STEPS: f32 = 64.0;
const DELTA_STEPS: f32 = 4.0;
/// Minimum size of inner nodes, in cells: twice the size then covers the distance to the children and the rounding of the grid.
/// Where a chunk's own coordinates are coarser, the distance may be longer and gets code 0, which stands for any length.
const LEAST_SIZE: f32 = 2.0;
/// Nodes in the first chunks, which are small so that distant views do not test a whole chunk.
const FIRST_CHUNKS: [usize; 2] = [64, 192];
/// Nodes at the front of a list that are strictly sorted by the smaller of their parents' codes. If a node there is rejected by
/// both measures, all nodes behind it are as well.
pub const SORTED: u32 = (FIRST_CHUNKS[0] + FIRST_CHUNKS[1]) as u32;
/// Minimum number of nodes in a chunk: smaller chunks take nodes from the next band.
const LEAST_CHUNK: usize = 256;

/// The largest code whose value is no less than `value`.
pub(super) fn code(value: f32, base: f32) -> u32 {
    if !(value > 0.0 && base > 0.0) {
        return NONE;
    }
    let below = ((base / value).log2() * STEPS).floor().clamp(1.0, (NONE - 1) as f32) as u32;
    // The logarithm may have rounded the code up.
    if decode(below, base) < value { below.saturating_sub(1).max(1) } else { below }
}

/// The error or size of a code, in units of `base`.
pub fn decode(code: u32, base: f32) -> f32 {
    if code == NONE { 0.0 } else { base * (-(code as f32) / STEPS).exp2() }
}

/// The largest code of a distance that is at least `value`; `size` is the code of the parent's size.
pub(super) fn delta_code(value: f32, size: u32, base: f32) -> u32 {
    let least = |code: &u32| delta_of(*code, size, base) >= value;
    (1..16).rev().find(least).unwrap_or(0)
}

/// The distance of a code, counted down from twice the parent's size (code `size`); code 0 stands for any length.
fn delta_of(code: u32, size: u32, base: f32) -> f32 {
    match code {
        0 => base,
        code => 2.0 * decode(size, base) * (-((code - 1) as f32) / DELTA_STEPS).exp2(),
    }
}

/// The sine of a cone's half angle, from a node's second word; the largest code means unknown.
pub fn cone_sine(size: u32) -> f32 {
    sine_of(size >> CONE_SHIFT & 7)
}

fn sine_of(code: u32) -> f32 {
    if code == 7 { 2.0 } else { (code * code) as f32 / 48.0 }
}

fn cone_code(cone: f32) -> u32 {
    let sine = if cone < std::f32::consts::FRAC_PI_2 { cone.sin() } else { 2.0 };
    (0..7).find(|&code| sine <= sine_of(code)).unwrap_or(7)
}

/// The distance of a node's parent, from the node's words; 0 without a parent.
pub fn decode_delta([error, size]: [u32; 2], base: f32) -> f32 {
    let size = size >> CODE_BITS & CODE;
    if size == NO_PARENT { 0.0 } else { delta_of(error >> DELTA_SHIFT & 15, size, base) }
}

/// The measures of a node that are coded: inner nodes have a minimum size.
pub fn measures_of(node: &Node, step: f32) -> Measures {
    let least = if node.level > 0 { LEAST_SIZE * step } else { 0.0 };
    Measures { error: node.error, size: node.size.max(least), ..Measures::default() }
}

/// The base of the codes, in cells: twice the largest measure, so that no node's own code equals [`NO_PARENT`].
pub fn base_from(most: f32, step: f32) -> f32 {
    2.0 * (most / step).max(LEAST_SIZE)
}

/// Codes of a node's error and size, and of its parent's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Codes {
    pub error: u16,
    pub size: u16,
    pub error_parent: u16,
    pub size_parent: u16,
}

/// Number of bands, see [`Codes::band`].
const BANDS: usize = 1 << 16;

impl Codes {
    /// Codes of a node's measures and of its parent's, if there is one.
    pub fn of(own: Measures, parent: Option<Measures>, base: f32, step: f32) -> Codes {
        let code = |value: f32| code(value / step, base) as u16;
        let none = NO_PARENT as u16;
        Codes {
            error: code(own.error),
            size: code(own.size),
            error_parent: parent.map_or(none, |parent| code(parent.error)),
            size_parent: parent.map_or(none, |parent| code(parent.size)),
        }
    }

    /// The band: half octaves of the parent's error, then octaves of the parent's size, then octaves of the node's own size. Nodes of a
    /// band that are neighbours along the curve pass or fail the tests together, so most parts of a chunk are drawn or skipped as a whole.
    pub fn band(self) -> u16 {
        self.error_parent / 32 * 1024 + self.size_parent / 64 * 32 + self.size / 64
    }

    /// The sort key of the first nodes.
    fn first_of_parents(self) -> u16 {
        self.error_parent.min(self.size_parent)
    }
}

/// The base of a tree's codes, in cells.
pub fn base_of(tree: &Tree, grid: Grid) -> f32 {
    let measures = tree.nodes.par_iter().map(|node| node.error.max(node.size));
    base_from(measures.reduce(|| 0.0, f32::max), grid.step as f32)
}

/// The value of a measure after packing.
pub fn rounded(value: f32, base: f32, step: f32) -> f32 {
    decode(code(value / step, base), base) * step
}

/// A tree whose nodes are samples: leaves keep their kernels and clip lines, the others are disks.
struct Nodes<'a> {
    cloud: &'a PointCloud,
    tree: &'a Tree,
    grid: Grid,
}

impl Nodes<'_> {
    fn is_clipped(&self, node: u32) -> bool {
        let sample = self.tree.samples.get(node as usize);
        self.cloud.clips.is_some() && sample.is_some_and(|&i| self.cloud.is_clipped(i as usize))
    }

    fn sample(&self, index: u32) -> Sample<'_> {
        let node = &self.tree.nodes[index as usize];
        let leaf = self.tree.samples.get(index as usize).map(|&sample| sample as usize);
        let size = measures_of(node, self.grid.step as f32).size;
        let [r, g, b] = node.color.to_array().map(|v| (v + 0.5) as u8);
        let kernel = |i: usize| match &self.cloud.kernels {
            Some(kernels) => Shape::Ellipse(kernels[i]),
            None => Shape::Ellipse(Kernel::default()),
        };
        Sample {
            cell: self.grid.quantise(node.position),
            color: [r, g, b, coverage::byte(node, size)],
            normal: node.normal,
            shape: leaf.map_or(Shape::Circle(node.radius / CUTOFF), kernel),
            clip: leaf.and_then(|i| Some(&self.cloud.clips.as_ref()?[i])),
        }
    }
}

/// Packs the tree. Also returns the node of `tree` behind each packed node.
///
/// Leaves before `first` are left out.
pub fn sequence(
    cloud: &PointCloud,
    tree: &Tree,
    grid: Grid,
    first: usize,
) -> (PackedSamples, Vec<u32>) {
    let base = base_of(tree, grid);
    let codes = codes_of(tree, base, grid.step as f32);
    let nodes = Nodes { cloud, tree, grid };
    let band = |node: u32| {
        let behind = if nodes.is_clipped(node) { BANDS } else { 0 };
        behind + usize::from(codes[node as usize].band())
    };
    let order = in_bands(&tree.along_the_curve(first), 2 * BANDS, band);
    let clipped_first = order.partition_point(|&node| !nodes.is_clipped(node));
    let (plain, with_lines) = order.split_at(clipped_first);
    let lists: Vec<(bool, Vec<u32>)> = [(false, plain), (true, with_lines)]
        .into_iter()
        .flat_map(|(clipped, nodes)| cut(nodes, &codes).into_iter().map(move |run| (clipped, run)))
        .collect();
    let pack = |(clipped, run): &(bool, Vec<u32>)| {
        let samples = run.iter().map(|&node| nodes.sample(node)).collect();
        pack_run(&grid, samples, *clipped, cloud.oriented)
    };
    let runs: Vec<PackedRun> = lists.par_iter().map(pack).collect();
    let order: Vec<u32> = lists.into_iter().flat_map(|(_, run)| run).collect();
    let mut out = joined(grid, runs);
    out.fields = fields_of(cloud);
    let width = value_words(&out.fields);
    let values = order.iter().flat_map(|&node| tree.nodes[node as usize].values[..width].iter());
    out.values = values.copied().collect();
    // The cells that the GPU decodes: distances to parents are measured between them.
    let mut cells = vec![IVec3::ZERO; tree.nodes.len()];
    for chunk in &out.chunks {
        let range = chunk.first as usize..(chunk.first + chunk.count) as usize;
        for (place, &node) in out.positions[range.clone()].iter().zip(&order[range]) {
            cells[node as usize] = chunk.cell(*place);
        }
    }
    out.nodes = order
        .par_iter()
        .map(|&index| {
            let node = &tree.nodes[index as usize];
            let parent = cells.get(node.parent as usize);
            let length = parent.map_or(0.0, |&parent| way_length(cells[index as usize] - parent));
            let codes = codes[index as usize];
            let tilts = Tilts::of(node, tree.nodes.get(node.parent as usize));
            let [error, size] = words(codes, node, tilts);
            [error | delta_bits(length, u32::from(codes.size_parent), base), size]
        })
        .collect();
    set_ranges(&mut out, base);
    (out, order)
}

fn codes_of(tree: &Tree, base: f32, step: f32) -> Vec<Codes> {
    let code = |value: f32| code(value / step, base) as u16;
    let own: Vec<(u16, u16)> = tree
        .nodes
        .par_iter()
        .map(|node| measures_of(node, step))
        .map(|own| (code(own.error), code(own.size)))
        .collect();
    tree.nodes
        .par_iter()
        .zip(&own)
        .map(|(node, &(error, size))| {
            let above = own.get(node.parent as usize).copied();
            let (error_parent, size_parent) = above.unwrap_or((NO_PARENT as u16, NO_PARENT as u16));
            Codes { error, size, error_parent, size_parent }
        })
        .collect()
}

/// Codes of a node's tilt and of its parent's.
#[derive(Clone, Copy)]
pub struct Tilts {
    own: u32,
    parent: u32,
}

impl Tilts {
    pub fn of(node: &Node, parent: Option<&Node>) -> Tilts {
        let parent = parent.map_or(tilt::ALIKE, |parent| tilt::seen_from(parent, node.normal));
        Tilts { own: tilt::of_node(node), parent }
    }
}

/// A node's words without the distance to its parent.
pub fn words(codes: Codes, node: &Node, tilts: Tilts) -> [u32; 2] {
    let Codes { error, size, error_parent, size_parent } = codes;
    let [first, second] = tilt::bits(tilts.own, tilts.parent);
    [
        u32::from(error) | u32::from(error_parent) << CODE_BITS | first,
        u32::from(size)
            | u32::from(size_parent) << CODE_BITS
            | u32::from(node.level).min(31) << LEVEL_SHIFT
            | cone_code(node.cone) << CONE_SHIFT
            | second,
    ]
}

/// The length of a vector, in cells, plus a margin of 0.1 %.
pub fn way_length(way: IVec3) -> f32 {
    way.as_dvec3().length() as f32 * 1.001
}

/// The bits of the first word for a parent at this distance; `size_parent` is the code of the parent's size.
pub fn delta_bits(length: f32, size_parent: u32, base: f32) -> u32 {
    if size_parent == NO_PARENT { 0 } else { delta_code(length, size_parent, base) << DELTA_SHIFT }
}

/// Sorts nodes by their bands, numbered below `count`; a stable bucket sort.
fn in_bands(nodes: &[u32], count: usize, band: impl Fn(u32) -> usize) -> Vec<u32> {
    let mut begins = vec![0; count + 1];
    nodes.iter().for_each(|&node| begins[band(node) + 1] += 1);
    for band in 0..count {
        begins[band + 1] += begins[band];
    }
    let mut sorted = vec![0; nodes.len()];
    for &node in nodes {
        let place = &mut begins[band(node)];
        sorted[*place] = node;
        *place += 1;
    }
    sorted
}

fn cut(order: &[u32], codes: &[Codes]) -> Vec<Vec<u32>> {
    let (mut cutter, mut chunks) = (Cutter::new(), Vec::with_capacity(order.len() / CHUNK + 2));
    for &node in order {
        cutter.push(node, codes[node as usize], &mut |chunk| chunks.push(chunk));
    }
    cutter.finish(&mut |chunk| chunks.push(chunk));
    chunks
}

/// Cuts a sorted stream of nodes into chunks. The nodes with the largest parents come first, in small chunks.
pub struct Cutter<T> {
    /// The first nodes, buffered until all that are sorted with them have arrived.
    head: Option<Vec<(T, Codes)>>,
    /// Number of small first chunks still to come.
    firsts: usize,
    chunk: Vec<T>,
    /// Band of the last node.
    band: u16,
}

impl<T> Cutter<T> {
    pub fn new() -> Cutter<T> {
        Cutter { head: Some(Vec::new()), firsts: FIRST_CHUNKS.len(), chunk: Vec::new(), band: 0 }
    }

    /// Takes the next node; `give` receives each chunk that is complete.
    pub fn push(&mut self, node: T, codes: Codes, give: &mut impl FnMut(Vec<T>)) {
        if let Some(head) = &mut self.head {
            // A band is unordered inside; the first nodes are strictly sorted.
            let all = FIRST_CHUNKS.iter().sum::<usize>();
            let alike = head.last().is_some_and(|(_, last)| last.band() == codes.band());
            if head.len() < all || (head.len() < 2 * CHUNK && alike) {
                head.push((node, codes));
                return;
            }
            self.sort_head(give);
        }
        self.add(node, codes, give);
    }

    pub fn finish(mut self, give: &mut impl FnMut(Vec<T>)) {
        self.sort_head(give);
        if !self.chunk.is_empty() {
            give(self.chunk);
        }
    }

    fn sort_head(&mut self, give: &mut impl FnMut(Vec<T>)) {
        let mut head = self.head.take().unwrap_or_default();
        head.sort_by_key(|(_, codes)| codes.first_of_parents());
        head.into_iter().for_each(|(node, codes)| self.add(node, codes, give));
    }

    fn add(&mut self, node: T, codes: Codes, give: &mut impl FnMut(Vec<T>)) {
        let most = match self.firsts {
            0 => CHUNK,
            left => FIRST_CHUNKS[FIRST_CHUNKS.len() - left],
        };
        let is_other = self.firsts == 0 && codes.band() != self.band;
        if self.chunk.len() >= most || (is_other && self.chunk.len() >= LEAST_CHUNK) {
            give(std::mem::take(&mut self.chunk));
            self.firsts = self.firsts.saturating_sub(1);
        }
        self.band = codes.band();
        self.chunk.push(node);
    }
}

/// Sets the ranges of all chunks.
fn set_ranges(samples: &mut PackedSamples, base: f32) {
    for chunk in &mut samples.chunks {
        let nodes = &samples.nodes[chunk.first as usize..(chunk.first + chunk.count) as usize];
        chunk.range = range_of(nodes, base);
    }
    // Nodes with clip lines form a separate list.
    let plain = samples.chunks.partition_point(|chunk| chunk.first < samples.clipped_first());
    let (plain, with_lines) = samples.chunks.split_at_mut(plain);
    reach_behind(plain);
    reach_behind(with_lines);
}

/// The range of some nodes, from their words.
pub fn range_of(nodes: &[[u32; 2]], base: f32) -> NodeRange {
    let parent = |code: u32| if code == NO_PARENT { ALWAYS } else { decode(code, base) };
    // A larger code stands for a smaller value.
    let (mut own, mut above, mut delta) = ([0; 2], [NONE; 2], 0.0f32);
    for words in nodes {
        for (measure, word) in words.iter().enumerate() {
            own[measure] = own[measure].max(word & CODE);
            above[measure] = above[measure].min(word >> CODE_BITS & CODE);
        }
        delta = delta.max(decode_delta(*words, base));
    }
    NodeRange {
        base,
        error_parent: parent(above[0]),
        size_parent: parent(above[1]),
        error_least: decode(own[0], base),
        size_least: decode(own[1], base),
        delta_most: delta,
    }
}

/// Extends the range of each chunk by the ranges of the chunks behind it.
pub fn reach_behind(chunks: &mut [PackedChunk]) {
    let mut behind = NodeRange::default();
    for chunk in chunks.iter_mut().rev() {
        let range = &mut chunk.range;
        range.error_parent = range.error_parent.max(behind.error_parent);
        range.size_parent = range.size_parent.max(behind.size_parent);
        range.delta_most = range.delta_most.max(behind.delta_most);
        behind = *range;
    }
}
