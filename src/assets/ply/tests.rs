use glam::{DVec3, Vec2, Vec3};
use proptest::prelude::*;

use super::*;
use crate::assets::first::{cloud, mesh};

fn read(bytes: impl Into<Vec<u8>>) -> Result<Asset, AssetError> {
    read_from(Input::from_bytes(bytes.into(), "a.ply"), &ReadOptions::default())
}

const SQUARE: &str = "ply\r\nformat ascii 1.0\r\ncomment hand made\r\nelement vertex 4\r\n\
    property float x\r\nproperty float y\r\nproperty float z\r\nelement face 1\r\n\
    property list uchar int vertex_indices\r\nend_header\r\n\
    0 0 0\r\n1 0 0\r\n\r\n1 1 0\r\n0 1 0\r\n4 0 1 2 3\r\n";

#[test]
fn ascii_mesh() {
    let asset = read(SQUARE).unwrap();
    assert_eq!(mesh(&asset).positions[2], DVec3::new(1.0, 1.0, 0.0));
    assert_eq!(mesh(&asset).triangles.len(), 2);
    assert!(asset.warnings.is_empty());
    assert_eq!(asset.format, "ply");
}

/// One vertex element of every scalar type, in both byte orders, with lists between the properties,
/// after an unknown element and before the faces.
fn binary(big: bool) -> Vec<u8> {
    let order = if big { "big" } else { "little" };
    let mut bytes = format!(
        "ply\nformat binary_{order}_endian 1.0\nelement odd 2\nproperty uchar a\n\
         property list ushort double b\nelement vertex 3\nproperty uchar red\nproperty double z\n\
         property list int8 int16 extra\nproperty int16 y\nproperty uchar green\n\
         property uint x\nproperty int8 unused\nproperty uchar blue\nproperty float nx\n\
         property float ny\nproperty float nz\nelement face 1\nproperty float quality\n\
         property list uint uint vertex_index\nend_header\n"
    )
    .into_bytes();
    let mut put = |mut word: Vec<u8>| {
        if big {
            word.reverse();
        }
        bytes.extend(word);
    };
    for _ in 0..2 {
        put(vec![1]);
        put(2u16.to_le_bytes().into());
        put(0.5f64.to_le_bytes().into());
        put(0.5f64.to_le_bytes().into());
    }
    for (x, y, z) in [(7u32, -300i16, 0.25f64), (1, 0, 0.0), (0, 1, 0.0)] {
        put(vec![200]);
        put(z.to_le_bytes().into());
        put(vec![1]);
        put((-9i16).to_le_bytes().into());
        put(y.to_le_bytes().into());
        put(vec![100]);
        put(x.to_le_bytes().into());
        put(vec![255]);
        put(vec![50]);
        for n in [0.0f32, 3.0, 4.0] {
            put(n.to_le_bytes().into());
        }
    }
    put(1.5f32.to_le_bytes().into());
    put(3u32.to_le_bytes().into());
    for index in [2u32, 1, 0] {
        put(index.to_le_bytes().into());
    }
    bytes
}

#[test]
fn every_type_order_and_encoding() {
    for big in [false, true] {
        let asset = read(binary(big)).unwrap();
        let mesh = mesh(&asset);
        assert_eq!(mesh.positions[0], DVec3::new(7.0, -300.0, 0.25));
        assert_eq!(mesh.colors.as_ref().unwrap()[1], [200, 100, 50, 255]);
        assert_eq!(mesh.normals.as_ref().unwrap()[2], Vec3::new(0.0, 0.6, 0.8));
        assert_eq!(mesh.triangles, [[2, 1, 0]]);
        assert_eq!(asset.warnings, ["2 odd elements are ignored"]);
    }
}

#[test]
fn truncation_names_element_index_and_property() {
    let bytes = binary(false);
    let error = read(&bytes[..bytes.len() - 3]).unwrap_err().to_string();
    assert!(error.starts_with("a.ply: face 0, property vertex_index: the file ends"), "{error}");
    let error = read(&bytes[..bytes.len() - 30]).unwrap_err().to_string();
    assert!(error.starts_with("a.ply: vertex 2, property n"), "{error}");
    let fixed = "ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty short x\n\
        property short y\nproperty short z\nend_header\n";
    let error = read([fixed.as_bytes(), &[0; 15]].concat()).unwrap_err().to_string();
    assert!(error.starts_with("a.ply: vertex 2, property y: the file ends here"), "{error}");
    let cut = SQUARE.find("1 1 0").unwrap();
    let error = read(&SQUARE[..cut]).unwrap_err().to_string();
    assert!(error.starts_with("a.ply: vertex 2, property x"), "{error}");
    let error = read(&SQUARE[..cut + 3]).unwrap_err().to_string();
    assert!(error.contains("vertex 2, property z") && error.contains("line 14"), "{error}");
}

#[test]
fn counts_are_judged_before_anything_is_allocated() {
    for count in ["99999999999999", "18446744073709551615", "400"] {
        let text = SQUARE.replace("vertex 4", &format!("vertex {count}"));
        let error = read(text).unwrap_err();
        let named = matches!(error, AssetError::TooLarge { what: "vertices", .. })
            || error.to_string().starts_with("a.ply: element vertex: declares 400");
        assert!(named, "{error}");
    }
    let empty = SQUARE.replace("element face", "element void 18446744073709551615\nelement face");
    assert!(read(empty).is_ok());
    let options = ReadOptions { max_vertices: 3, ..ReadOptions::default() };
    let input = Input::from_bytes(SQUARE.into(), "a");
    assert!(matches!(read_from(input, &options), Err(AssetError::TooLarge { limit: 3, .. })));
    let options = ReadOptions { max_triangles: 1, ..ReadOptions::default() };
    let input = Input::from_bytes(SQUARE.into(), "a");
    assert!(matches!(read_from(input, &options), Err(AssetError::TooLarge { limit: 1, .. })));
}

#[test]
fn bad_indices_and_lists_are_named() {
    for (from, to, expected) in [
        ("4 0 1 2 3", "4 0 1 2 4", "a.ply: face 0, property vertex_indices: vertex 4 does not"),
        ("4 0 1 2 3", "3 0 -1 2", "a.ply: face 0, property vertex_indices: vertex -1 does not"),
        ("4 0 1 2 3", "-4 0 1 2", "a.ply: face 0, property vertex_indices (line 16)"),
        ("4 0 1 2 3", "9 0 1 2", "a.ply: face 0, property vertex_indices (line 16)"),
        ("1 1 0", "1 x 0", "a.ply: vertex 2, property y (line 14): \"x\" is not a number"),
        ("float y", "float w", "a.ply: header: the vertex element has no scalar property y"),
        ("uchar int", "float int", "a.ply: header line 9: the length of a list"),
        ("uchar int", "uchar float", "a.ply: element face: vertex indices must be integers"),
        ("vertex_indices", "corners", "a.ply: element face: has no list property"),
        ("ascii", "utf8", "a.ply: header line 2: unknown format"),
        ("format ascii 1.0\r\n", "", "a.ply: header: there is no format line"),
        ("end_header\r\n", "", "a.ply: header line 10: \"0\" is data: end_header is missing"),
        (
            "element face",
            "elment face",
            "a.ply: header line 8: unknown keyword \"elment\"; did you mean element?",
        ),
        (
            "property float z",
            "Property float z",
            "a.ply: header line 7: unknown keyword \"Property\"",
        ),
        (
            "end_header",
            "endheader",
            "a.ply: header line 10: unknown keyword \"endheader\"; did you mean end_header?",
        ),
        ("end_header", "end\u{1}x", "a.ply: header line 10: is not text"),
    ] {
        let error = read(SQUARE.replacen(from, to, 1)).unwrap_err().to_string();
        assert!(error.starts_with(expected), "{error} / {expected}");
    }
}

#[test]
fn lines_that_software_writes_into_headers_are_ignored_with_a_warning() {
    let with =
        |lines: &str| SQUARE.replacen("element vertex", &format!("{lines}element vertex"), 1);
    let asset = read(with("obj_info num_cols 512\r\n\r\nbye\r\n")).unwrap();
    assert_eq!(mesh(&asset).triangles.len(), 2);
    let said = "header line 6 is not part of the PLY format and is ignored: \"bye\"";
    assert_eq!(asset.warnings, [said]);
    let many: String = (0..900).map(|i| format!("scanner setting {i}\n")).collect();
    let asset = read(with(&many)).unwrap();
    assert_eq!(asset.warnings.len(), 4);
    let rest = "897 more header lines are not part of the PLY format and are ignored";
    assert_eq!(asset.warnings[3], rest);
}

#[test]
fn lines_may_end_with_carriage_returns_alone() {
    let text = SQUARE.replace("\r\n", "\n").replace('\n', "\r");
    assert_eq!(mesh(&read(text).unwrap()).triangles.len(), 2);
    let header = "ply\rformat binary_little_endian 1.0\relement vertex 1\rproperty short x\r\
        property short y\rproperty int64 z\rend_header\r";
    let body = [&13i16.to_le_bytes()[..], &10i16.to_le_bytes(), &(-7i64).to_le_bytes()].concat();
    let asset = read([header.as_bytes(), &body].concat()).unwrap();
    assert_eq!(cloud(&asset).positions, [DVec3::new(13.0, 10.0, -7.0)]);
}

fn points(properties: &str, rows: &str) -> Asset {
    let count = rows.lines().count();
    let text = format!(
        "ply\nformat ascii 1.0\nelement vertex {count}\nproperty double x\nproperty double y\n\
         property double z\n{properties}end_header\n{rows}"
    );
    read(text).unwrap()
}

#[test]
fn colours_of_every_type() {
    let short = "property ushort diffuse_red\nproperty ushort diffuse_green\n\
        property ushort diffuse_blue\nproperty ushort alpha\n";
    let asset = points(short, "0 0 0 65535 257 0 32896\n");
    assert_eq!(cloud(&asset).colors.as_ref().unwrap()[0], [255, 1, 0, 128]);
    // Values of 8 bits, as PDAL writes those of LAS files.
    let asset = points(short, "0 0 0 255 1 0 128\n0 0 1 0 200 0 255\n");
    let colors = cloud(&asset).colors.as_ref().unwrap();
    assert_eq!(colors[..], [[255, 1, 0, 128], [0, 200, 0, 255]]);
    let float = "property float color_0\nproperty float color_1\nproperty float color_2\n";
    let asset = points(float, "0 0 0 1 0.5 0\n0 0 1 nan 0 0\n");
    assert_eq!(cloud(&asset).colors.as_ref().unwrap()[0], [255, 128, 0, 255]);
    assert_eq!(cloud(&asset).colors.as_ref().unwrap()[1], [255; 4]);
    assert_eq!(asset.warnings.len(), 1);
    let incomplete = points("property uchar red\nproperty uchar green\n", "0 0 0 1 2\n");
    assert!(cloud(&incomplete).colors.is_none());
}

#[test]
fn other_attributes() {
    let properties = "property float scalar_Intensity\nproperty int label\nproperty float radius\n\
        property float nx\nproperty float ny\nproperty float nz\n";
    let asset = points(properties, "0 0 0 0.5 3 0.1 0 0 2\n1 1 1 1.5 300 0.2 nan 0 0\n");
    let cloud = cloud(&asset);
    assert_eq!(cloud.values_of("intensity"), Some(vec![0.5, 1.5]));
    assert_eq!(cloud.values_of("classification"), Some(vec![3.0, 300.0]));
    assert_eq!(cloud.radii.as_deref(), Some(&[0.1, 0.2][..]));
    assert_eq!(cloud.normals.as_deref(), Some(&[Vec3::Z, Vec3::ZERO][..]));
    let said = "1 normal is not a number and counts as unknown; the first is that of vertex 1";
    assert_eq!(asset.warnings, [said]);
    for radius in ["-0.5", "0", "nan", "+inf", "1e39"] {
        let asset = points("property float radius\n", &format!("0 0 0 1\n1 1 1 {radius}\n"));
        assert!(matches!(&asset.geometries[0], Geometry::Points(c) if c.radii.is_none()));
        assert!(asset.warnings[0].starts_with("vertex 1 has a radius of "), "{:?}", asset.warnings);
    }
    let zero = "property float nx\nproperty float ny\nproperty float nz\n";
    let asset = points(zero, "0 0 0 0 0 0\n");
    assert!(matches!(&asset.geometries[0], Geometry::Points(c) if c.normals.is_none()));
}

#[test]
fn lost_points_are_counted() {
    let asset = points("", "0 0 0\n1 +inf 0\nnan 0 0\n2 0 0\n");
    assert_eq!(cloud(&asset).positions, [DVec3::ZERO, DVec3::X * 2.0]);
    assert_eq!(
        asset.warnings,
        ["2 points with non-finite coordinates are left out; the first is vertex 1"]
    );
    let text = SQUARE.replace("0 1 0\r\n4", "0 nan 0\r\n4");
    let asset = read(text).unwrap();
    assert_eq!(mesh(&asset).triangles.len(), 1);
    assert_eq!(mesh(&asset).positions.len(), 3);
}

#[test]
fn strips_restart_and_alternate() {
    let text = "ply\nformat ascii 1.0\nelement tristrips 1\nproperty list int int vertex_indices\n\
        element vertex 4\nproperty float x\nproperty float y\nproperty float z\nend_header\n\
        8 0 1 2 3 -1 3 2 1\n0 0 0\n1 0 0\n0 1 0\n1 1 0\n";
    let asset = read(text).unwrap();
    assert_eq!(mesh(&asset).triangles, [[0, 1, 2], [2, 1, 3], [3, 2, 1]]);
}

#[test]
fn faces_may_come_before_their_vertices() {
    let text = "ply\nformat ascii 1.0\nelement face 3\nproperty list uchar int vertex_indices\n\
        property uchar red\nproperty uchar green\nproperty uchar blue\nelement vertex 4\nproperty float x\nproperty float y\n\
        property float z\nelement edge 1\nproperty int a\nend_header\n\
        4 0 1 2 3 9 8 7\n2 0 1 0 0 1\n4 0 1 3 3 6 5 4\n0 0 0\n2 0 0\n0.5 0.5 0\n0 2 0\n7\n";
    let asset = read(text).unwrap();
    let found = mesh(&asset);
    let mut corners: Vec<_> = found.triangles[..2].concat();
    corners.sort_unstable();
    // The dent at vertex 2 is on the cut, with vertex 0.
    assert_eq!(corners, [0, 0, 1, 2, 2, 3]);
    let colors = found.colors.as_ref().unwrap();
    let of = |triangle: usize| found.triangles[triangle].map(|corner| colors[corner as usize]);
    assert_eq!(
        [of(0), of(1), of(2)],
        [[[9, 8, 7, 255]; 3], [[9, 8, 7, 255]; 3], [[6, 5, 4, 255]; 3]]
    );
    assert_eq!(asset.warnings.len(), 2, "{:?}", asset.warnings);
}

#[test]
fn faces_have_colors_where_vertices_have_none() {
    let with = |vertex: &str, face: &str, rows: &str| {
        let channels = |kind: &str| match kind {
            "" => String::new(),
            kind => ["red", "green", "blue", "alpha"]
                .map(|name| format!("property {kind} {name}\n"))
                .concat(),
        };
        read(format!(
            "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\n\
             property float z\n{}element face 2\n{}property list uchar int vertex_indices\n\
             end_header\n{rows}",
            channels(vertex),
            channels(face)
        ))
        .unwrap()
    };
    let square = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n";
    for (kind, red, blue) in [
        ("uchar", "255 0 0 255", "0 0 255 128"),
        ("float", "1 0 0 1", "0 0 1 0.5"),
        ("ushort", "65535 0 0 65535", "0 0 65535 32896"),
    ] {
        let rows = format!("{square}{red} 3 0 1 2\n{blue} 4 0 2 3 0\n");
        let asset = with("", kind, &rows);
        let found = mesh(&asset);
        let colors = found.colors.as_ref().unwrap();
        let of = |triangle: usize| found.triangles[triangle].map(|corner| colors[corner as usize]);
        assert_eq!(of(0), [[255, 0, 0, 255]; 3], "{kind}");
        assert_eq!(of(1), [[0, 0, 255, 128]; 3], "{kind}");
        assert!(asset.warnings.is_empty(), "{:?}", asset.warnings);
    }
    let rows = square.replace('\n', " 9 8 7 255\n") + "1 2 3 255 3 0 1 2\n1 2 3 255 3 0 2 3\n";
    let asset = with("uchar", "uchar", &rows);
    assert_eq!(mesh(&asset).colors, Some(vec![[9, 8, 7, 255]; 4]));
    assert_eq!(asset.warnings, ["colours of faces are ignored: vertices have colours"]);
    let black = format!("{square}0 0 0 0 3 0 1 2\n0 0 0 0 3 0 2 3\n");
    let asset = with("", "uchar", &black);
    assert!(mesh(&asset).colors.is_none() && asset.warnings.is_empty(), "declared and not filled");
}

#[test]
fn a_range_grid_adds_nothing() {
    let text = "ply\nformat ascii 1.0\nobj_info num_cols 2\nelement vertex 1\nproperty float x\n\
        property float y\nproperty float z\nelement range_grid 3\n\
        property list uchar int vertex_indices\nend_header\n1 2 3\n0\n1 0\n0\n";
    let asset = read(text).unwrap();
    assert_eq!(cloud(&asset).positions, [DVec3::new(1.0, 2.0, 3.0)]);
    assert!(asset.warnings.is_empty());
}

#[test]
fn splats_are_refused() {
    for property in ["f_dc_0", "packed_position"] {
        let text = SQUARE.replace("float z", &format!("float z\r\nproperty float {property}"));
        let error = read(text).unwrap_err();
        assert!(matches!(error, AssetError::Unsupported { .. }), "{error}");
        assert!(error.to_string().contains("Gaussian splats"), "{error}");
    }
}

#[test]
fn texture_files_are_found() {
    let folder = tempfile::tempdir().unwrap();
    let texels = [[10, 20, 30, 255]; 4];
    std::fs::write(folder.path().join("a b.png"), texture::tests::png(2, &texels)).unwrap();
    let text = SQUARE
        .replace("comment hand made", "comment TextureFile a b.png")
        .replace("float z\r\n", "float z\r\nproperty float s\r\nproperty float t\r\n")
        .replace(" 0\r\n", " 0 0.25 1\r\n");
    let path = folder.path().join("m.ply");
    let options = ReadOptions::default();
    std::fs::write(&path, &text).unwrap();
    let asset = read_from(Input::open(&path, "m.ply", &options).unwrap(), &options).unwrap();
    assert_eq!(asset.textures[0].rgba, texels);
    assert_eq!(mesh(&asset).uvs.as_ref().unwrap()[0], Vec2::new(0.25, 0.0));
    assert_eq!(mesh(&asset).parts, [MeshPart { triangles: 2, material: Some(0) }]);
    std::fs::write(&path, text.replace("a b.png", "gone.png")).unwrap();
    let asset = read_from(Input::open(&path, "m.ply", &options).unwrap(), &options).unwrap();
    assert_eq!((asset.textures.len(), asset.warnings.len()), (0, 1));
}

#[test]
fn corners_have_texture_coordinates_of_their_own() {
    let text = "ply\nformat ascii 1.0\ncomment TextureFile a.png\ncomment TextureFile a.png\n\
        comment TextureFile b.png\nelement vertex 4\nproperty float x\nproperty float y\n\
        property float z\nelement face 2\nproperty list uchar int vertex_indices\n\
        property list uchar float texcoord\nproperty int texnumber\nend_header\n\
        0 0 0\n1 0 0\n1 1 0\n0 1 0\n\
        4 0 1 2 3 8 0 0 0.5 0 0.5 0.5 0 0.5 0\n3 1 0 2 6 1 1 0 0 0.5 0.5 0\n";
    let header = text.replace("ascii", "binary_little_endian");
    let mut bytes = header.as_bytes()[..header.find("end_header\n").unwrap() + 11].to_vec();
    let floats = |bytes: &mut Vec<u8>, values: &[f32]| {
        bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    };
    floats(&mut bytes, &[0., 0., 0., 1., 0., 0., 1., 1., 0., 0., 1., 0.]);
    let faces: [(&[i32], &[f32]); 2] = [
        (&[0, 1, 2, 3], &[0., 0., 0.5, 0., 0.5, 0.5, 0., 0.5]),
        (&[1, 0, 2], &[1., 1., 0., 0., 0.5, 0.5]),
    ];
    for (corners, uvs) in faces {
        bytes.push(corners.len() as u8);
        bytes.extend(corners.iter().flat_map(|corner| corner.to_le_bytes()));
        bytes.push(uvs.len() as u8);
        floats(&mut bytes, uvs);
        bytes.extend([0; 4]);
    }
    for bytes in [text.as_bytes().to_vec(), bytes] {
        let asset = read(bytes).unwrap();
        let found = mesh(&asset);
        let uvs = found.uvs.as_ref().unwrap();
        assert_eq!((found.triangles.len(), found.positions.len(), uvs.len()), (3, 5, 5));
        assert_eq!(found.triangles[2], [4, 0, 2], "one corner has another place in the image");
        assert_eq!(found.positions[4], DVec3::X);
        assert_eq!(uvs[..2], [Vec2::new(0.0, 1.0), Vec2::new(0.5, 1.0)]);
        assert_eq!(uvs[4], Vec2::new(1.0, 0.0));
        assert!(asset.warnings[0].starts_with("1 more texture file"), "{:?}", asset.warnings);
    }
    // Some faces have no place in the image, or none has.
    let some = text.replace(" 6 1 1 0 0 0.5 0.5 0\n", " 0 0\n");
    let uvs = mesh(&read(some.as_str()).unwrap()).uvs.clone().unwrap();
    assert_eq!(uvs.iter().filter(|uv| **uv == Vec2::ZERO).count(), 3);
    let none = some.replace(" 8 0 0 0.5 0 0.5 0.5 0 0.5 0\n", " 0 0\n");
    assert!(mesh(&read(none.as_str()).unwrap()).uvs.is_none());
}

proptest! {
    #[test]
    fn damage_never_panics(at in 0usize..2000, value: u8, cut in 0usize..2000, ascii: bool) {
        let mut bytes = if ascii { SQUARE.as_bytes().to_vec() } else { binary(false) };
        let length = bytes.len();
        bytes[at % length] = value;
        bytes.truncate(length - cut % length / 2);
        let _ = read(bytes);
    }

    #[test]
    fn points_survive_the_trip(
        points in prop::collection::vec(prop::array::uniform3(-1e7f64..1e7), 1..50),
        big: bool,
    ) {
        let order = if big { "big" } else { "little" };
        let mut bytes = format!(
            "ply\nformat binary_{order}_endian 1.0\nelement vertex {}\nproperty double z\n\
             property double x\nproperty double y\nend_header\n", points.len()).into_bytes();
        for [x, y, z] in &points {
            for value in [z, x, y] {
                bytes.extend(if big { value.to_be_bytes() } else { value.to_le_bytes() });
            }
        }
        let asset = read(bytes).unwrap();
        let expected: Vec<DVec3> = points.iter().map(|p| DVec3::from_array(*p)).collect();
        prop_assert_eq!(&cloud(&asset).positions, &expected);
    }
}
