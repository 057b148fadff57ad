//! Reader for stereolithography files, binary and ascii (3D Systems, 1989).
//!
//! STL stores every triangle's corners anew; corners at exactly the same place become one vertex, so
//! that smooth normals can be estimated later. The file's own facet normals are the triangles'
//! and are not kept. Facets of binary files have colours where the file follows one of the two conventions for their
//! attributes: that of VisCAM, or that of Magics, whose header has a colour as well. Many binary files begin with `solid` like ascii ones: what follows decides.

use std::collections::HashMap;
use std::io::BufRead;

use glam::DVec3;

use super::input::{Input, Origin};
use super::polygon::Triangulator;
use super::tokens::{BYTE_ORDER_MARK, Lines, Tokens, number, shown};
use super::{Asset, AssetError, Geometry, Mesh, ReadOptions, corners, tidy};

const HEADER_BYTES: u64 = 84;
const TRIANGLE_BYTES: u64 = 50;
/// Before the colour of the whole, in headers of Magics.
const COLOR_MARK: &[u8] = b"COLOR=";
/// The bit of an attribute beside its three channels of five bits. It says that VisCAM gave the facet a colour, or that Magics gave it none.
const FLAG: u16 = 1 << 15;

/// Reads STL from `input`.
///
/// # Errors
/// Malformed or truncated content (naming the facet), counts over the limits.
pub fn read_from(input: Input, options: &ReadOptions) -> Result<Asset, AssetError> {
    let Input { reader, origin } = input;
    let mut warnings = Vec::new();
    let welded = if is_ascii(&origin) {
        ascii(reader, &origin, options, &mut warnings)?
    } else {
        binary(reader, &origin, options, &mut warnings)?
    };
    let colors = welded.colors(&origin.head);
    let mut mesh =
        Mesh { positions: welded.positions, triangles: welded.triangles, ..Mesh::default() };
    if let Some(colors) = colors {
        corners::paint(&mut mesh, &colors, &origin.name, options, &mut warnings)?;
    }
    let mesh = tidy::finish_mesh(mesh, &origin.name, &mut warnings)?;
    let mut asset = Asset::single("stl", &origin.name, Geometry::Mesh(mesh));
    asset.warnings = warnings;
    Ok(asset)
}

fn declared_triangles(head: &[u8]) -> Option<u64> {
    let count = head.get(80..84)?.first_chunk()?;
    Some(u64::from(u32::from_le_bytes(*count)))
}

fn is_ascii(origin: &Origin) -> bool {
    let head = origin.head.as_slice();
    let text = head.strip_prefix(BYTE_ORDER_MARK).unwrap_or(head).trim_ascii_start();
    if !text.get(..5).is_some_and(|word| word.eq_ignore_ascii_case(b"solid")) {
        return false;
    }
    let fits = |count: u64| HEADER_BYTES + count * TRIANGLE_BYTES == origin.max_bytes;
    if origin.exact && declared_triangles(head).is_some_and(fits) {
        return false;
    }
    !head.contains(&0)
}

/// Triangles whose corners at one place are one vertex.
#[derive(Default)]
struct Welded {
    positions: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    /// The attribute of each triangle, in binary files.
    attributes: Vec<u16>,
    vertices: HashMap<[u64; 3], u32>,
}

impl Welded {
    /// Bytes of vertices and of their entries in the map, which is up to 7/8 full.
    fn vertex_bytes(&self) -> u64 {
        64 * self.positions.len() as u64
    }

    fn triangle_bytes(&self) -> u64 {
        12 * self.triangles.len() as u64 + 2 * self.attributes.len() as u64
    }

    /// The colour of each triangle; `None` where the file has none.
    fn colors(&self, head: &[u8]) -> Option<Vec<[u8; 4]>> {
        let attributes = self.attributes.iter().copied();
        if let Some(whole) = color_of_the_whole(head).filter(|_| !self.attributes.is_empty()) {
            // Programs that know one colour alone leave all attributes 0, which would be black.
            let is_plain = attributes.clone().all(|attribute| attribute == 0);
            let color = |attribute: u16| {
                let [r, g, b] = channels(attribute);
                if is_plain || attribute & FLAG != 0 { whole } else { [r, g, b, 255] }
            };
            return Some(attributes.map(color).collect());
        }
        let color = |attribute: u16| {
            let [b, g, r] = channels(attribute);
            if attribute & FLAG != 0 { [r, g, b, 255] } else { [255; 4] }
        };
        let are_colors = attributes.clone().any(|attribute| attribute & FLAG != 0);
        are_colors.then(|| attributes.map(color).collect())
    }

    fn vertex(
        &mut self,
        position: DVec3,
        file: &str,
        options: &ReadOptions,
    ) -> Result<u32, AssetError> {
        if let Some(&known) = self.vertices.get(&tidy::weld_key(position)) {
            return Ok(known);
        }
        let next = self.positions.len() as u64;
        let most = options.max_vertices.min(u64::from(u32::MAX));
        AssetError::check_limit(file, "vertices", next + 1, most)?;
        self.vertices.insert(tidy::weld_key(position), next as u32);
        self.positions.push(position);
        Ok(next as u32)
    }
}

/// The colour of the whole in a header of Magics.
fn color_of_the_whole(head: &[u8]) -> Option<[u8; 4]> {
    let title = head.get(..80)?;
    let at = title.windows(COLOR_MARK.len()).position(|part| part == COLOR_MARK)?;
    let [r, g, b, _] = *title.get(at + COLOR_MARK.len()..)?.first_chunk::<4>()?;
    Some([r, g, b, 255])
}

/// The three channels of an attribute, that in the lowest bits first.
fn channels(attribute: u16) -> [u8; 3] {
    [0, 5, 10].map(|shift| (((attribute >> shift) & 31) * 255 / 31) as u8)
}

fn binary(
    mut reader: impl BufRead,
    origin: &Origin,
    options: &ReadOptions,
    warnings: &mut Vec<String>,
) -> Result<Welded, AssetError> {
    let file = origin.name.as_str();
    let fail = |source| AssetError::io(file, source);
    let Some(count) = declared_triangles(&origin.head) else {
        let reason = "the file is shorter than a binary STL's header of 84 bytes";
        return Err(AssetError::malformed(file, "header", reason));
    };
    let needed = HEADER_BYTES + count * TRIANGLE_BYTES;
    if needed > origin.max_bytes {
        let reason = format!(
            "declares {count} triangles, which take {needed} bytes, but the file has {}",
            origin.max_bytes
        );
        return Err(AssetError::malformed(file, "header", reason));
    }
    if origin.exact && needed < origin.max_bytes {
        let spare = origin.max_bytes - needed;
        warnings.push(format!("{spare} bytes after the last triangle are ignored"));
    }
    AssetError::check_limit(file, "triangles", count, options.max_triangles)?;
    reader.read_exact(&mut [0; HEADER_BYTES as usize]).map_err(fail)?;
    let mut welded = Welded::default();
    let (mut vertices, mut triangles) =
        (origin.admission.meter(file), origin.admission.meter(file));
    triangles.reach_exactly(14 * origin.reserve(count) as u64)?;
    welded.triangles.reserve(origin.reserve(count));
    welded.attributes.reserve(origin.reserve(count));
    let mut record = [0; TRIANGLE_BYTES as usize];
    for index in 0..count {
        reader.read_exact(&mut record).map_err(|source| match source.kind() {
            std::io::ErrorKind::UnexpectedEof => {
                let reason = format!("the file ends here, after {index} of {count} triangles");
                AssetError::malformed(file, format!("facet {index}"), reason)
            }
            _ => fail(source),
        })?;
        // Twelve floats: the normal, then three corners.
        let mut floats = [0.0f64; 12];
        for (float, bytes) in floats.iter_mut().zip(record.as_chunks::<4>().0) {
            *float = f64::from(f32::from_le_bytes(*bytes));
        }
        let corner = |at: usize| DVec3::new(floats[at], floats[at + 1], floats[at + 2]);
        let triangle = [
            welded.vertex(corner(3), file, options)?,
            welded.vertex(corner(6), file, options)?,
            welded.vertex(corner(9), file, options)?,
        ];
        welded.triangles.push(triangle);
        welded.attributes.push(u16::from_le_bytes([record[48], record[49]]));
        vertices.reach(welded.vertex_bytes())?;
        triangles.reach(welded.triangle_bytes())?;
    }
    Ok(welded)
}

fn ascii(
    reader: impl BufRead,
    origin: &Origin,
    options: &ReadOptions,
    warnings: &mut Vec<String>,
) -> Result<Welded, AssetError> {
    let file = origin.name.as_str();
    let mut lines = Lines::new(reader, file);
    lines.end_at_carriage_returns_if_alone()?;
    let mut welded = Welded::default();
    let mut meter = origin.admission.meter(file);
    let mut triangulator = Triangulator::default();
    let mut ring: Vec<u32> = Vec::new();
    let mut facets = 0u64;
    let (mut in_loop, mut in_solid, mut has_colors) = (false, false, false);
    while lines.advance()? {
        let line_number = lines.number;
        let fail = |facets: u64, reason: String| {
            let place = format!("facet {} (line {line_number})", facets.saturating_sub(1));
            AssetError::malformed(file, place, reason)
        };
        let mut tokens = lines.tokens();
        while let Some(word) = tokens.next() {
            match word.to_ascii_lowercase().as_slice() {
                b"vertex" if in_loop => {
                    let position = corner(&mut tokens).map_err(|reason| fail(facets, reason))?;
                    ring.push(welded.vertex(position, file, options)?);
                    let corners = 4 * ring.len() as u64;
                    meter.reach(welded.vertex_bytes() + welded.triangle_bytes() + corners)?;
                }
                b"facet" => facets += 1,
                b"normal" => drop(tokens.by_ref().take(3).count()),
                b"outer" | b"endfacet" => {}
                b"loop" => {
                    in_loop = true;
                    ring.clear();
                }
                b"endloop" => {
                    if ring.len() < 3 {
                        let reason = format!("the loop has {} corners", ring.len());
                        return Err(fail(facets, reason));
                    }
                    in_loop = false;
                    let Welded { positions, triangles, .. } = &mut welded;
                    triangulator.cut(
                        &ring,
                        |vertex| positions[vertex as usize],
                        |cut| triangles.push(cut.map(|at| ring[at as usize])),
                    );
                    let count = triangles.len() as u64;
                    AssetError::check_limit(file, "triangles", count, options.max_triangles)?;
                }
                b"solid" => {
                    in_solid = true;
                    break;
                }
                b"endsolid" => {
                    in_solid = false;
                    break;
                }
                b"color" => {
                    has_colors = true;
                    break;
                }
                _ => {
                    return Err(fail(facets, format!("{} is not expected here", shown(word))));
                }
            }
        }
    }
    if in_loop {
        let place = format!("facet {}", facets.saturating_sub(1));
        return Err(AssetError::malformed(file, place, "the file ends inside the loop"));
    }
    if has_colors {
        warnings.push("colours of ascii STL are ignored".to_owned());
    }
    if in_solid {
        warnings.push("endsolid is missing, the file may be truncated".to_owned());
    }
    Ok(welded)
}

fn corner(tokens: &mut Tokens) -> Result<DVec3, String> {
    let mut position = DVec3::ZERO;
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        let token = tokens.next().ok_or_else(|| format!("the vertex has no {name}"))?;
        position[axis] = number(token)
            .ok_or_else(|| format!("property {name}: {} is not a number", shown(token)))?;
    }
    Ok(position)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::assets::first::mesh;

    fn read(bytes: impl Into<Vec<u8>>) -> Result<Asset, AssetError> {
        read_from(Input::from_bytes(bytes.into(), "a.stl"), &ReadOptions::default())
    }

    fn binary_file(title: &str, triangles: &[[[f32; 3]; 3]]) -> Vec<u8> {
        let mut bytes = title.as_bytes().to_vec();
        bytes.resize(80, 0);
        bytes.extend((triangles.len() as u32).to_le_bytes());
        for triangle in triangles {
            bytes.extend([0; 12]);
            bytes.extend(triangle.iter().flatten().flat_map(|c| c.to_le_bytes()));
            bytes.extend([0; 2]);
        }
        bytes
    }

    const SQUARE: [[[f32; 3]; 3]; 2] = [
        [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]],
        [[-0.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]],
    ];

    #[test]
    fn binary_corners_are_welded() {
        for title in ["made by hand", "solid but binary"] {
            let asset = read(binary_file(title, &SQUARE)).unwrap();
            let mesh = mesh(&asset);
            assert_eq!(mesh.positions.len(), 4);
            assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
            assert!(mesh.normals.is_none() && asset.warnings.is_empty());
        }
    }

    #[test]
    fn lying_lengths_are_named() {
        let mut bytes = binary_file("x", &SQUARE);
        bytes[80..84].copy_from_slice(&u32::MAX.to_le_bytes());
        let error = read(bytes).unwrap_err().to_string();
        assert!(error.starts_with("a.stl: header: declares 4294967295 triangles"), "{error}");
        let mut long = binary_file("x", &SQUARE);
        long.extend([0; 7]);
        assert_eq!(read(long).unwrap().warnings.len(), 1);
        assert!(read(vec![1; 83]).is_err());
        assert!(read(binary_file("x", &[])).is_err());
    }

    #[test]
    fn facets_have_the_colors_of_both_conventions() {
        let painted = |title: &[u8], attributes: [u16; 2]| {
            let mut bytes = binary_file("", &SQUARE);
            bytes[..title.len()].copy_from_slice(title);
            for (at, attribute) in [132, 182].into_iter().zip(attributes) {
                bytes[at..at + 2].copy_from_slice(&attribute.to_le_bytes());
            }
            let asset = read(bytes).unwrap();
            let mesh = mesh(&asset);
            mesh.colors.as_ref().map(|colors| {
                let color = |triangle: [u32; 3]| {
                    let [a, b, c] = triangle.map(|corner| colors[corner as usize]);
                    assert!(a == b && b == c, "{colors:?}");
                    a
                };
                [color(mesh.triangles[0]), color(mesh.triangles[1])]
            })
        };
        let (red, blue, white) = ([255, 0, 0, 255], [0, 0, 255, 255], [255; 4]);
        assert_eq!(painted(b"x", [0, 0]), None);
        assert_eq!(painted(b"x", [31, 31 << 10]), None, "without the flag they mean nothing");
        assert_eq!(painted(b"x", [FLAG | 31, FLAG | (31 << 10)]), Some([blue, red]));
        assert_eq!(painted(b"x", [FLAG | 31, 0]), Some([blue, white]));
        let magics = b"COLOR=\x10\x20\x30\xff,MATERIAL=";
        let whole = [16, 32, 48, 255];
        assert_eq!(painted(magics, [31, FLAG]), Some([red, whole]));
        assert_eq!(painted(magics, [0, 0]), Some([whole, whole]));
    }

    const ASCII: &str = "solid a b\n facet normal 0 0 1\n outer loop\n vertex 0 0 0\n \
        VERTEX 1 0 0\n vertex 1 1e0 0\n vertex 0 1 0\n endloop\n endfacet\nendsolid a b\n";

    #[test]
    fn ascii_reads_polygons_too() {
        let asset = read(ASCII).unwrap();
        assert_eq!(mesh(&asset).triangles.len(), 2);
        assert_eq!(mesh(&asset).positions.len(), 4);
        let one_line = ASCII.replace("\n", " ").replacen("solid a b", "solid\n", 1);
        assert_eq!(mesh(&read(one_line).unwrap()).triangles.len(), 2);
        let marked = format!("\u{feff}{ASCII}");
        assert_eq!(mesh(&read(marked).unwrap()).triangles.len(), 2, "after a byte order mark");
        assert_eq!(mesh(&read(ASCII.replace('\n', "\r")).unwrap()).triangles.len(), 2);
        let colored = ASCII.replacen(" facet", " color 1 0 0\n facet", 1);
        assert_eq!(read(colored).unwrap().warnings, ["colours of ascii STL are ignored"]);
        let open = ASCII.replace("endsolid a b\n", "");
        assert_eq!(read(open).unwrap().warnings.len(), 1);
    }

    #[test]
    fn ascii_faults_name_their_place() {
        let error = read(ASCII.replace("1e0", "XX")).unwrap_err().to_string();
        assert_eq!(error, "a.stl: facet 0 (line 6): property y: \"XX\" is not a number");
        let error = read(&ASCII[..60]).unwrap_err().to_string();
        assert!(error.contains("facet 0"), "{error}");
        assert!(read(ASCII.replace("endloop", "nonsense")).is_err());
    }

    #[test]
    fn limits_hold() {
        let options = ReadOptions { max_triangles: 1, ..ReadOptions::default() };
        for bytes in [binary_file("x", &SQUARE), ASCII.into()] {
            let error = read_from(Input::from_bytes(bytes, "a"), &options).unwrap_err();
            assert!(matches!(error, AssetError::TooLarge { what: "triangles", .. }), "{error}");
        }
    }

    proptest! {
        #[test]
        fn damage_never_panics(at in 0usize..300, value: u8, cut in 0usize..300) {
            for mut bytes in [binary_file("solid", &SQUARE), ASCII.as_bytes().to_vec()] {
                let length = bytes.len();
                bytes[at % length] = value;
                bytes.truncate(length - cut % length);
                let _ = read(bytes);
            }
        }
    }
}
