//! Records of an entry's table and of its chunks, as words.

use glam::{DVec3, IVec3};

use crate::bake::pack::{
    Grid, NodeRange, PackedChunk, PackedGeometry, PackedMesh, PackedSamples, Sides, VERTEX_WORDS,
};

/// Magic 2, version, number of geometries, key 8, bytes of the file 2.
pub(super) const HEADER_WORDS: usize = 14;
/// Kind, `clipped_first`, grid 9, lengths of sections.
pub(super) const RECORD_WORDS: usize = 11 + SECTIONS;
/// Words of a chunk.
pub(super) const CHUNK_WORDS: usize = 20;
/// Length of a SHA-256.
pub(super) const TRAILER_BYTES: u64 = 32;

const SECTIONS: usize = 6;
const SAMPLES: u32 = 0;
const MESH: u32 = 1;
/// Words per element of each section.
const SAMPLES_WORDS: [usize; SECTIONS] = [CHUNK_WORDS, 2, 2, 1, 2, 2];
const MESH_WORDS: [usize; SECTIONS] = [CHUNK_WORDS, VERTEX_WORDS, 1, 0, 0, 0];

/// The table's record of a geometry.
pub(super) struct Record {
    pub(super) grid: Grid,
    pub(super) sections: Sections,
}

/// Number of elements of each section.
pub(super) enum Sections {
    Samples {
        chunks: u32,
        positions: u32,
        attributes: u32,
        kernels: u32,
        clips: u32,
        nodes: u32,
        clipped_first: u32,
    },
    Mesh {
        chunks: u32,
        vertices: u32,
        triangles: u32,
    },
}

impl Record {
    /// Builds the record of a checked geometry: its lengths fit 32 bits.
    pub(super) fn of(geometry: &PackedGeometry) -> Record {
        // Naming all fields makes the compiler report a new one.
        let sections = match geometry {
            PackedGeometry::Samples(PackedSamples {
                grid: _,
                chunks,
                positions,
                attributes,
                kernels,
                clips,
                clipped_first,
                nodes,
            }) => Sections::Samples {
                chunks: chunks.len() as u32,
                positions: positions.len() as u32,
                attributes: attributes.len() as u32,
                kernels: kernels.len() as u32,
                clips: clips.len() as u32,
                nodes: nodes.len() as u32,
                clipped_first: *clipped_first,
            },
            PackedGeometry::Mesh(PackedMesh { grid: _, chunks, vertices, triangles }) => {
                Sections::Mesh {
                    chunks: chunks.len() as u32,
                    vertices: vertices.len() as u32,
                    triangles: triangles.len() as u32,
                }
            }
        };
        Record { grid: *geometry.grid(), sections }
    }

    pub(super) fn to_words(&self) -> [u32; RECORD_WORDS] {
        let Grid { origin, step, reach } = self.grid;
        let [x, y, z] = origin.to_array().map(|v| halves(v.to_bits()));
        let step = halves(step.to_bits());
        let (kind, clipped_first, lengths) = self.sections.to_words();
        let [a, b, c, d, e, f] = lengths;
        [
            kind,
            clipped_first,
            x[0],
            x[1],
            y[0],
            y[1],
            z[0],
            z[1],
            step[0],
            step[1],
            reach as u32,
            a,
            b,
            c,
            d,
            e,
            f,
        ]
    }

    /// Returns `None` for an unknown kind, or for sections that the kind does not have.
    pub(super) fn from_words(words: &[u32; RECORD_WORDS]) -> Option<Record> {
        let [kind, clipped_first, x0, x1, y0, y1, z0, z1, step0, step1, reach, lengths @ ..] =
            *words;
        let float = |low, high| f64::from_bits(whole([low, high]));
        Some(Record {
            grid: Grid {
                origin: DVec3::new(float(x0, x1), float(y0, y1), float(z0, z1)),
                step: float(step0, step1),
                reach: reach as i32,
            },
            sections: Sections::from_words(kind, clipped_first, lengths)?,
        })
    }

    /// Bytes of the sections.
    fn bytes(&self) -> u64 {
        let (kind, _, lengths) = self.sections.to_words();
        let words = if kind == SAMPLES { SAMPLES_WORDS } else { MESH_WORDS };
        lengths.iter().zip(words).map(|(&length, words)| u64::from(length) * 4 * words as u64).sum()
    }
}

impl Sections {
    fn to_words(&self) -> (u32, u32, [u32; SECTIONS]) {
        match *self {
            Sections::Samples {
                chunks,
                positions,
                attributes,
                kernels,
                clips,
                nodes,
                clipped_first,
            } => (SAMPLES, clipped_first, [chunks, positions, attributes, kernels, clips, nodes]),
            Sections::Mesh { chunks, vertices, triangles } => {
                (MESH, 0, [chunks, vertices, triangles, 0, 0, 0])
            }
        }
    }

    fn from_words(kind: u32, clipped_first: u32, lengths: [u32; SECTIONS]) -> Option<Sections> {
        match (kind, clipped_first, lengths) {
            (SAMPLES, _, [chunks, positions, attributes, kernels, clips, nodes]) => {
                Some(Sections::Samples {
                    chunks,
                    positions,
                    attributes,
                    kernels,
                    clips,
                    nodes,
                    clipped_first,
                })
            }
            (MESH, 0, [chunks, vertices, triangles, 0, 0, 0]) => {
                Some(Sections::Mesh { chunks, vertices, triangles })
            }
            _ => None,
        }
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
        sides as u32,
        base.to_bits(),
        error_parent.to_bits(),
        size_parent.to_bits(),
        error_least.to_bits(),
        size_least.to_bits(),
        delta_most.to_bits(),
    ]
}

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
        sides: [Sides::Unknown, Sides::Oriented, Sides::Closed].get(sides as usize).copied()?,
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
