//! Scene files with their assets on disk, assembled.

use std::fmt::Write;

use super::*;
use crate::scene::{SceneLimits, parse};

/// A folder with `cube.ply`, points on a cube of edge 2 with normals; `bare.ply`, the same without; `mesh.ply`, a triangle.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let (mut cube, mut bare) = (String::new(), String::new());
    for face in 0..6 {
        for i in 0..100 {
            let (s, t) = (f64::from(i % 10) / 5.0 - 0.9, f64::from(i / 10) / 5.0 - 0.9);
            let side = if face % 2 == 0 { 1.0 } else { -1.0 };
            let turn = |v: [f64; 3]| std::array::from_fn::<f64, 3, _>(|k| v[(k + face / 2) % 3]);
            let ([x, y, z], [a, b, c]) = (turn([side, s, t]), turn([side, 0.0, 0.0]));
            writeln!(cube, "{x} {y} {z} {a} {b} {c}").unwrap();
            writeln!(bare, "{x} {y} {z}").unwrap();
        }
    }
    let head = "ply\nformat ascii 1.0\nelement vertex";
    let place = "property float x\nproperty float y\nproperty float z\n";
    let normal = "property float nx\nproperty float ny\nproperty float nz\n";
    let write = |name: &str, text: String| std::fs::write(folder.path().join(name), text).unwrap();
    write("cube.ply", format!("{head} 600\n{place}{normal}end_header\n{cube}"));
    write("bare.ply", format!("{head} 600\n{place}end_header\n{bare}"));
    let face = "element face 1\nproperty list uchar int vertex_indices\n";
    write("mesh.ply", format!("{head} 3\n{place}{face}end_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"));
    folder
}

fn assemble(assets: &str) -> (Scene, Result<Vec<Prepared>, AssembleError>) {
    let folder = folder();
    let text = format!(r#"{{"assets": {{{assets}}}, "nodes": [{{"asset": "part"}}]}}"#);
    let path = folder.path();
    let scene = parse(&text, "s.json", path, path, &SceneLimits::default()).unwrap();
    let mut assembler = Assembler::new(Path::new("s.json"), &scene, &ReadOptions::default());
    let made = (0..scene.assets.len()).map(|index| assembler.asset(index)).collect();
    (scene, made)
}

fn refused(assets: &str) -> String {
    assemble(assets).1.map(|_| ()).unwrap_err().to_string()
}

const CUBE: &str = r#""cube": {"file": "cube.ply"}, "bare": {"file": "bare.ply"}"#;

#[test]
fn solids_are_combined_where_they_stand() {
    let (_, made) = assemble(&format!(
        r#"{CUBE}, "part": {{"difference": [{{"asset": "cube"}}, {{"asset": "post"}}]}},
        "post": {{"union": [{{"asset": "cube", "translate": [1, 1, 1], "scale": 0.5}},
            {{"asset": "cube", "translate": [9, 0, 0]}}]}}"#
    ));
    let made = made.unwrap();
    let formats: Vec<&str> = made.iter().map(|one| one.asset.format).collect();
    assert_eq!(formats, ["operand", "ply", "csg", "operand"]);
    assert!(made[0].asset.geometries.is_empty() && made[0].asset.placements.is_empty());
    let part = &made[2];
    assert!(part.traits.has_normals && !part.traits.normals_estimated);
    let Geometry::Points(cloud) = &part.asset.geometries[0] else { panic!("samples") };
    assert_eq!(cloud.colors.as_ref().map(Vec::len), Some(cloud.positions.len()));
    // The corner is gone but for samples whose disks reach out of it, and walls look into where it was.
    let corner = |p: &glam::DVec3| p.min_element() > 0.8;
    assert!(!cloud.positions.iter().any(corner));
    let normals = cloud.normals.as_ref().unwrap();
    let walls = cloud
        .positions
        .iter()
        .zip(normals)
        .filter(|(p, n)| (p.x - 0.5).abs() < 1e-6 && n.x > 0.9 && p.min_element() > 0.4);
    assert!(walls.count() > 20);
    let clips = cloud.clips.as_ref().unwrap();
    assert!(clips.iter().any(|clip| *clip != Clip::NONE));
    let bounds = crate::math::Bounds::of(cloud.positions.iter().copied());
    // Centres may lie beyond an edge by as much as their disk.
    assert!(bounds.max.max_element() <= 1.2, "{bounds:?}");
}

#[test]
fn nothing_left_is_a_warning() {
    let (_, made) = assemble(&format!(
        r#"{CUBE}, "part": {{"intersection": [{{"asset": "cube"}}, {{"asset": "cube", "translate": [9, 0, 0]}}]}}"#
    ));
    let part = &made.unwrap()[2].asset;
    assert!(part.geometries[0].positions().is_empty());
    assert!(part.warnings[0].contains("nothing is left"), "{:?}", part.warnings);
}

#[test]
fn what_does_not_go_together_names_its_place() {
    let with =
        |part: &str| refused(&format!(r#"{CUBE}, "mesh": {{"file": "mesh.ply"}}, "part": {part}"#));
    let error = with(r#"{"difference": [{"asset": "cube"}, {"asset": "mesh"}]}"#);
    assert!(error.starts_with("s.json: assets.part.difference[1]: `mesh` is a mesh"), "{error}");
    let error = with(r#"{"union": [{"asset": "cube"}, {"asset": "bare"}]}"#);
    assert!(error.starts_with("s.json: assets.part.union[1]: `bare`: "), "{error}");
    assert!(error.contains("no normals"), "{error}");
    let error = with(r#"{"file": "cube.ply", "sample": {}}"#);
    assert!(error.starts_with("s.json: assets.part.sample: "), "{error}");
    let error = with(r#"{"file": "mesh.ply", "features": true}"#);
    assert!(error.starts_with("s.json: assets.part.features: "), "{error}");
}
