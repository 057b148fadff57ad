//! Reader for the track files of MRtrix: a header of text lines `key: value` up to `END`, then triples of floats.
//!
//! A triple of NaN ends a streamline, a triple of infinities the file. `datatype` names the floats and their byte order, `file`
//! the byte at which they begin. Coordinates are millimetres, x to the right, y to the front, z up. `count` is what the
//! program that wrote the header believed; a file that ends with its triple of infinities is whole whatever it says.
//! Streamlines have the colours of their directions.

use std::io::{BufRead, Read};

use glam::DVec3;

use super::input::{Input, Origin};
use super::strands::{Attributes, Paint, Strands, Vertex};
use super::tokens::shown;
use super::{Asset, AssetError, ReadOptions};

const MAGIC: &str = "mrtrix tracks";
/// Longer headers are refused; those of MRtrix hold a history of commands.
const MAX_HEADER_BYTES: u64 = 4 << 20;
/// Bytes that are decoded at a time, a whole number of triples of any type.
const BLOCK_BYTES: usize = 48 << 12;

/// Reads a track file from `input`.
///
/// # Errors
/// Malformed or truncated content, counts over the limits.
pub fn read_from(input: Input, options: &ReadOptions) -> Result<Asset, AssetError> {
    let Input { mut reader, origin } = input;
    let file = origin.name.as_str();
    let header = header(&mut reader, file)?;
    let fail = |reason: String| AssetError::malformed(file, "header, file", reason);
    if header.offset > origin.max_bytes {
        let reason =
            format!("the data begin at byte {}, behind the end of the file", header.offset);
        return Err(fail(reason));
    }
    let gap = header.offset.checked_sub(header.bytes).ok_or_else(|| {
        fail(format!("the data begin at byte {}, inside the header", header.offset))
    })?;
    let skipped = std::io::copy(&mut (&mut reader).take(gap), &mut std::io::sink());
    if skipped.map_err(|source| AssetError::io(file, source))? < gap {
        return Err(fail(format!("the data begin at byte {}, behind the end", header.offset)));
    }
    let attributes = Attributes { paint: Paint::Direction, ..Attributes::nothing() };
    let mut strands = Strands::new(&origin, options, attributes);
    let triples = (origin.max_bytes - header.offset) / header.float.triple_bytes() as u64;
    if origin.exact {
        // All but the last triple may be vertices.
        let most = options.max_vertices.min(u64::from(u32::MAX));
        strands.reserve(triples.saturating_sub(1).min(most) as usize)?;
    }
    let streamlines = data(&mut reader, header.float, &origin, &mut strands)?;
    let mut warnings = Vec::new();
    if let Some(count) = header.count.filter(|count| *count != streamlines) {
        warnings
            .push(format!("the header counts {count} streamlines, the file holds {streamlines}"));
    }
    strands.into_asset("tck", warnings)
}

/// The type of the file's floats.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Float {
    is_double: bool,
    is_big: bool,
}

impl Float {
    fn of(name: &str) -> Option<Float> {
        let (is_double, order) = match name.strip_prefix("Float64") {
            Some(order) => (true, order),
            None => (false, name.strip_prefix("Float32")?),
        };
        match order {
            "LE" => Some(Float { is_double, is_big: false }),
            "BE" => Some(Float { is_double, is_big: true }),
            // The order of the machine that wrote it. There are hardly any others.
            "" => Some(Float { is_double, is_big: false }),
            _ => None,
        }
    }

    fn triple_bytes(self) -> usize {
        if self.is_double { 24 } else { 12 }
    }

    fn decode(self, bytes: &[u8]) -> DVec3 {
        if self.is_double {
            let number = |of: fn([u8; 8]) -> f64| {
                let numbers = bytes.as_chunks::<8>().0;
                DVec3::from_array([0, 1, 2].map(|at| numbers.get(at).map_or(f64::NAN, |b| of(*b))))
            };
            number(if self.is_big { f64::from_be_bytes } else { f64::from_le_bytes })
        } else {
            let number = |of: fn([u8; 4]) -> f32| {
                let numbers = bytes.as_chunks::<4>().0;
                let at = |at: usize| numbers.get(at).map_or(f32::NAN, |b| of(*b));
                DVec3::new(at(0).into(), at(1).into(), at(2).into())
            };
            number(if self.is_big { f32::from_be_bytes } else { f32::from_le_bytes })
        }
    }
}

struct Header {
    float: Float,
    offset: u64,
    count: Option<u64>,
    /// Bytes up to and with the line `END`.
    bytes: u64,
}

fn header(reader: &mut impl BufRead, file: &str) -> Result<Header, AssetError> {
    let fail = |place: String, reason: String| AssetError::malformed(file, place, reason);
    let mut bytes = 0;
    let mut line = Vec::new();
    let mut number = 0;
    let (mut float, mut offset, mut count) = (None, None, None);
    loop {
        line.clear();
        number += 1;
        let read = reader
            .take(MAX_HEADER_BYTES - bytes)
            .read_until(b'\n', &mut line)
            .map_err(|source| AssetError::io(file, source))?;
        bytes += read as u64;
        let place = || format!("header line {number}");
        let is_first = number == 1;
        if is_first && line.trim_ascii() != MAGIC.as_bytes() {
            let reason =
                format!("is {}; a track file begins with \"{MAGIC}\"", shown(line.trim_ascii()));
            return Err(fail(place(), reason));
        }
        if line.last() != Some(&b'\n') {
            let reason = format!(
                "the header does not end here: END is missing within {MAX_HEADER_BYTES} bytes"
            );
            return Err(fail(place(), reason));
        }
        let text = String::from_utf8_lossy(&line);
        let text = text.trim();
        if text == "END" {
            break;
        }
        let Some((key, value)) = text.split_once(':') else {
            if is_first || text.is_empty() {
                continue;
            }
            let reason = format!("{} is no \"key: value\"", shown(text.as_bytes()));
            return Err(fail(place(), reason));
        };
        let value = value.trim();
        match key.trim() {
            "datatype" => {
                let found = Float::of(value).ok_or_else(|| {
                    let accepted = "accepted are Float32LE, Float32BE, Float64LE and Float64BE";
                    let reason =
                        format!("datatype {} is unknown; {accepted}", shown(value.as_bytes()));
                    fail(place(), reason)
                })?;
                float = Some(found);
            }
            "file" => {
                let found = value.strip_prefix('.').and_then(|at| at.trim().parse().ok());
                offset = Some(found.ok_or_else(|| {
                    let shown = shown(value.as_bytes());
                    let reason = format!(
                        "file {shown} names no place in this file; accepted is \". BYTES\""
                    );
                    fail(place(), reason)
                })?);
            }
            // A count that is none tells nothing.
            "count" => count = value.parse().ok(),
            _ => {}
        }
    }
    let missing = |key: &str| fail("header".to_owned(), format!("has no line \"{key}: …\""));
    Ok(Header {
        float: float.ok_or_else(|| missing("datatype"))?,
        // Without it the data follow the header.
        offset: offset.unwrap_or(bytes),
        count,
        bytes,
    })
}

/// Reads the triples up to the one that ends the file. Returns the number of streamlines.
fn data(
    reader: &mut impl Read,
    float: Float,
    origin: &Origin,
    strands: &mut Strands,
) -> Result<u64, AssetError> {
    let file = origin.name.as_str();
    let mut block = Vec::with_capacity(BLOCK_BYTES);
    let mut streamlines = 0;
    let mut is_open = false;
    loop {
        block.clear();
        let wish = BLOCK_BYTES as u64;
        let got = reader
            .take(wish)
            .read_to_end(&mut block)
            .map_err(|source| AssetError::io(file, source))?;
        let mut triples = block.chunks_exact(float.triple_bytes());
        while triples.len() > 0 {
            let is_finite = |bytes: &&[u8]| float.decode(bytes).is_finite();
            let vertices = triples.clone().take_while(is_finite).count();
            if vertices > 0 {
                is_open = true;
                strands.places((&mut triples).take(vertices).map(|bytes| float.decode(bytes)))?;
            }
            let Some(position) = triples.next().map(|bytes| float.decode(bytes)) else { break };
            if position.is_nan_mask().all() {
                streamlines += u64::from(is_open);
                is_open = false;
                strands.cut()?;
            } else if position.to_array().into_iter().all(f64::is_infinite) {
                streamlines += u64::from(is_open);
                return Ok(streamlines);
            } else {
                is_open = true;
                strands.vertex(Vertex::at(position))?;
            }
        }
        if (got as u64) < wish {
            let place = format!("streamline {streamlines}, after {} vertices", strands.came());
            let reason = "the file ends without the triple of infinities that ends track files: it is truncated";
            return Err(AssetError::malformed(file, place, reason));
        }
    }
}

#[cfg(test)]
mod tests;
