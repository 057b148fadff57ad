//! Reader for PTX: gridded laser scans as text, several in a file.
//!
//! Each scan has a header — columns, rows, scanner position, its three axes, and a 4 × 4 matrix that
//! takes scanner coordinates to the common frame, one **row vector** a line (translation in the last
//! line) — and then columns · rows lines `x y z intensity [r g b]` in scanner coordinates. `0 0 0`
//! marks a pulse without return. Lines of a scan may differ in what follows the coordinates: returns beside what the camera
//! saw have no colour. Every scan becomes a geometry, placed by its matrix.

use std::io::BufRead;
use std::path::Path;

use glam::{DAffine3, DMat3, DVec3};

use super::fields::{self, Column, INTENSITY, Numbers};
use super::points::{self, Lines, colors, malformed, quote, skipped_warning};
use super::warnings::counted;
use super::{Asset, AssetError, Geometry, Placement, PointCloud, ReadOptions};
use crate::math::Sensor;
use crate::memory::Interrupt;

/// Reads the scans of a PTX file.
///
/// # Errors
/// I/O, a header or row that is not as the format demands (with line and column), fewer rows than
/// the header announces, no point at all, or more than the options allow.
pub fn read(path: &Path, name: &str, options: &ReadOptions) -> Result<Asset, AssetError> {
    read_from(points::open(path, name, options)?, name, options)
}

/// Like [`read`], from a stream. At most [`ReadOptions::max_decompressed_bytes`] are read.
///
/// # Errors
/// See [`read`].
pub fn read_from(
    reader: impl BufRead,
    name: &str,
    options: &ReadOptions,
) -> Result<Asset, AssetError> {
    let mut rows = Rows { lines: Lines::new(reader, name, options), name };
    let mut meter = options.admission.meter(name);
    let mut kept = 0;
    let mut scans = Vec::new();
    let mut declared = 0u64;
    while let Some(header) = Header::read(&mut rows, scans.len())? {
        declared = declared.saturating_add(header.points);
        points::check_count(name, declared, options)?;
        let scan = Scan::read(&mut rows, header, scans.len(), |bytes| meter.reach(kept + bytes))?;
        kept += scan.bytes();
        scans.push(scan);
    }
    options.progress.report(1.0);
    finish(scans, name)
}

/// Lines of numbers.
struct Rows<'a, R> {
    lines: Lines<'a, R>,
    name: &'a str,
}

impl<R: BufRead> Rows<'_, R> {
    /// The numbers of the next line that is not empty, `None` at the end of the file.
    fn next(&mut self) -> Result<Option<([f64; 7], usize)>, AssetError> {
        let mut values = [0.0; 7];
        loop {
            let number = self.lines.number() + 1;
            let Some(line) = self.lines.next_line()? else { return Ok(None) };
            let mut count = 0;
            for token in line.split_ascii_whitespace() {
                let Some(value) = values.get_mut(count) else {
                    let reason = "has more than 7 columns";
                    return Err(malformed(self.name, format!("line {number}"), reason));
                };
                *value = token.parse().map_err(|_| {
                    let place = format!("line {number}, column {}", count + 1);
                    malformed(self.name, place, format!("{} is not a number", quote(token)))
                })?;
                count += 1;
            }
            if count > 0 {
                return Ok(Some((values, count)));
            }
        }
    }

    /// A header line with exactly `count` finite numbers.
    fn header(&mut self, count: usize, scan: usize, what: &str) -> Result<[f64; 7], AssetError> {
        let found = self.next()?;
        let place = format!("scan {scan}, {what} (line {})", self.lines.number());
        match found {
            Some((values, n)) if n == count && values.iter().all(|v| v.is_finite()) => Ok(values),
            Some((_, n)) => {
                let reason = format!("expected {count} finite numbers, found {n} numbers");
                Err(malformed(self.name, place, reason))
            }
            None => Err(malformed(self.name, place, "the file ends within the header")),
        }
    }
}

struct Header {
    /// Columns · rows.
    points: u64,
    file_from_scan: DAffine3,
}

impl Header {
    /// The next scan's header, `None` at the end of the file.
    fn read<R: BufRead>(rows: &mut Rows<R>, scan: usize) -> Result<Option<Self>, AssetError> {
        let Some((columns, count)) = rows.next()? else { return Ok(None) };
        let first_line = rows.lines.number();
        let name = rows.name;
        let whole = |value: f64, count: usize, what: &str, line: u64| {
            if count == 1 && value.fract() == 0.0 && (0.0..=4e9).contains(&value) {
                return Ok(value as u64);
            }
            let place = format!("scan {scan}, {what} (line {line})");
            Err(malformed(name, place, "expected one whole number"))
        };
        let columns = whole(columns[0], count, "number of columns", first_line)?;
        let [height, ..] = rows.header(1, scan, "number of rows")?;
        let height = whole(height, 1, "number of rows", rows.lines.number())?;
        rows.header(3, scan, "scanner position")?;
        for _ in 0..3 {
            rows.header(3, scan, "scanner axes")?;
        }
        let mut matrix = [[0.0; 4]; 4];
        for line in &mut matrix {
            let [a, b, c, d, ..] = rows.header(4, scan, "transformation")?;
            *line = [a, b, c, d];
        }
        let file_from_scan = affine(matrix);
        if file_from_scan.matrix3.determinant() == 0.0 {
            let place = format!("scan {scan}, transformation (line {})", rows.lines.number());
            return Err(malformed(rows.name, place, "the matrix is singular"));
        }
        Ok(Some(Self { points: columns.saturating_mul(height), file_from_scan }))
    }
}

/// The map of a matrix whose lines are row vectors; one with the translation in the last column,
/// as some programs write it, is recognised by its last line `0 0 0 1`.
fn affine(m: [[f64; 4]; 4]) -> DAffine3 {
    let column = |i: usize| DVec3::new(m[0][i], m[1][i], m[2][i]);
    let row = |i: usize| DVec3::new(m[i][0], m[i][1], m[i][2]);
    if m[3] == [0.0, 0.0, 0.0, 1.0] && column(3) != DVec3::ZERO {
        let matrix = DMat3::from_cols(column(0), column(1), column(2));
        return DAffine3::from_mat3_translation(matrix, column(3));
    }
    DAffine3::from_mat3_translation(DMat3::from_cols(row(0), row(1), row(2)), row(3))
}

struct Scan {
    file_from_scan: DAffine3,
    positions: Vec<DVec3>,
    /// Empty, or the intensity of each position; not-a-number where it has none.
    intensities: Vec<f32>,
    /// Empty, or the colour of each position; not-a-number where it has none.
    rgb: Vec<[f32; 3]>,
    no_return: u64,
    not_finite: u64,
}

impl Scan {
    fn read<R: BufRead>(
        rows: &mut Rows<R>,
        header: Header,
        index: usize,
        mut admit: impl FnMut(u64) -> Result<(), Interrupt>,
    ) -> Result<Self, AssetError> {
        let mut scan = Self {
            file_from_scan: header.file_from_scan,
            positions: Vec::new(),
            intensities: Vec::new(),
            rgb: Vec::new(),
            no_return: 0,
            not_finite: 0,
        };
        for point in 0..header.points {
            let Some((values, count)) = rows.next()? else {
                let reason = format!("the header announces {} points", header.points);
                let place = format!("scan {index}, point {point}: the file ends");
                return Err(malformed(rows.name, place, reason));
            };
            if !matches!(count, 3 | 4 | 6 | 7) {
                let place = format!("scan {index}, point {point} (line {})", rows.lines.number());
                let reason = format!("has {count} columns, expected 4 or 7");
                return Err(malformed(rows.name, place, reason));
            }
            admit(scan.bytes_with(count))?;
            scan.push(&values[..count]);
        }
        // Positions behind the last one with an intensity, or a colour, have none.
        if !scan.intensities.is_empty() {
            scan.intensities.resize(scan.positions.len(), f32::NAN);
        }
        if !scan.rgb.is_empty() {
            scan.rgb.resize(scan.positions.len(), [f32::NAN; 3]);
        }
        Ok(scan)
    }

    /// Bytes of what is kept.
    fn bytes(&self) -> u64 {
        24 * self.positions.len() as u64
            + 4 * self.intensities.len() as u64
            + 12 * self.rgb.len() as u64
    }

    /// Bytes of what is kept once another row of so many numbers is: the first intensity, and the first colour, bring those of all positions.
    fn bytes_with(&self, columns: usize) -> u64 {
        let intensity =
            if self.intensities.is_empty() && !matches!(columns, 4 | 7) { 0 } else { 4 };
        let color = if self.rgb.is_empty() && columns < 6 { 0 } else { 12 };
        (self.positions.len() as u64 + 1) * (24 + intensity + color)
    }

    /// Takes a row of 3 (x y z), 4 (and intensity), 6 (and colour) or 7 numbers.
    fn push(&mut self, values: &[f64]) {
        let &[x, y, z, ref rest @ ..] = values else { return };
        let position = DVec3::new(x, y, z);
        if position == DVec3::ZERO {
            self.no_return += 1;
            return;
        }
        if !self.file_from_scan.transform_point3(position).is_finite() {
            self.not_finite += 1;
            return;
        }
        // Positions since the last one with an intensity, or a colour, have none.
        let before = self.positions.len();
        self.positions.push(position);
        if let &[intensity] | &[intensity, _, _, _] = rest {
            self.intensities.resize(before, f32::NAN);
            self.intensities.push(intensity as f32);
        }
        if let &[r, g, b] | &[_, r, g, b] = rest {
            self.rgb.resize(before, [f32::NAN; 3]);
            self.rgb.push([r, g, b].map(|channel| channel as f32));
        }
    }

    /// The colour of each position, white where it has none, and how many have none; `None` where no position has one.
    fn colors(&self) -> Option<(Vec<[u8; 4]>, u64)> {
        let mut colors = colors(self.rgb.len(), |point| self.rgb[point])?;
        let mut bare = 0;
        for (color, rgb) in colors.iter_mut().zip(&self.rgb) {
            if rgb.iter().all(|channel| channel.is_nan()) {
                *color = [255; 4];
                bare += 1;
            }
        }
        Some((colors, bare))
    }
}

fn finish(scans: Vec<Scan>, name: &str) -> Result<Asset, AssetError> {
    let sum = |count: fn(&Scan) -> u64| scans.iter().map(count).sum();
    let mut asset = Asset { format: "ptx", ..Asset::default() };
    asset.warnings.extend(skipped_warning(sum(|scan| scan.not_finite), "no finite position"));
    let no_return: u64 = sum(|scan| scan.no_return);
    let scan_count = scans.len();
    let mut bare = 0;
    for (index, scan) in scans.into_iter().enumerate() {
        if scan.positions.is_empty() {
            asset.warnings.push(format!("scan {index} holds no points"));
            continue;
        }
        asset.placements.push(Placement {
            name: if scan_count == 1 { name.to_owned() } else { format!("{name} scan {index}") },
            geometry: asset.geometries.len(),
            asset_from_geometry: scan.file_from_scan,
        });
        let (colors, without_color) = scan.colors().unzip();
        bare += without_color.unwrap_or(0);
        let intensity = Column::of(INTENSITY, Numbers::Singles(scan.intensities));
        asset.geometries.push(Geometry::Points(PointCloud {
            colors,
            fields: fields::encoded(vec![intensity], &mut asset.warnings),
            positions: scan.positions,
            ..PointCloud::default()
        }));
    }
    asset.warnings.extend(counted(
        bare,
        "point has no colour and is drawn white",
        "points have no colour and are drawn white",
    ));
    // Scans are in the coordinates of their scanner.
    if let [only] = &asset.placements[..] {
        asset.sensor = Some(Sensor::Place(only.asset_from_geometry.translation));
    }
    if asset.geometries.is_empty() {
        let reason = match (scan_count, no_return) {
            (0, _) => "holds no scan".to_owned(),
            (_, 0) => "holds no points".to_owned(),
            (_, pulses) => format!("none of its {pulses} pulses has a return"),
        };
        return Err(malformed(name, "file", reason));
    }
    Ok(asset)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn read_text(text: &str) -> Result<Asset, AssetError> {
        read_from(text.as_bytes(), "t.ptx", &ReadOptions::default())
    }

    /// A scan of one row, turned a quarter about z and moved.
    fn scan(points: &str, count: usize) -> String {
        format!(
            "{count}\n1\n10 20 30\n0 1 0\n-1 0 0\n0 0 1\n\
             0 1 0 0\n-1 0 0 0\n0 0 1 0\n10 20 30 1\n{points}\n"
        )
    }

    fn points(asset: &Asset, index: usize) -> &PointCloud {
        let Geometry::Points(cloud) = &asset.geometries[index] else { panic!("not points") };
        cloud
    }

    #[test]
    fn scans_are_placed_by_their_matrix() {
        let text = scan("1 0 0 0.25 255 0 9\n0 0 0 0.5 0 0 0\n0 2 0 0.75 0 1 2", 3)
            + &scan("0 0 3 1.25", 1);
        let asset = read_text(&text).unwrap();
        assert_eq!(asset.geometries.len(), 2);
        let first = points(&asset, 0);
        let placed: Vec<DVec3> = first
            .positions
            .iter()
            .map(|&p| asset.placements[0].asset_from_geometry.transform_point3(p))
            .collect();
        assert_eq!(placed, [DVec3::new(10.0, 21.0, 30.0), DVec3::new(8.0, 20.0, 30.0)]);
        assert_eq!(first.colors, Some(vec![[255, 0, 9, 255], [0, 1, 2, 255]]));
        assert_eq!(first.values_of(INTENSITY), Some(vec![0.25, 0.75]));
        let second = points(&asset, 1);
        assert_eq!((second.values_of(INTENSITY), &second.colors), (Some(vec![1.25]), &None));
        assert_eq!(asset.bounds().max, DVec3::new(10.0, 21.0, 33.0));
        let asset = read_text(&text.replace('\n', "\r")).unwrap();
        assert_eq!(asset.geometries.len(), 2, "lines may end with carriage returns alone");
    }

    #[test]
    fn pulses_without_return_may_have_fewer_columns() {
        for pulse in ["0 0 0", "0 0 0 0.5", "0 0 0 0.5 0 0 0"] {
            let rows = format!("{pulse}\n1 0 0 0.25 255 0 9\n{pulse}\n0 2 0 0.75 0 1 2");
            let asset = read_text(&scan(&rows, 4)).unwrap();
            let cloud = points(&asset, 0);
            assert_eq!(cloud.positions, [DVec3::X, DVec3::Y * 2.0], "{pulse}");
            assert_eq!(cloud.colors, Some(vec![[255, 0, 9, 255], [0, 1, 2, 255]]), "{pulse}");
            assert_eq!(cloud.values_of(INTENSITY), Some(vec![0.25, 0.75]), "{pulse}");
        }
    }

    #[test]
    fn returns_may_have_fewer_columns_than_others() {
        for (first, intensity) in [("3 0 0", f64::NAN), ("3 0 0 0.5", 0.5)] {
            let rows = format!("{first}\n1 0 0 0.25 255 0 9\n{first}\n0 0 0");
            let asset = read_text(&scan(&rows, 4)).unwrap();
            let cloud = points(&asset, 0);
            assert_eq!(cloud.colors, Some(vec![[255; 4], [255, 0, 9, 255], [255; 4]]), "{first}");
            let found = cloud.values_of(INTENSITY).unwrap();
            let expected = [intensity, 0.25, intensity];
            assert!(
                found.iter().zip(expected).all(|(a, b)| a.to_bits() == b.to_bits()),
                "{found:?}"
            );
            assert_eq!(asset.warnings, ["2 points have no colour and are drawn white"]);
        }
    }

    #[test]
    fn a_translation_in_the_last_column_is_recognised() {
        let m = [[1.0, 0.0, 0.0, 5.0], [0.0, 1.0, 0.0, 6.0], [0.0, 0.0, 1.0, 7.0]];
        let map = affine([m[0], m[1], m[2], [0.0, 0.0, 0.0, 1.0]]);
        assert_eq!(map.translation, DVec3::new(5.0, 6.0, 7.0));
    }

    #[test]
    fn errors_name_scan_point_and_line() {
        let error = |text: &str| read_text(text).unwrap_err().to_string();
        assert!(error("").contains("holds no scan"));
        assert!(error("2.5\n").contains("scan 0, number of columns (line 1)"));
        assert!(error("2\n1\n0 0\n").contains("scan 0, scanner position (line 3)"));
        assert!(error(&scan("1 0 0 1", 2)).contains("scan 0, point 1: the file ends"));
        assert!(error(&scan("1 0 0 x", 1)).contains("line 11, column 4"));
        assert!(error(&scan("1 0 0 1\n1 0 0 1 2", 2)).contains("point 1 (line 12)"));
        assert!(error(&scan("0 0 0 0", 1)).contains("none of its 1 pulses"));
        let huge = scan("1 0 0 1", 1).replacen("1\n1\n", "4000000000\n4000000000\n", 1);
        assert!(matches!(read_text(&huge), Err(AssetError::TooLarge { .. })));
    }

    proptest! {
        #[test]
        fn truncations_and_noise_are_answered(cut in 0usize..200, at in 0usize..200, byte: u8) {
            let text = scan("1 0 0 0.25 255 0 9\n0 0 0 0.5 0 0 0", 2);
            let mut bytes = text.into_bytes();
            let at = at % bytes.len();
            bytes[at] = byte;
            bytes.truncate(cut.max(1));
            let _ = read_from(&bytes[..], "t.ptx", &ReadOptions::default());
        }
    }
}
