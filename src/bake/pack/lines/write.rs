//! Makes packed lines of lines, and of levels of detail.

use glam::{IVec3, Vec3};
use rayon::prelude::*;

use super::super::fields::{Values, pack_fields, value_words, values_at};
use super::super::{
    ALWAYS, CHUNK, Grid, KERNEL_DETAIL, NO_NORMAL, NodeRange, PackError, PackedChunk, PackedField,
    Sides, finite, morton, octahedral, rgba_word,
};
use super::{BEGINS, ENDS, HASH_SHIFT, LineVertex, PackedLines, Piece, cell_of};
use crate::assets::Polylines;
use crate::math::Bounds;

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
    let cell = |vertex: usize| grid.quantise(lines.positions[vertex]);
    let mut order: Vec<Ordered> = Vec::with_capacity(lines.positions.len());
    for (strand, ends) in lines.strands.windows(2).enumerate() {
        let segments = ends[0]..ends[1].saturating_sub(1);
        order.extend(segments.clone().map(|vertex| {
            let (begins, ends) = (vertex == segments.start, vertex + 1 == segments.end);
            (0, vertex, strand_word(strand as u32, 0, begins, ends))
        }));
    }
    order.par_iter_mut().for_each(|(code, vertex, _)| {
        let vertex = *vertex as usize;
        // Cells use 30 bits.
        *code = morton((cell(vertex) + cell(vertex + 1)) / 2);
    });
    let sides = lines.normals.as_ref().map(|normals| sides(lines, normals));
    let vertex = |v: usize| {
        let cell = cell(v);
        let color = lines.colors.as_ref().map_or(u32::MAX, |colors| rgba_word(colors[v]));
        let radius = lines.radii.as_ref().map_or(0.0, |radii| f64::from(radii[v]));
        // Steps are powers of two: the quotient is exact.
        let radius = (radius / grid.step) as f32;
        let normal = lines.normals.as_ref().map_or(NO_NORMAL, |n| octahedral(n[v]));
        let side = sides.as_ref().map_or(NO_NORMAL, |sides| octahedral(sides[v]));
        LineVertex {
            words: [cell.x as u32, cell.y as u32, cell.z as u32, color, radius.to_bits()],
            directions: [normal, side],
            number: v as u32,
            values: values_at(&lines.fields, v),
        }
    };
    let fields = pack_fields(&lines.fields);
    let mut packer = LinePacker::new(grid, lines.strands.clone(), fields, sides.is_some());
    let always = NodeRange { error_parent: ALWAYS, size_parent: ALWAYS, ..NodeRange::default() };
    packer.add(always, lines.positions.len(), order, vertex);
    let mut packed = packer.finished();
    let vertices = &packed.vertices;
    for chunk in &mut packed.chunks {
        chunk.translucent = vertices[chunk.vertices()].iter().any(|words| words[3] >> 24 < 255);
    }
    Ok(packed)
}

/// Returns the first word of a segment without its indices. `part` counts the segments before it that have the same number.
///
/// Shaders derive the dither keys of a segment from the hash and the number, and parts of one segment have the same number: each has a hash of
/// its own, by steps of Martin Roberts' R3 sequence.
pub(super) fn strand_word(strand: u32, part: u32, begins: bool, ends: bool) -> u32 {
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
        (!lines.fields.is_empty()).then(|| lines.fields.points()),
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

/// A segment in the order of packing: the Morton code of its middle, the first of its two vertices, and its word (see [`strand_word`]).
type Ordered = (u64, u32, u32);

/// Cuts sorted segments into chunks with the vertices that they use.
struct LinePacker {
    are_ribbons: bool,
    out: PackedLines,
}

impl LinePacker {
    fn new(
        grid: Grid,
        strands: Vec<u32>,
        fields: Vec<PackedField>,
        are_ribbons: bool,
    ) -> LinePacker {
        let out = PackedLines {
            grid,
            chunks: Vec::new(),
            vertices: Vec::new(),
            directions: Vec::new(),
            segments: Vec::new(),
            strands,
            fields,
            values: Vec::new(),
        };
        LinePacker { are_ribbons, out }
    }

    /// Adds segments in chunks of their own that have this range. The segments lead to `count` vertices.
    ///
    /// Where a chunk ends depends on all segments before: [`Self::cut`] takes one after the other. All else is done in parallel.
    fn add(
        &mut self,
        range: NodeRange,
        count: usize,
        mut order: Vec<Ordered>,
        vertex: impl Fn(usize) -> LineVertex + Sync,
    ) {
        order.par_sort_unstable();
        let first = self.out.segments.len();
        let used = self.cut(range, count, &order);
        drop(order);
        let used = used.par_iter().map(|&number| vertex(number as usize));
        self.out.vertices.par_extend(used.clone().map(|vertex| vertex.words));
        if self.are_ribbons {
            self.out.directions.par_extend(used.clone().map(|vertex| vertex.directions));
        }
        let width = value_words(&self.out.fields);
        if width > 0 {
            let values = used.flat_map_iter(|vertex| vertex.values.into_iter().take(width));
            self.out.values.par_extend(values);
        }
        self.out.segments[first..].par_iter_mut().for_each(|[_, number]| {
            *number = vertex(*number as usize).number;
        });
    }

    /// Adds chunks, and segments whose second word is the place of their first vertex. Returns the vertices of the chunks, in their order.
    fn cut(&mut self, range: NodeRange, count: usize, order: &[Ordered]) -> Vec<u32> {
        let PackedLines { chunks, segments, vertices, .. } = &mut self.out;
        // For every vertex: the last chunk that took it, and its index there.
        let mut stamp = vec![(u32::MAX, 0u32); count];
        let mut used: Vec<u32> = Vec::with_capacity(count);
        segments.reserve(order.len());
        let mut is_open = false;
        for &(_, vertex, word) in order {
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
            let mut link = word;
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
            segments.push([link, vertex]);
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

/// Packs levels of detail, coarsest first, each with the range of its chunks.
///
/// # Errors
/// There are more vertices or segments than 32 bits count.
pub fn pack_levels(
    lines: &PackedLines,
    levels: &[(NodeRange, Vec<Piece<LineVertex>>)],
) -> Result<PackedLines, PackError> {
    let (strands, fields) = (lines.strands.clone(), lines.fields.clone());
    let mut packer = LinePacker::new(lines.grid, strands, fields, lines.are_ribbons());
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
        packer.add(*range, vertices.len(), order, |v| vertices[v]);
        if u32::try_from(packer.out.vertices.len()).is_err() {
            return Err(PackError::TooMany);
        }
    }
    Ok(packer.finished())
}

/// Bytes that packing lines needs.
pub(in crate::bake::pack) fn packing_bytes(lines: &Polylines) -> u64 {
    let sides = if lines.normals.is_some() { 12 + 2 * 8 } else { 0 };
    let values = if lines.fields.is_empty() { 0 } else { 2 * size_of::<Values>() as u64 };
    // The order and stamps, packed segments, and packed vertices with their numbers, twice: chunks that share a vertex each store it.
    (16 + 8 + 8 + 2 * (20 + 4) + sides + values) * lines.positions.len() as u64
        + 4 * lines.strands.len() as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Shaders tell the strands of translucent tubes by their hashes.
    #[test]
    fn hashes_of_near_strands_differ() {
        let hash = |strand: u32| strand_word(strand, 0, false, false);
        for strand in 0..2000 {
            let is_alone = (1..600).all(|apart| hash(strand) != hash(strand + apart));
            assert!(is_alone, "{strand}");
        }
    }
}
