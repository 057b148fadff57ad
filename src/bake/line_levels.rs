//! Levels of detail of lines: what `lod=spt` draws of strands that are far away.
//!
//! Every level belongs to an accepted error `e`, and each is coarser than the last. A segment of a level is drawn where its own error is
//! accepted and that of the next level is not, as a node of a point tree is (Dachsbacher et al. 2003, §3.6). Two steps lead from a level to the
//! next.
//!
//! - *Simplification.* Vertices are dropped as long as the tube through those that stay is within `e / 4` of every vertex that was there,
//!   in position plus radius. All steps up to a level add up to `e / 2`. Vertices that stay take over radius, colour and scalar fields of those
//!   dropped beside them, by the area that they show, so that thin strands keep their area even where they lose length.
//! - *Pruning* (R. Cook, J. Halstead, M. Planck, D. Ryu, *Stochastic Simplification of Aggregate Detail*, SIGGRAPH 2007). Where many strands
//!   run through a cell of size `e`, some are left out and the others become wider by as much, up to a width of `e`. A fixed random number for each
//!   strand decides, so that the strands of a level are among those of the level before. In a cell, about [`LEAST_KEPT`] strands are
//!   left at least; single strands always stay.
//!
//! Lengths are in cells of the grid.

use glam::{IVec3, Vec3};
use rayon::prelude::*;

use super::pack::{
    ALWAYS, Layout, LineVertex, NodeRange, PackError, PackedLines, Piece, Values, pack_levels,
    unpack_lines,
};
use crate::scene::color::{srgb_from_linear, to_linear};

/// The first error over the mean length of segments.
const FIRST: f32 = 1.0 / 4.0;
/// The smallest error, in cells: positions are rounded to whole cells.
const LEAST_ERROR: f32 = 64.0;
/// A level is kept if it has at most this share of the segments of the level before.
const SAVING: f64 = 0.7;
/// No further levels are made above one of so few segments.
const FEWEST: usize = 64;
/// Longest segment of a level, in units of its error.
const LONGEST: f32 = 8.0;
/// Segments of full detail that are longer than this, in units of the mean length, are split: segments of two levels can then be tested near
/// each other.
const LONGEST_FULL: f32 = 2.0;
/// Vertices that one step drops in a row at most. The next step may drop more.
const RUN: usize = 16;
/// Strands that are left in a cell, about.
const LEAST_KEPT: f32 = 4.0;
/// How often the strands of a cell cover it before more of them are left out.
const LAYERS: f32 = 3.0;
/// Strands of more vertices are left or left out in stretches of [`STRETCH`] vertices: one may fill a volume by itself.
const LONG_STRAND: u32 = 1024;
const STRETCH: u32 = 16;
/// Segments of a block at most.
const BLOCK: usize = 8;

/// A vertex of a level.
#[derive(Clone, Copy, Debug)]
struct Vertex {
    packed: LineVertex,
    /// Linear red, green, blue and alpha.
    color: [f32; 4],
    radius: f32,
    /// Share of the strands about here that are left.
    left: f32,
}

impl Vertex {
    fn position(&self) -> Vec3 {
        self.packed.cell().as_vec3()
    }

    /// Distance between two vertices: cells hold more digits than f32.
    fn to(&self, other: &Vertex) -> Vec3 {
        (other.packed.cell() - self.packed.cell()).as_vec3()
    }
}

/// Returns packed lines with all their levels of detail, coarsest first, full detail last.
///
/// # Errors
/// See [`pack_levels`].
pub fn line_levels(lines: &PackedLines) -> Result<PackedLines, PackError> {
    let strands: Vec<Piece<Vertex>> = unpack_lines(lines).into_par_iter().map(read).collect();
    let source = Source { firsts: &lines.strands, fields: Layout::of(&lines.fields) };
    let segments = count(&strands);
    // Summed in order, so that the sum is always the same.
    let lengths: Vec<f32> = strands.par_iter().map(|piece| length_of(&piece.vertices)).collect();
    let length: f64 = lengths.into_iter().map(f64::from).sum();
    let mean = (length / segments.max(1) as f64) as f32;
    let extent = extent_of(lines);
    let split: Vec<Piece<Vertex>> = strands
        .into_par_iter()
        .map(|piece| {
            let vertices = split_at(&piece.vertices, LONGEST_FULL * mean, &source.fields);
            Piece { vertices, ..piece }
        })
        .collect();
    let mut levels = vec![(0.0, split)];
    let mut error = (FIRST * mean).max(LEAST_ERROR).log2().ceil().exp2();
    let mut last = next_level(&levels[0].1, &source, error, mean);
    let mut kept = segments;
    while kept > FEWEST && error < 2.0 * extent {
        let found = count(&last);
        if found == 0 {
            break;
        }
        let coarser = next_level(&last, &source, 2.0 * error, mean);
        if found as f64 <= SAVING * kept as f64 {
            kept = found;
            levels.push((error, last));
        }
        last = coarser;
        error *= 2.0;
    }
    // Error of the level above each, and its longest segment.
    let above: Vec<(f32, f32)> = levels[1..]
        .iter()
        .map(|(error, pieces)| (*error, longest_of(pieces)))
        .chain([(ALWAYS, 0.0)])
        .collect();
    let mut delta: f32 = 0.0;
    let mut packed: Vec<(NodeRange, Vec<Piece<LineVertex>>)> = levels
        .into_iter()
        .zip(above)
        .map(|((error, pieces), (parent, longest))| {
            // Both segments are tested in their middle, and lie within the error of each other.
            if parent < ALWAYS {
                delta = delta.max(0.5 * longest + parent);
            }
            let range = NodeRange {
                base: 0.0,
                error_parent: parent,
                size_parent: parent,
                error_least: error,
                size_least: error,
                delta_most: delta,
            };
            (range, pieces.into_par_iter().map(written).collect())
        })
        .collect();
    packed.reverse();
    pack_levels(lines, &packed)
}

fn read(piece: Piece<LineVertex>) -> Piece<Vertex> {
    let vertex = |packed: LineVertex| {
        let srgb = packed.words[3].to_le_bytes().map(|byte| f64::from(byte) / 255.0);
        Vertex { packed, color: to_linear(srgb), radius: packed.radius(), left: 1.0 }
    };
    let Piece { strand, begins, ends, vertices } = piece;
    Piece { strand, begins, ends, vertices: vertices.into_iter().map(vertex).collect() }
}

fn written(piece: Piece<Vertex>) -> Piece<LineVertex> {
    let vertex = |vertex: Vertex| {
        let mut packed = vertex.packed;
        let [r, g, b, a] = vertex.color.map(f64::from);
        let color = [srgb_from_linear(r), srgb_from_linear(g), srgb_from_linear(b), a];
        packed.words[3] =
            u32::from_le_bytes(color.map(|c| (c.clamp(0.0, 1.0) * 255.0).round() as u8));
        packed.words[4] = vertex.radius.to_bits();
        packed
    };
    let Piece { strand, begins, ends, vertices } = piece;
    Piece { strand, begins, ends, vertices: vertices.into_iter().map(vertex).collect() }
}

fn count(pieces: &[Piece<Vertex>]) -> usize {
    pieces.iter().map(|piece| piece.vertices.len() - 1).sum()
}

fn length_of(vertices: &[Vertex]) -> f32 {
    vertices.windows(2).map(|pair| pair[0].to(&pair[1]).length()).sum()
}

fn longest_of(pieces: &[Piece<Vertex>]) -> f32 {
    let pairs = pieces.iter().flat_map(|piece| piece.vertices.windows(2));
    pairs.map(|pair| pair[0].to(&pair[1]).length()).fold(0.0, f32::max)
}

/// The longest side of the box around all vertices.
fn extent_of(lines: &PackedLines) -> f32 {
    let low = lines.chunks.iter().map(|chunk| chunk.origin).fold(IVec3::MAX, IVec3::min);
    let high =
        lines.chunks.iter().map(|chunk| chunk.origin + chunk.extent).fold(IVec3::MIN, IVec3::max);
    if lines.chunks.is_empty() { 0.0 } else { (high - low).max_element() as f32 }
}

/// Splits a strand's segments so that none is longer than this.
fn split_at(vertices: &[Vertex], longest: f32, fields: &Layout) -> Vec<Vertex> {
    let mut split = Vec::with_capacity(vertices.len());
    for pair in vertices.windows(2) {
        let [a, b] = [pair[0], pair[1]];
        split.push(a);
        let parts = (a.to(&b).length() / longest.max(1.0)).ceil().clamp(1.0, 4096.0) as i32;
        // Classes and gaps of fields change in the middle of a segment: it stays in the middle of a part.
        let parts = if fields.is_empty() { parts } else { parts | 1 };
        split.extend((1..parts).map(|part| between(&a, &b, (part, parts), fields)));
    }
    split.extend(vertices.last());
    split
}

/// The vertex at `part / parts` of a segment.
fn between(a: &Vertex, b: &Vertex, (part, parts): (i32, i32), fields: &Layout) -> Vertex {
    let share = part as f32 / parts as f32;
    let from = a.packed.cell();
    let way = (b.packed.cell() - from).as_dvec3() * (f64::from(part) / f64::from(parts));
    let cell = from + way.round().as_ivec3();
    let mut packed = a.packed;
    let words: [u32; 3] = cell.to_array().map(|c| c as u32);
    packed.words[..3].copy_from_slice(&words);
    if share > 0.5 {
        // Directions of ribbons are those of the nearer end.
        packed.directions = b.packed.directions;
    }
    packed.values = fields.between([a.packed.values, b.packed.values], share);
    let mix = |a: f32, b: f32| a + (b - a) * share;
    Vertex {
        packed,
        color: [0, 1, 2, 3].map(|c| mix(a.color[c], b.color[c])),
        radius: mix(a.radius, b.radius),
        left: mix(a.left, b.left),
    }
}

/// What levels need to know of the lines that they are made of.
struct Source<'l> {
    /// The first vertex of each strand.
    firsts: &'l [u32],
    fields: Layout,
}

/// The level of an error above a finer one. `mean`: length of segments at full detail.
fn next_level(
    finer: &[Piece<Vertex>],
    source: &Source<'_>,
    error: f32,
    mean: f32,
) -> Vec<Piece<Vertex>> {
    let longest = (LONGEST * error).max(LONGEST_FULL * mean);
    let simple: Vec<Piece<Vertex>> = finer
        .par_iter()
        .map(|piece| {
            let vertices = simplified(&piece.vertices, error, longest, &source.fields);
            Piece { vertices, ..*piece }
        })
        .collect();
    // Below, cells hold less than a segment.
    if error < mean { simple } else { pruned(simple, source.firsts, error) }
}

/// Drops vertices of a strand. Those that stay are the ends of runs.
fn simplified(vertices: &[Vertex], error: f32, longest: f32, fields: &Layout) -> Vec<Vertex> {
    let tolerance = 0.25 * error;
    let mut stay = vec![0];
    let mut from = 0;
    while from + 1 < vertices.len() {
        let mut to = from + 1;
        while to + 1 < vertices.len() && to - from < RUN {
            let run = &vertices[from..=to + 1];
            if run[0].to(&run[run.len() - 1]).length() > longest || !is_near(run, tolerance) {
                break;
            }
            to += 1;
        }
        stay.push(to);
        from = to;
    }
    let mut kept: Vec<Vertex> = stay.iter().map(|&v| vertices[v]).collect();
    take_over(&mut kept, vertices, &stay, error);
    if !fields.is_empty() {
        take_over_values(&mut kept, vertices, &stay, fields);
    }
    kept
}

/// Whether the tube between the ends of a run is near all vertices between them.
fn is_near(run: &[Vertex], tolerance: f32) -> bool {
    let [a, b] = [&run[0], &run[run.len() - 1]];
    run[1..run.len() - 1].iter().all(|vertex| {
        let share = share_of(a, b, vertex);
        let beside = a.to(vertex) - a.to(b) * share;
        let radius = a.radius + (b.radius - a.radius) * share;
        beside.length() + (vertex.radius - radius).abs() <= tolerance
    })
}

/// Where on a segment a vertex is nearest, from 0 to 1.
fn share_of(a: &Vertex, b: &Vertex, vertex: &Vertex) -> f32 {
    let way = a.to(b);
    let square = way.length_squared();
    if square > 0.0 { (a.to(vertex).dot(way) / square).clamp(0.0, 1.0) } else { 0.5 }
}

/// Half the length of the segments at each vertex.
fn half_lengths(vertices: &[Vertex]) -> Vec<f32> {
    let mut halves = vec![0.0; vertices.len()];
    for (at, pair) in vertices.windows(2).enumerate() {
        let half = 0.5 * pair[0].to(&pair[1]).length();
        halves[at] += half;
        halves[at + 1] += half;
    }
    halves
}

/// Shares a strand's vertices out among those that stay: calls `add` with the place of one that stays, a vertex, and the share of that vertex
/// that it stands for. Vertices that are dropped go to both neighbours, by their distances.
fn share_out(vertices: &[Vertex], stay: &[usize], mut add: impl FnMut(usize, usize, f32)) {
    for (at, pair) in stay.windows(2).enumerate() {
        add(at, pair[0], 1.0);
        for vertex in pair[0] + 1..pair[1] {
            let share = share_of(&vertices[pair[0]], &vertices[pair[1]], &vertices[vertex]);
            add(at, vertex, 1.0 - share);
            add(at + 1, vertex, share);
        }
    }
    add(stay.len() - 1, vertices.len() - 1, 1.0);
}

/// Gives the vertices that stay the mean radius and colour of what they stand for.
fn take_over(kept: &mut [Vertex], vertices: &[Vertex], stay: &[usize], error: f32) {
    #[derive(Clone, Copy, Default)]
    struct Sum {
        length: f32,
        area: f32,
        /// Sum of the weights of colours.
        weight: f32,
        color: [f32; 4],
    }
    let before = half_lengths(vertices);
    let mut sums = vec![Sum::default(); kept.len()];
    let add = |at: usize, vertex: usize, share: f32| {
        let (length, own) = (before[vertex] * share, &vertices[vertex]);
        // Strands of a width of 0 have colours, too.
        let weight = length * own.radius.max(1e-6);
        let sum = &mut sums[at];
        sum.length += length;
        sum.area += length * own.radius;
        sum.weight += weight;
        (0..4).for_each(|c| sum.color[c] += weight * own.color[c]);
    };
    share_out(vertices, stay, add);
    let after = half_lengths(kept);
    // The ends of what has shrunk to a point would show more than it did.
    let widest = (0.25 * length_of(kept)).min(0.5 * error);
    for ((vertex, sum), length) in kept.iter_mut().zip(&sums).zip(after) {
        if sum.length > 0.0 && sum.weight > 0.0 {
            let mean = sum.area / sum.length;
            // Thin strands keep their area; those that are wider than the error keep their width.
            vertex.radius = (sum.area / length.max(1e-9)).clamp(mean, mean.max(widest));
            vertex.color = sum.color.map(|c| c / sum.weight);
        }
    }
}

/// Gives the vertices that stay the values of what they stand for: means by the area that is shown, and of classes the largest.
fn take_over_values(kept: &mut [Vertex], vertices: &[Vertex], stay: &[usize], fields: &Layout) {
    let lengths = half_lengths(vertices);
    let mut parts: Vec<(usize, (Values, f32))> = Vec::with_capacity(2 * vertices.len());
    share_out(vertices, stay, |at, vertex, share| {
        let own = &vertices[vertex];
        // As colours do: strands of a width of 0 have values, too.
        let weight = lengths[vertex] * share * own.radius.max(1e-6);
        parts.push((at, (own.packed.values, weight)));
    });
    // Stable, so that sums keep the order of the vertices.
    parts.sort_by_key(|part| part.0);
    for parts in parts.chunk_by(|a, b| a.0 == b.0) {
        kept[parts[0].0].packed.values = fields.above(parts.iter().map(|part| part.1));
    }
}

/// Area of both ends of a strand, half discs, over the square of its width.
const CAPS: f32 = std::f32::consts::FRAC_PI_4;

/// The part of a strand in a cell. Lengths are in units of the cell's size, areas in those of its area.
struct Shown {
    length: f32,
    /// Factor of the square of the width, for the ends.
    caps: f32,
}

impl Shown {
    fn of(length: f32) -> Shown {
        Shown { length: length.min(1.0), caps: CAPS / length.max(1.0) }
    }

    fn area(&self, width: f32) -> f32 {
        width * (self.length + self.caps * width)
    }

    /// The width at which this area is shown.
    fn width(&self, area: f32) -> f32 {
        let root = (self.length * self.length + 4.0 * self.caps * area).sqrt();
        2.0 * area / (self.length + root).max(1e-12)
    }
}

/// Number of units in the area of a cell, for sums that do not depend on order.
const UNITS: f32 = (1 << 16) as f32;

/// Leaves strands out where there are many.
fn pruned(pieces: Vec<Piece<Vertex>>, firsts: &[u32], error: f32) -> Vec<Piece<Vertex>> {
    let areas = Areas::of(&pieces, error);
    pieces.into_par_iter().flat_map_iter(|piece| prune(piece, &areas, firsts, error)).collect()
}

/// The area of all strands in each cell that has some, in [`UNITS`] of a cell's.
struct Areas {
    error: f32,
    cells: Vec<(Key, u64)>,
}

impl Areas {
    fn of(pieces: &[Piece<Vertex>], error: f32) -> Areas {
        let mut parts: Vec<(Key, u64)> = pieces
            .par_iter()
            .flat_map_iter(|piece| {
                let mut parts = Vec::new();
                for pair in piece.vertices.windows(2) {
                    add_parts(&pair[0], &pair[1], error, &mut parts);
                }
                for end in piece.vertices.first().into_iter().chain(piece.vertices.last()) {
                    let width = 2.0 * end.radius / error;
                    let key = key_of(end.position(), error);
                    parts.push((key, units_of(0.5 * CAPS * width * width)));
                }
                parts
            })
            .collect();
        parts.par_sort_unstable_by_key(|part| part.0);
        let mut cells: Vec<(Key, u64)> = Vec::new();
        for (key, area) in parts {
            match cells.last_mut() {
                Some(last) if last.0 == key => last.1 += area,
                _ => cells.push((key, area)),
            }
        }
        Areas { error, cells }
    }

    /// Area about a vertex over that of a cell.
    fn about(&self, vertex: &Vertex) -> f32 {
        let key = key_of(vertex.position(), self.error);
        self.cells
            .binary_search_by_key(&key, |cell| cell.0)
            .map_or(0.0, |at| self.cells[at].1 as f32 / UNITS)
    }
}

fn units_of(area: f32) -> u64 {
    (area * UNITS).ceil().clamp(1.0, 1e12) as u64
}

/// A cell of a level. Coordinates of the grid are at most 2²⁸ in size and a cell measures at least [`LEAST_ERROR`]: three coordinates have too
/// many bits for a single word.
type Key = [i32; 3];

/// Returns the cell of a position.
fn key_of(position: Vec3, error: f32) -> Key {
    position.to_array().map(|x| (x / error).floor() as i32)
}

/// Adds the area of a segment to the cells along it.
fn add_parts(a: &Vertex, b: &Vertex, error: f32, parts: &mut Vec<(Key, u64)>) {
    let way = a.to(b);
    let length = way.length();
    let steps = (2.0 * length / error).ceil().clamp(1.0, 256.0) as i32;
    for step in 0..steps {
        let share = (step as f32 + 0.5) / steps as f32;
        let radius = a.radius + (b.radius - a.radius) * share;
        let area = 2.0 * radius * length / steps as f32 / (error * error);
        let key = key_of(a.position() + way * share, error);
        let units = units_of(area);
        match parts.last_mut() {
            Some(last) if last.0 == key => last.1 += units,
            _ => parts.push((key, units)),
        }
    }
}

/// A fixed number of a stretch of a strand, from 0 to 1.
fn key_of_stretch(strand: u32, stretch: u32) -> f32 {
    let mut x = strand.wrapping_mul(0x85eb_ca6b).wrapping_add(stretch).wrapping_add(0x9e37_79b9);
    x = (x ^ x >> 16).wrapping_mul(0x7feb_352d);
    x = (x ^ x >> 15).wrapping_mul(0x846c_a68b);
    ((x ^ x >> 16) >> 8) as f32 / (1 << 24) as f32
}

/// The parts of a strand that are left, with wider vertices. `firsts`: the first vertex of each strand, and the number of vertices.
///
/// All segments of a block are left with the same probability, and are wider by its inverse, so that the mean area is kept.
fn prune(piece: Piece<Vertex>, areas: &Areas, firsts: &[u32], error: f32) -> Vec<Piece<Vertex>> {
    let vertices = &piece.vertices;
    let shown = Shown::of(length_of(vertices) / error);
    let own: Vec<f32> = vertices.iter().map(|v| shown.area(2.0 * v.radius / error)).collect();
    let wanted: Vec<f32> = vertices
        .iter()
        .zip(&own)
        .map(|(vertex, &own)| {
            if own <= 0.0 {
                return vertex.left;
            }
            let area = areas.about(vertex).max(own).max(1e-12);
            let by_number = LEAST_KEPT * own / area;
            let by_width = own / shown.area(1.0) * (LAYERS / area).min(1.0);
            vertex.left * by_number.max(by_width).clamp(1e-9, 1.0)
        })
        .collect();
    let left = left_of(&piece, firsts, &wanted);
    let mut parts: Vec<Piece<Vertex>> = Vec::new();
    for (at, vertex) in vertices.iter().enumerate() {
        // The segments that end and begin here.
        let before = at.checked_sub(1).and_then(|segment| left[segment]);
        let after = left.get(at).copied().flatten();
        if before.is_none() && after.is_some() {
            let begins = piece.begins && at == 0;
            parts.push(Piece { begins, ends: false, vertices: Vec::new(), ..piece });
        }
        let Some(part) = parts.last_mut().filter(|_| before.or(after).is_some()) else { continue };
        let (mut radius, mut inverse, mut count) = (0.0, 0.0, 0.0);
        for left in [before, after].into_iter().flatten() {
            let left = left.min(vertex.left);
            let wider = 0.5 * error * shown.width(own[at] * vertex.left / left).min(1.0);
            radius += vertex.radius.max(wider);
            inverse += 1.0 / left;
            count += 1.0;
        }
        let (radius, left) = (radius / count, count / inverse);
        part.vertices.push(Vertex { radius, left, ..*vertex });
        part.ends = piece.ends && at + 1 == vertices.len();
    }
    parts
}

/// For each segment the share of strands like this one that are left there; `None` where this one is not. Segments of a block, which have one key,
/// are left together: as many as the sparsest cell along them asks for. `wanted`: the share that each vertex asks to be left.
fn left_of(piece: &Piece<Vertex>, firsts: &[u32], wanted: &[f32]) -> Vec<Option<f32>> {
    let [first, end] =
        [0, 1].map(|after| firsts.get(piece.strand as usize + after).copied().unwrap_or(0));
    let is_long = end.saturating_sub(first) > LONG_STRAND;
    let segments = piece.vertices.len() - 1;
    let key = |segment: usize| {
        let number = piece.vertices[segment].packed.number.saturating_sub(first);
        key_of_stretch(piece.strand, if is_long { number / STRETCH } else { 0 })
    };
    let mut left = Vec::with_capacity(segments);
    while left.len() < segments {
        let begin = left.len();
        let own = key(begin);
        let most = segments.min(begin + BLOCK);
        let end = (begin + 1..most).find(|&segment| key(segment) != own).unwrap_or(most);
        let share = wanted[begin..=end].iter().copied().fold(0.0, f32::max);
        left.resize(end, (own <= share).then_some(share));
    }
    left
}

#[cfg(test)]
mod tests;
