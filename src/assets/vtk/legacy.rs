//! The legacy format of VTK, versions 1 to 5, ascii and binary (big-endian): polygonal data.
//!
//! Three lines (the version, a title, the encoding) are followed by sections that begin with a keyword. Cells of versions up to
//! 4 are a number of corners and the corners; version 5 has a list of offsets and a list of corners.

mod scanner;

use std::io::BufRead;

use glam::DVec3;
use percent_encoding::percent_decode_str;

use self::scanner::Scanner;
use super::super::input::{Input, Origin};
use super::super::tokens::shown;
use super::super::{Asset, AssetError, ReadOptions};
use super::values::{Array, Kind};
use super::{Cells, MOST_COMPONENTS, PolyData};
use crate::memory::Meter;

/// Reads a legacy file from `input`.
///
/// # Errors
/// Malformed or truncated content (naming section and item), counts that the file cannot hold or that are over the limits,
/// other data than polygons.
pub fn read_from(input: Input, options: &ReadOptions) -> Result<Asset, AssetError> {
    let Input { reader, origin } = input;
    let mut file = File {
        scanner: Scanner::new(reader, &origin.name),
        origin: &origin,
        options,
        version: 0,
        data: PolyData::default(),
        meter: origin.admission.meter(&origin.name),
        of: None,
    };
    file.begin()?;
    while file.section()? {}
    file.data.finish("vtk", &origin, options)
}

/// The elements that arrays describe.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Of {
    Points(u64),
    Cells(u64),
}

struct File<'a, R> {
    scanner: Scanner<'a, R>,
    origin: &'a Origin,
    options: &'a ReadOptions,
    /// Main number of the version.
    version: u32,
    data: PolyData,
    meter: Meter<'a>,
    /// The elements that the next arrays describe; `None` before the first announcement.
    of: Option<Of>,
}

impl<R: BufRead> File<'_, R> {
    fn fail(&self, place: &str, reason: impl Into<String>) -> AssetError {
        self.scanner.fail(place, reason)
    }

    /// The first lines, and the kind of data.
    fn begin(&mut self) -> Result<(), AssetError> {
        let first = self.scanner.line()?;
        let version = first.trim().strip_prefix("# vtk DataFile Version ");
        let main = version.and_then(|version| version.split('.').next()?.trim().parse().ok());
        self.version = main.filter(|main| (1..=5).contains(main)).ok_or_else(|| {
            let reason = format!(
                "{} is no \"# vtk DataFile Version\" of 1 to 5",
                shown(first.trim().as_bytes())
            );
            self.fail("header", reason)
        })?;
        self.scanner.line()?;
        let encoding = self.scanner.line()?;
        self.scanner.is_binary = match encoding.trim().to_ascii_uppercase().as_str() {
            "ASCII" => false,
            "BINARY" => true,
            other => {
                let shown = shown(other.as_bytes());
                return Err(self.fail("header", format!("{shown} is neither ASCII nor BINARY")));
            }
        };
        Ok(())
    }

    /// Reads a section; false at the end of the file.
    fn section(&mut self) -> Result<bool, AssetError> {
        let Some(keyword) = self.scanner.token()? else { return Ok(false) };
        match keyword.to_ascii_uppercase().as_str() {
            "DATASET" => {
                let kind = self.word("DATASET")?;
                if !kind.eq_ignore_ascii_case("POLYDATA") {
                    let reason = format!(
                        "holds VTK data of the kind {kind}; accepted is POLYDATA: points, lines and polygons"
                    );
                    return Err(AssetError::unsupported(&self.origin.name, reason));
                }
            }
            "POINTS" => self.points()?,
            "VERTICES" => self.data.verts = self.cells("VERTICES")?.len() as u64,
            "LINES" => self.data.lines = self.cells("LINES")?,
            "POLYGONS" => self.data.polys = self.cells("POLYGONS")?,
            "TRIANGLE_STRIPS" => self.data.strips = self.cells("TRIANGLE_STRIPS")?,
            "POINT_DATA" => self.of = Some(Of::Points(self.count("POINT_DATA")?)),
            "CELL_DATA" => self.of = Some(Of::Cells(self.count("CELL_DATA")?)),
            "METADATA" => self.scanner.skip_to_blank_line()?,
            "FIELD" => self.field()?,
            keyword => self.attribute(keyword)?,
        }
        Ok(true)
    }

    fn word(&mut self, place: &str) -> Result<String, AssetError> {
        let word = self.scanner.token()?;
        word.ok_or_else(|| self.fail(place, "the file ends here"))
    }

    fn count(&mut self, place: &str) -> Result<u64, AssetError> {
        let word = self.word(place)?;
        word.parse()
            .map_err(|_| self.fail(place, format!("{} is no count", shown(word.as_bytes()))))
    }

    fn kind(&mut self, place: &str) -> Result<Kind, AssetError> {
        let word = self.word(place)?;
        Kind::of_legacy(&word).ok_or_else(|| {
            let accepted = "accepted are bit, char, short, int, long, their unsigned_ forms, float, double and vtkIdType";
            self.fail(place, format!("type {} is unknown; {accepted}", shown(word.as_bytes())))
        })
    }

    /// Refuses numbers that the file cannot hold.
    fn check_count(&self, place: &str, count: u64, kind: Kind) -> Result<(), AssetError> {
        let file = if self.scanner.is_binary {
            let (items, bytes) =
                if kind == Kind::Bit { (count / 8, 1) } else { (count, kind.bytes() as u64) };
            (items, bytes)
        } else {
            // A digit and a blank; the last number may lack its blank.
            (count / 2, 4)
        };
        self.origin.check_count(place, file.0, file.1)
    }

    fn points(&mut self) -> Result<(), AssetError> {
        let count = self.count("POINTS")?;
        let kind = self.kind("POINTS")?;
        let most = self.options.max_vertices.min(u64::from(u32::MAX));
        AssetError::check_limit(&self.origin.name, "vertices", count, most)?;
        self.check_count("POINTS", count * 3, kind)?;
        let reserved = self.origin.reserve(count);
        self.meter.reach_exactly(self.data.bytes() + 24 * reserved as u64)?;
        let mut points = Vec::with_capacity(reserved);
        let (mut place, mut axis) = (DVec3::ZERO, 0);
        let (meter, before) = (&mut self.meter, self.data.bytes());
        self.scanner.numbers("POINTS", count * 3, kind, |number| {
            place[axis] = number;
            axis = (axis + 1) % 3;
            if axis == 0 {
                meter.reach(before + 24 * (points.len() as u64 + 1))?;
                points.push(place);
            }
            Ok(())
        })?;
        self.data.points = points;
        Ok(())
    }

    fn cells(&mut self, name: &'static str) -> Result<Cells, AssetError> {
        let (count, size) = (self.count(name)?, self.count(name)?);
        let limit = self.options.max_vertices.min(u64::from(u32::MAX));
        AssetError::check_limit(&self.origin.name, "corners of cells", size, limit)?;
        let before = self.data.bytes();
        if self.version >= 5 {
            return self.offset_cells(name, count, size, before);
        }
        if size < count {
            return Err(self.fail(name, format!("{count} cells need more than {size} numbers")));
        }
        self.check_count(name, size, Kind::I32)?;
        let mut cells = Cells::default();
        let (mut left, mut bad) = (0u64, None);
        let meter = &mut self.meter;
        self.scanner.numbers(name, size, Kind::I32, |number| {
            let whole = (number.fract() == 0.0 && number >= 0.0).then_some(number as u64);
            let Some(number) = whole.and_then(|number| u32::try_from(number).ok()) else {
                bad.get_or_insert((cells.ends.len(), number));
                return Ok(());
            };
            if left == 0 {
                left = number.into();
                let end = cells.ends.last().copied().unwrap_or(0) + left;
                cells.ends.push(end);
            } else {
                left -= 1;
                cells.corners.push(number);
            }
            Ok(meter.reach(before + cells.bytes())?)
        })?;
        if let Some((cell, number)) = bad {
            let reason = format!("{number} in cell {cell} is no number of a point");
            return Err(self.fail(name, reason));
        }
        if left > 0 || cells.len() as u64 != count {
            let found = cells.len();
            let reason = format!(
                "the {size} numbers hold {found} cells, the last lacking {left} corners; the header announces {count}"
            );
            return Err(self.fail(name, reason));
        }
        Ok(cells)
    }

    /// Cells of version 5: offsets, of which there is one more than cells, and corners.
    fn offset_cells(
        &mut self,
        name: &'static str,
        count: u64,
        size: u64,
        before: u64,
    ) -> Result<Cells, AssetError> {
        let mut cells = Cells::default();
        for (keyword, count) in [("OFFSETS", count), ("CONNECTIVITY", size)] {
            let place = format!("{name}, {keyword}");
            let word = self.word(&place)?;
            if !word.eq_ignore_ascii_case(keyword) {
                let reason = format!("{} stands here instead", shown(word.as_bytes()));
                return Err(self.fail(&place, reason));
            }
            let kind = self.kind(&place)?;
            self.check_count(&place, count, kind)?;
            let mut bad = None;
            let mut number_of = 0;
            let meter = &mut self.meter;
            self.scanner.numbers(&place, count, kind, |number| {
                let most = if keyword == "OFFSETS" { size } else { u64::from(u32::MAX) };
                if !(number >= 0.0 && number.fract() == 0.0 && number <= most as f64) {
                    bad.get_or_insert(number);
                } else if keyword == "CONNECTIVITY" {
                    cells.corners.push(number as u32);
                } else {
                    if number_of > 0 {
                        cells.ends.push(number as u64);
                    } else if number != 0.0 {
                        bad.get_or_insert(number);
                    }
                    number_of += 1;
                }
                Ok(meter.reach(before + cells.bytes())?)
            })?;
            if let Some(number) = bad {
                return Err(self.fail(&place, format!("{number} does not belong here")));
            }
        }
        if !cells.ends.is_sorted() || cells.ends.last().copied().unwrap_or(0) != size {
            let reason = format!("the offsets do not rise from 0 to {size}, the number of corners");
            return Err(self.fail(name, reason));
        }
        Ok(cells)
    }

    /// An array of a keyword of its own.
    fn attribute(&mut self, keyword: &str) -> Result<(), AssetError> {
        let place = keyword.to_owned();
        let components = match keyword {
            "SCALARS" | "COLOR_SCALARS" | "LOOKUP_TABLE" | "TEXTURE_COORDINATES" => 0,
            "GLOBAL_IDS" | "PEDIGREE_IDS" | "EDGE_FLAGS" => 1,
            "VECTORS" | "NORMALS" => 3,
            "TENSORS6" => 6,
            "TENSORS" => 9,
            _ => {
                let shown = shown(keyword.as_bytes());
                return Err(self.fail("section", format!("keyword {shown} is unknown")));
            }
        };
        let name = self.name(&place)?;
        let place = format!("{place} {name}");
        if keyword == "LOOKUP_TABLE" {
            let count = self.count(&place)?;
            return self.skip(&place, count.saturating_mul(4), self.color_kind());
        }
        let count = match self.of {
            Some(Of::Points(count) | Of::Cells(count)) => count,
            None => {
                return Err(self.fail(&place, "stands before POINT_DATA and CELL_DATA"));
            }
        };
        let (kind, components) = match keyword {
            "COLOR_SCALARS" => (self.color_kind(), self.count(&place)?),
            "TEXTURE_COORDINATES" => {
                let components = self.count(&place)?;
                (self.kind(&place)?, components)
            }
            "SCALARS" => {
                let kind = self.kind(&place)?;
                // The number of components is left out where it is 1.
                let mut word = self.word(&place)?;
                let mut components = 1;
                if let Ok(count) = word.parse() {
                    components = count;
                    word = self.word(&place)?;
                }
                if !word.eq_ignore_ascii_case("LOOKUP_TABLE") {
                    let reason = format!("{} is no LOOKUP_TABLE", shown(word.as_bytes()));
                    return Err(self.fail(&place, reason));
                }
                self.word(&place)?;
                (kind, components)
            }
            _ => (self.kind(&place)?, components),
        };
        let mut array = self.array(&place, &name, components, count, kind)?;
        if let Some(array) = &mut array {
            array.is_color |= keyword == "COLOR_SCALARS";
            array.is_normals |= keyword == "NORMALS";
        }
        self.keep(array);
        Ok(())
    }

    /// Colours are bytes in binary files and fractions in text.
    fn color_kind(&self) -> Kind {
        if self.scanner.is_binary { Kind::U8 } else { Kind::F32 }
    }

    fn name(&mut self, place: &str) -> Result<String, AssetError> {
        let word = self.word(place)?;
        Ok(percent_decode_str(&word).decode_utf8_lossy().into_owned())
    }

    /// Arrays of any shape.
    fn field(&mut self) -> Result<(), AssetError> {
        let name = self.name("FIELD")?;
        let place = format!("FIELD {name}");
        let arrays = self.count(&place)?;
        for _ in 0..arrays {
            let mut name = self.name(&place)?;
            while name == "METADATA" {
                self.scanner.skip_to_blank_line()?;
                name = self.name(&place)?;
            }
            let place = format!("array {name}");
            let (components, tuples) = (self.count(&place)?, self.count(&place)?);
            let kind = self.word(&place)?;
            if ["string", "unicode_string"].contains(&kind.to_ascii_lowercase().as_str()) {
                self.scanner.skip_strings(&place, components.saturating_mul(tuples))?;
                continue;
            }
            let Some(kind) = Kind::of_legacy(&kind) else {
                let shown = shown(kind.as_bytes());
                return Err(self.fail(&place, format!("type {shown} is unknown")));
            };
            if self.of.is_none() {
                self.skip(&place, components.saturating_mul(tuples), kind)?;
            } else {
                let array = self.array(&place, &name, components, tuples, kind)?;
                self.keep(array);
            }
        }
        Ok(())
    }

    fn skip(&mut self, place: &str, count: u64, kind: Kind) -> Result<(), AssetError> {
        self.check_count(place, count, kind)?;
        self.scanner.numbers(place, count, kind, |_| Ok(()))
    }

    /// Reads an array; `None` for one of too many components.
    fn array(
        &mut self,
        place: &str,
        name: &str,
        components: u64,
        tuples: u64,
        kind: Kind,
    ) -> Result<Option<Array>, AssetError> {
        let count = components.saturating_mul(tuples);
        let usable = (1..=MOST_COMPONENTS as u64).contains(&components);
        if !usable {
            self.data.warnings.push(format!(
                "array \"{name}\" is left out: it has {components} numbers for an element; accepted are 1 to {MOST_COMPONENTS}"
            ));
            self.skip(place, count, kind)?;
            return Ok(None);
        }
        self.check_count(place, count, kind)?;
        let mut array = Array::new(name, components as usize, kind);
        let before = self.data.bytes();
        let meter = &mut self.meter;
        let values = &mut array.values;
        self.scanner.numbers(place, count, kind, |number| {
            meter.reach(before + 4 * (values.len() as u64 + 1))?;
            values.push(number as f32);
            Ok(())
        })?;
        Ok(Some(array))
    }

    fn keep(&mut self, array: Option<Array>) {
        match self.of {
            Some(Of::Points(_)) => self.data.point_arrays.extend(array),
            Some(Of::Cells(_)) => self.data.cell_arrays.extend(array),
            None => {}
        }
    }
}
