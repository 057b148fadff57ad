//! Reader for PCD (Point Cloud Library): `ascii`, `binary` and `binary_compressed`.
//!
//! A text header names the fields of a point with their sizes, types and counts, in any order;
//! x, y, z, colour (packed in one field or in three) and normal are taken, and other fields of one value
//! become scalar fields. The body is a stream: text rows, packed little-endian records, or — in
//! `binary_compressed` — one LZF block ([`lzf`]) that holds field after field. Organised clouds
//! (height above 1) mark pixels without depth by NaN; those are skipped. `VIEWPOINT` is where the
//! sensor stood, and as in the Point Cloud Library does not move the points. It gives the first view ([`sensor`]).

mod header;
mod lzf;
mod sensor;

use std::collections::HashSet;
use std::io::{BufRead, Read};
use std::path::Path;

use glam::DVec3;

use super::fields::{self, Column, INTENSITY};
use super::points::{
    self, Lines, colors, io_error, malformed, quote, skipped_warning, unit_or_zero,
};
use super::{Asset, AssetError, Geometry, PointCloud, ReadOptions};
use crate::math::Sensor;
use header::{Body, Field, Header, Wanted};
use sensor::Raster;

/// Points that are read at a time.
const BATCH: u64 = 1 << 14;

/// Reads a PCD file.
///
/// # Errors
/// I/O, a header that lacks or contradicts itself in a field (named), a body that is shorter than
/// the header announces, a damaged compressed block, no finite point, more than the options allow.
pub fn read(path: &Path, name: &str, options: &ReadOptions) -> Result<Asset, AssetError> {
    read_from(points::open(path, name, options)?, name, options)
}

/// Like [`read`], from a stream.
///
/// # Errors
/// See [`read`].
pub fn read_from(
    reader: impl BufRead,
    name: &str,
    options: &ReadOptions,
) -> Result<Asset, AssetError> {
    let mut lines = Lines::new(reader, name, options);
    let header = Header::read(&mut lines, name)?;
    points::check_count(name, header.points, options)?;
    let body_bytes = header.points.saturating_mul(header.stride as u64);
    if header.body != Body::Ascii && body_bytes > options.max_decompressed_bytes {
        return Err(AssetError::TooLarge {
            file: name.to_owned(),
            what: "number of bytes",
            found: body_bytes,
            limit: options.max_decompressed_bytes,
        });
    }
    points::admit(name, header.points, options)?;
    let scalar_bytes = 8 * scalars(&header).len() as u64;
    options.admission.grow(name, header.points.saturating_mul(scalar_bytes))?;
    if header.body == Body::Compressed {
        options.admission.grow(name, body_bytes.saturating_mul(2))?;
    }
    let mut columns = Columns::new(&header);
    match header.body {
        Body::Ascii => read_ascii(&mut lines, &header, &mut columns, name)?,
        Body::Binary => read_binary(&mut lines.into_inner(), &header, &mut columns, name)?,
        Body::Compressed => read_compressed(&mut lines.into_inner(), &header, &mut columns, name)?,
    }
    options.progress.report(1.0);
    columns.finish(&header, name)
}

fn read_ascii(
    lines: &mut Lines<impl BufRead>,
    header: &Header,
    columns: &mut Columns,
    name: &str,
) -> Result<(), AssetError> {
    // For each text column the field that wants it.
    let mut takers = vec![None; header.fields.iter().map(|field| field.count).sum()];
    let mut column = 0;
    for field in &header.fields {
        if let Some(slot) = takers.get_mut(column) {
            *slot = field.wanted.map(|wanted| (wanted, field));
        }
        column += field.count;
    }
    let mut row = Row::of(columns);
    let mut point = 0;
    while point < header.points {
        let number = lines.number() + 1;
        let Some(line) = lines.next_line()? else { return Err(truncated(name, header, point)) };
        let line = line.trim_start();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let mut column = 0;
        for token in line.split_ascii_whitespace() {
            if let Some(&Some((wanted, field))) = takers.get(column) {
                let Some(value) = field.parse(token) else {
                    let place = format!("point {point}, property {} (line {number})", field.name);
                    let reason = format!("{} is not a number of its type", quote(token));
                    return Err(malformed(name, place, reason));
                };
                row.set(wanted, value);
            }
            column += 1;
        }
        if column != takers.len() {
            let place = format!("point {point} (line {number})");
            let reason = format!("has {column} columns, the header asks for {}", takers.len());
            return Err(malformed(name, place, reason));
        }
        columns.push(&row);
        point += 1;
    }
    Ok(())
}

fn read_binary(
    reader: &mut impl Read,
    header: &Header,
    columns: &mut Columns,
    name: &str,
) -> Result<(), AssetError> {
    let wanted: Vec<(Wanted, &Field)> = header.wanted().collect();
    let mut buffer = Vec::new();
    let mut row = Row::of(columns);
    let mut point = 0;
    while point < header.points {
        let batch = BATCH.min(header.points - point);
        let bytes = batch * header.stride as u64;
        buffer.clear();
        let count = reader.take(bytes).read_to_end(&mut buffer).map_err(|e| io_error(name, e))?;
        for record in buffer.chunks_exact(header.stride) {
            for &(wanted, field) in &wanted {
                row.set(wanted, field.decode(&record[field.offset..]));
            }
            columns.push(&row);
        }
        if (count as u64) < bytes {
            return Err(truncated(name, header, point + (count / header.stride) as u64));
        }
        point += batch;
    }
    Ok(())
}

fn read_compressed(
    reader: &mut impl Read,
    header: &Header,
    columns: &mut Columns,
    name: &str,
) -> Result<(), AssetError> {
    let bad = |reason: String| malformed(name, "compressed data", reason);
    let mut sizes = [0; 8];
    reader.read_exact(&mut sizes).map_err(|_| bad("its two sizes are missing".to_owned()))?;
    let [a, b, c, d, e, f, g, h] = sizes;
    let compressed = u32::from_le_bytes([a, b, c, d]);
    let uncompressed = u64::from(u32::from_le_bytes([e, f, g, h]));
    let expected = header.points * header.stride as u64;
    if uncompressed != expected {
        let points = header.points;
        return Err(bad(format!("{uncompressed} bytes; {points} points have {expected}")));
    }
    let mut packed = Vec::new();
    let taken = reader.take(compressed.into()).read_to_end(&mut packed);
    let taken = taken.map_err(|e| io_error(name, e))? as u64;
    if taken < u64::from(compressed) {
        return Err(bad(format!("ends after {taken} of {compressed} bytes")));
    }
    let body = lzf::decompress(&packed, uncompressed).map_err(bad)?;
    // Field after field: one field's values of all points lie together.
    let points = header.points as usize;
    let wanted: Vec<(Wanted, &Field, &[u8])> =
        header.wanted().map(|(w, field)| (w, field, &body[field.offset * points..])).collect();
    let mut row = Row::of(columns);
    for point in 0..points {
        for &(wanted, field, values) in &wanted {
            row.set(wanted, field.decode(&values[point * field.bytes()..]));
        }
        columns.push(&row);
    }
    Ok(())
}

fn truncated(name: &str, header: &Header, point: u64) -> AssetError {
    let reason = format!("the file ends; the header announces {} points", header.points);
    malformed(name, format!("point {point}"), reason)
}

/// One point as read.
#[derive(Default)]
struct Row {
    position: DVec3,
    normal: [f32; 3],
    rgb: [f32; 3],
    packed: u32,
    scalars: Vec<f64>,
}

impl Row {
    /// A row for these columns.
    fn of(columns: &Columns) -> Row {
        Row { scalars: vec![0.0; columns.fields.len()], ..Row::default() }
    }

    fn set(&mut self, wanted: Wanted, value: f64) {
        match wanted {
            Wanted::Position(axis) => self.position[axis] = value,
            Wanted::Normal(axis) => self.normal[axis] = value as f32,
            Wanted::Rgb(channel) => self.rgb[channel] = value as f32,
            Wanted::Packed { .. } => self.packed = value as u32,
            Wanted::Scalar(number) => self.scalars[number] = value,
        }
    }
}

/// Empty columns of the header's scalar fields, in the order of their numbers.
fn scalars(header: &Header) -> Vec<Column> {
    let mut columns: Vec<Column> = Vec::new();
    let mut known = HashSet::new();
    for field in &header.fields {
        if !matches!(field.wanted, Some(Wanted::Scalar(_))) {
            continue;
        }
        let usual = match field.name.as_str() {
            "i" | "I" => INTENSITY.to_owned(),
            own => fields::name_of(own),
        };
        let is_taken = !known.insert(usual.clone());
        columns.push(Column::new(if is_taken { &field.name } else { &usual }));
    }
    columns
}

/// The points so far; what the file lacks stays empty.
struct Columns {
    positions: Vec<DVec3>,
    /// Place in the file, for organised clouds.
    pixels: Option<Vec<u32>>,
    rows: u32,
    normals: Option<Vec<glam::Vec3>>,
    rgb: Option<Vec<[f32; 3]>>,
    packed: Option<Vec<u32>>,
    fields: Vec<Column>,
    not_finite: u64,
}

impl Columns {
    fn new(header: &Header) -> Self {
        fn column<T>(present: bool) -> Option<Vec<T>> {
            present.then(Vec::new)
        }
        let all = |of: fn(usize) -> Wanted| (0..3).all(|i| header.has(of(i)));
        Self {
            positions: Vec::new(),
            pixels: column(header.image.is_some() && u32::try_from(header.points).is_ok()),
            rows: 0,
            normals: column(all(Wanted::Normal)),
            rgb: column(all(Wanted::Rgb)),
            packed: column(header.packed_color().is_some()),
            fields: scalars(header),
            not_finite: 0,
        }
    }

    fn push(&mut self, row: &Row) {
        fn add<T>(column: &mut Option<Vec<T>>, value: T) {
            if let Some(column) = column {
                column.push(value);
            }
        }
        let pixel = self.rows;
        self.rows = self.rows.wrapping_add(1);
        if !row.position.is_finite() {
            self.not_finite += 1;
            return;
        }
        self.positions.push(row.position);
        add(&mut self.pixels, pixel);
        add(&mut self.normals, unit_or_zero(row.normal));
        add(&mut self.rgb, row.rgb);
        add(&mut self.packed, row.packed);
        self.fields.iter_mut().zip(&row.scalars).for_each(|(field, &value)| field.push(value));
    }

    fn finish(self, header: &Header, name: &str) -> Result<Asset, AssetError> {
        let count = self.positions.len();
        if count == 0 {
            let reason = match header.points {
                0 => "holds no points".to_owned(),
                points => format!("none of its {points} points is finite"),
            };
            return Err(malformed(name, "file", reason));
        }
        let raster = match (header.image, &self.pixels) {
            (Some([width, height]), Some(pixels)) => Some(Raster { width, height, pixels }),
            _ => None,
        };
        let sensor = sensor::view(&self.positions, raster.as_ref(), header.viewpoint);
        let packed = self.packed.zip(header.packed_color());
        let mut warnings = header.warnings.clone();
        let cloud = PointCloud {
            colors: match (packed, self.rgb) {
                (Some((packed, alpha)), _) => unpack(&packed, alpha),
                (None, Some(rgb)) => colors(count, |point| rgb[point]),
                (None, None) => None,
            },
            normals: self.normals,
            fields: fields::encoded(self.fields, &mut warnings),
            positions: self.positions,
            radii: None,
            oriented: false,
            kernels: None,
            clips: None,
        };
        let mut asset = Asset::single("pcd", name, Geometry::Points(cloud));
        asset.sensor = sensor.map(Sensor::View);
        asset.warnings = warnings;
        asset.warnings.extend(skipped_warning(self.not_finite, "no finite position"));
        Ok(asset)
    }
}

/// Colours packed as `0xAARRGGBB`. An alpha that is zero throughout was never written; `None` for colours that were not.
fn unpack(packed: &[u32], has_alpha: bool) -> Option<Vec<[u8; 4]>> {
    if packed.iter().all(|color| color & 0xff_ffff == 0) {
        return None;
    }
    let opaque = !has_alpha || packed.iter().all(|color| color >> 24 == 0);
    let unpack_one = |&color: &u32| {
        let [alpha, r, g, b] = color.to_be_bytes();
        [r, g, b, if opaque { 255 } else { alpha }]
    };
    Some(packed.iter().map(unpack_one).collect())
}

#[cfg(test)]
mod tests;
