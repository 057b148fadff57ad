//! Records of an entry's table and of its chunks, as words.

use glam::{DVec3, IVec3};

use crate::bake::pack::{GeometryKind, Grid, NodeRange, PackedChunk, PackedGeometry, Sides};

/// Magic 2, version, number of geometries, key 8, bytes of the file 2.
pub(super) const HEADER_WORDS: usize = 14;
/// Kind, grid 9, number of chunks, lengths of arrays.
pub(super) const RECORD_WORDS: usize = 11 + MOST_ARRAYS;
/// Words of a chunk.
pub(super) const CHUNK_WORDS: usize = 20;
/// Length of a SHA-256.
pub(super) const TRAILER_BYTES: u64 = 32;
/// Largest number of arrays of a kind.
const MOST_ARRAYS: usize = 8;

/// The table's record of a geometry.
pub(super) struct Record {
    pub(super) kind: GeometryKind,
    pub(super) grid: Grid,
    pub(super) chunks: u32,
    /// Number of elements of each array.
    pub(super) lengths: [u32; MOST_ARRAYS],
}

impl Record {
    /// Builds the record of a checked geometry: its lengths fit 32 bits.
    pub(super) fn of(geometry: &PackedGeometry) -> Record {
        let arrays = geometry.arrays();
        let lengths = arrays.iter().zip(geometry.kind().widths());
        let lengths = lengths.map(|(words, width)| (words.len() / width) as u32);
        Record::new(geometry.kind(), *geometry.grid(), geometry.chunks(), lengths)
    }

    pub(super) fn new(
        kind: GeometryKind,
        grid: Grid,
        chunks: &[PackedChunk],
        lengths: impl IntoIterator<Item = u32>,
    ) -> Record {
        let mut own = [0; MOST_ARRAYS];
        own.iter_mut().zip(lengths).for_each(|(own, length)| *own = length);
        Record { kind, grid, chunks: chunks.len() as u32, lengths: own }
    }

    pub(super) fn to_words(&self) -> [u32; RECORD_WORDS] {
        let Grid { origin, step, reach } = self.grid;
        let [x, y, z] = origin.to_array().map(|v| halves(v.to_bits()));
        let step = halves(step.to_bits());
        let mut words = [0; RECORD_WORDS];
        let (head, lengths) = words.split_at_mut(RECORD_WORDS - MOST_ARRAYS);
        head[0] = self.kind as u32;
        head[1..9].copy_from_slice([x, y, z, step].as_flattened());
        head[9] = reach as u32;
        head[10] = self.chunks;
        lengths.copy_from_slice(&self.lengths);
        words
    }

    /// Returns `None` for an unknown kind, or for arrays that the kind does not have.
    pub(super) fn from_words(words: &[u32; RECORD_WORDS]) -> Option<Record> {
        let [kind, x0, x1, y0, y1, z0, z1, step0, step1, reach, chunks, lengths @ ..] = *words;
        let kind = GeometryKind::from_number(kind)?;
        if lengths.iter().skip(kind.widths().len()).any(|&length| length != 0) {
            return None;
        }
        let float = |low, high| f64::from_bits(whole([low, high]));
        let grid = Grid {
            origin: DVec3::new(float(x0, x1), float(y0, y1), float(z0, z1)),
            step: float(step0, step1),
            reach: reach as i32,
        };
        Some(Record { kind, grid, chunks, lengths })
    }

    /// Bytes of the chunks and arrays.
    fn bytes(&self) -> u64 {
        let words = |length: u32, width: usize| u64::from(length) * width as u64;
        let arrays = self.lengths.iter().zip(self.kind.widths());
        let arrays: u64 = arrays.map(|(&length, &width)| words(length, width)).sum();
        4 * (words(self.chunks, CHUNK_WORDS) + arrays)
    }
}

/// Bytes of the file that a table describes.
pub(super) fn file_bytes(table: &[Record]) -> u64 {
    let fixed = 4 * (HEADER_WORDS + RECORD_WORDS * table.len()) as u64 + TRAILER_BYTES;
    // No file is as long as the saturated sum.
    table.iter().map(Record::bytes).fold(fixed, u64::saturating_add)
}

pub(super) fn chunk_to_words(chunk: &PackedChunk) -> [u32; CHUNK_WORDS] {
    let PackedChunk {
        origin,
        extent,
        first,
        count,
        shift,
        vertex_first,
        vertex_count,
        material,
        kernel_base,
        sides,
        translucent,
        range: NodeRange { base, error_parent, size_parent, error_least, size_least, delta_most },
    } = *chunk;
    [
        origin.x as u32,
        origin.y as u32,
        origin.z as u32,
        extent.x as u32,
        extent.y as u32,
        extent.z as u32,
        first,
        count,
        shift,
        vertex_first,
        vertex_count,
        material,
        kernel_base.to_bits(),
        sides as u32 | u32::from(translucent) << TRANSLUCENT_BIT,
        base.to_bits(),
        error_parent.to_bits(),
        size_parent.to_bits(),
        error_least.to_bits(),
        size_least.to_bits(),
        delta_most.to_bits(),
    ]
}

/// The bit of the word of a chunk's sides that says that it is translucent.
const TRANSLUCENT_BIT: u32 = 8;

/// Returns `None` if `sides` has an invalid value.
pub(super) fn chunk_from_words(words: &[u32; CHUNK_WORDS]) -> Option<PackedChunk> {
    let [
        x,
        y,
        z,
        extent_x,
        extent_y,
        extent_z,
        first,
        count,
        shift,
        vertex_first,
        vertex_count,
        material,
        kernel_base,
        sides,
        range @ ..,
    ] = *words;
    let cells = |x, y, z| IVec3::new(x as i32, y as i32, z as i32);
    let [base, error_parent, size_parent, error_least, size_least, delta_most] =
        range.map(f32::from_bits);
    Some(PackedChunk {
        origin: cells(x, y, z),
        extent: cells(extent_x, extent_y, extent_z),
        first,
        count,
        shift,
        vertex_first,
        vertex_count,
        material,
        kernel_base: f32::from_bits(kernel_base),
        sides: [Sides::Unknown, Sides::Oriented, Sides::Closed]
            .get((sides & !(1 << TRANSLUCENT_BIT)) as usize)
            .copied()?,
        translucent: sides >> TRANSLUCENT_BIT & 1 == 1,
        range: NodeRange { base, error_parent, size_parent, error_least, size_least, delta_most },
    })
}

/// A 64-bit number as words, the lower one first.
pub(super) fn halves(number: u64) -> [u32; 2] {
    [number as u32, (number >> 32) as u32]
}

pub(super) fn whole([low, high]: [u32; 2]) -> u64 {
    u64::from(low) | u64::from(high) << 32
}

/// Converts bytes to words; an incomplete last word is dropped.
pub(super) fn words_of(bytes: &[u8]) -> Vec<u32> {
    bytes.as_chunks::<4>().0.iter().map(|&word| u32::from_le_bytes(word)).collect()
}
