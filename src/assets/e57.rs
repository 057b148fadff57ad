//! Reader for E57 (ASTM E2807) through the `e57` crate: every scan becomes a geometry, placed by its
//! pose.
//!
//! Coordinates are Cartesian or spherical; records whose state says that they are invalid, or only
//! a direction, are skipped and counted. Colours are scaled by the range that the scan declares or
//! else holds, intensities over all scans of the file. Checksums are verified on the way. What the
//! crate believes without looking is checked first: lengths in the header, and scans whose records
//! take no bits at all, which it would generate without end.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use e57::{E57Reader, RecordDataType, RecordName, RecordValue};
use glam::{DAffine3, DQuat, DVec3};

use super::fields::{self, Column, INTENSITY, Numbers};
use super::points::{self, colors, io_error, malformed, skipped_warning, unsupported};
use super::{Asset, AssetError, Geometry, Placement, PointCloud, ReadOptions, quiet};
use crate::math::Sensor;

const HEADER_BYTES: u64 = 48;
/// The decoder keeps a queue of values for each field.
const MAX_FIELDS: usize = 64;
/// Points between two reports of progress.
const REPORT_EVERY: u64 = 1 << 16;

/// Reads the scans of an E57 file.
///
/// # Errors
/// I/O, a wrong checksum, a header or scan description that contradicts itself or the file, scans
/// without coordinates, no valid point at all, or more points than the options allow.
pub fn read(path: &Path, name: &str, options: &ReadOptions) -> Result<Asset, AssetError> {
    let file = File::open(path).map_err(|source| io_error(name, source))?;
    read_seekable(BufReader::new(file), name, options)
}

fn read_seekable<R: Read + Seek>(
    mut reader: R,
    name: &str,
    options: &ReadOptions,
) -> Result<Asset, AssetError> {
    check_header(&mut reader, name)?;
    // The crate returns errors, but may meet damage that nobody foresaw.
    let scans = quiet::catch(|| read_scans(reader, name, options))
        .unwrap_or_else(|| Err(malformed(name, "file", "is damaged: the decoder gave up")))?;
    options.progress.report(1.0);
    finish(scans, name)
}

/// Checks the lengths that the header declares against the file's.
fn check_header<R: Read + Seek>(reader: &mut R, name: &str) -> Result<(), AssetError> {
    let io = |source| io_error(name, source);
    let file_bytes = reader.seek(SeekFrom::End(0)).map_err(io)?;
    reader.seek(SeekFrom::Start(0)).map_err(io)?;
    if file_bytes < HEADER_BYTES {
        let reason = format!("the file has {file_bytes} bytes, fewer than the header");
        return Err(malformed(name, "header", reason));
    }
    let mut header = [0; HEADER_BYTES as usize];
    reader.read_exact(&mut header).map_err(io)?;
    reader.seek(SeekFrom::Start(0)).map_err(io)?;
    if !header.starts_with(b"ASTM-E57") {
        return Err(unsupported(name, "the signature ASTM-E57 is missing: not an E57 file"));
    }
    for (at, field) in [(16, "file length"), (24, "XML offset"), (32, "XML length")] {
        let bytes = header[at..].first_chunk().copied().unwrap_or_default();
        let value = u64::from_le_bytes(bytes);
        if value > file_bytes {
            let reason = format!("is {value}; the file has {file_bytes} bytes");
            return Err(malformed(name, format!("header, {field}"), reason));
        }
    }
    Ok(())
}

fn read_scans<R: Read + Seek>(
    reader: R,
    name: &str,
    options: &ReadOptions,
) -> Result<Vec<Scan>, AssetError> {
    let mut file =
        E57Reader::new(reader).map_err(|error| malformed(name, "file", describe(&error)))?;
    let descriptions = file.pointclouds();
    if descriptions.is_empty() {
        return Err(malformed(name, "file", "holds no scans"));
    }
    let total = descriptions.iter().fold(0u64, |sum, scan| sum.saturating_add(scan.records));
    points::admit(name, total, options)?;
    let mut scans = Vec::new();
    let mut done = 0;
    for (index, description) in descriptions.iter().enumerate() {
        let place = format!("scan {index}");
        let fields = Fields::of(description).map_err(|why| malformed(name, &*place, why))?;
        let mut scan = Scan::new(description, &fields)
            .map_err(|why| malformed(name, format!("{place}, pose"), why))?;
        let records = file
            .pointcloud_raw(description)
            .map_err(|error| malformed(name, &*place, describe(&error)))?;
        for (point, record) in records.enumerate() {
            let record = record.map_err(|error| {
                malformed(name, format!("{place}, point {point}"), describe(&error))
            })?;
            scan.push(&fields, &record);
            done += 1;
            if done % REPORT_EVERY == 0 {
                options.admission.check()?;
                options.progress.report(done as f32 / total as f32);
            }
        }
        scans.push(scan);
    }
    Ok(scans)
}

/// An error with its causes.
fn describe(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        let inner = error.to_string();
        if !text.contains(&inner) {
            text = format!("{text}: {inner}");
        }
        cause = error.source();
    }
    text
}

/// A field of a scan's records.
#[derive(Clone, Debug)]
struct Field {
    index: usize,
    kind: RecordDataType,
}

impl Field {
    fn get(&self, record: &[RecordValue]) -> f64 {
        record.get(self.index).and_then(|value| value.to_f64(&self.kind).ok()).unwrap_or(f64::NAN)
    }

    /// Whether a record of this type takes bits in the file.
    fn has_bits(kind: &RecordDataType) -> bool {
        match kind {
            RecordDataType::Single { .. } | RecordDataType::Double { .. } => true,
            RecordDataType::ScaledInteger { min, max, .. }
            | RecordDataType::Integer { min, max } => min < max,
        }
    }

    /// The largest value that its type can hold, where that says something.
    fn declared_max(&self) -> Option<f64> {
        match self.kind {
            RecordDataType::Single { max, .. } => max.map(f64::from),
            RecordDataType::Double { max, .. } => max,
            RecordDataType::Integer { max, .. } => Some(max as f64),
            RecordDataType::ScaledInteger { max, scale, offset, .. } => {
                Some(max as f64 * scale + offset)
            }
        }
    }
}

/// Where a scan's records keep what is wanted.
#[derive(Debug)]
struct Fields {
    cartesian: Option<[Field; 3]>,
    cartesian_state: Option<Field>,
    /// Range, azimuth, elevation.
    spherical: Option<[Field; 3]>,
    spherical_state: Option<Field>,
    rgb: Option<[Field; 3]>,
    rgb_state: Option<Field>,
    /// Divisor of the channels; 1 leaves the range to the values.
    rgb_divisor: f64,
    intensity: Option<Field>,
    intensity_state: Option<Field>,
}

impl Fields {
    fn of(scan: &e57::PointCloud) -> Result<Self, String> {
        let count = scan.prototype.len();
        if count > MAX_FIELDS {
            return Err(format!("its points have {count} fields; up to {MAX_FIELDS} are read"));
        }
        if !scan.prototype.iter().any(|record| Field::has_bits(&record.data_type)) {
            return Err("every field of its points is constant".to_owned());
        }
        let find = |name: RecordName| {
            let index = scan.prototype.iter().position(|record| record.name == name)?;
            Some(Field { index, kind: scan.prototype[index].data_type.clone() })
        };
        let triple = |a, b, c| Some([find(a)?, find(b)?, find(c)?]);
        use RecordName as N;
        let cartesian = triple(N::CartesianX, N::CartesianY, N::CartesianZ);
        let spherical = triple(N::SphericalRange, N::SphericalAzimuth, N::SphericalElevation);
        if cartesian.is_none() && spherical.is_none() {
            return Err("its points have neither Cartesian nor spherical coordinates".to_owned());
        }
        let rgb = triple(N::ColorRed, N::ColorGreen, N::ColorBlue);
        let limit = scan.color_limits.as_ref().and_then(|limits| limits.red_max.as_ref());
        let rgb_max = rgb.as_ref().and_then(|[red, ..]| match limit {
            Some(limit) => limit.to_f64(&red.kind).ok(),
            None => red.declared_max(),
        });
        // 1, 255 and 65535 are declared by writers that use another range; the values tell those.
        let is_usual = |max: f64| !(max > 1.0 && max < 65535.0) || max == 255.0;
        Ok(Self {
            cartesian,
            cartesian_state: find(N::CartesianInvalidState),
            spherical,
            spherical_state: find(N::SphericalInvalidState),
            rgb,
            rgb_state: find(N::IsColorInvalid),
            rgb_divisor: rgb_max.filter(|&max| !is_usual(max)).unwrap_or(1.0),
            intensity: find(N::Intensity),
            intensity_state: find(N::IsIntensityInvalid),
        })
    }

    /// The position in scan coordinates, `None` where the record declares it invalid.
    fn position(&self, record: &[RecordValue]) -> Option<DVec3> {
        let valid = |state: &Option<Field>| state.as_ref().is_none_or(|s| s.get(record) == 0.0);
        if let Some([x, y, z]) = &self.cartesian
            && valid(&self.cartesian_state)
        {
            return Some(DVec3::new(x.get(record), y.get(record), z.get(record)));
        }
        let [range, azimuth, elevation] = self.spherical.as_ref()?;
        if !valid(&self.spherical_state) {
            return None;
        }
        let (sin_azimuth, cos_azimuth) = azimuth.get(record).sin_cos();
        let (sin_elevation, cos_elevation) = elevation.get(record).sin_cos();
        let direction =
            DVec3::new(cos_elevation * cos_azimuth, cos_elevation * sin_azimuth, sin_elevation);
        Some(range.get(record) * direction)
    }
}

/// A scan as read; columns that it lacks are `None`.
struct Scan {
    name: Option<String>,
    file_from_scan: DAffine3,
    positions: Vec<DVec3>,
    rgb: Option<Vec<[f32; 3]>>,
    intensity: Option<Vec<f32>>,
    invalid: u64,
    not_finite: u64,
}

impl Scan {
    fn new(description: &e57::PointCloud, fields: &Fields) -> Result<Self, String> {
        Ok(Self {
            name: description.name.clone(),
            file_from_scan: pose(description.transform.as_ref())?,
            positions: Vec::new(),
            rgb: fields.rgb.as_ref().map(|_| Vec::new()),
            intensity: fields.intensity.as_ref().map(|_| Vec::new()),
            invalid: 0,
            not_finite: 0,
        })
    }

    fn push(&mut self, fields: &Fields, record: &[RecordValue]) {
        let Some(position) = fields.position(record) else {
            self.invalid += 1;
            return;
        };
        if !self.file_from_scan.transform_point3(position).is_finite() {
            self.not_finite += 1;
            return;
        }
        self.positions.push(position);
        let unless = |state: &Option<Field>, value: f64| match state {
            Some(state) if state.get(record) != 0.0 => f32::NAN,
            _ => value as f32,
        };
        if let (Some(column), Some(rgb)) = (&mut self.rgb, &fields.rgb) {
            let channel =
                |field: &Field| unless(&fields.rgb_state, field.get(record) / fields.rgb_divisor);
            let [r, g, b] = rgb;
            column.push([channel(r), channel(g), channel(b)]);
        }
        if let (Some(column), Some(intensity)) = (&mut self.intensity, &fields.intensity) {
            column.push(unless(&fields.intensity_state, intensity.get(record)));
        }
    }
}

/// A pose as a map from scan to file coordinates.
fn pose(transform: Option<&e57::Transform>) -> Result<DAffine3, String> {
    let Some(transform) = transform else { return Ok(DAffine3::IDENTITY) };
    let (q, t) = (&transform.rotation, &transform.translation);
    let rotation = DQuat::from_xyzw(q.x, q.y, q.z, q.w);
    let translation = DVec3::new(t.x, t.y, t.z);
    let length = rotation.length();
    let is_rigid = translation.is_finite() && length > 0.0 && length.is_finite();
    if !is_rigid {
        return Err("is not a rotation and a finite translation".to_owned());
    }
    Ok(DAffine3::from_rotation_translation(rotation * (1.0 / length), translation))
}

fn finish(scans: Vec<Scan>, name: &str) -> Result<Asset, AssetError> {
    let sum = |count: fn(&Scan) -> u64| scans.iter().map(count).sum();
    let invalid: u64 = sum(|scan| scan.invalid);
    let not_finite: u64 = sum(|scan| scan.not_finite);
    let mut asset = Asset { format: "e57", ..Asset::default() };
    asset.warnings.extend(skipped_warning(invalid, "marked as invalid"));
    asset.warnings.extend(skipped_warning(not_finite, "no finite position"));
    for (index, scan) in scans.into_iter().enumerate() {
        if scan.positions.is_empty() {
            asset.warnings.push(format!("scan {index} holds no valid points"));
            continue;
        }
        asset.placements.push(Placement {
            name: scan.name.unwrap_or_else(|| format!("{name} scan {index}")),
            geometry: asset.geometries.len(),
            asset_from_geometry: scan.file_from_scan,
        });
        let intensity =
            scan.intensity.map(|values| Column::of(INTENSITY, Numbers::Singles(values)));
        asset.geometries.push(Geometry::Points(PointCloud {
            colors: scan.rgb.and_then(|rgb| colors(rgb.len(), |point| rgb[point])),
            fields: fields::encoded(intensity.into_iter().collect(), &mut asset.warnings),
            positions: scan.positions,
            ..PointCloud::default()
        }));
    }
    // Scans are in the coordinates of their scanner.
    if let [only] = &asset.placements[..] {
        asset.sensor = Some(Sensor::Place(only.asset_from_geometry.translation));
    }
    if asset.geometries.is_empty() {
        let reason = match invalid + not_finite {
            0 => "holds no points".to_owned(),
            points => format!("none of its {points} points is valid"),
        };
        return Err(malformed(name, "file", reason));
    }
    Ok(asset)
}

#[cfg(test)]
mod tests;
