//! Tests of generators through their public interface: files can be read, bytes repeat, and committed scenes are up to date.

use std::path::{Path, PathBuf};

use super::*;
use crate::scene::{self, SceneLimits};

/// The committed scenes and their parameters.
const COMMITTED: [(Kind, &str, Parameters); 5] = [
    (
        Kind::Town,
        "town",
        Parameters { seed: 1, points: Some(165_000), triangles: None, size: Some(64.0) },
    ),
    (
        Kind::Relief,
        "relief",
        Parameters { seed: 1, points: None, triangles: Some(36_000), size: None },
    ),
    (
        Kind::Textured,
        "textured",
        Parameters { seed: 1, points: None, triangles: Some(8_000), size: None },
    ),
    (Kind::CsgPart, "part", Parameters { seed: 1, points: None, triangles: None, size: None }),
    (Kind::Plaza, "plaza", Parameters { seed: 1, points: None, triangles: None, size: None }),
];

fn scenes_folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes")
}

/// After a change of a generator its scenes must be regenerated; `scenes/README.md` has the commands.
#[test]
fn committed_scenes_come_from_the_generators() {
    let fresh = tempfile::tempdir().unwrap();
    let mut total = 0;
    for (kind, name, parameters) in COMMITTED {
        let made = generate_scene(kind, name, &parameters, &Progress::none()).unwrap();
        let path = fresh.path().join(format!("{name}.json"));
        for file in write(&Generated::Scene(made), &path).unwrap() {
            let file_name = file.file_name().unwrap().to_string_lossy().into_owned();
            let expected = std::fs::read(scenes_folder().join(&file_name))
                .unwrap_or_else(|error| panic!("scenes/{file_name}: {error}"));
            let found = std::fs::read(&file).unwrap();
            assert!(found == expected, "scenes/{file_name} is not what `generate {name}` makes");
            total += found.len();
        }
    }
    assert!(total < 6_000_000, "{total} bytes committed");
}

#[test]
fn committed_scenes_are_valid() {
    let folder = scenes_folder();
    for (_, name, _) in COMMITTED {
        let path = folder.join(format!("{name}.json"));
        let scene = scene::load(&path, &folder, &SceneLimits::default()).unwrap();
        assert_eq!(scene.name, name);
        assert!(scene.cameras.len() >= 3 && scene.paths.len() == 1, "{name}");
        let expected = match name {
            "plaza" => 1600 * 11,
            // The other assets are operands of this one.
            "part" => 1,
            _ => scene.assets.len() as u64,
        };
        assert_eq!(scene.instance_count(), expected, "{name}");
    }
}

/// The committed files are exactly the generated ones, and they are small.
#[test]
fn the_hard_cases_come_from_their_generator() {
    let fresh = tempfile::tempdir().unwrap();
    let made = generate(Kind::Hard, &Parameters::default(), &Progress::none()).unwrap();
    let folder = scenes_folder().join("hard");
    let mut expected = std::fs::read_dir(&folder).unwrap().count();
    let mut total = 0;
    for file in write(&made, fresh.path()).unwrap() {
        let name = file.file_name().unwrap().to_string_lossy().into_owned();
        let committed = std::fs::read(folder.join(&name))
            .unwrap_or_else(|error| panic!("scenes/hard/{name}: {error}"));
        assert!(committed == std::fs::read(&file).unwrap(), "scenes/hard/{name} differs");
        total += committed.len();
        expected -= 1;
        if name.ends_with(".json") {
            let scene = scene::load(&file, fresh.path(), &SceneLimits::default())
                .unwrap_or_else(|error| panic!("{name}: {error}"));
            assert!(scene.cameras.len() >= 2 && format!("{}.json", scene.name) == name);
        }
    }
    assert_eq!(expected, 0, "files in scenes/hard that no generator makes");
    assert!(total < 600_000, "{total} bytes committed");
    let error = generate_scene(Kind::Hard, "it", &Parameters::default(), &Progress::none());
    assert!(error.unwrap_err().to_string().contains("folder"));
    let error = write(&made, Path::new("a.ply")).unwrap_err().to_string();
    assert!(error.contains("many scenes"), "{error}");
}

#[test]
fn las_files_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let parameters = Parameters { points: Some(3_000), size: Some(60.0), ..Parameters::default() };
    let made = generate(Kind::Town, &parameters, &Progress::none()).unwrap();
    let Generated::Points(cloud) = &made else { panic!("points expected") };
    for name in ["a.las", "a.laz"] {
        let path = folder.path().join(name);
        write(&made, &path).unwrap();
        let mut reader = las::Reader::from_path(&path).unwrap();
        let read = reader.read_all().unwrap();
        let points: Vec<las::Point> = read.points().map(|point| point.unwrap()).collect();
        assert_eq!(points.len(), 3_000);
        for (i, point) in points.iter().enumerate() {
            let p = glam::DVec3::new(point.x, point.y, point.z);
            assert!((p - cloud.positions[i]).abs().max_element() < 1e-6, "{name} {i}");
            let value = |name: &str| cloud.value(name, i).unwrap();
            assert_eq!(f64::from(point.intensity), value("intensity"));
            let class = u8::from(point.classification);
            assert_eq!(f64::from(class), value("classification"));
            let red = point.color.unwrap().red;
            assert_eq!(red >> 8, u16::from(cloud.colors.as_ref().unwrap()[i][0]));
        }
    }
}

/// A PLY file has exactly the bytes that its header announces.
#[test]
fn ply_files_have_the_size_their_headers_say() {
    let folder = tempfile::tempdir().unwrap();
    let body = |bytes: &[u8]| {
        let end = b"end_header\n";
        let at = bytes.windows(end.len()).position(|w| w == end).unwrap();
        bytes.len() - at - end.len()
    };
    let points = Parameters { points: Some(1_000), ..Parameters::default() };
    let cases = [
        (Kind::Cube, Parameters::default(), 24 * (12 + 12 + 3) + 12 * 13),
        (Kind::Checkerboard, points.clone(), 1_000 * (24 + 12 + 3)),
        (Kind::Town, Parameters { size: Some(60.0), ..points }, 1_000 * (24 + 3 + 2 + 1)),
    ];
    for (kind, parameters, expected) in cases {
        let path = folder.path().join("a.ply");
        let made = generate(kind, &parameters, &Progress::none()).unwrap();
        write(&made, &path).unwrap();
        assert_eq!(body(&std::fs::read(&path).unwrap()), expected, "{kind:?}");
    }
}

#[test]
fn obj_files_have_material_and_texture() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("pot.obj");
    let parameters = Parameters { triangles: Some(2_000), ..Parameters::default() };
    let made = generate(Kind::Textured, &parameters, &Progress::none()).unwrap();
    let files = write(&made, &path).unwrap();
    assert_eq!(files.len(), 3);
    let (models, materials) = tobj::load_obj(&path, &tobj::GPU_LOAD_OPTIONS).unwrap();
    let materials = materials.unwrap();
    assert_eq!(materials[0].diffuse_texture.as_deref(), Some("pot.png"));
    let Generated::Mesh(mesh) = &made else { panic!("mesh expected") };
    assert_eq!(models[0].mesh.indices.len(), 3 * mesh.mesh.triangles.len());
    let image = image::open(folder.path().join("pot.png")).unwrap();
    assert_eq!((image.width(), image.height()), (512, 512));
}

#[test]
fn refusals_name_the_parameter_and_the_format() {
    let none = Progress::none();
    let with = |points, triangles, size| Parameters { seed: 0, points, triangles, size };
    for (kind, parameters, name) in [
        (Kind::Town, with(Some(0), None, None), "points"),
        (Kind::Town, with(None, None, Some(f64::NAN)), "size"),
        (Kind::Relief, with(None, Some(1), None), "triangles"),
        (Kind::Cube, with(None, None, Some(-1.0)), "size"),
    ] {
        let error = generate(kind, &parameters, &none).unwrap_err().to_string();
        assert!(error.starts_with(name), "{kind:?}: {error}");
    }
    let cube = generate(Kind::Cube, &Parameters::default(), &none).unwrap();
    let error = write(&cube, Path::new("a.las")).unwrap_err().to_string();
    assert!(error.contains("a mesh") && error.contains(".obj"), "{error}");
    let error = write(&cube, Path::new("/nowhere/at/all/a.ply")).unwrap_err().to_string();
    assert!(error.starts_with("/nowhere/at/all/a.ply: "), "{error}");
    let odd = generate_scene(Kind::Cube, "a\"b", &Parameters::default(), &none);
    assert!(odd.unwrap_err().to_string().contains("letters"));
}

#[test]
fn every_kind_makes_a_scene() {
    let folder = tempfile::tempdir().unwrap();
    use clap::ValueEnum;
    for kind in Kind::value_variants().iter().filter(|kind| **kind != Kind::Hard) {
        let parameters = Parameters {
            seed: 2,
            points: Some(2_000),
            triangles: Some(3_000),
            size: matches!(kind, Kind::Town).then_some(60.0),
        };
        let made = generate_scene(*kind, "it", &parameters, &Progress::none()).unwrap();
        let path = folder.path().join("it.json");
        write(&Generated::Scene(made), &path).unwrap();
        let scene = scene::load(&path, folder.path(), &SceneLimits::default())
            .unwrap_or_else(|error| panic!("{kind:?}: {error}"));
        assert!(scene.instance_count() > 0);
    }
}
