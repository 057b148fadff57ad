//! Reader for the track files of TrackVis, versions 1 to 3, in both byte orders.
//!
//! A header of 1000 bytes is followed by streamlines: a number of points, then for each point x, y, z and its scalars, then the
//! properties of the streamline. The byte order is the one in which the header's own size reads 1000. Scalars and properties
//! become scalar fields; properties are the same along a streamline. Scalars called `color` or `rgb` are colours, otherwise
//! streamlines have the colours of their directions.
//!
//! Coordinates become millimetres, x to the right, y to the front, z up ([`header`]).

mod header;

use std::io::Read;

use glam::{DAffine3, DVec3};

use self::header::{HEADER_BYTES, Header, Order};
use super::fields::{self, Column, Numbers};
use super::input::Input;
use super::strands::{Attributes, Paint, Strands, Vertex};
use super::{Asset, AssetError, ReadOptions};
use crate::memory::Meter;

/// Bytes that are decoded at a time, if a point has no more.
const BLOCK_BYTES: usize = 64 << 10;
/// A longer streamline is read in such pieces.
const PIECE_BYTES: usize = 1 << 20;
/// Names of scalars that are colours.
pub(super) const COLORS: [&str; 5] = ["color", "colors", "colour", "colours", "rgb"];

/// Reads a track file from `input`.
///
/// # Errors
/// Malformed or truncated content (naming streamline and part), counts that the file cannot hold or that are over the limits.
pub fn read_from(input: Input, options: &ReadOptions) -> Result<Asset, AssetError> {
    let Input { mut reader, origin } = input;
    let file = origin.name.as_str();
    let mut bytes = Vec::with_capacity(HEADER_BYTES);
    let took = (&mut reader).take(HEADER_BYTES as u64).read_to_end(&mut bytes);
    took.map_err(|source| AssetError::io(file, source))?;
    let mut warnings = Vec::new();
    let header = Header::parse(&bytes, file, &mut warnings)?;
    // Every streamline has at least its number of points and its properties.
    origin.check_count("header, n_count", header.count, header.streamline_bytes() as u64)?;
    let paint = if header.color.is_some() { Paint::Floats } else { Paint::Direction };
    let attributes = Attributes { radii: false, paint, columns: columns(&header) };
    let mut strands = Strands::new(&origin, options, attributes);
    if origin.exact {
        let points = (origin.max_bytes - HEADER_BYTES as u64) / header.point_bytes() as u64;
        strands.reserve(points.min(options.max_vertices.min(u64::from(u32::MAX))) as usize)?;
    }
    let mut body = Body {
        reader,
        file,
        order: header.order,
        ras_from_file: header.ras_from_file,
        point_bytes: header.point_bytes(),
        left: origin.exact.then(|| origin.max_bytes - HEADER_BYTES as u64),
        block: Vec::new(),
        meter: origin.admission.meter(file),
        color: header.color,
        scalars: header.scalars.len(),
        properties: vec![0.0; header.properties.len()],
        values: Vec::new(),
        streamline: 0,
    };
    body.all(header.count, &mut strands, &mut warnings)?;
    strands.into_asset("trk", warnings)
}

/// A column for each scalar that is no colour, then one for each property.
fn columns(header: &Header) -> Vec<Column> {
    let scalars = header.scalars.iter().enumerate();
    let scalars = scalars.filter(|(at, _)| header.color.is_none_or(|color| !color.contains(at)));
    let names = scalars.map(|(_, name)| name).chain(&header.properties);
    names.map(|name| Column::of(&fields::name_of(name), Numbers::Singles(Vec::new()))).collect()
}

/// The streamlines.
struct Body<'a, R> {
    reader: R,
    file: &'a str,
    order: Order,
    ras_from_file: DAffine3,
    point_bytes: usize,
    /// Bytes that follow, where that is known.
    left: Option<u64>,
    block: Vec<u8>,
    meter: Meter<'a>,
    /// Which scalars are the channels of a colour.
    color: Option<[usize; 3]>,
    scalars: usize,
    properties: Vec<f32>,
    /// Those of a vertex.
    values: Vec<f32>,
    streamline: u64,
}

impl<R: Read> Body<'_, R> {
    fn fail(&self, part: &str, reason: String) -> AssetError {
        AssetError::malformed(self.file, format!("streamline {}{part}", self.streamline), reason)
    }

    /// Reads `count` streamlines, or all up to the end of the file if that is 0.
    fn all(
        &mut self,
        count: u64,
        strands: &mut Strands,
        warnings: &mut Vec<String>,
    ) -> Result<(), AssetError> {
        while count == 0 || self.streamline < count {
            let got = self.take(4)?;
            match *self.block {
                [] if count == 0 => return Ok(()),
                [a, b, c, d] => {
                    let points = self.order.int([a, b, c, d]);
                    self.streamline(points, strands)?;
                }
                _ => {
                    let reason = match count {
                        0 => format!("the file ends after {got} of 4 bytes"),
                        count => {
                            format!("the file ends here, after {} of {count}", self.streamline)
                        }
                    };
                    return Err(self.fail(", number of points", reason));
                }
            }
            self.streamline += 1;
        }
        if self.take(1)? > 0 {
            warnings.push(format!(
                "what follows the {count} streamlines that the header counts is ignored"
            ));
        }
        Ok(())
    }

    fn streamline(&mut self, points: i32, strands: &mut Strands) -> Result<(), AssetError> {
        let properties = 4 * self.properties.len();
        let Ok(points) = u64::try_from(points) else {
            return Err(self.fail(", number of points", format!("{points} is negative")));
        };
        let bytes = points * self.point_bytes as u64 + properties as u64;
        if let Some(left) = self.left.filter(|left| *left < bytes) {
            let reason = format!("{points} points take {bytes} bytes, but {left} follow");
            return Err(self.fail(", number of points", reason));
        }
        // Properties come last, and each vertex has them.
        if properties == 0 {
            let most = (BLOCK_BYTES / self.point_bytes) as u64;
            let mut done = 0;
            while done < points {
                let batch = most.min(points - done);
                self.fill(batch as usize * self.point_bytes)?;
                self.vertices(self.block.len(), strands)?;
                done += batch;
            }
        } else {
            let wish = usize::try_from(bytes).unwrap_or(usize::MAX);
            self.fill(wish)?;
            let end = wish - properties;
            let numbers = self.block[end..].as_chunks::<4>().0;
            for (property, bytes) in self.properties.iter_mut().zip(numbers) {
                *property = self.order.float(*bytes);
            }
            self.vertices(end, strands)?;
        }
        strands.cut()
    }

    /// Adds the points in the first bytes of the block.
    fn vertices(&mut self, bytes: usize, strands: &mut Strands) -> Result<(), AssetError> {
        let (order, color, ras_from_file) = (self.order, self.color, self.ras_from_file);
        let points = self.block[..bytes].chunks_exact(self.point_bytes);
        let number = |numbers: &[[u8; 4]], at: usize| {
            numbers.get(at).map_or(f32::NAN, |bytes| order.float(*bytes))
        };
        let position = |point: &[u8]| {
            let numbers = point.as_chunks::<4>().0;
            let place = [0, 1, 2].map(|at| f64::from(number(numbers, at)));
            ras_from_file.transform_point3(DVec3::from_array(place))
        };
        let has_places_alone = self.scalars == 0 && self.properties.is_empty();
        if has_places_alone && points.clone().all(|point| position(point).is_finite()) {
            return strands.places(points.map(position));
        }
        for point in points {
            let numbers = point.as_chunks::<4>().0;
            let number = |at: usize| number(numbers, at);
            let mut vertex = Vertex::at(position(point));
            if self.scalars > 0 || !self.properties.is_empty() {
                self.values.clear();
                for at in 0..self.scalars {
                    if color.is_none_or(|color| !color.contains(&at)) {
                        self.values.push(number(3 + at));
                    }
                }
                self.values.extend_from_slice(&self.properties);
                vertex.values = &self.values;
                if let Some([r, g, b]) = color {
                    vertex.color = [number(3 + r), number(3 + g), number(3 + b), f32::NAN];
                }
            }
            strands.vertex(vertex)?;
        }
        Ok(())
    }

    /// Reads up to `bytes` into the block. Returns how many there were.
    fn take(&mut self, bytes: usize) -> Result<usize, AssetError> {
        self.block.clear();
        while self.block.len() < bytes {
            // A streamline may be longer than the file; memory is granted for what comes of it.
            let piece = (bytes - self.block.len()).min(PIECE_BYTES) as u64;
            self.meter.reach(self.block.len() as u64 + piece)?;
            let took = (&mut self.reader).take(piece).read_to_end(&mut self.block);
            if (took.map_err(|source| AssetError::io(self.file, source))? as u64) < piece {
                break;
            }
        }
        let got = self.block.len();
        self.left = self.left.map(|left| left.saturating_sub(got as u64));
        Ok(got)
    }

    /// Reads exactly `bytes` into the block.
    fn fill(&mut self, bytes: usize) -> Result<(), AssetError> {
        let got = self.take(bytes)?;
        if got == bytes {
            return Ok(());
        }
        let point = got / self.point_bytes;
        Err(self.fail(
            "",
            format!("the file ends {got} bytes behind its number of points, at point {point}"),
        ))
    }
}

#[cfg(test)]
mod tests;
