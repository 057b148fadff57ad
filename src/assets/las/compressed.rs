//! LAZ point data: chunk table, chunks in parallel, and the stream without a table.
//!
//! The decoder is the `laz` crate's, but for the items with GPS times, whose decoders in that crate
//! recurse without a bound ([`super::gps_time`], [`super::point14`]). The crate believes sizes that it
//! finds, so each is checked first: the number of chunks, their bytes and points, and for layered
//! chunks (formats 6 to 10) the sizes of the layers. It is also called where a panic of its stays
//! inside, and becomes an error.

use std::io::{Cursor, Read, Seek, SeekFrom};

use laz::laszip::ChunkTable;
use laz::record::{
    LayeredPointRecordDecompressor, RecordDecompressor, SequentialPointRecordDecompressor,
};
use laz::{LazItem, LazItemType, LazVlr};
use rayon::prelude::*;

use super::gps_time::GpsTimes;
use super::header::Header;
use super::point14::{self, Point14};
use super::record::{Columns, Layout};
use super::{AssetError, ReadOptions, Visit, io_error, malformed};
use crate::assets::points::unsupported;
use crate::assets::quiet;

/// Longer records are refused: the decoder's models take kilobytes for each extra byte.
const MAX_RECORD_BYTES: usize = 4096;
/// Points that are decompressed at a time.
const BATCH: u64 = 4096;

/// How the compressor arranged the points.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Arrangement {
    /// One run of points.
    Pointwise,
    /// Chunks of points.
    Chunked,
    /// Chunks of layers, one for each group of attributes.
    Layered,
}

/// Contents of the LASzip record.
struct Scheme {
    arrangement: Arrangement,
    vlr: LazVlr,
}

/// One chunk in the file.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Chunk {
    bytes: u64,
    points: u64,
}

/// Decompresses every point, some at a time.
pub(super) fn each_part<R: Read + Seek + Send + Sync>(
    mut reader: R,
    header: &Header,
    layout: &Layout,
    name: &str,
    options: &ReadOptions,
    visit: &mut Visit,
) -> Result<(), AssetError> {
    let scheme = Scheme::of(header, name)?;
    let seek = |reader: &mut R, at| {
        reader.seek(SeekFrom::Start(at)).map_err(|source| io_error(name, source))
    };
    if scheme.arrangement == Arrangement::Pointwise {
        seek(&mut reader, header.points_offset)?;
        return read_stream(reader, &scheme, u64::MAX, header, layout, name, visit);
    }
    let start = header.points_offset + 8;
    match find_chunk_table(&mut reader, header, name)? {
        Some(table_at) => {
            let chunks = read_chunk_table(&mut reader, table_at, &scheme, header)
                .map_err(|reason| malformed(name, "chunk table", reason))?;
            seek(&mut reader, start)?;
            read_chunks(reader, &chunks, &scheme, header, layout, name, options, visit)
        }
        None if scheme.arrangement == Arrangement::Chunked
            && !scheme.vlr.uses_variable_size_chunks() =>
        {
            seek(&mut reader, start)?;
            let chunk_points = u64::from(scheme.vlr.chunk_size());
            read_stream(reader, &scheme, chunk_points, header, layout, name, visit)
        }
        None => Err(malformed(name, "chunk table", "is missing")),
    }
}

impl Scheme {
    fn of(header: &Header, name: &str) -> Result<Self, AssetError> {
        let bad = |reason: String| malformed(name, "LASzip record", reason);
        let data = header.laszip.as_deref().ok_or_else(|| bad("is missing".to_owned()))?;
        let vlr = LazVlr::from_buffer(data).map_err(|error| bad(error.to_string()))?;
        let (Some(&[low, high]), Some(first)) = (data.first_chunk(), vlr.items().first()) else {
            return Err(bad("names no items".to_owned()));
        };
        let arrangement = match u16::from_le_bytes([low, high]) {
            1 => Arrangement::Pointwise,
            2 => Arrangement::Chunked,
            3 => Arrangement::Layered,
            other => return Err(unsupported(name, format!("LAZ compressor {other}"))),
        };
        let versions = if arrangement == Arrangement::Layered { 3..=4 } else { 1..=2 };
        if let Some(item) = vlr.items().iter().find(|item| !versions.contains(&item.version())) {
            let (kind, version) = (item.item_type(), item.version());
            return Err(unsupported(
                name,
                format!(
                    "LAZ item {kind:?} of version {version}; versions {} to {} are read here",
                    versions.start(),
                    versions.end()
                ),
            ));
        }
        if !matches!(first.item_type(), LazItemType::Point10 | LazItemType::Point14) {
            return Err(bad(format!("begins with {:?}, not with a point", first.item_type())));
        }
        let record_bytes: u64 = vlr.items().iter().map(|item| u64::from(item.size())).sum();
        if record_bytes != header.record_bytes as u64 {
            let expected = header.record_bytes;
            return Err(bad(format!("items of {record_bytes} bytes; a point has {expected}")));
        }
        if header.record_bytes > MAX_RECORD_BYTES {
            let reason = format!("compressed records of {record_bytes} bytes");
            return Err(unsupported(name, reason));
        }
        if vlr.chunk_size() == 0 {
            return Err(bad("chunks of no points".to_owned()));
        }
        Ok(Self { arrangement, vlr })
    }
}

/// Where the chunk table is: before the points, or in the last bytes if the writer could not go
/// back; `None` if it was never written.
fn find_chunk_table<R: Read + Seek>(
    reader: &mut R,
    header: &Header,
    name: &str,
) -> Result<Option<u64>, AssetError> {
    let start = header.points_offset + 8;
    if start > header.file_bytes {
        return Err(malformed(name, "chunk table", "the file ends before the points"));
    }
    for (is_last, from) in
        [(false, SeekFrom::Start(header.points_offset)), (true, SeekFrom::End(-8))]
    {
        let mut bytes = [0; 8];
        let read = reader.seek(from).and_then(|_| reader.read_exact(&mut bytes));
        read.map_err(|source| io_error(name, source))?;
        match u64::try_from(i64::from_le_bytes(bytes)) {
            Ok(at) if at >= start && at + 8 <= header.file_bytes => return Ok(Some(at)),
            // The last bytes may be anything where there is no table.
            Ok(at) if at >= start && !is_last => {
                let reason = format!("begins at byte {at}, behind the end of the file");
                return Err(malformed(name, "chunk table", reason));
            }
            _ => {}
        }
    }
    Ok(None)
}

/// Reads the table; bytes and points of its chunks add up to what file and header have.
fn read_chunk_table<R: Read + Seek>(
    reader: &mut R,
    table_at: u64,
    scheme: &Scheme,
    header: &Header,
) -> Result<Vec<Chunk>, String> {
    let data_bytes = table_at - (header.points_offset + 8);
    let mut head = [0; 8];
    let read = reader.seek(SeekFrom::Start(table_at)).and_then(|_| reader.read_exact(&mut head));
    read.map_err(|error| error.to_string())?;
    let count = u64::from(u32::from_le_bytes([head[4], head[5], head[6], head[7]]));
    // Each chunk begins with one record as it is; a few empty ones may be listed.
    let room = data_bytes / header.record_bytes as u64 + 16;
    if count > room {
        return Err(format!("lists {count} chunks; the file has room for {room}"));
    }
    let is_variable = scheme.vlr.uses_variable_size_chunks();
    reader.seek(SeekFrom::Start(table_at)).map_err(|error| error.to_string())?;
    let table = guarded(|| ChunkTable::read(reader, is_variable).map_err(|e| e.to_string()))?;
    let (mut points_left, mut bytes_left) = (header.points, data_bytes);
    let mut chunks = Vec::with_capacity(table.len());
    for (index, entry) in table.as_ref().iter().enumerate() {
        // The decoder sign-extends these 32-bit numbers.
        let bytes = entry.byte_count & 0xffff_ffff;
        let points = match is_variable {
            true => entry.point_count & 0xffff_ffff,
            false => u64::from(scheme.vlr.chunk_size()),
        };
        let chunk = Chunk { bytes, points: points.min(points_left) };
        if bytes > bytes_left {
            return Err(format!("chunk {index} has {bytes} bytes; {bytes_left} are left"));
        }
        bytes_left -= bytes;
        points_left -= chunk.points;
        chunks.push(chunk);
    }
    if points_left > 0 {
        let found = header.points - points_left;
        return Err(format!("holds {found} points; the header announces {}", header.points));
    }
    Ok(chunks)
}

/// Decompresses groups of chunks, those of a group in parallel, in order.
#[expect(clippy::too_many_arguments, reason = "what a file is, each used once")]
fn read_chunks<R: Read>(
    mut reader: R,
    chunks: &[Chunk],
    scheme: &Scheme,
    header: &Header,
    layout: &Layout,
    name: &str,
    options: &ReadOptions,
    visit: &mut Visit,
) -> Result<(), AssetError> {
    let (mut first, mut done) = (0, 0);
    for group in chunks.chunks(2 * rayon::current_num_threads()) {
        let mut packed = Vec::with_capacity(group.len());
        for chunk in group {
            let mut bytes = vec![0; chunk.bytes as usize];
            reader.read_exact(&mut bytes).map_err(|source| io_error(name, source))?;
            packed.push((chunk, bytes));
        }
        let parts: Vec<Result<Columns, String>> = packed
            .into_par_iter()
            .map(|(chunk, bytes)| {
                guarded(|| decompress_chunk(&bytes, chunk.points, scheme, header, layout))
            })
            .collect();
        for (index, part) in parts.into_iter().enumerate() {
            let place = format!("chunk {}", first + index);
            let part = part.map_err(|reason| malformed(name, place.as_str(), reason))?;
            visit(part, place)?;
        }
        first += group.len();
        done += group.iter().map(|chunk| chunk.points).sum::<u64>();
        options.progress.report(done as f32 / header.points.max(1) as f32);
    }
    Ok(())
}

fn decompress_chunk(
    bytes: &[u8],
    points: u64,
    scheme: &Scheme,
    header: &Header,
    layout: &Layout,
) -> Result<Columns, String> {
    let mut columns = Columns::default();
    if points == 0 {
        return Ok(columns);
    }
    let items = scheme.vlr.items();
    let mut decoder: Box<dyn RecordDecompressor<Cursor<&[u8]>>> =
        if scheme.arrangement == Arrangement::Layered {
            check_layers(bytes, items, header.record_bytes)?;
            let mut decoder = LayeredPointRecordDecompressor::new(Cursor::new(bytes));
            add_layered(&mut decoder, items)?;
            Box::new(decoder)
        } else {
            let mut decoder = SequentialPointRecordDecompressor::new(Cursor::new(bytes));
            add_sequential(&mut decoder, items)?;
            Box::new(decoder)
        };
    decompress_points(&mut *decoder, points, header, |records| {
        columns.try_reserve(records.len() / header.record_bytes, layout)?;
        columns.extend(records, layout);
        Ok(())
    })?;
    Ok(columns)
}

/// Adds the items' decoders; that of [`GpsTimes`] replaces the crate's.
fn add_sequential<R: Read>(
    decoder: &mut SequentialPointRecordDecompressor<'_, R>,
    items: &[LazItem],
) -> Result<(), String> {
    for &item in items {
        match (item.item_type(), item.version()) {
            (LazItemType::GpsTime, 2) => decoder.add_field_decompressor(GpsTimes::of_item()),
            _ => decoder.set_fields_from(&vec![item]).map_err(|error| error.to_string())?,
        }
    }
    Ok(())
}

/// Adds the items' decoders; that of [`Point14`] replaces the crate's.
fn add_layered<R: Read + Seek>(
    decoder: &mut LayeredPointRecordDecompressor<'_, R>,
    items: &[LazItem],
) -> Result<(), String> {
    for &item in items {
        match item.item_type() {
            LazItemType::Point14 => decoder.add_field_decompressor(Point14::new(item.version())),
            _ => decoder.set_fields_from(&vec![item]).map_err(|error| error.to_string())?,
        }
    }
    Ok(())
}

/// Gives the records of `points` points to `take`, some at a time; memory grows only with what is really decompressed.
fn decompress_points<R>(
    decoder: &mut dyn RecordDecompressor<R>,
    points: u64,
    header: &Header,
    mut take: impl FnMut(&[u8]) -> Result<(), String>,
) -> Result<(), String> {
    if decoder.record_size() != header.record_bytes {
        let (found, expected) = (decoder.record_size(), header.record_bytes);
        return Err(format!("decompresses to records of {found} bytes, expected {expected}"));
    }
    let mut buffer = vec![0; BATCH.min(points) as usize * header.record_bytes];
    let mut left = points;
    while left > 0 {
        let batch = BATCH.min(left);
        let records = &mut buffer[..batch as usize * header.record_bytes];
        decoder.decompress_many(records).map_err(|error| match error.kind() {
            std::io::ErrorKind::UnexpectedEof => format!("ends with {left} points to come"),
            _ => error.to_string(),
        })?;
        take(records)?;
        left -= batch;
    }
    Ok(())
}

/// Checks that a layered chunk's layers lie within it: after the first record and the number of
/// points stand the layers' sizes, item by item.
fn check_layers(bytes: &[u8], items: &[LazItem], record_bytes: usize) -> Result<(), String> {
    let layers = |item: &LazItem| match item.item_type() {
        LazItemType::Point14 => point14::LAYERS,
        LazItemType::RGBNIR14 => 2,
        LazItemType::Byte14(count) => usize::from(count),
        _ => 1,
    };
    let count: usize = items.iter().map(layers).sum();
    let sizes_at = record_bytes + 4;
    let ends = || format!("{} bytes are too few for the sizes of {count} layers", bytes.len());
    let (sizes, layers) =
        bytes.get(sizes_at..).and_then(|rest| rest.split_at_checked(4 * count)).ok_or_else(ends)?;
    let total: u64 =
        sizes.as_chunks::<4>().0.iter().map(|&size| u64::from(u32::from_le_bytes(size))).sum();
    if total > layers.len() as u64 {
        return Err(format!("layers of {total} bytes in a chunk with {}", layers.len()));
    }
    Ok(())
}

/// Decompresses points one after the other, where there is no table of chunks.
fn read_stream<R: Read>(
    reader: R,
    scheme: &Scheme,
    chunk_points: u64,
    header: &Header,
    layout: &Layout,
    name: &str,
    visit: &mut Visit,
) -> Result<(), AssetError> {
    let mut refused = None;
    let decompress = || {
        let mut decoder = SequentialPointRecordDecompressor::new(reader);
        let mut left = header.points;
        while left > 0 {
            add_sequential(&mut decoder, scheme.vlr.items())?;
            let points = chunk_points.min(left);
            decompress_points(&mut decoder, points, header, |records| {
                let mut part = Columns::default();
                part.try_reserve(records.len() / header.record_bytes, layout)?;
                part.extend(records, layout);
                visit(part, "point data".to_owned()).map_err(|error| {
                    refused = Some(error);
                    String::new()
                })
            })?;
            decoder.reset();
            left -= points;
        }
        Ok(())
    };
    let done = guarded(decompress);
    match (done, refused) {
        (_, Some(error)) => Err(error),
        (Err(reason), None) => Err(malformed(name, "point data", reason)),
        (Ok(()), None) => Ok(()),
    }
}

/// Runs the decoder; a panic of its is damage that it does not report.
fn guarded<T>(decode: impl FnOnce() -> Result<T, String>) -> Result<T, String> {
    quiet::catch(decode).unwrap_or_else(|| Err("is damaged: the decoder gave up".to_owned()))
}

#[cfg(test)]
mod tests;
