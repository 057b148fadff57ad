use std::io::Write;

use ::base64::Engine as _;
use glam::DVec3;
use proptest::prelude::*;

use super::*;
use crate::assets::Polylines;
use crate::assets::first::{cloud, lines, mesh};
use crate::assets::input::Input;

fn legacy(bytes: impl Into<Vec<u8>>) -> Result<Asset, AssetError> {
    read_legacy(Input::from_bytes(bytes.into(), "a.vtk"), &ReadOptions::default())
}

fn xml(bytes: impl Into<Vec<u8>>) -> Result<Asset, AssetError> {
    read_xml(Input::from_bytes(bytes.into(), "a.vtp"), &ReadOptions::default())
}

fn values(lines: &Polylines, name: &str) -> Vec<f64> {
    let field = lines.fields.list().iter().find(|field| field.name == name).unwrap();
    let points = 0..lines.positions.len();
    points.map(|vertex| field.value(lines.fields.at(vertex)).unwrap()).collect()
}

/// The example that all encodings hold: four points, lines 0 1 2 and 3 0, with arrays.
fn check(asset: &Asset) {
    assert!(asset.warnings.is_empty(), "{:?}", asset.warnings);
    let lines = lines(asset);
    let places = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 2.5, 0.0], [0.0, 0.0, -3.0], [0.0; 3]];
    assert_eq!(lines.positions, places.map(DVec3::from_array));
    assert_eq!(lines.strands, [0, 3, 5]);
    assert_eq!(lines.radii.as_ref().unwrap()[..], [0.5, 0.25, 0.125, 2.0, 0.5]);
    let colors = lines.colors.as_ref().unwrap();
    assert_eq!(colors[..2], [[255, 0, 0, 255], [0, 255, 0, 255]]);
    assert_eq!(colors[2..4], [[0, 0, 255, 255], [9, 8, 7, 255]]);
    assert_eq!(values(lines, "t"), [10.0, 20.0, 30.0, 40.0, 10.0]);
    assert_eq!(values(lines, "cell"), [7.0, 7.0, 7.0, 8.0, 8.0]);
}

const POINTS: [f64; 12] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 2.5, 0.0, 0.0, 0.0, -3.0];
const COLORS: [u8; 12] = [255, 0, 0, 0, 255, 0, 0, 0, 255, 9, 8, 7];
const RADIUS: [f64; 4] = [0.5, 0.25, 0.125, 2.0];
const T: [f64; 4] = [10.0, 20.0, 30.0, 40.0];

/// Legacy files: text or big-endian bytes.
struct Legacy {
    bytes: Vec<u8>,
    is_binary: bool,
}

impl Legacy {
    fn new(version: &str, is_binary: bool) -> Legacy {
        let encoding = if is_binary { "BINARY" } else { "ASCII" };
        let head =
            format!("# vtk DataFile Version {version}\ntitle\n{encoding}\nDATASET POLYDATA\n");
        Legacy { bytes: head.into_bytes(), is_binary }
    }

    fn put(&mut self, line: &str, kind: &str, numbers: &[f64]) {
        self.bytes.extend(format!("{line}\n").bytes());
        for &number in numbers {
            if !self.is_binary {
                self.bytes.extend(format!("{number}\n").bytes());
                continue;
            }
            match kind {
                "float" => self.bytes.extend((number as f32).to_be_bytes()),
                "double" => self.bytes.extend(number.to_be_bytes()),
                "int" => self.bytes.extend((number as i32).to_be_bytes()),
                "vtktypeint64" => self.bytes.extend((number as i64).to_be_bytes()),
                _ => self.bytes.push(number as u8),
            }
        }
        self.bytes.push(b'\n');
    }

    fn text(&mut self, text: &str) {
        self.bytes.extend(text.bytes());
    }
}

fn whole_legacy(version: &str, is_binary: bool) -> Vec<u8> {
    let mut file = Legacy::new(version, is_binary);
    // Data without meaning before everything.
    file.put("FIELD FieldData 1\nmeta 2 2 float", "float", &[1.0, 2.0, 3.0, 4.0]);
    file.put("POINTS 4 float", "float", &POINTS);
    file.text("METADATA\nINFORMATION 1\nNAME a LOCATION b\nDATA 2 0 1\n\n");
    if version.starts_with('5') {
        let kind = "vtktypeint64";
        file.put(&format!("LINES 3 5\nOFFSETS {kind}"), kind, &[0.0, 3.0, 5.0]);
        file.put(&format!("CONNECTIVITY {kind}"), kind, &[0.0, 1.0, 2.0, 3.0, 0.0]);
    } else {
        file.put("LINES 2 7", "int", &[3.0, 0.0, 1.0, 2.0, 2.0, 3.0, 0.0]);
    }
    file.put("CELL_DATA 2\nSCALARS cell int 1\nLOOKUP_TABLE default", "int", &[7.0, 8.0]);
    let strings = match is_binary {
        false => "one\ntwo\n".to_owned(),
        true => String::from_utf8_lossy(&[]).into_owned(),
    };
    if !is_binary {
        file.text(&format!("FIELD FieldData 1\nnames 1 2 string\n{strings}"));
    }
    file.put("POINT_DATA 4\nSCALARS t double\nLOOKUP_TABLE table", "double", &T);
    let colors = COLORS.map(f64::from);
    if is_binary {
        file.put("COLOR_SCALARS hue 3", "unsigned_char", &colors);
    } else {
        file.put("COLOR_SCALARS hue 3", "float", &colors.map(|channel| channel / 255.0));
    }
    file.put("LOOKUP_TABLE table 1", "unsigned_char", &[1.0, 0.0, 1.0, 0.0]);
    file.put("FIELD FieldData 1\nRadius 1 4 float", "float", &RADIUS);
    file.bytes
}

#[test]
fn legacy_files_of_all_versions_and_encodings_are_read() {
    for version in ["2.0", "3.0", "4.2", "5.1"] {
        for is_binary in [false, true] {
            let asset = legacy(whole_legacy(version, is_binary)).unwrap();
            assert_eq!(asset.format, "vtk");
            check(&asset);
        }
    }
}

#[test]
fn binary_strings_are_stepped_over() {
    let mut file = Legacy::new("4.2", true);
    file.put("POINTS 2 double", "double", &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
    file.put("LINES 1 3", "int", &[2.0, 0.0, 1.0]);
    file.text("CELL_DATA 1\nFIELD FieldData 1\nname 1 1 string\n");
    file.bytes.extend([0xc0 | 3, b'a', b'\n', b'c', b'\n']);
    assert_eq!(lines(&legacy(file.bytes).unwrap()).strands, [0, 2]);
}

#[test]
fn polygons_are_meshes_and_bare_points_a_cloud() {
    let mut file = Legacy::new("3.0", false);
    file.put("POINTS 4 float", "float", &POINTS);
    file.put("VERTICES 1 2", "int", &[1.0, 0.0]);
    file.put("LINES 1 3", "int", &[2.0, 0.0, 1.0]);
    file.put("POLYGONS 2 9", "int", &[3.0, 0.0, 1.0, 2.0, 4.0, 0.0, 1.0, 2.0, 3.0]);
    file.put("TRIANGLE_STRIPS 1 5", "int", &[4.0, 0.0, 1.0, 2.0, 3.0]);
    // Five cells: a vertex, a line, three others.
    file.put("CELL_DATA 5\nSCALARS c int\nLOOKUP_TABLE default", "int", &[1.0, 2.0, 3.0, 4.0, 5.0]);
    file.put("POINT_DATA 4\nNORMALS n float", "float", &[0.0, 0.0, 2.0].repeat(4));
    let asset = legacy(file.bytes).unwrap();
    assert_eq!(asset.geometries.len(), 2);
    assert_eq!(asset.placements.iter().map(|p| p.geometry).collect::<Vec<_>>(), [0, 1]);
    assert_eq!(values(lines(&asset), "c"), [2.0, 2.0]);
    assert_eq!(mesh(&asset).triangles.len(), 5);
    assert_eq!(mesh(&asset).triangles[3..], [[0, 1, 2], [2, 1, 3]]);
    assert_eq!(mesh(&asset).normals.as_ref().unwrap()[0], glam::Vec3::Z);

    let mut file = Legacy::new("3.0", true);
    file.put("POINTS 4 float", "float", &POINTS);
    file.put("POINT_DATA 4\nSCALARS t int\nLOOKUP_TABLE default", "int", &T);
    let asset = legacy(file.bytes).unwrap();
    assert_eq!(cloud(&asset).positions.len(), 4);
    assert_eq!(cloud(&asset).values_of("t").unwrap(), T);
}

/// A vertex, a line, two polygons with one of a single corner between them, and a strip, with these arrays.
fn painted(arrays: &[(&str, &[f64])]) -> Asset {
    let mut file = Legacy::new("3.0", false);
    file.put("POINTS 4 float", "float", &POINTS);
    file.put("VERTICES 1 2", "int", &[1.0, 0.0]);
    file.put("LINES 1 3", "int", &[2.0, 0.0, 1.0]);
    file.put("POLYGONS 3 11", "int", &[3.0, 0.0, 1.0, 2.0, 1.0, 0.0, 4.0, 0.0, 1.0, 2.0, 3.0]);
    file.put("TRIANGLE_STRIPS 1 5", "int", &[4.0, 0.0, 1.0, 2.0, 3.0]);
    arrays.iter().for_each(|(line, numbers)| file.put(line, "float", numbers));
    legacy(file.bytes).unwrap()
}

#[test]
fn polygons_and_strips_have_the_colors_of_their_cells() {
    let cells =
        [0.2, 0.2, 0.2, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.4, 0.4, 0.4, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0];
    let asset = painted(&[("CELL_DATA 6\nCOLOR_SCALARS paint 3", &cells)]);
    let found = mesh(&asset);
    let colors = found.colors.as_ref().unwrap();
    let of = |triangle: &[u32; 3]| triangle.map(|corner| colors[corner as usize]);
    let (red, blue, yellow) = ([255, 0, 0, 255], [0, 0, 255, 255], [255, 255, 0, 255]);
    let expected = [red, blue, blue, yellow, yellow].map(|color| [color; 3]);
    assert_eq!(found.triangles.iter().map(of).collect::<Vec<_>>(), expected);
    assert_eq!(lines(&asset).colors.as_ref().unwrap()[..], [[0, 255, 0, 255]; 2]);
    assert!(!asset.warnings.iter().any(|text| text.contains("paint")), "{:?}", asset.warnings);
}

#[test]
fn colors_and_normals_of_cells_that_are_not_used_are_named() {
    let points = [0.0, 1.0, 0.0].repeat(4);
    let asset = painted(&[
        ("CELL_DATA 6\nCOLOR_SCALARS paint 3", &[0.5; 18]),
        ("NORMALS up float", &[1.0; 18]),
        ("POINT_DATA 4\nCOLOR_SCALARS own 3", &points),
    ]);
    assert_eq!(mesh(&asset).colors, Some(vec![[0, 255, 0, 255]; 4]));
    for name in ["colours of faces are ignored", "\"up\" of cells"] {
        assert!(asset.warnings.iter().any(|text| text.contains(name)), "{:?}", asset.warnings);
    }
}

#[test]
fn lines_without_two_points_cost_no_mesh() {
    let file = |polygons: bool| {
        let mut file = Legacy::new("3.0", false);
        file.put("POINTS 4 float", "float", &POINTS);
        file.put("LINES 1 2", "int", &[1.0, 0.0]);
        if polygons {
            file.put("POLYGONS 1 4", "int", &[3.0, 0.0, 1.0, 2.0]);
        }
        legacy(file.bytes)
    };
    let asset = file(true).unwrap();
    assert_eq!((asset.geometries.len(), asset.placements.len()), (1, 1));
    assert_eq!(mesh(&asset).triangles.len(), 1);
    assert!(asset.warnings.iter().any(|text| text.starts_with("lines are left out: no strand")));
    assert!(file(false).unwrap_err().to_string().contains("no strand has two vertices"));
}

#[test]
fn damaged_legacy_files_are_refused() {
    for (version, is_binary) in [("3.0", true), ("5.1", true)] {
        let whole = whole_legacy(version, is_binary);
        let mut whole_ones = 0;
        for length in 0..whole.len() {
            match legacy(whole[..length].to_vec()) {
                Err(error) => assert!(error.to_string().starts_with("a.vtk: ")),
                // A file may end behind any section, and within what describes an array.
                Ok(_) => whole_ones += 1,
            }
        }
        assert!(whole_ones < 80, "{whole_ones}");
    }
    let head = "# vtk DataFile Version 3.0\nt\nASCII\n";
    for (text, expected) in [
        (
            "# vtk DataFile Version 9.0\nt\nASCII\n".to_owned(),
            "is no \"# vtk DataFile Version\" of 1 to 5",
        ),
        ("# vtk DataFile Version 3.0\nt\nEBCDIC\n".to_owned(), "neither ASCII nor BINARY"),
        (format!("{head}DATASET STRUCTURED_POINTS\n"), "accepted is POLYDATA"),
        (format!("{head}DATASET POLYDATA\nPOINTS 999999999 float\n"), "POINTS: declares"),
        (format!("{head}DATASET POLYDATA\nPOINTS 1 complex\n"), "type \"complex\" is unknown"),
        (
            format!("{head}POINTS 1 float\n1 2 x\n"),
            "POINTS, number 2 (line 5): \"x\" is not a number",
        ),
        (format!("{head}POINTS 1 float\n1 2\n"), "the file ends after 2 of 3 numbers"),
        (
            format!("{head}POINTS 1 float\n1 2 3\nLINES 1 3\n2 0 1\n"),
            "line 0: point 1 does not exist",
        ),
        (
            format!("{head}POINTS 1 float\n1 2 3\nLINES 1 3\n2 0 -1\n"),
            "-1 in cell 1 is no number of a point",
        ),
        (format!("{head}POINTS 1 float\n1 2 3\nLINES 1 3\n5 0 0\n"), "lacking 3 corners"),
        (format!("{head}POINTS 1 float\n1 2 3\nSCALARS a int\n"), "stands before POINT_DATA"),
        (format!("{head}NONSENSE 1\n"), "keyword \"NONSENSE\" is unknown"),
        (format!("{head}POINTS 0 float\n"), "holds no vertices"),
    ] {
        let error = legacy(text.clone()).unwrap_err().to_string();
        assert!(error.contains(expected), "{text:?}: {error}");
    }
    let offsets = "# vtk DataFile Version 5.1\nt\nASCII\nPOINTS 2 float\n0 0 0 1 1 1\nLINES 2 2\nOFFSETS vtktypeint64\n";
    for (rest, expected) in [
        ("1 2\nCONNECTIVITY vtktypeint64\n0 1\n", "1 does not belong here"),
        ("0 1\nCONNECTIVITY vtktypeint64\n0 1\n", "do not rise from 0 to 2"),
        ("0 2\nCORNERS vtktypeint64\n0 1\n", "\"CORNERS\" stands here instead"),
    ] {
        let error = legacy(format!("{offsets}{rest}")).unwrap_err().to_string();
        assert!(error.contains(expected), "{rest:?}: {error}");
    }
}

#[test]
fn arrays_of_another_length_are_left_out() {
    let mut file = Legacy::new("3.0", false);
    file.put("POINTS 4 float", "float", &POINTS);
    file.put("LINES 1 3", "int", &[2.0, 0.0, 1.0]);
    file.put("POINT_DATA 3\nSCALARS t int\nLOOKUP_TABLE default", "int", &[1.0, 2.0, 3.0]);
    file.put("TENSORS s float", "float", &[0.0; 27]);
    let asset = legacy(file.bytes).unwrap();
    assert!(lines(&asset).fields.is_empty());
    assert_eq!(asset.warnings.len(), 2, "{:?}", asset.warnings);
    assert!(asset.warnings[1].contains("\"t\" is left out: it has 3 numbers for 4 points"));
}

/// How arrays of an XML file are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Ascii,
    Binary,
    AppendedRaw,
    AppendedBase64,
}

struct Xml {
    format: Format,
    is_big: bool,
    is_wide: bool,
    is_packed: bool,
    appended: Vec<u8>,
}

fn base64(bytes: &[u8]) -> String {
    ::base64::engine::general_purpose::STANDARD.encode(bytes)
}

impl Xml {
    fn order<const N: usize>(&self, little: [u8; N]) -> Vec<u8> {
        if self.is_big { little.iter().rev().copied().collect() } else { little.to_vec() }
    }

    fn word(&self, number: usize) -> Vec<u8> {
        if self.is_wide {
            self.order((number as u64).to_le_bytes())
        } else {
            self.order((number as u32).to_le_bytes())
        }
    }

    /// Header and data.
    fn stream(&self, bytes: &[u8]) -> [Vec<u8>; 2] {
        if !self.is_packed {
            return [self.word(bytes.len()), bytes.to_vec()];
        }
        let size = 16;
        let blocks: Vec<Vec<u8>> = bytes
            .chunks(size)
            .map(|block| {
                let mut encoder =
                    flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
                encoder.write_all(block).unwrap();
                encoder.finish().unwrap()
            })
            .collect();
        let mut header = [self.word(blocks.len()), self.word(size)].concat();
        header.extend(self.word(bytes.len() % size));
        blocks.iter().for_each(|block| header.extend(self.word(block.len())));
        [header, blocks.concat()]
    }

    fn array(&mut self, kind: &str, name: &str, components: usize, numbers: &[f64]) -> String {
        let bytes: Vec<u8> = numbers
            .iter()
            .flat_map(|&number| match kind {
                "Float32" => self.order((number as f32).to_le_bytes()),
                "Float64" => self.order(number.to_le_bytes()),
                "Int64" => self.order((number as i64).to_le_bytes()),
                "Int32" => self.order((number as i32).to_le_bytes()),
                _ => vec![number as u8],
            })
            .collect();
        let [header, data] = self.stream(&bytes);
        // Headers of packed data are encoded by themselves.
        let text = match self.is_packed {
            true => base64(&header) + &base64(&data),
            false => base64(&[header.clone(), data.clone()].concat()),
        };
        let offset = self.appended.len();
        let (format, content) = match self.format {
            Format::Ascii => {
                let words: Vec<String> = numbers.iter().map(f64::to_string).collect();
                ("format=\"ascii\"".to_owned(), words.join(" "))
            }
            Format::Binary => ("format=\"binary\"".to_owned(), format!("\n  {text}\n")),
            Format::AppendedRaw => {
                self.appended.extend([header, data].concat());
                (format!("format=\"appended\" offset=\"{offset}\""), String::new())
            }
            Format::AppendedBase64 => {
                self.appended.extend(text.bytes());
                (format!("format=\"appended\" offset=\"{offset}\""), String::new())
            }
        };
        format!(
            "<DataArray type=\"{kind}\" Name=\"{name}\" NumberOfComponents=\"{components}\" {format}>{content}</DataArray>"
        )
    }

    fn file(mut self, pieces: &[&dyn Fn(&mut Xml) -> String]) -> Vec<u8> {
        let order = if self.is_big { "BigEndian" } else { "LittleEndian" };
        let header = if self.is_wide { "UInt64" } else { "UInt32" };
        let packing = if self.is_packed { " compressor=\"vtkZLibDataCompressor\"" } else { "" };
        let mut bytes = format!(
            "<?xml version=\"1.0\"?>\n<VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"{order}\" header_type=\"{header}\"{packing}>\n<PolyData>"
        )
        .into_bytes();
        for piece in pieces {
            bytes.extend(piece(&mut self).bytes());
        }
        bytes.extend(b"</PolyData>");
        let encoding = match self.format {
            Format::AppendedRaw => "raw",
            Format::AppendedBase64 => "base64",
            _ => "",
        };
        if !encoding.is_empty() {
            bytes.extend(format!("<AppendedData encoding=\"{encoding}\">\n_").bytes());
            bytes.extend(&self.appended);
            bytes.extend(b"\n</AppendedData>");
        }
        bytes.extend(b"</VTKFile>");
        bytes
    }
}

fn piece(xml: &mut Xml) -> String {
    let points = xml.array("Float32", "p", 3, &POINTS);
    let corners = xml.array("Int64", "connectivity", 1, &[0.0, 1.0, 2.0, 3.0, 0.0]);
    let ends = xml.array("Int32", "offsets", 1, &[3.0, 5.0]);
    let colors = xml.array("UInt8", "paint", 3, &COLORS.map(f64::from));
    let radius = xml.array("Float64", "radius", 1, &RADIUS);
    let t = xml.array("Float32", "t", 1, &T);
    let cell = xml.array("Int32", "cell", 1, &[7.0, 8.0]);
    format!(
        "<Piece NumberOfPoints=\"4\" NumberOfLines=\"2\"><PointData>{colors}{radius}{t}</PointData><CellData>{cell}</CellData><Points>{points}</Points><Lines>{corners}{ends}</Lines></Piece>"
    )
}

const FORMATS: [Format; 4] =
    [Format::Ascii, Format::Binary, Format::AppendedRaw, Format::AppendedBase64];

fn example(format: Format, is_big: bool, is_wide: bool, is_packed: bool) -> Xml {
    Xml { format, is_big, is_wide, is_packed, appended: Vec::new() }
}

#[test]
fn xml_files_of_all_encodings_are_read() {
    for format in FORMATS {
        for bits in 0..8 {
            let file = example(format, bits & 1 > 0, bits & 2 > 0, bits & 4 > 0);
            let asset = xml(file.file(&[&piece])).unwrap();
            assert_eq!(asset.format, "vtp");
            check(&asset);
        }
    }
}

#[test]
fn pieces_follow_each_other() {
    let file = example(Format::Binary, false, false, true).file(&[&piece, &piece]);
    let asset = xml(file).unwrap();
    let lines = lines(&asset);
    assert_eq!(lines.strands, [0, 3, 5, 8, 10]);
    assert_eq!(lines.positions[..5], lines.positions[5..]);
    assert_eq!(values(lines, "t")[5..], [10.0, 20.0, 30.0, 40.0, 10.0]);
    assert!(asset.warnings[0].contains("several pieces"), "{:?}", asset.warnings);
}

#[test]
fn arrays_of_one_name_in_a_piece_are_not_joined() {
    let twice = |xml: &mut Xml| piece(xml).replace("Name=\"t\"", "Name=\"radius\"");
    let read = |pieces: &[&dyn Fn(&mut Xml) -> String]| {
        xml(example(Format::Ascii, false, false, false).file(pieces)).unwrap()
    };
    for (count, asset) in [(1, read(&[&twice])), (2, read(&[&twice, &twice]))] {
        let found = asset.warnings.iter().filter(|text| text.contains("has the same name"));
        assert_eq!(found.count(), count, "{:?}", asset.warnings);
        assert_eq!(lines(&asset).radii.as_ref().unwrap()[..5], [0.5, 0.25, 0.125, 2.0, 0.5]);
    }
}

#[test]
fn damaged_xml_files_are_refused() {
    for format in FORMATS {
        for is_packed in [false, true] {
            let whole = example(format, false, false, is_packed).file(&[&piece]);
            for length in 0..whole.len() - 40 {
                let error = xml(whole[..length].to_vec()).unwrap_err().to_string();
                assert!(error.starts_with("a.vtp: "), "{error}");
            }
        }
    }
    let text =
        String::from_utf8(example(Format::Ascii, false, false, false).file(&[&piece])).unwrap();
    for (from, to, expected) in [
        ("type=\"PolyData\"", "type=\"ImageData\"", "accepted is PolyData"),
        ("LittleEndian", "Middle", "byte_order \"Middle\" is unknown"),
        ("UInt32\"", "UInt16\"", "header_type \"UInt16\" is unknown"),
        (
            "NumberOfPoints=\"4\"",
            "NumberOfPoints=\"5\"",
            "piece 0, Points: 12 numbers for 5 points",
        ),
        (
            "NumberOfLines=\"2\"",
            "NumberOfLines=\"3\"",
            "2 cells end at corner 5; the piece announces 3",
        ),
        ("0 1 2 3 0", "0 1 2 4 0", "line 1: point 4 does not exist"),
        ("0 1 2 3 0", "0 1 2 -1 0", "piece 0, Lines: -1 does not belong here"),
        ("0 1 2 3 0", "0 1 2 x 0", "piece 0, Lines, connectivity, number 3: \"x\" is not a number"),
        (">3 5<", ">3 4<", "2 cells end at corner 4"),
        ("10 20 30 40", "10 20 30", "\"t\": 3 numbers; 4 elements have 4"),
        ("<Piece ", "<Piece NumberOfVerts=\"18446744073709551615\" ", "vertex cells"),
        ("VTKFile", "File", "not VTKFile"),
        ("format=\"ascii\"", "format=\"appended\" offset=\"0\"", "refers to appended data"),
        ("format=\"ascii\"", "format=\"morse\"", "format \"morse\" is unknown"),
    ] {
        let error = xml(text.replace(from, to)).unwrap_err().to_string();
        assert!(error.contains(expected), "{from} {to}: {error}");
    }
    let packed = text.replace(
        "version=\"1.0\" byte",
        "version=\"1.0\" compressor=\"vtkLZ4DataCompressor\" byte",
    );
    assert!(
        xml(packed)
            .unwrap_err()
            .to_string()
            .contains("accepted are none and vtkZLibDataCompressor")
    );
}

/// Sizes that blocks of zlib declare are judged before anything is allocated for them.
#[test]
fn lying_blocks_are_refused() {
    let with = |header: [u32; 4], rest: &[u8]| {
        let mut appended: Vec<u8> = header.iter().flat_map(|word| word.to_le_bytes()).collect();
        appended.extend(rest);
        let mut file = b"<VTKFile type=\"PolyData\" compressor=\"vtkZLibDataCompressor\"><PolyData><Piece NumberOfPoints=\"1\"><Points><DataArray type=\"Float32\" NumberOfComponents=\"3\" format=\"appended\" offset=\"0\"/></Points></Piece></PolyData><AppendedData encoding=\"raw\">_".to_vec();
        file.extend(appended);
        file.extend(b"</AppendedData></VTKFile>");
        xml(file).unwrap_err().to_string()
    };
    assert!(with([u32::MAX, 12, 0, 4], b"").contains("declares more blocks than"));
    assert!(
        with([1, u32::MAX, 0, 4], b"abcd").contains("4 bytes of zlib cannot hold the 4294967295")
    );
    assert!(with([1, 12, 0, u32::MAX], b"abcd").contains("the file is truncated or lies"));
    assert!(with([1, 13, 0, 4], b"abcd").contains("13 bytes are no whole number of items of 4"));
    assert!(with([1, 12, 0, 4], b"abcd").contains("block 0 of zlib"));
}

#[test]
fn numbers_of_every_type_are_decoded() {
    use super::values::Kind;
    for (name, bytes, expected) in [
        ("Int8", &[0xffu8][..], -1.0),
        ("UInt8", &[0xff], 255.0),
        ("Int16", &[0xfe, 0xff], -2.0),
        ("UInt16", &[0xfe, 0xff], 65534.0),
        ("Int32", &[0xfd, 0xff, 0xff, 0xff], -3.0),
        ("UInt32", &[0xfd, 0xff, 0xff, 0xff], 4294967293.0),
        ("Int64", &[0xfc, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff], -4.0),
        ("UInt64", &[1, 0, 0, 0, 1, 0, 0, 0], 4294967297.0),
        ("Float32", &[0, 0, 0xc0, 0x3f], 1.5),
        ("Float64", &[0, 0, 0, 0, 0, 0, 0xf8, 0xbf], -1.5),
    ] {
        let kind = Kind::of_xml(name).unwrap();
        assert_eq!(kind.decode(bytes, false), expected, "{name}");
        let big: Vec<u8> = bytes.iter().rev().copied().collect();
        assert_eq!(kind.decode(&big, true), expected, "{name}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]
    #[test]
    fn damaged_legacy_bytes_never_panic(at in 0usize..2000, with in any::<u8>(), is_binary in any::<bool>(), new in any::<bool>()) {
        let mut bytes = whole_legacy(if new { "5.1" } else { "3.0" }, is_binary);
        let at = at % bytes.len();
        bytes[at] = with;
        let _ = legacy(bytes);
    }

    #[test]
    fn damaged_xml_bytes_never_panic(at in 0usize..4000, with in any::<u8>(), format in 0usize..4, is_packed in any::<bool>()) {
        let mut bytes = example(FORMATS[format], false, false, is_packed).file(&[&piece]);
        let at = at % bytes.len();
        bytes[at] = with;
        let _ = xml(bytes);
    }
}
