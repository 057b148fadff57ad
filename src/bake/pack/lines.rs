//! Segments of lines. Vertices that chunks share are stored in each, with equal words, so that neighbours meet without a gap.

use std::borrow::Cow;
use std::io;
use std::ops::Range;

use glam::{DVec3, IVec3, Vec3};
use rayon::prelude::*;

use super::kind::{Arrays, PackedKind, PageKind, Stream, StreamOf, holds};
use super::{
    ALWAYS, CHUNK, GeometryKind, Grid, KERNEL_DETAIL, NO_NORMAL, NodeRange, PackError, PackedChunk,
    Sides, finite, morton, octahedral, rgba_word,
};
use crate::assets::Polylines;
use crate::math::Bounds;

/// Words of a vertex: grid position, colour, radius in cells, normal of a ribbon, and the direction of its width.
pub const LINE_WORDS: usize = 7;

/// Bits of a segment's first word, above two indices of 10 bits: it begins or ends its strand.
pub const BEGINS: u32 = 1 << 20;
pub const ENDS: u32 = 1 << 21;
/// The highest bits of that word are a hash of the strand's number, and of the segment's among parts of a segment of the file.
const HASH_SHIFT: u32 = 22;

/// Angle that counts for straight strands: segments of levels of detail are short as well.
const LEAST_BEND: f64 = 0.25;
/// Number of segments that an area is estimated from.
const MEASURED: usize = 4096;

/// Lines as the GPU holds them.
#[derive(Clone, Debug)]
pub struct PackedLines {
    pub grid: Grid,
    pub chunks: Vec<PackedChunk>,
    pub vertices: Vec<[u32; LINE_WORDS]>,
    /// Two 10-bit indices into the chunk's vertices with [`BEGINS`], [`ENDS`] and a hash; the number of the first vertex in the file.
    pub segments: Vec<[u32; 2]>,
    /// The first vertex of each strand in the file, and behind them the number of vertices; not on the GPU.
    pub strands: Vec<u32>,
}

/// Packs lines. Lines without radii have zeros.
///
/// # Errors
/// See [`PackError`].
pub fn pack_lines(lines: &Polylines) -> Result<PackedLines, PackError> {
    finite(&lines.positions)?;
    check_lines(lines)?;
    let widest = lines.widest();
    if widest > 1e30 {
        return Err(PackError::TooFar { extent: widest });
    }
    let bounds = Bounds::of_all(&lines.positions);
    let grid = Grid::with_detail(&bounds, widest * KERNEL_DETAIL)?;
    let cells: Vec<IVec3> = lines.positions.par_iter().map(|&p| grid.quantise(p)).collect();
    let middle = |vertex: u32| {
        let (a, b) = (cells[vertex as usize], cells[vertex as usize + 1]);
        // Cells use 30 bits.
        morton((a + b) / 2)
    };
    let mut order: Vec<Ordered> = Vec::with_capacity(lines.positions.len());
    for (strand, ends) in lines.strands.windows(2).enumerate() {
        order.extend((ends[0]..ends[1].saturating_sub(1)).map(|v| (0, v, strand as u32)));
    }
    order.par_iter_mut().for_each(|segment| segment.0 = middle(segment.1));
    order.par_sort_unstable();
    let sides = lines.normals.as_ref().map(|normals| sides(lines, normals));
    let words = |v: usize| {
        let cell = cells[v];
        let color = lines.colors.as_ref().map_or(u32::MAX, |colors| rgba_word(colors[v]));
        let radius = lines.radii.as_ref().map_or(0.0, |radii| f64::from(radii[v]));
        let normal = lines.normals.as_ref().map_or(NO_NORMAL, |n| octahedral(n[v]));
        let side = sides.as_ref().map_or(NO_NORMAL, |sides| octahedral(sides[v]));
        // Steps are powers of two: the quotient is exact.
        let radius = (radius / grid.step) as f32;
        [cell.x as u32, cell.y as u32, cell.z as u32, color, radius.to_bits(), normal, side]
    };
    let segment = |vertex: u32, strand: u32| {
        let [first, end] = [strand, strand + 1].map(|at| lines.strands[at as usize]);
        [strand_word(strand, 0, first == vertex, end == vertex + 2), vertex]
    };
    let mut packer = LinePacker::new(grid, lines.strands.clone());
    let always = NodeRange { error_parent: ALWAYS, size_parent: ALWAYS, ..NodeRange::default() };
    packer.add(always, lines.positions.len(), &order, words, segment);
    Ok(packer.finished())
}

/// Returns the first word of a segment without its indices. `part` counts the segments before it that have the same number.
///
/// Shaders derive the dither keys of a segment from the hash and the number, and parts of one segment have the same number: each has a hash of
/// its own, by steps of Martin Roberts' R3 sequence.
fn strand_word(strand: u32, part: u32, begins: bool, ends: bool) -> u32 {
    let of_strand = strand.wrapping_add(1).wrapping_mul(0x9e37_79b9);
    let hash = of_strand.wrapping_add(part.wrapping_mul(0xd1b5_4a33)) >> HASH_SHIFT << HASH_SHIFT;
    hash | if begins { BEGINS } else { 0 } | if ends { ENDS } else { 0 }
}

/// Checks what a reader promises: lengths, order of strands, radii, normals.
fn check_lines(lines: &Polylines) -> Result<(), PackError> {
    let count = lines.positions.len();
    let is_sorted = lines.strands.windows(2).all(|ends| ends[0] < ends[1]);
    let is_whole = lines.strands.first().is_none_or(|&first| first == 0)
        && lines.strands.last().map_or(0, |&last| last as usize) == count;
    let lengths = [
        lines.radii.as_ref().map(Vec::len),
        lines.normals.as_ref().map(Vec::len),
        lines.colors.as_ref().map(Vec::len),
    ];
    if !is_sorted || !is_whole || lengths.iter().flatten().any(|&length| length != count) {
        return Err(PackError::Strands);
    }
    let is_radius = |radius: f32| radius >= 0.0 && radius.is_finite();
    if let Some(radii) = &lines.radii
        && let Some(index) = radii.par_iter().position_first(|&radius| !is_radius(radius))
    {
        return Err(PackError::Radius { index });
    }
    if let Some(normals) = &lines.normals
        && let Some(index) =
            normals.par_iter().position_first(|&normal| octahedral(normal) == NO_NORMAL)
    {
        return Err(PackError::Normal { index });
    }
    Ok(())
}

/// The directions of ribbons' widths at their vertices.
fn sides(lines: &Polylines, normals: &[Vec3]) -> Vec<Vec3> {
    let of_strand = move |ends: &[u32]| {
        let (first, end) = (ends[0] as usize, ends[1] as usize);
        (first..end).map(move |vertex| lines.side(normals, vertex, first..end).as_vec3())
    };
    lines.strands.par_windows(2).flat_map_iter(of_strand).collect()
}

/// A segment in the order of packing: the Morton code of its middle, the first of its two vertices, and its strand (or its word, in levels of
/// detail).
type Ordered = (u64, u32, u32);

/// Cuts sorted segments into chunks with the vertices that they use.
struct LinePacker {
    out: PackedLines,
}

impl LinePacker {
    fn new(grid: Grid, strands: Vec<u32>) -> LinePacker {
        let out = PackedLines {
            grid,
            chunks: Vec::new(),
            vertices: Vec::new(),
            segments: Vec::new(),
            strands,
        };
        LinePacker { out }
    }

    /// Adds sorted segments, in chunks of their own that have this range. The segments lead to `count` vertices, whose words are `words`.
    /// `segment` takes the last two values of an [`Ordered`]. It returns the word (see [`strand_word`]) and the first vertex's number in the file.
    ///
    /// Where a chunk ends depends on all segments before: [`Self::cut`] takes one after the other. All else is done in parallel.
    fn add(
        &mut self,
        range: NodeRange,
        count: usize,
        order: &[Ordered],
        words: impl Fn(usize) -> [u32; LINE_WORDS] + Sync,
        segment: impl Fn(u32, u32) -> [u32; 2] + Sync,
    ) {
        let first = self.out.segments.len();
        let used = self.cut(range, count, order);
        self.out.vertices.par_extend(used.par_iter().map(|&vertex| words(vertex as usize)));
        let stored = self.out.segments[first..].par_iter_mut();
        stored.zip(order.par_iter()).for_each(|(stored, &(_, vertex, of_packer))| {
            let [word, number] = segment(vertex, of_packer);
            *stored = [stored[0] | word, number];
        });
    }

    /// Adds chunks, and segments that have their indices alone. Returns the vertices of the chunks, in their order.
    fn cut(&mut self, range: NodeRange, count: usize, order: &[Ordered]) -> Vec<u32> {
        let PackedLines { chunks, segments, vertices, .. } = &mut self.out;
        // For every vertex: the last chunk that took it, and its index there.
        let mut stamp = vec![(u32::MAX, 0u32); count];
        let mut used: Vec<u32> = Vec::with_capacity(count);
        segments.reserve(order.len());
        let mut is_open = false;
        for &(_, vertex, _) in order {
            let ends = [vertex as usize, vertex as usize + 1];
            let last = chunks.last().filter(|_| is_open);
            let fits = last.is_some_and(|chunk| {
                let number = chunks.len() as u32 - 1;
                let fresh = ends.iter().filter(|&&v| stamp[v].0 != number).count();
                (chunk.count as usize) < CHUNK && chunk.vertex_count as usize + fresh <= CHUNK
            });
            if !fits {
                is_open = true;
                chunks.push(PackedChunk {
                    origin: IVec3::ZERO,
                    extent: IVec3::ZERO,
                    first: segments.len() as u32,
                    count: 0,
                    shift: 0,
                    vertex_first: (vertices.len() + used.len()) as u32,
                    vertex_count: 0,
                    material: 0,
                    kernel_base: 0.0,
                    sides: Sides::Unknown,
                    translucent: false,
                    range,
                });
            }
            let number = chunks.len() - 1;
            let chunk = &mut chunks[number];
            let mut link = 0u32;
            for (place, v) in ends.into_iter().enumerate() {
                let (owner, local) = &mut stamp[v];
                if *owner != number as u32 {
                    (*owner, *local) = (number as u32, chunk.vertex_count);
                    chunk.vertex_count += 1;
                    used.push(v as u32);
                }
                link |= *local << (10 * place);
            }
            chunk.count += 1;
            segments.push([link, 0]);
        }
        used
    }

    /// The packed lines, with the boxes and the largest radii of their chunks.
    fn finished(self) -> PackedLines {
        let mut out = self.out;
        let vertices = &out.vertices;
        out.chunks.par_iter_mut().for_each(|chunk| {
            let run = &vertices[chunk.vertices()];
            let low = run.iter().map(cell_of).fold(IVec3::MAX, IVec3::min);
            let high = run.iter().map(cell_of).fold(IVec3::MIN, IVec3::max);
            chunk.origin = low;
            chunk.extent = high - low;
            chunk.kernel_base =
                run.iter().map(|words| f32::from_bits(words[4])).fold(0.0, f32::max);
        });
        out
    }
}

/// Part of a strand: vertices that follow each other.
#[derive(Clone, Debug, PartialEq)]
pub struct Piece<V> {
    /// Number of the strand in the file.
    pub strand: u32,
    /// Its first and last vertices are the strand's.
    pub begins: bool,
    pub ends: bool,
    /// Two vertices or more.
    pub vertices: Vec<V>,
}

/// A vertex of packed lines: its words, and its number in the file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineVertex {
    pub words: [u32; LINE_WORDS],
    pub number: u32,
}

impl LineVertex {
    pub fn cell(&self) -> IVec3 {
        cell_of(&self.words)
    }

    /// Radius in cells.
    pub fn radius(&self) -> f32 {
        f32::from_bits(self.words[4])
    }
}

/// The strands of packed lines, each as one piece.
pub fn unpack_lines(lines: &PackedLines) -> Vec<Piece<LineVertex>> {
    let count = lines.strands.last().map_or(0, |&count| count as usize);
    let mut words = vec![[0; LINE_WORDS]; count];
    for chunk in &lines.chunks {
        let vertices = &lines.vertices[chunk.vertices()];
        for [link, first] in &lines.segments[chunk.elements()] {
            for (shift, number) in [(0, *first), (10, first + 1)] {
                if let Some(at) = words.get_mut(number as usize) {
                    *at = vertices[(link >> shift & 0x3ff) as usize];
                }
            }
        }
    }
    let strand = |(strand, ends): (usize, &[u32])| Piece {
        strand: strand as u32,
        begins: true,
        ends: true,
        vertices: (ends[0]..ends[1])
            .map(|number| LineVertex { words: words[number as usize], number })
            .collect(),
    };
    lines.strands.windows(2).enumerate().map(strand).collect()
}

/// Packs levels of detail, coarsest first, each with the range of its chunks.
///
/// # Errors
/// There are more vertices or segments than 32 bits count.
pub fn pack_levels(
    lines: &PackedLines,
    levels: &[(NodeRange, Vec<Piece<LineVertex>>)],
) -> Result<PackedLines, PackError> {
    let mut packer = LinePacker::new(lines.grid, lines.strands.clone());
    for (range, pieces) in levels {
        let vertices: Vec<LineVertex> =
            pieces.iter().flat_map(|piece| piece.vertices.iter().copied()).collect();
        let mut order: Vec<Ordered> = Vec::with_capacity(vertices.len());
        let mut first = 0;
        for piece in pieces {
            let last = first + piece.vertices.len() as u32 - 1;
            let mut part = 0;
            for vertex in first..last {
                let number = |vertex: u32| vertices[vertex as usize].number;
                let continues = vertex > first && number(vertex) == number(vertex - 1);
                part = if continues { part + 1 } else { 0 };
                let [a, b] = [vertex, vertex + 1].map(|v| vertices[v as usize].cell());
                let begins = piece.begins && vertex == first;
                let ends = piece.ends && vertex + 1 == last;
                let word = strand_word(piece.strand, part, begins, ends);
                order.push((morton((a + b) / 2), vertex, word));
            }
            first = last + 1;
        }
        order.par_sort_unstable();
        let words = |v: usize| vertices[v].words;
        let segment = |vertex: u32, word: u32| [word, vertices[vertex as usize].number];
        packer.add(*range, vertices.len(), &order, words, segment);
        if u32::try_from(packer.out.vertices.len()).is_err() {
            return Err(PackError::TooMany);
        }
    }
    Ok(packer.finished())
}

/// Bytes that packing lines needs.
pub(super) fn packing_bytes(lines: &Polylines) -> u64 {
    // Cells, stamps, sides, and packed vertices with their numbers, twice: chunks that share a vertex each store it. The order and packed segments.
    (12 + 8 + 12 + 2 * (28 + 4)) * lines.positions.len() as u64
        + (16 + 8) * lines.positions.len() as u64
        + 4 * lines.strands.len() as u64
}

/// The grid position of a vertex.
fn cell_of(words: &[u32; LINE_WORDS]) -> IVec3 {
    IVec3::new(words[0] as i32, words[1] as i32, words[2] as i32)
}

/// An end of a segment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineEnd {
    pub position: DVec3,
    pub radius: f64,
    pub color: u32,
    /// Words of normal and width; [`NO_NORMAL`] for tubes.
    pub normal: u32,
    pub side: u32,
}

impl PackedLines {
    /// Area of the segments seen from the side, in square units, estimated from about [`MEASURED`] of them.
    pub fn area(&self) -> f64 {
        let every = self.segments.len().div_ceil(MEASURED).max(1);
        let of_chunk = |chunk: &PackedChunk| {
            let ends = chunk.elements().step_by(every).filter_map(|i| self.ends(chunk, i));
            let area =
                |[a, b]: [LineEnd; 2]| (b.position - a.position).length() * (a.radius + b.radius);
            let areas: Vec<f64> = ends.map(area).collect();
            let mean = areas.iter().sum::<f64>() / areas.len().max(1) as f64;
            mean * chunk.elements().len() as f64
        };
        self.chunks.iter().map(of_chunk).sum()
    }

    /// Both ends of a segment of a chunk.
    pub fn ends(&self, chunk: &PackedChunk, segment: usize) -> Option<[LineEnd; 2]> {
        let [link, _] = *self.segments.get(segment)?;
        let end = |shift: u32| {
            let words =
                self.vertices.get((chunk.vertex_first + (link >> shift & 0x3ff)) as usize)?;
            Some(LineEnd {
                position: self.grid.position(cell_of(words)),
                radius: f64::from(f32::from_bits(words[4])) * self.grid.step,
                color: words[3],
                normal: words[5],
                side: words[6],
            })
        };
        Some([end(0)?, end(10)?])
    }

    /// The strand of a segment, and the number of the segment in it.
    pub fn strand_of(&self, segment: usize) -> Option<(u32, u32)> {
        let [_, vertex] = *self.segments.get(segment)?;
        let strand = self.strands.partition_point(|&first| first <= vertex).checked_sub(1)?;
        Some((strand as u32, vertex - self.strands[strand]))
    }

    /// The mean length of a chunk's segments, in cells, times the mean angle between neighbours in radians, from [`LEAST_BEND`] to 1. Segments
    /// without a neighbour in the chunk count as if there were one at an angle of one radian.
    pub(in crate::bake) fn bend_of(&self, chunk: &PackedChunk) -> f64 {
        let vertices = &self.vertices[chunk.vertices()];
        let mut ways: Vec<(u32, u32, DVec3)> = self.segments[chunk.elements()]
            .iter()
            .map(|&[link, number]| {
                let [a, b] =
                    [0, 10].map(|shift| cell_of(&vertices[(link >> shift & 0x3ff) as usize]));
                (number, link, (b - a).as_dvec3())
            })
            .collect();
        ways.sort_unstable_by_key(|way| way.0);
        let (mut length, mut angle) = (0.0, 0.0);
        for (at, (number, link, way)) in ways.iter().enumerate() {
            length += way.length();
            let next = ways.get(at + 1).filter(|next| next.0 == number + 1 && link & ENDS == 0);
            angle += match next {
                Some((.., after)) if way.length() > 0.0 && after.length() > 0.0 => {
                    way.angle_between(*after)
                }
                Some(_) => 0.0,
                None => 1.0,
            };
        }
        let count = ways.len().max(1) as f64;
        length / count * (angle / count + LEAST_BEND).min(1.0)
    }

    /// The longest radius, in cells.
    fn widest(&self) -> f32 {
        self.chunks.iter().map(|chunk| chunk.kernel_base).fold(0.0, f32::max)
    }
}

impl PackedKind for PackedLines {
    fn grid(&self) -> &Grid {
        &self.grid
    }

    fn chunks(&self) -> &[PackedChunk] {
        &self.chunks
    }

    fn len(&self) -> usize {
        self.segments.len()
    }

    fn arrays(&self) -> Vec<&[u32]> {
        let PackedLines { grid: _, chunks: _, vertices, segments, strands } = self;
        vec![vertices.as_flattened(), segments.as_flattened(), strands]
    }

    fn widths() -> &'static [usize] {
        &[LINE_WORDS, 2, 1]
    }

    fn read(grid: Grid, chunks: Vec<PackedChunk>, arrays: &mut Arrays<'_>) -> io::Result<Self> {
        Ok(PackedLines {
            grid,
            chunks,
            vertices: arrays.rows()?,
            segments: arrays.rows()?,
            strands: arrays.words()?,
        })
    }

    fn check(&self) -> Result<(), &'static str> {
        let mut vertices = 0u64;
        for chunk in &self.chunks {
            holds(chunk.vertex_count as usize <= CHUNK, "a chunk has too many vertices")?;
            holds(
                u64::from(chunk.vertex_first) == vertices,
                "a chunk's vertices are not the next",
            )?;
            vertices += u64::from(chunk.vertex_count);
            let is_inside = |[link, _]: &[u32; 2]| {
                [link & 0x3ff, link >> 10 & 0x3ff].iter().all(|&v| v < chunk.vertex_count)
            };
            let segments = &self.segments[chunk.elements()];
            holds(segments.iter().all(is_inside), "a segment's vertex is not in its chunk")?;
        }
        holds(vertices == self.vertices.len() as u64, "chunks do not have all vertices")?;
        holds(u32::try_from(vertices).is_ok(), "there are too many vertices")?;
        let is_radius = |words: &[u32; LINE_WORDS]| {
            let radius = f32::from_bits(words[4]);
            radius >= 0.0 && radius.is_finite()
        };
        holds(self.vertices.iter().all(is_radius), "a radius is none")?;
        let is_sorted = self.strands.windows(2).all(|ends| ends[0] < ends[1]);
        holds(is_sorted, "strands are not in order")?;
        let end = self.strands.last().copied().unwrap_or(0);
        let is_known = |&[_, vertex]: &[u32; 2]| vertex < end;
        holds(self.segments.iter().all(is_known), "a segment's vertex is in no strand")
    }

    fn page(&self, chunk: &PackedChunk) -> PageKind {
        // The lines of a geometry are all ribbons or all tubes.
        let first = self.vertices[chunk.vertices()].first();
        PageKind {
            ribbons: first.is_some_and(|words| words[5] != NO_NORMAL),
            ..PageKind::plain(GeometryKind::Lines)
        }
    }

    fn streams(_page: PageKind) -> Vec<Stream> {
        vec![
            Stream { name: "line_segments", words: 2, of: StreamOf::Elements },
            Stream { name: "line_vertices", words: LINE_WORDS, of: StreamOf::Vertices },
        ]
    }

    fn stream(&self, _page: PageKind, name: &str, range: Range<usize>) -> Cow<'_, [u32]> {
        match name {
            "line_segments" => self.segments[range].as_flattened().into(),
            _ => self.vertices[range].as_flattened().into(),
        }
    }

    fn visit_elements(
        &self,
        chunk: &PackedChunk,
        range: Range<usize>,
        visit: &mut dyn FnMut(&[IVec3]),
    ) {
        let vertices = &self.vertices[chunk.vertices()];
        for [link, _] in &self.segments[range] {
            visit(&[0, 10].map(|shift| cell_of(&vertices[(link >> shift & 0x3ff) as usize])));
        }
    }

    fn visit_cells(&self, chunk: &PackedChunk, visit: &mut dyn FnMut(IVec3)) {
        self.vertices[chunk.vertices()].iter().map(cell_of).for_each(visit);
    }

    /// How much less the largest radius among a range of segments is than the chunk's.
    fn shortness(&self, range: Range<usize>) -> u32 {
        let number = self.chunks.partition_point(|chunk| chunk.first as usize <= range.start);
        let Some(chunk) = number.checked_sub(1).map(|number| &self.chunks[number]) else {
            return 0;
        };
        let vertices = &self.vertices[chunk.vertices()];
        let radius =
            |link: u32, shift: u32| f32::from_bits(vertices[(link >> shift & 0x3ff) as usize][4]);
        let most = self.segments[range]
            .iter()
            .map(|&[link, _]| radius(link, 0).max(radius(link, 10)))
            .fold(0.0, f32::max);
        // Conversions saturate: a part without radii has infinity here.
        (16.0 * (chunk.kernel_base / most).log2()).clamp(0.0, 255.0) as u32
    }

    fn core(&self) -> Option<Bounds> {
        None
    }

    fn weight(&self, corners: &[DVec3]) -> f64 {
        let &[a, b] = corners else { return 0.0 };
        a.distance(b)
    }

    fn stray_weight(&self) -> f64 {
        0.0
    }

    fn corner_radius(&self) -> f64 {
        let extent = self.chunks.iter().map(|chunk| chunk.extent.as_uvec3().max_element()).max();
        let widest = f64::from(self.widest());
        // Thin lines add nothing to a frame.
        if widest > 1e-3 * f64::from(extent.unwrap_or(0)) { widest * self.grid.step } else { 0.0 }
    }
}

#[cfg(test)]
mod tests;
