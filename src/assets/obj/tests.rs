use std::io::Write;

use glam::Vec2;
use proptest::prelude::*;

use super::*;
use crate::assets::first::mesh;
use crate::assets::{MeshPart, texture};

fn read(text: &str) -> Result<Asset, AssetError> {
    read_from(Input::from_bytes(text.as_bytes().to_vec(), "a.obj"), &ReadOptions::default())
}

const SQUARE: &str = "# made by hand\no thing\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n\
    vt 0 0\nvt 1 0.25\nvn 0 0 2\n";

#[test]
fn combinations_become_vertices() {
    let asset =
        read(&format!("{SQUARE}f 1/1/1 2/2/1 3/2/1 \\\n 4/1/1\nf 1//1 2//1 3//1\n")).unwrap();
    let mesh = mesh(&asset);
    assert_eq!(mesh.triangles.len(), 3);
    assert_eq!(mesh.positions.len(), 7);
    assert_eq!(mesh.uvs.as_ref().unwrap()[1], Vec2::new(1.0, 0.75));
    assert_eq!(mesh.normals.as_ref().unwrap()[0], Vec3::Z);
    assert!(asset.warnings.is_empty() && mesh.parts.is_empty());
}

#[test]
fn lines_may_end_with_carriage_returns_alone() {
    let asset = read(&format!("{SQUARE}f 1 2 \\\n 3\n").replace('\n', "\r")).unwrap();
    assert_eq!(mesh(&asset).triangles, [[0, 1, 2]]);
    assert!(asset.warnings.is_empty(), "{:?}", asset.warnings);
}

#[test]
fn comments_do_not_continue() {
    let asset = read("# from C:\\models\\\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    assert_eq!(mesh(&asset).positions, [DVec3::ZERO, DVec3::X, DVec3::Y]);
}

#[test]
fn a_byte_order_mark_hides_no_vertex() {
    let asset = read("\u{feff}v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    assert_eq!(mesh(&asset).positions, [DVec3::ZERO, DVec3::X, DVec3::Y]);
    assert!(asset.warnings.is_empty(), "{:?}", asset.warnings);
}

#[test]
fn line_elements_are_strands() {
    let text = "l 1 2/7 3 # forward\nv 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 1 1 0 0 0 1\nl -1 -3\nl 2\n";
    let asset = read(text).unwrap();
    let strands = |geometry: &Geometry| match geometry {
        Geometry::Lines(lines) => lines.clone(),
        _ => panic!("no lines"),
    };
    let lines = strands(&asset.geometries[0]);
    assert_eq!(lines.strands, [0, 3, 5]);
    assert_eq!(lines.positions[3..], [DVec3::new(1.0, 1.0, 0.0), DVec3::ZERO]);
    assert_eq!(lines.colors.as_ref().unwrap()[2], [0, 0, 255, 255]);
    assert_eq!(asset.warnings, ["strand of a single vertex is left out"].map(|t| format!("1 {t}")));

    let asset = read(&format!("{SQUARE}f 1 2 3\nl 1 3\n")).unwrap();
    assert_eq!(mesh(&asset).triangles.len(), 1);
    assert_eq!(strands(&asset.geometries[1]).strands, [0, 2]);
    assert_eq!(asset.placements.len(), 2);
    // A line without a second vertex costs no mesh.
    let asset = read(&format!("{SQUARE}f 1 2 3\nl 2\n")).unwrap();
    assert_eq!((asset.geometries.len(), asset.placements.len()), (1, 1));
    assert_eq!(mesh(&asset).triangles.len(), 1);
    assert_eq!(
        asset.warnings[1],
        "lines are left out: no strand has two vertices with finite coordinates"
    );
    for (text, expected) in [
        ("v 0 0 0\nl 1 2\n", "line element 0 (line 2): vertex 2 does not exist, the file has 1"),
        ("v 0 0 0\nl 1 x\n", "line element 0 (line 2): \"x\" is no corner"),
        ("v 0 0 0\nl 1 -2\n", "leads to nothing before it"),
        ("v 0 0 0\nl 1\n", "no strand has two vertices"),
    ] {
        let error = read(text).unwrap_err().to_string();
        assert!(error.contains(expected), "{text:?}: {error}");
    }
}

#[test]
fn indices_may_be_negative_or_forward() {
    let asset = read("f 1 2 3\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -1 -2\n").unwrap();
    assert_eq!(mesh(&asset).triangles, [[0, 1, 2], [0, 2, 1]]);
}

#[test]
fn colours_and_utm_coordinates() {
    let asset = read("v 6368963.125 849087.6875 4 1 0 0.5\nv 0 1 0\nv 0 0 1 0 0 0 0.25\nf 1 2 3\n")
        .unwrap();
    assert_eq!(mesh(&asset).positions[0], DVec3::new(6368963.125, 849087.6875, 4.0));
    let colors = mesh(&asset).colors.as_ref().unwrap();
    assert_eq!(*colors, [[255, 0, 128, 255], [255; 4], [0, 0, 0, 64]]);
}

#[test]
fn vertices_without_a_color_are_white_however_others_count() {
    let vertices = "v 0 0 0\nv 1 0 0 200 100 0\nv 0 1 0\n";
    let expected = Some(vec![[255; 4], [200, 100, 0, 255], [255; 4]]);
    for elements in ["", "l 1 2 3\n", "f 1 2 3\n"] {
        let asset = read(&format!("{vertices}{elements}")).unwrap();
        let colors = match &asset.geometries[0] {
            Geometry::Points(cloud) => &cloud.colors,
            Geometry::Lines(lines) => &lines.colors,
            Geometry::Mesh(mesh) => &mesh.colors,
        };
        assert_eq!(*colors, expected, "{elements:?}");
        assert!(asset.warnings.is_empty(), "{:?}", asset.warnings);
    }
    let odd = format!("{vertices}v 1 1 0 nan 0 0\nf 1 2 3\nl 1 2\n");
    let said = "1 colour is not a number and is drawn white; the first is that of vertex 3";
    assert_eq!(read(&odd).unwrap().warnings, [said], "once for triangles and lines");
}

#[test]
fn without_faces_it_is_a_cloud() {
    let asset = read("v 0 0 0\nvn 0 0 1\nv 1 2 3\nvn 0 2 0\np 1 2\n").unwrap();
    let Geometry::Points(cloud) = &asset.geometries[0] else { panic!("a mesh") };
    assert_eq!(cloud.positions.len(), 2);
    assert_eq!(cloud.normals.as_deref(), Some(&[Vec3::Z, Vec3::Y][..]));
    assert!(asset.warnings.is_empty());
}

#[test]
fn faults_are_named() {
    for (text, expected) in [
        ("v 0 0 0\nf 1 2 1", "a.obj: face 0 (line 2): vertex 2 does not exist, the file has 1"),
        ("v 0 0 0\nf 1/1 1 1", "a.obj: face 0 (line 2): texture coordinate 1 does not exist"),
        ("v 0 0 0\nf 1//9 1 1", "a.obj: face 0 (line 2): normal 9 does not exist"),
        ("v 0 0 0\nf 0 1 1", "a.obj: face 0 (line 2): \"0\": indices begin at 1"),
        ("v 0 0 0\nf -2 1 1", "a.obj: face 0 (line 2): \"-2\" leads to nothing"),
        ("v 0 0 0\nf a 1 1", "a.obj: face 0 (line 2): \"a\" is no corner"),
        ("v 0 0 0\nf 1/2/3/4 1 1", "a.obj: face 0 (line 2): \"1/2/3/4\" is no corner"),
        ("v 0 zero 0", "a.obj: vertex 0 (line 1): property y: \"zero\" is not a number"),
        ("v 0 0", "a.obj: vertex 0 (line 1): property z is missing"),
        ("vn 0 0 x", "a.obj: normal 0 (line 1): property nz"),
        ("vt", "a.obj: texture coordinate 0 (line 1): property u is missing"),
        ("", "a.obj: vertex: the file holds no vertices"),
        ("v nan 0 0\n", "a.obj: vertex: no vertex has finite"),
    ] {
        let error = read(text).unwrap_err().to_string();
        assert!(error.starts_with(expected), "{error} / {expected}");
    }
    let options = ReadOptions { max_triangles: 1, ..ReadOptions::default() };
    let input = Input::from_bytes(format!("{SQUARE}f 1 2 3 4").into_bytes(), "a");
    assert!(matches!(read_from(input, &options), Err(AssetError::TooLarge { limit: 1, .. })));
}

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn put(&self, name: &str, bytes: impl AsRef<[u8]>) {
        std::fs::write(self.0.path().join(name), bytes).unwrap();
    }

    fn read(&self, name: &str) -> Asset {
        let options = ReadOptions::default();
        read_from(Input::open(&self.0.path().join(name), name, &options).unwrap(), &options)
            .unwrap()
    }
}

#[test]
fn materials_sort_the_triangles_into_runs() {
    let folder = Folder::new();
    folder
        .put("my lib.mtl", "newmtl red one\nKd 1 0 0\nnewmtl leaf\nmap_Kd -clamp on leaf 1.png\n");
    folder.put("leaf 1.png", texture::tests::png(1, &[[9, 9, 9, 255], [9, 9, 9, 0]]));
    let text = format!(
        "mtllib ../elsewhere/my lib.mtl\n{SQUARE}usemtl red one\nf 1 2 3\nusemtl leaf\nf 1 3 4\n\
         usemtl red one\nf 2 3 4\nusemtl gone\nf 1 2 4\n"
    );
    folder.put("m.obj", &text);
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(text.as_bytes()).unwrap();
    folder.put("m.obj.gz", encoder.finish().unwrap());
    for name in ["m.obj", "m.obj.gz"] {
        let asset = folder.read(name);
        assert_eq!(mesh(&asset).triangles, [[0, 1, 2], [1, 2, 3], [0, 2, 3], [0, 1, 3]]);
        assert_eq!(
            mesh(&asset).parts,
            [(2, 0), (1, 1), (1, 2)]
                .map(|(triangles, number)| MeshPart { triangles, material: Some(number) })
        );
        let [red, leaf, gone] = &asset.materials[..] else { panic!("{:?}", asset.materials) };
        assert_eq!((red.name.as_str(), red.base_color), ("red one", [1.0, 0.0, 0.0, 1.0]));
        assert_eq!((leaf.base_texture, leaf.alpha_cutoff), (Some(0), Some(0.5)));
        assert_eq!(asset.textures[0].wrap, [crate::assets::Wrap::Clamp; 2]);
        assert_eq!(gone.name, "gone");
        assert_eq!(asset.warnings, ["material gone is not defined and is drawn plain"]);
    }
}

#[test]
fn nothing_missing_is_fatal() {
    let folder = Folder::new();
    folder.put(
        "a.mtl",
        "newmtl m\nKd 0.5 0.5 0.5\nmap_Kd broken.png\nnewmtl n\nmap_Kd /etc/passwd\n",
    );
    folder.put("broken.png", b"\x89PNG\r\n\x1a\nrubbish");
    folder.put(
        "m.obj",
        format!(
            "{SQUARE}mtllib gone.mtl a.mtl\nmtllib a.mtl\nusemtl m\nf 1 2 3\nusemtl n\nf 1 2 4\n"
        ),
    );
    let asset = folder.read("m.obj");
    assert_eq!(asset.materials.len(), 2);
    assert!((asset.materials[0].base_color[0] - 0.214).abs() < 1e-3);
    assert!(asset.textures.is_empty() && asset.warnings.len() == 3, "{:?}", asset.warnings);
}

proptest! {
    #[test]
    fn damage_never_panics(at in 0usize..200, value: u8, cut in 0usize..200) {
        let mut bytes = format!("{SQUARE}usemtl a\nf 1/1/1 2/2/1 3/2/1 4\nf -1 -2 -3\n").into_bytes();
        let length = bytes.len();
        bytes[at % length] = value;
        bytes.truncate(length - cut % length / 2);
        let _ = read_from(Input::from_bytes(bytes, "a"), &ReadOptions::default());
    }
}

#[test]
fn image_that_no_material_names_is_a_warning() {
    let folder = Folder::new();
    folder.put("bare.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n");
    assert!(folder.read("bare.obj").warnings.is_empty(), "no image beside it");
    folder.put("paint.PNG", "not read");
    let warnings = folder.read("bare.obj").warnings;
    assert_eq!(warnings.len(), 1, "{warnings:?}");
    assert!(warnings[0].starts_with("paint.PNG is not used") && warnings[0].contains("mtllib"));
    folder.put("plain.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    assert!(folder.read("plain.obj").warnings.is_empty(), "it has no texture coordinates");
}
