//! Reader for the Object File Format of Geomview: `OFF` with the prefixes `ST`, `C` and `N`, ascii.
//!
//! A vertex is a line `x y z [nx ny nz] [r g b [a]] [s t]`, a face `n i₁ … iₙ [colour]`; `#` begins a
//! comment. Colours are integers to 255 or floats to 1. A vertex or face without one is white where another has one. Colours of faces
//! count where vertices have none. A file without faces is a point cloud.

use std::io::BufRead;
use std::ops::Range;

use glam::{DVec3, Vec2, Vec3};

use super::input::{Input, Origin};
use super::polygon::Triangulator;
use super::tokens::{Lines, number, shown};
use super::warnings::counted;
use super::{Asset, AssetError, Geometry, Mesh, PointCloud, ReadOptions, corners, tidy};

/// A vertex takes no less: three digits, two blanks, a line end.
const VERTEX_BYTES: u64 = 6;
/// As does a face: its length, three indices, what separates them.
const FACE_BYTES: u64 = 2;

/// Reads OFF from `input`.
///
/// # Errors
/// Malformed or truncated content (naming vertex or face), counts that the file cannot hold or that
/// are over the limits, variants with another number of dimensions.
pub fn read_from(input: Input, options: &ReadOptions) -> Result<Asset, AssetError> {
    let Input { reader, origin } = input;
    let file = origin.name.as_str();
    let mut lines = Lines::new(reader, file);
    lines.end_at_carriage_returns_if_alone()?;
    let header = header(&mut lines, &origin, options)?;
    let mut warnings = Vec::new();
    let vertices = vertices(&mut lines, &header, &origin)?;
    let colors = vertices.paint.colors();
    let normals = vertices.normals.and_then(|normals| tidy::unit_normals(normals, &mut warnings));
    let geometry = if header.faces == 0 {
        let cloud =
            PointCloud { positions: vertices.positions, colors, normals, ..PointCloud::default() };
        Geometry::Points(tidy::finish_cloud(cloud, file, &mut warnings)?)
    } else {
        let Faces { triangles, paint } =
            faces(&mut lines, &header, &vertices.positions, &origin, options, &mut warnings)?;
        let mut mesh = Mesh {
            positions: vertices.positions,
            triangles,
            colors,
            normals,
            uvs: vertices.uvs,
            parts: Vec::new(),
        };
        if let Some(colors) = paint.colors() {
            corners::paint(&mut mesh, &colors, file, options, &mut warnings)?;
        }
        Geometry::Mesh(tidy::finish_mesh(mesh, file, &mut warnings)?)
    };
    let mut asset = Asset::single("off", file, geometry);
    asset.warnings = warnings;
    Ok(asset)
}

struct Header {
    vertices: u64,
    faces: u64,
    has_normals: bool,
    has_colors: bool,
    has_uvs: bool,
}

fn header<R: BufRead>(
    lines: &mut Lines<R>,
    origin: &Origin,
    options: &ReadOptions,
) -> Result<Header, AssetError> {
    let file = origin.name.as_str();
    let fail = |reason: String| AssetError::malformed(file, "header", reason);
    let ended = || fail("the file ends inside the header".to_owned());
    if !lines.advance_to_content(b'#')? {
        return Err(ended());
    }
    let word = lines.tokens().next().unwrap_or_default().to_owned();
    // Files of ModelNet have no line end between the keyword and the number of vertices.
    let digits = word.iter().rev().take_while(|byte| byte.is_ascii_digit()).count();
    let (keyword, joined) = word.split_at(word.len() - digits);
    let prefix =
        keyword.strip_suffix(b"OFF").ok_or_else(|| fail(format!("{} is not OFF", shown(&word))))?;
    let (has_uvs, prefix) = match prefix.strip_prefix(b"ST") {
        Some(rest) => (true, rest),
        None => (false, prefix),
    };
    if prefix.iter().any(|letter| !matches!(letter, b'C' | b'N')) {
        let reason = format!("{} has another number of dimensions than three", shown(&word));
        return Err(AssetError::unsupported(file, reason));
    }
    let parsed = |token: &[u8]| {
        let count = std::str::from_utf8(token).ok().and_then(|text| text.parse::<u64>().ok());
        count.ok_or_else(|| fail(format!("{} is no count", shown(token))))
    };
    let mut counts = Vec::new();
    if !joined.is_empty() {
        counts.push(parsed(joined)?);
    }
    let mut skip = 1;
    while counts.len() < 3 {
        for token in lines.tokens().skip(skip) {
            if token == b"BINARY" {
                return Err(AssetError::unsupported(file, "binary OFF files are not offered"));
            }
            counts.push(parsed(token)?);
        }
        // The number of edges, which means nothing, is missing in some files.
        if counts.len() == 2 && skip == 0 {
            break;
        }
        skip = 0;
        if counts.len() < 3 && !lines.advance_to_content(b'#')? {
            return Err(ended());
        }
    }
    let header = Header {
        vertices: counts[0],
        faces: counts[1],
        has_normals: prefix.contains(&b'N'),
        has_colors: prefix.contains(&b'C'),
        has_uvs,
    };
    // The last line may lack its end.
    origin.check_count("vertices", header.vertices, VERTEX_BYTES)?;
    origin.check_count("faces", header.faces, FACE_BYTES)?;
    let most = options.max_vertices.min(u64::from(u32::MAX));
    AssetError::check_limit(file, "vertices", header.vertices, most)?;
    AssetError::check_limit(file, "faces", header.faces, options.max_triangles)?;
    Ok(header)
}

#[derive(Default)]
struct Vertices {
    positions: Vec<DVec3>,
    normals: Option<Vec<Vec3>>,
    uvs: Option<Vec<Vec2>>,
    paint: Paint,
}

impl Vertices {
    fn bytes(&self) -> u64 {
        let normals = self.normals.as_ref().map_or(0, Vec::len);
        let uvs = self.uvs.as_ref().map_or(0, Vec::len);
        let colors = self.paint.raw_colors.len();
        (24 * self.positions.len() + 12 * normals + 8 * uvs + 16 * colors) as u64
    }
}

fn vertices<R: BufRead>(
    lines: &mut Lines<R>,
    header: &Header,
    origin: &Origin,
) -> Result<Vertices, AssetError> {
    let file = origin.name.as_str();
    let mut vertices = Vertices {
        normals: header.has_normals.then(Vec::new),
        uvs: header.has_uvs.then(Vec::new),
        ..Vertices::default()
    };
    let mut meter = origin.admission.meter(file);
    let mut values = Vec::new();
    let fixed = 3 + 3 * usize::from(header.has_normals);
    for index in 0..header.vertices {
        if !lines.advance_to_content(b'#')? {
            let reason = format!("the file ends here, after {index} of {}", header.vertices);
            return Err(AssetError::malformed(file, format!("vertex {index}"), reason));
        }
        let place = || format!("vertex {index} (line {})", lines.number);
        values.clear();
        for token in lines.tokens() {
            let Some(value) = channel(token) else {
                let property = ["x", "y", "z"].get(values.len()).copied().unwrap_or("attribute");
                let reason = format!("property {property}: {} is not a number", shown(token));
                return Err(AssetError::malformed(file, place(), reason));
            };
            values.push(value);
        }
        let uv_values = 2 * usize::from(header.has_uvs);
        if values.len() < fixed + uv_values {
            let reason = format!("has {} of {} values", values.len(), fixed + uv_values);
            return Err(AssetError::malformed(file, place(), reason));
        }
        meter.reach(vertices.bytes())?;
        let [(x, _), (y, _), (z, _)] = [values[0], values[1], values[2]];
        vertices.positions.push(DVec3::new(x, y, z));
        if let Some(normals) = &mut vertices.normals {
            let [(x, _), (y, _), (z, _)] = [values[3], values[4], values[5]];
            normals.push(DVec3::new(x, y, z).as_vec3());
        }
        let uv = values.len() - uv_values;
        if let (Some(uvs), [(s, _), (t, _)]) = (&mut vertices.uvs, &values[uv..]) {
            uvs.push(Vec2::new(*s as f32, (1.0 - t) as f32));
        }
        if header.has_colors && uv < fixed + 3 {
            return Err(AssetError::malformed(file, place(), "has no colour"));
        }
        // Plain OFF with colours behind the coordinates is common.
        let colors = values[fixed..uv].iter().copied();
        vertices.paint.add(colors, index as usize..index as usize + 1);
    }
    Ok(vertices)
}

/// A number, and whether it is written as a float.
fn channel(token: &[u8]) -> Option<(f64, bool)> {
    Some((number(token)?, token.contains(&b'.')))
}

struct Faces {
    triangles: Vec<[u32; 3]>,
    paint: Paint,
}

/// Colours of vertices or of triangles, as the file has them.
#[derive(Default)]
struct Paint {
    /// Empty, or the colour of each element; not-a-number where it has none.
    raw_colors: Vec<[f32; 4]>,
    /// Whether any channel is written as a float.
    are_floats: bool,
    /// Faces whose colour is an entry of a colour map.
    mapped: u64,
}

impl Paint {
    /// Gives elements the colour of these channels.
    fn add(&mut self, channels: impl Iterator<Item = (f64, bool)>, elements: Range<usize>) {
        let mut values = [f32::NAN; 4];
        let mut count = 0;
        for (slot, (value, is_float)) in values.iter_mut().zip(channels) {
            *slot = value as f32;
            self.are_floats |= is_float;
            count += 1;
        }
        self.mapped += u64::from(count == 1);
        let color = if count < 3 { [f32::NAN; 4] } else { values };
        if count >= 3 || !self.raw_colors.is_empty() {
            // Elements before the first one with a colour have none.
            self.raw_colors.resize(elements.start, [f32::NAN; 4]);
            self.raw_colors.resize(elements.end, color);
        }
    }

    /// The colour of each element, white where it has none; `None` where no element has one.
    fn colors(&self) -> Option<Vec<[u8; 4]>> {
        // Colours of Geomview count to 1, and may be written without a point. Those that count to 255 would be black.
        let most = if self.are_floats { tidy::MOST_OF_UNIT } else { 1.0 };
        let mut channels = self.raw_colors.iter().flatten();
        let count_to_255 = channels.any(|channel| channel.is_finite() && *channel > most);
        let colors = self.raw_colors.iter();
        let colors = colors.map(|color| tidy::color_from_floats(*color, count_to_255));
        (!self.raw_colors.is_empty()).then(|| colors.collect())
    }
}

fn faces<R: BufRead>(
    lines: &mut Lines<R>,
    header: &Header,
    positions: &[DVec3],
    origin: &Origin,
    options: &ReadOptions,
    warnings: &mut Vec<String>,
) -> Result<Faces, AssetError> {
    let file = origin.name.as_str();
    let mut meter = origin.admission.meter(file);
    meter.reach_exactly(12 * origin.reserve(header.faces) as u64)?;
    let mut triangles = Vec::with_capacity(origin.reserve(header.faces));
    let mut triangulator = Triangulator::default();
    let mut ring = Vec::new();
    let mut paint = Paint::default();
    let mut short = 0u64;
    for index in 0..header.faces {
        if !lines.advance_to_content(b'#')? {
            let reason = format!("the file ends here, after {index} of {}", header.faces);
            return Err(AssetError::malformed(file, format!("face {index}"), reason));
        }
        let fail = |reason: String| {
            let place = format!("face {index} (line {})", lines.number);
            AssetError::malformed(file, place, reason)
        };
        let mut tokens = lines.tokens();
        let first = tokens.next().unwrap_or_default();
        let integer = |token: &[u8]| -> Option<u64> {
            std::str::from_utf8(token).ok().and_then(|text| text.parse().ok())
        };
        let corners =
            integer(first).ok_or_else(|| fail(format!("{} is no corner count", shown(first))))?;
        ring.clear();
        for corner in 0..corners {
            let token = tokens.next().ok_or_else(|| {
                fail(format!("the line ends after {corner} of {corners} corners"))
            })?;
            match integer(token) {
                Some(vertex) if vertex < header.vertices => ring.push(vertex as u32),
                _ => {
                    let reason = format!(
                        "vertex {} does not exist, the file has {}",
                        shown(token),
                        header.vertices
                    );
                    return Err(fail(reason));
                }
            }
        }
        if ring.len() < 3 {
            short += 1;
            continue;
        }
        let begin = triangles.len();
        triangulator.cut(
            &ring,
            |vertex| positions[vertex as usize],
            |cut| triangles.push(cut.map(|at| ring[at as usize])),
        );
        paint.add(tokens.map_while(channel), begin..triangles.len());
        let count = triangles.len() as u64;
        AssetError::check_limit(file, "triangles", count, options.max_triangles)?;
        meter.reach(12 * count + 16 * paint.raw_colors.len() as u64)?;
    }
    for (count, one, many) in [
        (
            short,
            "face with fewer than three corners is left out",
            "faces with fewer than three corners are left out",
        ),
        (
            triangulator.forced,
            "polygon crosses itself and is drawn as a fan",
            "polygons cross themselves and are drawn as fans",
        ),
        (
            paint.mapped,
            "face names an entry of a colour map, which is ignored",
            "faces name entries of a colour map, which are ignored",
        ),
    ] {
        warnings.extend(counted(count, one, many));
    }
    Ok(Faces { triangles, paint })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::assets::first::mesh;

    fn read(text: &str) -> Result<Asset, AssetError> {
        let input = Input::from_bytes(text.as_bytes().to_vec(), "a.off");
        read_from(input, &ReadOptions::default())
    }

    const PLAIN: &str =
        "OFF # a square\n\n4 1 4\n0 0 0\n1 0 0 # corner\n1 1 0\n0 1 0\n4 0 1 2 3 255 0 0\n";

    #[test]
    fn comments_polygons_and_counts_on_one_line() {
        let joined = PLAIN.replacen(" # a square\n\n", " ", 1);
        for text in [PLAIN.to_owned(), joined, PLAIN.replace('\n', "\r")] {
            let asset = read(&text).unwrap();
            assert_eq!(mesh(&asset).positions.len(), 4);
            assert_eq!(mesh(&asset).triangles.len(), 2);
            assert!(asset.warnings.is_empty());
            assert_eq!(mesh(&asset).colors, Some(vec![[255, 0, 0, 255]; 4]));
        }
    }

    #[test]
    fn faces_have_colors_where_vertices_have_none() {
        let faces = "OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n\
            3 0 1 2\n3 0 1 3 0 0 1.0\n3 0 2 3 0 0 1 0.5 # blue\n3 1 2 3 7\n";
        let asset = read(faces).unwrap();
        let found = mesh(&asset);
        let colors = found.colors.as_ref().unwrap();
        let of = |triangle: usize| found.triangles[triangle].map(|at| colors[at as usize]);
        assert_eq!(of(0), [[255; 4]; 3]);
        assert_eq!(of(1), [[0, 0, 255, 255]; 3]);
        assert_eq!(of(2), [[0, 0, 255, 128]; 3]);
        assert_eq!(of(3), [[255; 4]; 3]);
        assert_eq!(asset.warnings, ["1 face names an entry of a colour map, which is ignored"]);
        let both = "COFF\n3 1 0\n0 0 0 9 8 7\n1 0 0 9 8 7\n0 1 0 9 8 7\n3 0 1 2 255 0 0\n";
        let asset = read(both).unwrap();
        assert_eq!(mesh(&asset).colors, Some(vec![[9, 8, 7, 255]; 3]));
        assert_eq!(asset.warnings.len(), 1);
        let plain = read(&PLAIN.replace(" 255 0 0", "")).unwrap();
        assert!(plain.warnings.is_empty() && mesh(&plain).colors.is_none());
    }

    #[test]
    fn the_keyword_and_the_counts_may_be_joined() {
        let asset = read(&PLAIN.replacen("OFF # a square\n\n4", "OFF4", 1)).unwrap();
        assert_eq!(mesh(&asset).positions.len(), 4);
        assert_eq!(mesh(&asset).triangles.len(), 2);
        assert!(read("OFFX4 1 4\n").unwrap_err().to_string().contains("is not OFF"));
    }

    #[test]
    fn prefixes() {
        let asset = read("COFF\n3 1\n0 0 0 255 0 1 128\n1 0 0 1 1 1 1\n0 1 0 0 0 0 0\n3 0 1 2\n");
        let colors = mesh(&asset.unwrap()).colors.clone().unwrap();
        assert_eq!(colors, [[255, 0, 1, 128], [1, 1, 1, 1], [0, 0, 0, 0]]);
        let floats = read("COFF\n3 1 0\n0 0 0 1 0 0.5\n1 0 0 1 1 1\n0 1 0 0 0 0\n3 0 1 2\n");
        let colors = mesh(&floats.unwrap()).colors.clone().unwrap();
        assert_eq!(colors[0], [255, 0, 128, 255]);
        let whole = read("COFF\n3 1 0\n0 0 0 1 0 0 1\n1 0 0 0 1 0 1\n0 1 0 0 0 0 1\n3 0 1 2\n");
        let colors = mesh(&whole.unwrap()).colors.clone().unwrap();
        assert_eq!(colors, [[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 0, 255]]);
        let all = "STCNOFF\n3 1 0\n\
            0 0 0 0 0 2 9 8 7 255 0.25 1\n1 0 0 0 0 1 1 1 1 255 0 0\n0 1 0 0 0 1 0 0 0 255 1 1\n3 0 1 2\n";
        let asset = read(all).unwrap();
        let mesh = mesh(&asset);
        assert_eq!(mesh.normals.as_ref().unwrap()[0], Vec3::Z);
        assert_eq!(mesh.uvs.as_ref().unwrap()[0], Vec2::new(0.25, 0.0));
        assert_eq!(mesh.colors.as_ref().unwrap()[0], [9, 8, 7, 255]);
    }

    #[test]
    fn vertices_without_a_color_are_white_beside_others() {
        for red in ["255 0 0", "1 0 0", "1.0 0.0 0.0"] {
            let rows = format!("0 0 0\n1 0 0 {red}\n0 1 0\n");
            let asset = read(&format!("OFF\n3 1 0\n{rows}3 0 1 2\n")).unwrap();
            let white = [255; 4];
            assert_eq!(mesh(&asset).colors, Some(vec![white, [255, 0, 0, 255], white]), "{red}");
        }
        let error = read("COFF\n2 0 0\n0 0 0 1 0 0\n1 0 0\n").unwrap_err().to_string();
        assert_eq!(error, "a.off: vertex 1 (line 4): has no colour");
        // Texture coordinates are no channels of colours.
        let textured = read("STCOFF\n1 0 0\n0 0 0 2 1 0 0.5 0.5\n").unwrap();
        let Geometry::Points(cloud) = &textured.geometries[0] else { panic!("no faces") };
        assert_eq!(cloud.colors, Some(vec![[2, 1, 0, 255]]));
    }

    #[test]
    fn without_faces_it_is_a_cloud() {
        let asset = read("OFF\n2 0 0\n0 0 0\n1 2 3\n").unwrap();
        assert!(matches!(&asset.geometries[0], Geometry::Points(c) if c.positions.len() == 2));
    }

    #[test]
    fn faults_are_named() {
        for (text, expected) in [
            ("OFF\n353535235358 6 0\n0 0 0\n", "a.off: vertices: declares 353535235358"),
            ("OFF\n1 99 0\n0 0 0\n", "a.off: faces: declares 99"),
            ("OFF\n2 0 0\n0 0 0\n0 0", "a.off: vertex 1 (line 4): has 2 of 3 values"),
            ("OFF\n2 0 0\n0 0 0       \n", "a.off: vertex 1: the file ends here"),
            ("OFF\n1 0 0\n0 X 0\n", "a.off: vertex 0 (line 3): property y: \"X\" is not a number"),
            ("OFF\n1 1 0\n0 0 0\n3 0 0 1\n", "a.off: face 0 (line 4): vertex \"1\" does not exist"),
            ("OFF\n1 1 0\n0 0 0\n3 0 0\n", "a.off: face 0 (line 4): the line ends after 2 of 3"),
            ("OFF\n1 2 0\n0 0 0\n2 0 0\n", "a.off: face 1: the file ends here"),
            ("OFF\n-1 2 0\n", "a.off: header: \"-1\" is no count"),
            ("OFF", "a.off: header: the file ends"),
            ("4OFF\n1 0 0\n0 0 0 0\n", "a.off: \"4OFF\" has another number"),
            ("OFF BINARY\n", "a.off: binary OFF"),
        ] {
            let error = read(text).unwrap_err().to_string();
            assert!(error.starts_with(expected), "{error} / {expected}");
        }
    }

    proptest! {
        #[test]
        fn damage_never_panics(at in 0usize..80, value: u8, cut in 0usize..80) {
            let mut bytes = PLAIN.as_bytes().to_vec();
            let length = bytes.len();
            bytes[at % length] = value;
            bytes.truncate(length - cut % length);
            let _ = read_from(Input::from_bytes(bytes, "a"), &ReadOptions::default());
        }
    }
}
