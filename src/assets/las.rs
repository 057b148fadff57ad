//! Reader for LAS 1.0–1.4, LAZ and COPC.
//!
//! The header is read and checked against the file's length here ([`header`]) before anything is
//! allocated for it; point records are decoded from bytes ([`record`]). LAZ goes chunk by chunk
//! through the `laz` crate ([`compressed`]), several chunks at a time, each bounded by the chunk
//! table. The `las` crate's own reader sits above that crate, but trusts the number of variable
//! length records, the chunk table and the layer sizes, so that a few damaged bytes make it
//! allocate gigabytes; it serves the tests as the independent writer. A COPC file is read as the LAZ
//! file that it is: all levels of its octree together are the cloud.
//!
//! Colours may be 8-bit values in 16-bit fields, 8-bit values in their high bytes, or true 16-bit
//! values: what the whole file holds decides, and all zero means no colour. Withheld points are
//! skipped and counted.

mod compressed;
mod header;
mod record;

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use super::points::{self, colors_from_words, io_error, malformed, skipped_warning};
use super::{Asset, AssetError, Geometry, PointCloud, ReadOptions};
use header::Header;
use record::{Columns, Layout};

/// Records of an uncompressed file that are read at a time.
const BATCH: u64 = 1 << 16;

/// Whether a file that begins with `head` is LAS or LAZ.
pub fn sniff(head: &[u8]) -> bool {
    head.starts_with(b"LASF")
}

/// Reads a LAS, LAZ or COPC file.
///
/// # Errors
/// I/O, a header that contradicts itself or the file's length (field named), a point format or
/// compression that is not known, damaged chunks, no point, or more than the options allow.
pub fn read(path: &Path, name: &str, options: &ReadOptions) -> Result<Asset, AssetError> {
    let file = File::open(path).map_err(|source| io_error(name, source))?;
    read_seekable(BufReader::with_capacity(1 << 18, file), name, options)
}

fn read_seekable<R: Read + Seek + Send + Sync>(
    mut reader: R,
    name: &str,
    options: &ReadOptions,
) -> Result<Asset, AssetError> {
    let mut warnings = Vec::new();
    let header = Header::read(&mut reader, name, &mut warnings)?;
    points::check_count(name, header.points, options)?;
    let bytes = header.points.saturating_mul(header.record_bytes as u64);
    if header.is_compressed && bytes > options.max_decompressed_bytes {
        return Err(AssetError::TooLarge {
            file: name.to_owned(),
            what: "number of decompressed bytes",
            found: bytes,
            limit: options.max_decompressed_bytes,
        });
    }
    let layout = Layout::of(&header);
    let columns = if header.is_compressed {
        compressed::read(reader, &header, &layout, name, options)?
    } else {
        read_plain(&mut reader, &header, &layout, name, options)?
    };
    options.progress.report(1.0);
    finish(columns, &header, warnings, name)
}

/// Records as they are; [`Header::read`] has checked that the file can hold them.
fn read_plain<R: Read + Seek>(
    reader: &mut R,
    header: &Header,
    layout: &Layout,
    name: &str,
    options: &ReadOptions,
) -> Result<Columns, AssetError> {
    let start = SeekFrom::Start(header.points_offset);
    reader.seek(start).map_err(|source| io_error(name, source))?;
    let mut columns = Columns::default();
    columns.reserve(header.points as usize, layout);
    let mut buffer = Vec::new();
    let mut point = 0;
    while point < header.points {
        let batch = BATCH.min(header.points - point);
        buffer.resize(batch as usize * header.record_bytes, 0);
        reader
            .read_exact(&mut buffer)
            .map_err(|error| malformed(name, format!("point {point}"), error.to_string()))?;
        columns.extend(&buffer, layout);
        point += batch;
        options.progress.report(point as f32 / header.points as f32);
    }
    Ok(columns)
}

fn finish(
    columns: Columns,
    header: &Header,
    mut warnings: Vec<String>,
    name: &str,
) -> Result<Asset, AssetError> {
    if columns.positions.is_empty() {
        let reason = match header.points {
            0 => "holds no points".to_owned(),
            points => format!("all of its {points} points are withheld or not finite"),
        };
        return Err(malformed(name, "file", reason));
    }
    warnings.extend(skipped_warning(columns.withheld, "flagged as withheld"));
    warnings.extend(skipped_warning(columns.not_finite, "no finite position"));
    fn unless_zero<T: PartialEq + Default>(column: Vec<T>) -> Option<Vec<T>> {
        column.iter().any(|value| *value != T::default()).then_some(column)
    }
    let cloud = PointCloud {
        positions: columns.positions,
        colors: colors_from_words(&columns.rgb),
        intensity: unless_zero(columns.intensity),
        classification: unless_zero(columns.classes),
        ..PointCloud::default()
    };
    let format = if header.is_compressed { "laz" } else { "las" };
    let mut asset = Asset::single(format, name, Geometry::Points(cloud));
    asset.warnings = warnings;
    Ok(asset)
}

#[cfg(test)]
mod tests;
