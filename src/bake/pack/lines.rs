//! Segments of lines. Vertices that chunks share are stored in each, with equal words, so that neighbours meet without a gap.

mod write;

use std::borrow::Cow;
use std::io;
use std::ops::Range;

use glam::{DVec3, IVec3};

use super::fields::{FIELD_WORDS, PackedField, Values, check_fields, value_words};
use super::kind::{Arrays, PackedKind, PageKind, Stream, StreamOf, holds};
use super::{CHUNK, GeometryKind, Grid, NO_NORMAL, PackedChunk, cell_of};
use crate::math::Bounds;

pub(super) use self::write::packing_bytes;
pub use self::write::{pack_levels, pack_lines};

/// Words of a vertex: grid position, colour, radius in cells.
pub const LINE_WORDS: usize = 5;
/// Words of a ribbon's vertex besides: its normal, and the direction of its width.
pub const DIRECTION_WORDS: usize = 2;

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
    /// One for each vertex of ribbons; empty for tubes.
    pub directions: Vec<[u32; DIRECTION_WORDS]>,
    /// Two 10-bit indices into the chunk's vertices with [`BEGINS`], [`ENDS`] and a hash; the number of the first vertex in the file.
    pub segments: Vec<[u32; 2]>,
    /// The first vertex of each strand in the file, and behind them the number of vertices; not on the GPU.
    pub strands: Vec<u32>,
    /// Scalar fields of the vertices.
    pub fields: Vec<PackedField>,
    /// For each vertex the codes of its fields, in [`value_words`] words.
    pub values: Vec<u32>,
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

/// A vertex of packed lines: its words, its number in the file, and the codes of its scalar fields.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineVertex {
    pub words: [u32; LINE_WORDS],
    /// [`NO_NORMAL`] twice for tubes.
    pub directions: [u32; DIRECTION_WORDS],
    pub number: u32,
    pub values: Values,
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
    let mut found: Vec<LineVertex> = (0..count as u32)
        .map(|number| LineVertex {
            words: [0; LINE_WORDS],
            directions: [NO_NORMAL; DIRECTION_WORDS],
            number,
            values: Values::default(),
        })
        .collect();
    for chunk in &lines.chunks {
        let vertices = &lines.vertices[chunk.vertices()];
        for [link, first] in &lines.segments[chunk.elements()] {
            for (shift, number) in [(0, *first), (10, first + 1)] {
                if let Some(at) = found.get_mut(number as usize) {
                    let local = link >> shift & 0x3ff;
                    let vertex = (chunk.vertex_first + local) as usize;
                    at.words = vertices[local as usize];
                    at.directions = lines.directions_of(vertex);
                    let own = lines.values_of(vertex);
                    at.values.iter_mut().zip(own).for_each(|(value, word)| *value = *word);
                }
            }
        }
    }
    let strand = |(strand, ends): (usize, &[u32])| Piece {
        strand: strand as u32,
        begins: true,
        ends: true,
        vertices: found[ends[0] as usize..ends[1] as usize].to_vec(),
    };
    lines.strands.windows(2).enumerate().map(strand).collect()
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
        let end = |vertex: usize| {
            let words = self.vertices.get(vertex)?;
            let [normal, side] = self.directions_of(vertex);
            Some(LineEnd {
                position: self.grid.position(cell_of(words)),
                radius: f64::from(f32::from_bits(words[4])) * self.grid.step,
                color: words[3],
                normal,
                side,
            })
        };
        let [a, b] = self.vertices_of(chunk, segment)?;
        Some([end(a)?, end(b)?])
    }

    /// The vertices of a segment of a chunk.
    fn vertices_of(&self, chunk: &PackedChunk, segment: usize) -> Option<[usize; 2]> {
        let [link, _] = *self.segments.get(segment)?;
        Some([0, 10].map(|shift| (chunk.vertex_first + (link >> shift & 0x3ff)) as usize))
    }

    fn are_ribbons(&self) -> bool {
        !self.directions.is_empty()
    }

    /// [`NO_NORMAL`] for the vertices of tubes.
    fn directions_of(&self, vertex: usize) -> [u32; DIRECTION_WORDS] {
        self.directions.get(vertex).copied().unwrap_or([NO_NORMAL; DIRECTION_WORDS])
    }

    /// The codes of a vertex's fields.
    fn values_of(&self, vertex: usize) -> &[u32] {
        let words = value_words(&self.fields);
        &self.values[words * vertex..words * (vertex + 1)]
    }

    /// The codes of the fields at both ends of a segment of a chunk.
    pub fn end_values(&self, chunk: &PackedChunk, segment: usize) -> Option<[&[u32]; 2]> {
        Some(self.vertices_of(chunk, segment)?.map(|vertex| self.values_of(vertex)))
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
        let PackedLines {
            grid: _,
            chunks: _,
            vertices,
            directions,
            segments,
            strands,
            fields,
            values,
        } = self;
        vec![
            vertices.as_flattened(),
            directions.as_flattened(),
            segments.as_flattened(),
            strands,
            bytemuck::cast_slice(fields),
            values,
        ]
    }

    fn widths() -> &'static [usize] {
        &[LINE_WORDS, DIRECTION_WORDS, 2, 1, FIELD_WORDS, 1]
    }

    fn read(grid: Grid, chunks: Vec<PackedChunk>, arrays: &mut Arrays<'_>) -> io::Result<Self> {
        Ok(PackedLines {
            grid,
            chunks,
            vertices: arrays.rows()?,
            directions: arrays.rows()?,
            segments: arrays.rows()?,
            strands: arrays.words()?,
            fields: bytemuck::cast_slice(&arrays.rows::<FIELD_WORDS>()?).to_vec(),
            values: arrays.words()?,
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
        holds(
            !self.are_ribbons() || self.directions.len() == self.vertices.len(),
            "not all vertices of ribbons have directions",
        )?;
        check_fields(&self.fields, self.vertices.len(), self.values.len())?;
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
        PageKind {
            translucent: chunk.translucent,
            ribbons: self.are_ribbons(),
            value_words: value_words(&self.fields) as u8,
            ..PageKind::plain(GeometryKind::Lines)
        }
    }

    fn streams(page: PageKind) -> Vec<Stream> {
        let of_vertex = LINE_WORDS + if page.ribbons { DIRECTION_WORDS } else { 0 };
        let mut streams = vec![
            Stream { name: "line_segments", words: 2, of: StreamOf::Elements },
            Stream { name: "line_vertices", words: of_vertex, of: StreamOf::Vertices },
        ];
        let words = usize::from(page.value_words);
        let values = Stream { name: "values", words, of: StreamOf::Vertices };
        streams.extend((words > 0).then_some(values));
        streams
    }

    fn stream(&self, page: PageKind, name: &str, range: Range<usize>) -> Cow<'_, [u32]> {
        let words = usize::from(page.value_words);
        match name {
            "values" => self.values[words * range.start..words * range.end].into(),
            "line_segments" => self.segments[range].as_flattened().into(),
            _ if page.ribbons => {
                let vertices = self.vertices[range.clone()].iter().zip(&self.directions[range]);
                vertices
                    .flat_map(|(words, directions)| words.iter().chain(directions))
                    .copied()
                    .collect()
            }
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
