//! Tests of generators through their public interface: files can be read, bytes repeat, and committed scenes are up to date.

use std::path::{Path, PathBuf};

use super::*;
use crate::scene::{self, SceneLimits};

const PLAIN: Parameters =
    Parameters { seed: 1, points: None, triangles: None, size: None, count: None, form: None };

/// The committed scenes and their parameters.
const COMMITTED: [(Kind, &str, Parameters); 9] = [
    (Kind::Town, "town", Parameters { points: Some(165_000), size: Some(64.0), ..PLAIN }),
    (Kind::Relief, "relief", Parameters { triangles: Some(36_000), ..PLAIN }),
    (Kind::Textured, "textured", Parameters { triangles: Some(8_000), ..PLAIN }),
    (Kind::CsgPart, "part", PLAIN),
    (Kind::Plaza, "plaza", PLAIN),
    (Kind::Neurons, "neurons", Parameters { count: Some(4), ..PLAIN }),
    (Kind::Glasshouse, "glasshouse", PLAIN),
    (Kind::GlasshouseNight, "glasshouse-night", PLAIN),
    (Kind::Materials, "materials", PLAIN),
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
            // Seven plants and six balls share four assets.
            "glasshouse" | "glasshouse-night" => scene.assets.len() as u64 + 9,
            // Twelve balls share an asset.
            "materials" => scene.assets.len() as u64 + 11,
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
    let with = |points, triangles, size| Parameters {
        seed: 0,
        points,
        triangles,
        size,
        count: None,
        form: None,
    };
    for (kind, parameters, name) in [
        (Kind::Town, with(Some(0), None, None), "points"),
        (Kind::Town, with(None, None, Some(f64::NAN)), "size"),
        (Kind::Relief, with(None, Some(1), None), "triangles"),
        (Kind::Cube, with(None, None, Some(-1.0)), "size"),
        (
            Kind::Cube,
            with(Some(9), None, None),
            "points: this kind has no such option; it has --size, --seed",
        ),
        (Kind::Town, with(None, Some(9), None), "triangles"),
        (Kind::Hard, with(None, None, Some(1.0)), "size"),
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
        let has = |name| kind.parameters().contains(&name);
        let parameters = Parameters {
            seed: 2,
            points: has("points").then_some(2_000),
            triangles: has("triangles").then_some(3_000),
            size: matches!(kind, Kind::Town).then_some(60.0),
            count: has("count").then_some(30),
            form: None,
        };
        let made = generate_scene(*kind, "it", &parameters, &Progress::none()).unwrap();
        let path = folder.path().join("it.json");
        write(&Generated::Scene(made), &path).unwrap();
        let scene = scene::load(&path, folder.path(), &SceneLimits::default())
            .unwrap_or_else(|error| panic!("{kind:?}: {error}"));
        assert!(scene.instance_count() > 0);
    }
}

/// Lines are read back as they were made, and those of fewer streamlines or neurons begin in the same way.
#[test]
fn lines_are_read_back_from_both_formats() {
    let folder = tempfile::tempdir().unwrap();
    let options = crate::assets::ReadOptions::default();
    for (kind, count, has_radii) in [(Kind::Neurons, 3, true), (Kind::Tracts, 200, false)] {
        let parameters = Parameters { seed: 5, count: Some(count), ..Parameters::default() };
        let made = generate(kind, &parameters, &Progress::none()).unwrap();
        let Generated::Lines(lines) = &made else { panic!("lines expected") };
        assert_eq!(lines.radii.is_some(), has_radii);
        let mut radii = lines.radii.iter().flatten();
        assert!(radii.all(|radius| *radius > 0.0 && radius.is_finite()));
        let strands = lines.strands.len() as u64 - 1;
        if kind == Kind::Tracts {
            assert_eq!(strands, count);
        } else {
            // A body, and at least a branch of each kind.
            assert!(strands > 10 * count, "{strands}");
        }
        for extension in ["vtk", "tck"] {
            let path = folder.path().join(format!("a.{extension}"));
            write(&made, &path).unwrap();
            let first = std::fs::read(&path).unwrap();
            write(&generate(kind, &parameters, &Progress::none()).unwrap(), &path).unwrap();
            assert!(std::fs::read(&path).unwrap() == first, "{kind:?} twice");
            let asset = crate::assets::read(&path, &options).unwrap();
            let crate::assets::Geometry::Lines(found) = &asset.geometries[0] else { panic!() };
            assert!(asset.warnings.is_empty(), "{:?}", asset.warnings);
            assert_eq!(found.strands, lines.strands);
            let near = |(a, b): (&glam::DVec3, &glam::DVec3)| a.distance(*b) < 1e-3;
            assert!(found.positions.iter().zip(&lines.positions).all(near));
            if extension == "vtk" {
                assert_eq!(found.radii, lines.radii);
                assert_eq!(found.colors, lines.colors);
                assert_eq!(found.fields.list().len(), usize::from(has_radii));
            }
        }
        assert!(write(&made, &folder.path().join("a.ply")).is_err());
        let scene = generate_scene(kind, "it", &parameters, &Progress::none()).unwrap();
        let path = folder.path().join("it.json");
        write(&Generated::Scene(scene), &path).unwrap();
        scene::load(&path, folder.path(), &SceneLimits::default()).unwrap();
    }
}

/// Trees of lines come back from their files as they were made, and equal parameters give equal bytes.
#[test]
fn trees_are_read_back_in_both_forms() {
    use crate::assets::Geometry;
    let folder = tempfile::tempdir().unwrap();
    let of =
        |form| Parameters { seed: 7, count: Some(500), form: Some(form), ..Parameters::default() };
    let read = |path: &Path| {
        let mut asset = crate::assets::read(path, &crate::assets::ReadOptions::default()).unwrap();
        assert!(asset.warnings.is_empty(), "{:?}", asset.warnings);
        asset.geometries.remove(0)
    };
    let made = generate(Kind::Tree, &of(Form::Lines), &Progress::none()).unwrap();
    let path = folder.path().join("a.vtk");
    let files = write(&made, &path).unwrap();
    let bytes: Vec<Vec<u8>> = files.iter().map(|file| std::fs::read(file).unwrap()).collect();
    let names: Vec<_> = files.iter().map(|file| file.file_name().unwrap().to_owned()).collect();
    assert_eq!(names, ["a.vtk", "a-leaves.vtk", "a-trunk.ply"]);
    write(&generate(Kind::Tree, &of(Form::Lines), &Progress::none()).unwrap(), &path).unwrap();
    for (file, bytes) in files.iter().zip(&bytes) {
        assert!(std::fs::read(file).unwrap() == *bytes, "{} twice", file.display());
    }
    let Generated::Plant(plant) = &made else { panic!("a tree of lines expected") };
    for (file, lines) in files.iter().zip([&plant.branches, &plant.leaves]) {
        let Geometry::Lines(found) = read(file) else { panic!("lines expected") };
        assert_eq!(found.strands, lines.strands);
        assert_eq!((&found.radii, &found.colors), (&lines.radii, &lines.colors));
        assert_eq!(found.normals.is_some(), lines.normals.is_some());
        let pairs = found.normals.iter().flatten().zip(lines.normals.iter().flatten());
        assert!(pairs.into_iter().all(|(a, b)| a.distance(*b) < 1e-6));
    }
    let Geometry::Mesh(trunk) = read(&files[2]) else { panic!("a mesh expected") };
    assert_eq!(trunk.triangles, plant.trunk.mesh.triangles);
    let error = write(&made, Path::new("a.ply")).unwrap_err().to_string();
    assert!(error.contains("a tree of lines") && error.contains(".vtk"), "{error}");
    let mesh = generate(Kind::Tree, &of(Form::Triangles), &Progress::none()).unwrap();
    assert!(matches!(&mesh, Generated::Mesh(mesh) if mesh.mesh.triangles.len() > 2_000));
    for form in [Form::Lines, Form::Triangles] {
        for kind in [Kind::Tree, Kind::Grove] {
            let made = generate_scene(kind, "it", &of(form), &Progress::none()).unwrap();
            let path = folder.path().join("it.json");
            write(&Generated::Scene(made), &path).unwrap();
            let scene = scene::load(&path, folder.path(), &SceneLimits::default()).unwrap();
            let parts = if form == Form::Lines { 3 } else { 1 };
            let copies = if kind == Kind::Grove { 10 * parts + 1 } else { parts };
            assert_eq!(scene.instance_count(), copies, "{kind:?} {form:?}");
        }
    }
}

#[test]
fn trees_refuse_counts_out_of_range() {
    let none = Progress::none();
    let parameters = |count, triangles| Parameters {
        count,
        triangles,
        form: Some(Form::Lines),
        ..Parameters::default()
    };
    for kind in [Kind::Tree, Kind::Grove] {
        for (parameters, name) in [
            (parameters(Some(0), None), "count"),
            (parameters(Some(3_500_001), None), "count"),
            (parameters(None, Some(99)), "triangles"),
            (Parameters { size: Some(0.0), ..parameters(Some(1), None) }, "size"),
        ] {
            let error = generate(kind, &parameters, &none).unwrap_err().to_string();
            assert!(error.starts_with(name), "{error}");
        }
    }
}
