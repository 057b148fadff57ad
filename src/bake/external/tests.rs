use std::fmt::Write as _;
use std::path::Path;

use glam::{DVec3, Vec3};

use super::super::pack::{PackedSamples, pack_samples, unpack_samples};
use super::super::prepare::{AssetTraits, prepare_geometry};
use super::super::tree::build_tree;
use super::*;
use crate::assets::{Geometry, ReadOptions, las, read};
use crate::scene::random::SplitMix64;

const KIB: usize = 1 << 10;

fn numbers(seed: u64) -> impl FnMut() -> f64 {
    let mut numbers = SplitMix64::new(seed);
    move || numbers.unit()
}

/// An ASCII PLY file with these properties.
fn ply(properties: &str, rows: &[Vec<f64>]) -> Vec<u8> {
    let mut text = format!("ply\nformat ascii 1.0\nelement vertex {}\n", rows.len());
    for property in properties.split(' ') {
        let kind =
            if ["red", "green", "blue", "class"].contains(&property) { "uchar" } else { "double" };
        writeln!(text, "property {kind} {property}").unwrap();
    }
    text += "end_header\n";
    for row in rows {
        let row: Vec<String> = row.iter().map(f64::to_string).collect();
        writeln!(text, "{}", row.join(" ")).unwrap();
    }
    text.into_bytes()
}

/// Points of a bumpy sphere far from the origin, denser on one side, with some strays far away.
fn sphere(count: usize) -> Vec<DVec3> {
    let mut next = numbers(5);
    let point = |i: usize| {
        let z = 1.0 - 2.0 * next().powi(2);
        let (sin, cos) = (next() * std::f64::consts::TAU).sin_cos();
        let ring = (1.0 - z * z).sqrt();
        let far = if i % 1500 == 3 { 3.0 + 20.0 * next() } else { 1.0 + 0.02 * (9.0 * z).sin() };
        DVec3::new(636_000.0, 848_000.0, 30.0) + DVec3::new(ring * cos, ring * sin, z) * far * 10.0
    };
    (0..count).map(point).collect()
}

/// The result of reading, preparing and building in memory.
fn in_memory(path: &Path) -> (PackedSamples, PackedSamples) {
    let mut geometry = read(path, &ReadOptions::default()).unwrap().geometries.remove(0);
    let admission = crate::memory::Admission::default();
    prepare_geometry(&mut geometry, &mut AssetTraits::default(), &admission).unwrap();
    let Geometry::Points(cloud) = geometry else { panic!("no cloud") };
    let packed = pack_samples(&cloud).unwrap();
    let tree = build_tree(&unpack_samples(&packed), None).unwrap();
    (packed, tree)
}

fn all<R: bytemuck::Pod>(file: &SpillFile<R>) -> Vec<R> {
    file.load(0..file.count()).unwrap()
}

fn check_equal(found: &Spilled, expected: &PackedSamples, what: &str) {
    assert_eq!(found.grid, expected.grid, "{what}");
    assert!(all(&found.positions) == expected.positions, "{what}: positions");
    assert!(all(&found.attributes) == expected.attributes, "{what}: attributes");
    assert!(all(&found.kernels) == expected.kernels, "{what}: kernels");
    assert_eq!(found.fields, expected.fields, "{what}");
    assert!(all(&found.values) == expected.values, "{what}: values");
    assert!(all(&found.nodes) == expected.nodes, "{what}: nodes");
    assert_eq!(found.chunks.len(), expected.chunks.len(), "{what}");
    for (found, expected) in found.chunks.iter().zip(&expected.chunks) {
        assert_eq!(found, expected, "{what}");
    }
}

/// Bakes a file in memory, externally, and externally from packed samples; all words must be equal.
fn check(name: &str, bytes: &[u8], memory: usize) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    let (packed, tree) = in_memory(&path);
    let source = PointBlocks::open(&path, &ReadOptions::default()).unwrap().unwrap();
    let survey = source.survey().unwrap();
    let spill = Spill::new(folder.path(), disk_bytes(survey.points));
    let progress = |_, done| assert!((0.0..=1.0).contains(&done));
    let work = Work::new(&spill, Memory(memory), &progress);
    let spilled = pack_points(&source, &survey, &work).unwrap();
    check_equal(&spilled, &packed, &format!("{name}, samples"));
    let statistics = TreeStatistics::of(&tree);
    for packed in [Packed::Spilled(&spilled), Packed::Memory(&packed)] {
        let (grown, found) = grow_tree(packed, &work).unwrap();
        check_equal(&grown, &tree, &format!("{name}, tree"));
        assert_eq!(format!("{found:?}"), format!("{statistics:?}"));
    }
    drop(spilled);
    // No temporary file is left.
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn scans_are_baked_alike_with_little_memory() {
    let mut next = numbers(2);
    let rows: Vec<Vec<f64>> = sphere(30_000)
        .into_iter()
        .map(|p| [p.to_array().to_vec(), vec![(next() * 255.0).floor(), 7.0, 200.0]].concat())
        .collect();
    let bytes = ply("x y z red green blue", &rows);
    for memory in [600 * KIB, 3 << 20, 64 << 20] {
        check("scan.ply", &bytes, memory);
    }
}

#[test]
fn lattices_are_baked_alike() {
    // All neighbour distances are equal; some positions occur twice or a hundred times.
    let rows: Vec<Vec<f64>> = (0..20_000)
        .map(|i| {
            let i = if i % 100 == 7 { i - 1 } else { i };
            let i = if i % 9000 < 100 { 0 } else { i };
            let (x, y) = (f64::from(i % 160), f64::from(i / 160));
            vec![x, y, f64::from(u8::from(x > 80.0)) * 30.0, f64::from(i % 13), f64::from(i % 4)]
        })
        .collect();
    check("lattice.ply", &ply("x y z intensity class", &rows), 500 * KIB);
    let plain: Vec<Vec<f64>> =
        rows.iter().map(|row| [&row[..3], &[5.0, row[4]]].concat()).collect();
    check("classes.ply", &ply("x y z intensity class", &plain), 500 * KIB);
}

#[test]
fn what_a_file_gives_is_kept() {
    let points = sphere(12_000);
    let row = |(i, p): (usize, &DVec3)| {
        let n = (*p - DVec3::new(636_000.0, 848_000.0, 30.0)).as_vec3().normalize_or_zero();
        let n = if i % 50 == 0 { Vec3::ZERO } else { n };
        let numbers =
            [p.to_array(), n.as_dvec3().to_array(), [0.1 + (i % 3) as f64 * 0.01, 0.0, 0.0]];
        numbers.concat()
    };
    let rows: Vec<Vec<f64>> = points.iter().enumerate().map(row).collect();
    let columns =
        |count: usize| -> Vec<Vec<f64>> { rows.iter().map(|row| row[..count].to_vec()).collect() };
    check("radii.ply", &ply("x y z nx ny nz radius", &columns(7)), 400 * KIB);
    check("normals.ply", &ply("x y z nx ny nz", &columns(6)), 400 * KIB);
    let radii: Vec<Vec<f64>> = rows.iter().map(|row| [&row[..3], &[row[6]]].concat()).collect();
    check("only-radii.ply", &ply("x y z radius", &radii), 400 * KIB);
}

#[test]
fn laser_scans_and_odd_ones_are_baked_alike() {
    for (name, is_compressed) in [("a.las", false), ("a.laz", true)] {
        check(name, &las::tests::file((1, 4), 7, is_compressed, 9000, 1), 300 * KIB);
    }
    let place = vec![1.0, 2.0, 3.0];
    for count in [1, 2, 5, 40, 3000] {
        check("one place.ply", &ply("x y z", &vec![place.clone(); count]), 300 * KIB);
    }
    // Kernels much longer than all distances determine the grid.
    let rows: Vec<Vec<f64>> =
        (0..3000).map(|i| vec![f64::from(i) * 1e-12, 0.0, 0.0, 1e9]).collect();
    check("kernels.ply", &ply("x y z radius", &rows), 300 * KIB);
}

#[test]
fn temporary_files_have_a_bound() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    let rows: Vec<Vec<f64>> = sphere(20_000).iter().map(|p| p.to_array().to_vec()).collect();
    std::fs::write(&path, ply("x y z", &rows)).unwrap();
    let source = PointBlocks::open(&path, &ReadOptions::default()).unwrap().unwrap();
    let survey = source.survey().unwrap();
    let bake = |limit| {
        let spill = Spill::new(folder.path(), limit);
        let work = Work::new(&spill, Memory(400 * KIB), &|_, _| ());
        let packed = pack_points(&source, &survey, &work)?;
        grow_tree(Packed::Spilled(&packed), &work).map(|_| spill.most_bytes())
    };
    let most = bake(u64::MAX).unwrap();
    assert!(most < 20_000 * DISK_BYTES, "{}", most / 20_000);
    let error = bake(1 << 20).unwrap_err().to_string();
    assert!(error.contains("1 MiB"), "{error}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}
