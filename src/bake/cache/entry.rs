//! The bytes of an entry.
//!
//! ```text
//! header    magic, format version, number of geometries, key, bytes of the file
//! table     for each geometry: kind, grid, number of chunks, and number of elements of each of its arrays
//! sections  for each geometry: chunks, and its arrays as PackedKind::arrays lists them
//! trailer   SHA-256 of all the above
//! ```
//! All values are 32-bit little-endian words; 64-bit numbers are two words, the lower one first. Sections lie without gaps in the
//! table's order; arrays of words are read directly to their destination.
//!
//! A file is read twice, for its checksum and then for its contents, so a damaged length is never used. The sizes in the table
//! have to add up to the file's length, which bounds allocations even if a checksum is forged.

use std::io::{self, Read, Seek, SeekFrom, Write};

use sha2::{Digest, Sha256};

use super::FORMAT_VERSION;
use super::check::{check, check_frame};
use super::record::{
    HEADER_WORDS, RECORD_WORDS, Record, TRAILER_BYTES, chunk_from_words, chunk_to_words,
    file_bytes, halves, whole, words_of,
};
use crate::bake::external::Spilled;
use crate::bake::pack::{
    Arrays, CLIP_BYTES, GeometryKind, PackedChunk, PackedGeometry, read_words,
};
use crate::bake::tree::TreeStatistics;

const MAGIC: [u8; 8] = *b"PTLSBAKE";
/// Number of words written at once.
const BLOCK: usize = 1 << 14;
/// Number of bytes hashed at once.
const HASHED: usize = 1 << 20;

/// Why a file is not believed, or geometries are not written.
#[derive(Debug, thiserror::Error)]
pub(super) enum Refusal {
    #[error("{0}")]
    Io(#[from] io::Error),
    #[error("it is no baked geometry")]
    Foreign,
    #[error("it has format version {found}, not {FORMAT_VERSION}")]
    Version { found: u32 },
    #[error("it has {found} bytes, not as many as were written")]
    Length { found: u64 },
    #[error("it is another asset's")]
    Key,
    #[error("its checksum is another")]
    Checksum,
    #[error("its table does not describe it")]
    Table,
    #[error("geometry {geometry}: {what}")]
    Invalid { geometry: usize, what: &'static str },
}

/// Geometries that passed the checks for writing.
pub(super) struct Entry<'a> {
    geometries: &'a [PackedGeometry],
    table: Vec<Record>,
}

impl<'a> Entry<'a> {
    /// # Errors
    /// Fails for geometries that [`read`] would refuse.
    pub(super) fn of(geometries: &'a [PackedGeometry]) -> Result<Entry<'a>, Refusal> {
        for (index, geometry) in geometries.iter().enumerate() {
            check(geometry).map_err(|what| Refusal::Invalid { geometry: index, what })?;
        }
        if geometries.len() > u32::MAX as usize {
            return Err(Refusal::Table);
        }
        Ok(Entry { geometries, table: geometries.iter().map(Record::of).collect() })
    }

    /// Bytes of the file.
    pub(super) fn bytes(&self) -> u64 {
        file_bytes(&self.table)
    }

    pub(super) fn write(&self, out: impl Write, key: &[u8; 32]) -> io::Result<()> {
        let mut writer = Writer::begin(out, key, &self.table)?;
        for geometry in self.geometries {
            for chunk in geometry.chunks() {
                writer.put(&chunk_to_words(chunk))?;
            }
            for words in geometry.arrays() {
                writer.put(words)?;
            }
        }
        writer.finish()
    }
}

/// A point tree without clip lines that lies in files, as the only geometry of an entry.
pub(super) struct SpilledEntry<'a> {
    tree: &'a Spilled,
    table: [Record; 1],
}

impl<'a> SpilledEntry<'a> {
    /// # Errors
    /// Fails for a tree that [`read`] would refuse.
    pub(super) fn of(tree: &'a Spilled) -> Result<SpilledEntry<'a>, Refusal> {
        let invalid = |what| Refusal::Invalid { geometry: 0, what };
        check_frame(&tree.grid, &tree.chunks, tree.len()).map_err(invalid)?;
        let Spilled { grid, chunks, positions, attributes, kernels, fields, values, nodes } = tree;
        let counts = [
            positions.count(),
            attributes.count(),
            kernels.count(),
            0,
            fields.len() as u64,
            values.count(),
            nodes.count(),
        ];
        let lengths = counts.map(|count| count as u32);
        let record = Record::new(GeometryKind::Samples, *grid, chunks, lengths);
        Ok(SpilledEntry { tree, table: [record] })
    }

    /// Bytes of the file.
    pub(super) fn bytes(&self) -> u64 {
        file_bytes(&self.table)
    }

    pub(super) fn write(&self, out: impl Write, key: &[u8; 32]) -> io::Result<()> {
        let mut writer = Writer::begin(out, key, &self.table)?;
        for chunk in &self.tree.chunks {
            writer.put(&chunk_to_words(chunk))?;
        }
        self.tree.positions.each_block(|words| writer.put(words.as_flattened()))?;
        self.tree.attributes.each_block(|words| writer.put(words.as_flattened()))?;
        self.tree.kernels.each_block(|words| writer.put(words))?;
        writer.put(bytemuck::cast_slice(&self.tree.fields))?;
        self.tree.values.each_block(|words| writer.put(words))?;
        self.tree.nodes.each_block(|words| writer.put(words.as_flattened()))?;
        writer.finish()
    }
}

struct Writer<W> {
    out: W,
    hasher: Sha256,
    /// Buffered little-endian words.
    block: Vec<u32>,
}

impl<W: Write> Writer<W> {
    /// Writes header and table.
    fn begin(out: W, key: &[u8; 32], table: &[Record]) -> io::Result<Writer<W>> {
        let mut writer = Writer { out, hasher: Sha256::new(), block: Vec::with_capacity(BLOCK) };
        let mut header = [0; HEADER_WORDS];
        header[..2].copy_from_slice(&words_of(&MAGIC));
        header[2] = FORMAT_VERSION;
        header[3] = table.len() as u32;
        header[4..12].copy_from_slice(&words_of(key));
        header[12..].copy_from_slice(&halves(file_bytes(table)));
        writer.put(&header)?;
        for record in table {
            writer.put(&record.to_words())?;
        }
        Ok(writer)
    }

    /// Writes the trailer.
    fn finish(mut self) -> io::Result<()> {
        self.out.write_all(&self.hasher.finalize())?;
        self.out.flush()
    }

    fn put(&mut self, words: &[u32]) -> io::Result<()> {
        for part in words.chunks(BLOCK) {
            self.block.clear();
            self.block.extend(part.iter().map(|word| word.to_le()));
            let bytes = bytemuck::cast_slice(&self.block);
            self.hasher.update(bytes);
            self.out.write_all(bytes)?;
        }
        Ok(())
    }
}

/// Reads a file of `bytes` bytes.
pub(super) fn read(
    source: &mut (impl Read + Seek),
    bytes: u64,
    key: &[u8; 32],
) -> Result<Vec<PackedGeometry>, Refusal> {
    read_whole(source, bytes, key).map_err(|refusal| match refusal {
        // The file was truncated meanwhile.
        Refusal::Io(error) if error.kind() == io::ErrorKind::UnexpectedEof => {
            Refusal::Length { found: bytes }
        }
        other => other,
    })
}

/// Checks that the file is whole and has this key; returns its number of geometries.
pub(super) fn verify(
    source: &mut (impl Read + Seek),
    bytes: u64,
    key: &[u8; 32],
) -> Result<u32, Refusal> {
    let header_bytes = 4 * HEADER_WORDS as u64;
    if bytes < header_bytes + TRAILER_BYTES {
        return Err(Refusal::Length { found: bytes });
    }
    let mut header = [0; HEADER_WORDS];
    read_words(source, &mut header)?;
    if header[..2] != *words_of(&MAGIC) {
        return Err(Refusal::Foreign);
    }
    if header[2] != FORMAT_VERSION {
        return Err(Refusal::Version { found: header[2] });
    }
    if whole([header[12], header[13]]) != bytes {
        return Err(Refusal::Length { found: bytes });
    }
    if header[4..12] != *words_of(key) {
        return Err(Refusal::Key);
    }
    source.rewind()?;
    let hash = hash(source, bytes - TRAILER_BYTES)?;
    let mut trailer = [0; TRAILER_BYTES as usize];
    source.read_exact(&mut trailer)?;
    if trailer != hash {
        return Err(Refusal::Checksum);
    }
    Ok(header[3])
}

/// The figures of an entry's only geometry, a point tree, read in small parts.
pub(super) fn figures(
    source: &mut (impl Read + Seek),
    bytes: u64,
    key: &[u8; 32],
) -> Result<TreeStatistics, Refusal> {
    let count = verify(source, bytes, key)?;
    source.seek(SeekFrom::Start(4 * HEADER_WORDS as u64))?;
    let mut words = [[0; RECORD_WORDS]];
    if count != 1 {
        return Err(Refusal::Table);
    }
    read_words(source, words.as_flattened_mut())?;
    let table = Record::from_words(&words[0]).map(|record| [record]);
    let table = table.filter(|table| file_bytes(table) == bytes).ok_or(Refusal::Table)?;
    let [Record { kind: GeometryKind::Samples, grid, chunks, lengths }] = table else {
        return Err(Refusal::Table);
    };
    let [_, _, _, clips, _, values, nodes, ..] = lengths;
    let chunks = read_chunks(source, chunks)?.ok_or(Refusal::Table)?;
    source.seek(SeekFrom::Start(bytes - TRAILER_BYTES - 8 * u64::from(nodes)))?;
    let mut statistics = TreeStatistics::default();
    let mut left = nodes;
    while left > 0 {
        let block: Vec<[u32; 2]> = read_arrays(source, left.min(BLOCK as u32))?;
        statistics.add(&block);
        left -= block.len() as u32;
    }
    let beside = CLIP_BYTES * u64::from(clips) + 4 * u64::from(values);
    statistics.finish(&grid, &chunks, beside);
    Ok(statistics)
}

fn read_whole(
    source: &mut (impl Read + Seek),
    bytes: u64,
    key: &[u8; 32],
) -> Result<Vec<PackedGeometry>, Refusal> {
    let count = verify(source, bytes, key)?;
    let header_bytes = 4 * HEADER_WORDS as u64;
    source.seek(SeekFrom::Start(header_bytes))?;
    if u64::from(count) * 4 * RECORD_WORDS as u64 > bytes - header_bytes - TRAILER_BYTES {
        return Err(Refusal::Table);
    }
    let records = read_arrays::<RECORD_WORDS>(source, count)?;
    let table: Option<Vec<Record>> = records.iter().map(Record::from_words).collect();
    let table = table.filter(|table| file_bytes(table) == bytes).ok_or(Refusal::Table)?;
    let mut geometries = Vec::with_capacity(table.len());
    for (index, record) in table.iter().enumerate() {
        let invalid = |what| Refusal::Invalid { geometry: index, what };
        let geometry =
            read_geometry(source, record)?.ok_or(invalid("a flag is neither 0 nor 1"))?;
        check(&geometry).map_err(invalid)?;
        geometries.push(geometry);
    }
    Ok(geometries)
}

/// The hash of the next `bytes` bytes.
fn hash(source: &mut impl Read, bytes: u64) -> io::Result<[u8; 32]> {
    let mut hasher = Sha256::new();
    let mut buffer = vec![0; bytes.min(HASHED as u64) as usize];
    let mut left = bytes;
    while left > 0 {
        let part = &mut buffer[..left.min(HASHED as u64) as usize];
        source.read_exact(part)?;
        hasher.update(&*part);
        left -= part.len() as u64;
    }
    Ok(hasher.finalize().into())
}

/// Returns `None` if a flag is neither 0 nor 1. The table has been checked against the file's length.
fn read_geometry(source: &mut impl Read, record: &Record) -> io::Result<Option<PackedGeometry>> {
    let Some(chunks) = read_chunks(source, record.chunks)? else { return Ok(None) };
    let arrays = Arrays::new(source, &record.lengths);
    record.kind.read(record.grid, chunks, arrays).map(Some)
}

fn read_chunks(source: &mut impl Read, count: u32) -> io::Result<Option<Vec<PackedChunk>>> {
    Ok(read_arrays(source, count)?.iter().map(chunk_from_words).collect())
}

fn read_arrays<const N: usize>(source: &mut impl Read, count: u32) -> io::Result<Vec<[u32; N]>> {
    let mut list = vec![[0; N]; count as usize];
    read_words(source, list.as_flattened_mut())?;
    Ok(list)
}
