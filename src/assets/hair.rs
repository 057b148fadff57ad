//! Reader for the HAIR format of Cem Yuksel's hair models (<http://www.cemyuksel.com/research/hairmodels/>), little-endian.
//!
//! A header of 128 bytes tells how many strands and points there are and which arrays follow: numbers of segments (16 bits),
//! points, thicknesses, transparencies, colours. What has no array is the same everywhere and stands in the header. A
//! thickness is a diameter. Transparency is left out, with a warning.

use std::io::Read;

use glam::DVec3;

use super::input::{Input, Origin};
use super::strands::{Attributes, Paint, Strands, Vertex};
use super::{Asset, AssetError, ReadOptions};
use crate::memory::Meter;

const HEADER_BYTES: usize = 128;
/// Bits of the arrays that follow.
const SEGMENTS: u32 = 1;
const POINTS: u32 = 2;
const THICKNESS: u32 = 4;
const TRANSPARENCY: u32 = 8;
const COLORS: u32 = 16;
/// Arrays are read in such pieces.
const PIECE_BYTES: u64 = 1 << 20;

/// Reads a HAIR file from `input`.
///
/// # Errors
/// Malformed or truncated content (naming the array), counts that the file cannot hold or that are over the limits.
pub fn read_from(input: Input, options: &ReadOptions) -> Result<Asset, AssetError> {
    let Input { mut reader, origin } = input;
    let header = Header::read(&mut reader, &origin, options)?;
    let meter = origin.admission.meter(&origin.name);
    let mut arrays = Arrays { reader, file: &origin.name, meter, held: 0 };
    let mut array = |bit: u32, name: &'static str, count: u64, bytes: u64| {
        let is_there = header.arrays & bit != 0;
        let read = is_there.then(|| arrays.read(name, count * bytes));
        read.transpose()
    };
    let segments = array(SEGMENTS, "segments", header.strands, 2)?;
    let points = array(POINTS, "points", header.points, 12)?.unwrap_or_default();
    let thickness = array(THICKNESS, "thickness", header.points, 4)?;
    let mut warnings = Vec::new();
    if array(TRANSPARENCY, "transparency", header.points, 4)?.is_some() || header.transparency > 0.0
    {
        warnings.push("transparency is left out: strands are opaque".to_owned());
    }
    let colors = array(COLORS, "colours", header.points, 12)?;
    if arrays.reader.read(&mut [0]).map_err(|source| AssetError::io(&origin.name, source))? > 0 {
        warnings.push("what follows the arrays is ignored".to_owned());
    }
    let attributes = Attributes { radii: true, paint: Paint::Bytes, columns: Vec::new() };
    let mut strands = Strands::new(&origin, options, attributes);
    strands.reserve(header.points as usize)?;
    let mut vertices = points.as_chunks::<12>().0.iter().enumerate();
    for strand in 0..header.strands {
        let segments = match &segments {
            Some(list) => u64::from(u16::from_le_bytes(
                list.as_chunks().0.get(strand as usize).copied().unwrap_or_default(),
            )),
            None => header.segments.into(),
        };
        for _ in 0..=segments {
            let Some((at, point)) = vertices.next() else {
                let reason = format!(
                    "it has {segments} segments, but there are {} points only",
                    header.points
                );
                let place = format!("strand {strand}");
                return Err(AssetError::malformed(&origin.name, place, reason));
            };
            let [x, y, z] = vector(point);
            let diameter = match &thickness {
                Some(list) => float(list, at),
                None => header.thickness,
            };
            let color = match &colors {
                Some(list) => list.as_chunks().0.get(at).map_or(header.color, vector),
                None => header.color,
            };
            let [r, g, b] = color.map(|channel| (channel * 255.0).round().clamp(0.0, 255.0));
            strands.vertex(Vertex {
                position: DVec3::new(x.into(), y.into(), z.into()),
                radius: 0.5 * diameter,
                color: [r, g, b, 255.0],
                values: &[],
            })?;
        }
        strands.cut()?;
    }
    if let Some((at, _)) = vertices.next() {
        let reason = format!(
            "the {} strands have {at} points, the header announces {}",
            header.strands, header.points
        );
        return Err(AssetError::malformed(&origin.name, "points", reason));
    }
    strands.into_asset("hair", warnings)
}

struct Header {
    strands: u64,
    points: u64,
    arrays: u32,
    segments: u32,
    thickness: f32,
    transparency: f32,
    color: [f32; 3],
}

impl Header {
    fn read(
        reader: &mut impl Read,
        origin: &Origin,
        options: &ReadOptions,
    ) -> Result<Header, AssetError> {
        let file = origin.name.as_str();
        let mut bytes = Vec::with_capacity(HEADER_BYTES);
        let read = reader.take(HEADER_BYTES as u64).read_to_end(&mut bytes);
        read.map_err(|source| AssetError::io(file, source))?;
        if !bytes.starts_with(b"HAIR") {
            return Err(AssetError::malformed(file, "header", "does not begin with HAIR"));
        }
        if bytes.len() < HEADER_BYTES {
            let reason = format!("the file ends after {} of {HEADER_BYTES} bytes", bytes.len());
            return Err(AssetError::malformed(file, "header", reason));
        }
        let word = |at: usize| {
            u32::from_le_bytes(bytes.as_chunks().0.get(at).copied().unwrap_or_default())
        };
        let header = Header {
            strands: word(1).into(),
            points: word(2).into(),
            arrays: word(3),
            segments: word(4),
            thickness: f32::from_bits(word(5)),
            transparency: f32::from_bits(word(6)),
            color: [7, 8, 9].map(|at| f32::from_bits(word(at))),
        };
        if header.arrays & POINTS == 0 {
            return Err(AssetError::malformed(file, "header", "the file has no points"));
        }
        let most = options.max_vertices.min(u64::from(u32::MAX));
        AssetError::check_limit(file, "vertices", header.points, most)?;
        origin.check_count("header, number of points", header.points, 12)?;
        // A strand has a point at least.
        if header.strands > header.points {
            let reason =
                format!("{} strands need more than {} points", header.strands, header.points);
            return Err(AssetError::malformed(file, "header, number of strands", reason));
        }
        Ok(header)
    }
}

/// The arrays, in their order.
struct Arrays<'a, R> {
    reader: R,
    file: &'a str,
    meter: Meter<'a>,
    /// Bytes of those that have been read.
    held: u64,
}

impl<R: Read> Arrays<'_, R> {
    fn read(&mut self, name: &str, bytes: u64) -> Result<Vec<u8>, AssetError> {
        let mut array = Vec::new();
        while (array.len() as u64) < bytes {
            let piece = (bytes - array.len() as u64).min(PIECE_BYTES);
            self.held += piece;
            self.meter.reach(self.held)?;
            let got = (&mut self.reader).take(piece).read_to_end(&mut array);
            if (got.map_err(|source| AssetError::io(self.file, source))? as u64) < piece {
                let reason = format!("the file ends after {} of {bytes} bytes", array.len());
                return Err(AssetError::malformed(self.file, format!("array of {name}"), reason));
            }
        }
        Ok(array)
    }
}

fn float(list: &[u8], at: usize) -> f32 {
    list.as_chunks().0.get(at).map_or(f32::NAN, |bytes| f32::from_le_bytes(*bytes))
}

fn vector(bytes: &[u8; 12]) -> [f32; 3] {
    [0, 1, 2].map(|at| float(bytes, at))
}

#[cfg(test)]
mod tests;
