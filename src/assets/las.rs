//! Reader for LAS 1.0–1.4, LAZ and COPC.
//!
//! The header is read and checked against the file's length here ([`header`]) before anything is
//! allocated for it; point records are decoded from bytes ([`record`]). LAZ goes chunk by chunk
//! through the `laz` crate ([`compressed`]), several chunks at a time, each bounded by the chunk
//! table; items with GPS times have decoders here ([`gps_time`], [`point14`]). The `las` crate's own
//! reader sits above the `laz` crate, but trusts the number of variable length records, the chunk
//! table and the layer sizes, so that a few damaged bytes make it allocate gigabytes; it serves the
//! tests as the independent writer. A COPC file is read as the LAZ file that it is: all levels of its
//! octree together are the cloud.
//!
//! Colours may be 8-bit values in 16-bit fields, 8-bit values in their high bytes, or true 16-bit
//! values: what the whole file holds decides, and all zero means no colour. Withheld points are
//! skipped and counted.

mod compressed;
mod extra;
mod gps_time;
mod header;
mod point14;
mod record;

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use rayon::prelude::*;

use super::fields::Spans;
use super::points::{self, WordColors, io_error, malformed, skipped_warning};
use super::{Asset, AssetError, Geometry, PointCloud, ReadOptions};
use header::Header;
use record::{Columns, Layout};

/// Records of an uncompressed file that are read at a time.
const BATCH: u64 = 1 << 16;

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
    let header = open(&mut reader, name, options, &mut warnings)?;
    let layout = Layout::of(&header);
    points::admit(name, header.points, options)?;
    let extra_bytes = 8 * header.extra.len() as u64;
    options.admission.grow(name, header.points.saturating_mul(extra_bytes))?;
    let mut columns = Columns::default();
    if !header.is_compressed {
        columns.reserve(header.points as usize, &layout);
    }
    each_part(reader, &header, &layout, name, options, &mut |part, place| {
        options.admission.check()?;
        let reserved = columns.try_reserve(part.positions.len(), &layout);
        reserved.map_err(|reason| malformed(name, place, reason))?;
        columns.append(part);
        Ok(())
    })?;
    options.progress.report(1.0);
    finish(columns, &header, warnings, name)
}

/// The header, checked against the file and the options.
fn open<R: Read + Seek>(
    reader: &mut R,
    name: &str,
    options: &ReadOptions,
    warnings: &mut Vec<String>,
) -> Result<Header, AssetError> {
    let header = Header::read(reader, name, warnings)?;
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
    Ok(header)
}

/// Takes some of the points, in the file's order, with their place in the file.
type Visit<'a> = dyn FnMut(Columns, String) -> Result<(), AssetError> + Send + 'a;

fn each_part<R: Read + Seek + Send + Sync>(
    mut reader: R,
    header: &Header,
    layout: &Layout,
    name: &str,
    options: &ReadOptions,
    visit: &mut Visit,
) -> Result<(), AssetError> {
    if header.is_compressed {
        compressed::each_part(reader, header, layout, name, options, visit)
    } else {
        each_plain(&mut reader, header, layout, name, options, visit)
    }
}

/// Records as they are; [`Header::read`] has checked that the file can hold them. While one group of batches is decoded, the next
/// one is read.
fn each_plain<R: Read + Seek + Send>(
    reader: &mut R,
    header: &Header,
    layout: &Layout,
    name: &str,
    options: &ReadOptions,
    visit: &mut Visit,
) -> Result<(), AssetError> {
    let start = SeekFrom::Start(header.points_offset);
    reader.seek(start).map_err(|source| io_error(name, source))?;
    let group = BATCH * rayon::current_num_threads() as u64;
    let mut fill = |buffer: &mut Vec<u8>, point: u64| {
        let count = group.min(header.points - point);
        buffer.resize(count as usize * header.record_bytes, 0);
        reader
            .read_exact(buffer)
            .map_err(|error| malformed(name, format!("point {point}"), error.to_string()))
    };
    let (mut buffer, mut next) = (Vec::new(), Vec::new());
    fill(&mut buffer, 0)?;
    let mut point = 0;
    while point < header.points {
        let behind = header.points.min(point + group);
        let (parts, filled) = rayon::join(
            || decode(&buffer, header, layout),
            || if behind < header.points { fill(&mut next, behind) } else { Ok(()) },
        );
        for part in parts {
            visit(part, format!("point {point}"))?;
            point = behind.min(point + BATCH);
        }
        filled?;
        std::mem::swap(&mut buffer, &mut next);
        options.progress.report(point as f32 / header.points as f32);
    }
    Ok(())
}

/// The points of whole records, a [`BATCH`] of them a part.
fn decode(records: &[u8], header: &Header, layout: &Layout) -> Vec<Columns> {
    let batches = records.par_chunks(BATCH as usize * header.record_bytes);
    batches
        .map(|batch| {
            let mut part = Columns::default();
            part.reserve(batch.len() / header.record_bytes, layout);
            part.extend(batch, layout);
            part
        })
        .collect()
}

/// The points that the header announces.
pub(super) fn announced(path: &Path, name: &str, options: &ReadOptions) -> Result<u64, AssetError> {
    let mut file = File::open(path).map_err(|source| io_error(name, source))?;
    Ok(open(&mut file, name, options, &mut Vec::new())?.points)
}

/// Facts about all points of a file.
#[derive(Clone, Debug, Default)]
pub(super) struct Facts {
    is_compressed: bool,
    colors: WordColors,
    fields: Spans,
}

impl Facts {
    pub(super) fn format(&self) -> &'static str {
        if self.is_compressed { "laz" } else { "las" }
    }

    fn add(&mut self, columns: &Columns) {
        self.colors.add(&columns.rgb);
        self.fields.add(&columns.fields);
    }

    fn cloud(&self, columns: Columns) -> PointCloud {
        PointCloud {
            colors: self.colors.colors(&columns.rgb),
            positions: columns.positions,
            fields: self.fields.fields(columns.fields),
            ..PointCloud::default()
        }
    }
}

/// Calls `visit` with the points, some at a time. What colours are depends on the whole file: give what a first call has found to
/// a second one. Memory: that of some [`BATCH`]es, or chunks of a LAZ file.
///
/// # Errors
/// As [`read`]; those of `visit`.
pub(super) fn each(
    path: &Path,
    name: &str,
    options: &ReadOptions,
    known: Option<&Facts>,
    visit: &mut (dyn FnMut(PointCloud) -> Result<(), AssetError> + Send),
) -> Result<Facts, AssetError> {
    let file = File::open(path).map_err(|source| io_error(name, source))?;
    let mut reader = BufReader::with_capacity(1 << 18, file);
    let header = open(&mut reader, name, options, &mut Vec::new())?;
    let mut facts = Facts { is_compressed: header.is_compressed, ..Facts::default() };
    each_part(reader, &header, &Layout::of(&header), name, options, &mut |part, _| {
        facts.add(&part);
        visit(known.unwrap_or(&facts).cloud(part))
    })?;
    Ok(facts)
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
    let mut facts = Facts { is_compressed: header.is_compressed, ..Facts::default() };
    facts.add(&columns);
    warnings.extend(facts.fields.warning());
    let cloud = facts.cloud(columns);
    let mut asset = Asset::single(facts.format(), name, Geometry::Points(cloud));
    asset.warnings = warnings;
    Ok(asset)
}

#[cfg(test)]
pub(crate) mod tests;
