//! Reader for TRX tractograms (<https://github.com/tee-ar-ex/trx-spec>): a ZIP archive of little-endian arrays, stored or deflated.
//!
//! | entry | holds |
//! |---|---|
//! | `header.json` | `NB_STREAMLINES` and `NB_VERTICES`; the grid of voxels, which is not needed |
//! | `positions.3.TYPE` | vertices as float16, float32 or float64: millimetres, x to the right, y to the front, z up |
//! | `offsets.TYPE` | the first vertex of each streamline as uint32 or uint64, and, in most files, the number of vertices |
//! | `dpv/NAME.TYPE`, `dpv/NAME.COLUMNS.TYPE` | data of vertices |
//! | `dps/NAME.TYPE`, `dps/NAME.COLUMNS.TYPE` | data of streamlines |
//! | `groups/NAME.uint32` | numbers of the streamlines of a group |
//! | `dpg/…` | data of groups, which are ignored |
//!
//! Data become scalar fields, rounded to 32-bit floats, with a number for each column: `NAME_0`, `NAME_1`. Those of streamlines are
//! the same along a streamline. A group is a field that is 1 in the group and 0 outside. Three columns called `color` or `rgb` are
//! colours, otherwise streamlines have the colours of their directions.
//!
//! Counts of the header are claims that the sizes of arrays must match. Data and offsets are in memory as the file has them while
//! positions are read in blocks.

mod archive;
mod array;
mod contents;
mod table;

use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::path::Path;

use glam::DVec3;
use serde::Deserialize;

use self::archive::{Archive, Entry, whole};
use self::array::Array;
use self::contents::Contents;
use self::table::Table;
use super::points::io_error;
use super::strands::{Attributes, Paint, Strands, Vertex};
use super::{Asset, AssetError, ReadOptions, quiet};

/// Larger headers are refused.
const MAX_HEADER_BYTES: u64 = 1 << 20;
/// The directory of an archive is read in many small pieces, and each moves the file's place.
const BUFFER_BYTES: usize = 16 << 10;

/// Reads the file at `path`; `name` begins every error.
///
/// # Errors
/// A damaged archive, entries that are encrypted, missing or of another size than the header says, offsets that decrease or leave
/// the file's vertices (entry and streamline named), or more vertices or decompressed bytes than the options allow.
pub fn read(path: &Path, name: &str, options: &ReadOptions) -> Result<Asset, AssetError> {
    let file = File::open(path).map_err(|source| io_error(name, source))?;
    let reader = BufReader::with_capacity(BUFFER_BYTES, file);
    // The crate returns errors, but may meet damage that nobody foresaw.
    quiet::catch(|| read_seekable(reader, name, options)).unwrap_or_else(|| {
        Err(AssetError::malformed(name, "file", "is damaged: the decoder gave up"))
    })
}

fn read_seekable<R: Read + Seek>(
    reader: R,
    name: &str,
    options: &ReadOptions,
) -> Result<Asset, AssetError> {
    let mut archive = Archive::open(reader, name, options)?;
    let mut warnings = Vec::new();
    let Contents { header, positions, offsets, data } =
        Contents::of(archive.entries()?, name, &mut warnings)?;
    let arrays = data.iter().map(|(_, array)| &array.entry);
    archive.expect([&header, &positions.entry, &offsets.entry].into_iter().chain(arrays))?;
    let header = Header::read(&mut archive, &header, name)?;
    let most_vertices = options.max_vertices.min(u64::from(u32::MAX));
    AssetError::check_limit(name, "vertices", header.vertices, most_vertices)?;
    positions.check_rows(name, header.vertices, "vertices")?;
    let offsets = Offsets::read(&mut archive, offsets, &header, name)?;
    let mut tables = Vec::new();
    for (per, array) in data {
        tables.push(Table::read(&mut archive, per, array, &header, name, options)?);
    }
    let color = tables.iter().position(Table::is_color).map(|at| tables.remove(at));
    let paint = color.as_ref().map_or(Paint::Direction, |table| match table.kind.name {
        "uint8" => Paint::Bytes,
        _ => Paint::Floats,
    });
    let columns = tables.iter().flat_map(Table::fields).collect();
    let attributes = Attributes { radii: false, paint, columns };
    let mut strands = Strands::within(name, &options.admission, most_vertices, attributes);
    if positions.entry.is_stored {
        strands.reserve(header.vertices as usize)?;
    }
    let (mut number, mut streamline) = (0, 0);
    let mut values = Vec::new();
    let bytes = positions.kind.bytes;
    archive.blocks(&positions.entry, |block| {
        for place in block.chunks_exact(3 * bytes) {
            while offsets.begin(streamline + 1) <= number {
                strands.cut()?;
                streamline += 1;
            }
            let coordinate = |axis: usize| positions.kind.number(&place[axis * bytes..]);
            let position = DVec3::new(coordinate(0), coordinate(1), coordinate(2));
            let mut vertex = Vertex::at(position);
            values.clear();
            tables.iter().for_each(|table| values.extend(table.row(number, streamline)));
            vertex.values = &values;
            if let Some(table) = &color {
                let opaque = if paint == Paint::Bytes { 255.0 } else { f32::NAN };
                let channels = table.row(number, streamline).chain([opaque]);
                vertex.color.iter_mut().zip(channels).for_each(|(to, channel)| *to = channel);
            }
            strands.vertex(vertex)?;
            number += 1;
        }
        Ok(())
    })?;
    strands.into_asset("trx", warnings)
}

/// The counts that the header claims.
#[derive(Debug, Deserialize)]
struct Header {
    #[serde(rename = "NB_STREAMLINES")]
    streamlines: u64,
    #[serde(rename = "NB_VERTICES")]
    vertices: u64,
}

impl Header {
    fn read<R: Read + Seek>(
        archive: &mut Archive<'_, R>,
        entry: &Entry,
        file: &str,
    ) -> Result<Header, AssetError> {
        let fail = |reason: String| AssetError::malformed(file, &*entry.place, reason);
        if entry.bytes > MAX_HEADER_BYTES {
            return Err(fail(format!(
                "has {} bytes; up to {MAX_HEADER_BYTES} are read",
                entry.bytes
            )));
        }
        serde_json::from_slice(&archive.read(entry)?).map_err(|error| {
            fail(format!(
                "{error}; an object with whole NB_STREAMLINES and NB_VERTICES is accepted"
            ))
        })
    }
}

/// The first vertex of each streamline, not decreasing, and behind them the number of vertices.
struct Offsets {
    bytes: Vec<u8>,
    width: usize,
    vertices: u64,
}

impl Offsets {
    fn read<R: Read + Seek>(
        archive: &mut Archive<'_, R>,
        array: Array,
        header: &Header,
        file: &str,
    ) -> Result<Offsets, AssetError> {
        let Header { streamlines, vertices } = *header;
        let has_end = u128::from(array.entry.bytes)
            == (u128::from(streamlines) + 1) * array.kind.bytes as u128;
        if !has_end {
            array.check_rows(file, streamlines, "streamlines")?;
        }
        let bytes = archive.read(&array.entry)?;
        let offsets = Offsets { bytes, width: array.kind.bytes, vertices };
        let mut before = 0;
        for streamline in 0..=streamlines {
            let begin = offsets.begin(streamline);
            let reason = if streamline == 0 && begin != 0 {
                "the first one begins at vertex 0".to_owned()
            } else if begin < before {
                format!("the one before begins at {before}, and offsets do not decrease")
            } else if begin > vertices {
                format!("header.json counts {vertices} vertices")
            } else if streamline == streamlines && begin != vertices {
                format!("the last offset is the number of vertices, {vertices}")
            } else {
                before = begin;
                continue;
            };
            let place = format!("{}, streamline {streamline}", array.entry.place);
            return Err(AssetError::malformed(
                file,
                place,
                format!("begins at vertex {begin}; {reason}"),
            ));
        }
        Ok(offsets)
    }

    /// The first vertex of a streamline. Many files leave the end of the last one to the header.
    fn begin(&self, streamline: u64) -> u64 {
        let at = self.width * streamline as usize;
        self.bytes.get(at..at + self.width).map_or(self.vertices, whole)
    }
}

#[cfg(test)]
mod tests;
