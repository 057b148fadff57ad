//! The XML format of VTK for polygonal data (`.vtp`): arrays as text, as base 64 in the text, or appended raw or in base 64; all
//! binary forms plain or in blocks of zlib; headers of 32 and 64 bits; both byte orders; any number of pieces.
//!
//! Raw appended data make the file no XML. The element is therefore cut out first, and what is left is parsed as a document
//! that borrows its text from the file's bytes.

mod data;

use glam::DVec3;
use roxmltree::{Document, Node, ParsingOptions};

use self::data::Decoder;
use super::super::input::{Input, Origin};
use super::super::tokens::shown;
use super::super::{Asset, AssetError, ReadOptions};
use super::values::{Array, Kind};
use super::{Cells, MOST_COMPONENTS, PolyData};
use crate::memory::Meter;

/// Most elements and texts of a document; arrays are single ones.
const MOST_NODES: u32 = 1 << 18;
/// Bytes of one of them in memory at most.
const NODE_BYTES: u64 = 128;

/// Reads a `.vtp` file from `input`.
///
/// # Errors
/// XML that is not well-formed, malformed or truncated content (naming piece and array), counts that the file cannot hold or
/// that are over the limits, other data than polygons, other compression than zlib.
pub fn read_from(mut input: Input, options: &ReadOptions) -> Result<Asset, AssetError> {
    let bytes = input.read_all()?;
    let origin = input.origin;
    let file = origin.name.as_str();
    let fail = |reason: String| AssetError::malformed(file, "XML", reason);
    let (text, appended) = data::split(&bytes).map_err(fail)?;
    let markup = text.iter().filter(|byte| **byte == b'<').count() as u64;
    // A document that has line ends of another system holds its texts once more.
    let nodes = (2 * markup + 1).min(MOST_NODES.into());
    origin.admission.grow(file, 2 * text.len() as u64 + nodes * NODE_BYTES)?;
    let text = std::str::from_utf8(&text).map_err(|_| fail("is no UTF-8".to_owned()))?;
    let parsing = ParsingOptions { nodes_limit: MOST_NODES, ..ParsingOptions::default() };
    let document =
        Document::parse_with_options(text, parsing).map_err(|error| fail(error.to_string()))?;
    let root = document.root_element();
    let decoder = Decoder::new(&root, appended, &origin, options)?;
    let kind = root.attribute("type").unwrap_or("nothing");
    if kind != "PolyData" {
        let reason = format!("holds VTK data of the type {kind}; accepted is PolyData");
        return Err(AssetError::unsupported(file, reason));
    }
    let pieces = root.children().filter(|node| node.has_tag_name("PolyData"));
    let pieces = pieces.flat_map(|node| node.children());
    let mut reading = Reading {
        origin: &origin,
        options,
        decoder,
        data: PolyData::default(),
        verts: 0,
        meter: origin.admission.meter(file),
    };
    for (number, piece) in pieces.filter(|node| node.has_tag_name("Piece")).enumerate() {
        reading.piece(number, &piece)?;
    }
    reading.data.finish("vtp", &origin, options)
}

struct Reading<'a> {
    origin: &'a Origin,
    options: &'a ReadOptions,
    decoder: Decoder<'a>,
    data: PolyData,
    /// Vertex cells so far.
    verts: u64,
    meter: Meter<'a>,
}

impl Reading<'_> {
    fn fail(&self, place: &str, reason: impl Into<String>) -> AssetError {
        AssetError::malformed(&self.origin.name, place, reason)
    }

    fn piece(&mut self, number: usize, piece: &Node) -> Result<(), AssetError> {
        let place = format!("piece {number}");
        let count = |name: &str| -> Result<u64, AssetError> {
            let Some(text) = piece.attribute(name) else { return Ok(0) };
            text.trim().parse().map_err(|_| {
                let reason = format!("{name} {} is no count", shown(text.as_bytes()));
                self.fail(&place, reason)
            })
        };
        let points = count("NumberOfPoints")?;
        let verts = count("NumberOfVerts")?;
        let lines = count("NumberOfLines")?;
        let strips = count("NumberOfStrips")?;
        let polys = count("NumberOfPolys")?;
        let total = points.saturating_add(self.data.points.len() as u64);
        let most = self.options.max_vertices.min(u64::from(u32::MAX));
        AssetError::check_limit(&self.origin.name, "vertices", total, most)?;
        let first = self.data.points.len() as u32;
        self.points(&place, piece, points)?;
        let cells = verts.saturating_add(lines).saturating_add(polys).saturating_add(strips);
        // A vertex cell has a corner at least; these corners are not read.
        self.verts = self.verts.saturating_add(verts);
        AssetError::check_limit(&self.origin.name, "vertex cells", self.verts, most)?;
        for (name, count) in [("Lines", lines), ("Polys", polys), ("Strips", strips)] {
            self.cells(&place, piece, name, count, first)?;
        }
        self.arrays(&place, piece, "PointData", points, first.into())?;
        let is_whole = first == 0 && self.data.cell_arrays.is_empty();
        if is_whole {
            self.arrays(&place, piece, "CellData", cells, 0)?;
        } else if element(piece, "CellData").is_some_and(|node| node.has_children()) {
            // The cells of a kind lie together only where there is one piece.
            self.data.cell_arrays.clear();
            self.data
                .warnings
                .push("arrays of cells are left out: the file has several pieces".to_owned());
        }
        self.data.verts = self.verts;
        Ok(())
    }

    fn points(&mut self, place: &str, piece: &Node, count: u64) -> Result<(), AssetError> {
        let node = element(piece, "Points").and_then(|node| array_elements(node).next());
        let Some(node) = node else {
            return match count {
                0 => Ok(()),
                _ => Err(self.fail(place, "has no array of Points")),
            };
        };
        let place = format!("{place}, Points");
        let (mut point, mut axis, mut read) = (DVec3::ZERO, 0, 0);
        let before = self.data.bytes();
        let Self { decoder, data, meter, .. } = self;
        let points = &mut data.points;
        let mut came = 0;
        decoder.numbers(&place, &node, &mut |number| {
            point[axis] = number;
            axis = (axis + 1) % 3;
            read += 1;
            if axis == 0 && came < count {
                came += 1;
                meter.reach(before + 24 * came)?;
                points.push(point);
            }
            Ok(())
        })?;
        if read != 3 * count {
            let reason = format!("{read} numbers for {count} points; each has 3");
            return Err(self.fail(&place, reason));
        }
        Ok(())
    }

    /// Appends the cells of a piece, whose first point has the number `first`.
    fn cells(
        &mut self,
        place: &str,
        piece: &Node,
        name: &str,
        count: u64,
        first: u32,
    ) -> Result<(), AssetError> {
        if count == 0 {
            return Ok(());
        }
        let node = element(piece, name);
        let array = |wanted: &str| {
            let arrays = node.into_iter().flat_map(array_elements);
            arrays.into_iter().find(|node| node.attribute("Name") == Some(wanted))
        };
        let place = format!("{place}, {name}");
        let (Some(connectivity), Some(offsets)) = (array("connectivity"), array("offsets")) else {
            return Err(self.fail(&place, "has no arrays \"connectivity\" and \"offsets\""));
        };
        let before = self.data.bytes();
        let Self { decoder, data, meter, options, origin, .. } = self;
        let cells = match name {
            "Lines" => &mut data.lines,
            "Polys" => &mut data.polys,
            _ => &mut data.strips,
        };
        let most = options.max_vertices.min(u64::from(u32::MAX));
        let base = cells.corners.len() as u64;
        let mut bad = None;
        let corners = &mut cells.corners;
        decoder.numbers(&format!("{place}, connectivity"), &connectivity, &mut |number| {
            let point = number + f64::from(first);
            if number.fract() == 0.0 && number >= 0.0 && point < f64::from(u32::MAX) {
                corners.push(point as u32);
            } else {
                bad.get_or_insert(number);
            }
            let total = corners.len() as u64;
            AssetError::check_limit(&origin.name, "corners of cells", total, most)?;
            Ok(meter.reach(before + 4 * (total - base))?)
        })?;
        let size = cells.corners.len() as u64 - base;
        let mut last = 0;
        let mut found = 0;
        let Cells { ends, corners } = cells;
        let corner_bytes = 4 * (corners.len() as u64 - base);
        decoder.numbers(&format!("{place}, offsets"), &offsets, &mut |number| {
            let is_end = number.fract() == 0.0 && number >= last as f64 && number <= size as f64;
            if is_end && found < count {
                last = number as u64;
                found += 1;
                ends.push(base + last);
            } else {
                bad.get_or_insert(number);
            }
            Ok(meter.reach(before + corner_bytes + 8 * found)?)
        })?;
        if let Some(number) = bad {
            return Err(self.fail(&place, format!("{number} does not belong here")));
        }
        if found != count || last != size {
            let reason = format!(
                "{found} cells end at corner {last}; the piece announces {count} and has {size} corners"
            );
            return Err(self.fail(&place, reason));
        }
        Ok(())
    }

    /// Appends the arrays of a piece to those of earlier pieces that have the same name; `before` elements have come before.
    fn arrays(
        &mut self,
        place: &str,
        piece: &Node,
        name: &str,
        count: u64,
        before: u64,
    ) -> Result<(), AssetError> {
        let Some(node) = element(piece, name) else { return Ok(()) };
        let normals = node.attribute("Normals");
        for node in array_elements(node) {
            let own = node.attribute("Name").unwrap_or("array");
            let place = format!("{place}, {name} \"{own}\"");
            let components: u64 = match node.attribute("NumberOfComponents") {
                Some(text) => text.trim().parse().unwrap_or(0),
                None => 1,
            };
            let kind = node.attribute("type").and_then(Kind::of_xml);
            let usable = (1..=MOST_COMPONENTS as u64).contains(&components);
            let (Some(kind), true) = (kind, usable) else {
                // Strings, and numbers that mean nothing here.
                self.data.warnings.push(format!(
                    "array \"{own}\" is left out: accepted are arrays of 1 to {MOST_COMPONENTS} numbers for an element"
                ));
                continue;
            };
            let expected = count.saturating_mul(components);
            let data_bytes = self.data.bytes();
            let mut array = Array::new(own, components as usize, kind);
            array.is_normals |= normals == Some(own);
            let Self { decoder, meter, .. } = self;
            let values = &mut array.values;
            decoder.numbers(&place, &node, &mut |number| {
                meter.reach(data_bytes + 4 * (values.len() as u64 + 1))?;
                values.push(number as f32);
                Ok(())
            })?;
            if array.values.len() as u64 != expected {
                let found = array.values.len();
                let reason = format!("{found} numbers; {count} elements have {expected}");
                return Err(self.fail(&place, reason));
            }
            let arrays = match name {
                "PointData" => &mut self.data.point_arrays,
                _ => &mut self.data.cell_arrays,
            };
            match arrays.iter_mut().find(|known| known.name == array.name) {
                Some(known) => {
                    // One that an earlier piece lacks is shorter, and is found so at the end.
                    let numbers = known.values.len() as u64;
                    let earlier = before.saturating_mul(known.components as u64);
                    if numbers > earlier {
                        self.data.warnings.push(format!(
                            "{place} is left out: an earlier array of the piece has the same name; names must differ"
                        ));
                    } else if numbers == earlier && known.components == array.components {
                        known.values.append(&mut array.values);
                    }
                }
                // An array that an earlier piece lacks is found missing at the end.
                None if before > 0 => {}
                None => arrays.push(array),
            }
        }
        Ok(())
    }
}

fn element<'a, 'input>(piece: &Node<'a, 'input>, name: &str) -> Option<Node<'a, 'input>> {
    piece.children().find(|node| node.has_tag_name(name))
}

/// The arrays in an element.
fn array_elements<'a, 'input: 'a>(
    node: Node<'a, 'input>,
) -> impl Iterator<Item = Node<'a, 'input>> {
    node.children().filter(|node| node.has_tag_name("DataArray") || node.has_tag_name("Array"))
}
