//! Tests with real and broken point files from a folder outside the repository: the one that `POINTILLIST_DATA` names, or
//! `../shared/data` beside the checkout. Without the folder nothing is tested.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a panic is how a test fails")]

use std::path::{Path, PathBuf};

use glam::DVec3;
use pointillist::assets::{self, Asset, AssetError, Geometry, PointCloud, ReadOptions};

fn data() -> Option<PathBuf> {
    let folder = std::env::var_os("POINTILLIST_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"),
        PathBuf::from,
    );
    if folder.is_dir() {
        return Some(folder);
    }
    println!("skipped: there is no {}", folder.display());
    None
}

fn read(path: &Path) -> Result<Asset, AssetError> {
    let options = ReadOptions::default();
    let name = path.file_name().unwrap().to_string_lossy();
    match path.extension().unwrap().to_str().unwrap() {
        "las" | "laz" => assets::las::read(path, &name, &options),
        "e57" => assets::e57::read(path, &name, &options),
        "pcd" => assets::pcd::read(path, &name, &options),
        "ptx" => assets::ptx::read(path, &name, &options),
        _ => assets::xyz::read(path, &name, &options),
    }
}

fn cloud(asset: &Asset) -> &PointCloud {
    match &asset.geometries[..] {
        [Geometry::Points(cloud)] => cloud,
        other => panic!("{} geometries", other.len()),
    }
}

/// Checks that every optional vector is as long as the positions, all numbers are finite, and normals have unit length.
fn check_consistent(cloud: &PointCloud) {
    let count = cloud.positions.len();
    assert!(cloud.positions.iter().all(|p| p.is_finite()));
    assert!(cloud.colors.as_ref().is_none_or(|c| c.len() == count));
    assert!(cloud.fields.is_empty() || cloud.fields.points() == count);
    assert!(cloud.normals.as_ref().is_none_or(|c| c.len() == count));
    assert!(cloud.normals.iter().flatten().all(|n| (n.length() - 1.0).abs() < 1e-5));
}

struct Expected {
    file: &'static str,
    points: usize,
    min: [f64; 3],
    max: [f64; 3],
    has_color: bool,
    has_normals: bool,
    /// Tolerance of the bounds, in units of the file.
    tolerance: f64,
}

const fn plain(file: &'static str, points: usize, min: [f64; 3], max: [f64; 3]) -> Expected {
    Expected { file, points, min, max, has_color: false, has_normals: false, tolerance: 0.006 }
}

const fn colored(file: &'static str, points: usize, min: [f64; 3], max: [f64; 3]) -> Expected {
    Expected { file, points, min, max, has_color: true, has_normals: false, tolerance: 0.006 }
}

const AUTZEN_MIN: [f64; 3] = [636001.76, 848935.2, 406.26];
const AUTZEN_MAX: [f64; 3] = [637179.22, 849497.9, 520.51];
const SMALL_MIN: [f64; 3] = [635619.85, 848899.7, 406.59];
const SMALL_MAX: [f64; 3] = [638982.55, 853535.43, 586.38];
const FIXTURE_MIN: [f64; 3] = [-1500.01, 250.0, -350.04];
const FIXTURE_MAX: [f64; 3] = [496.16, 1746.71, 449.12];
const ONE: [f64; 3] = [470692.44, 4602888.9, 16.0];
const BUNNY_MIN: [f64; 3] = [-0.0947, 0.04, -0.0619];
const BUNNY_MAX: [f64; 3] = [0.061, 0.1873, 0.0588];

const FILES: &[Expected] = &[
    colored("pointclouds/autzen_trim.las", 110_000, AUTZEN_MIN, AUTZEN_MAX),
    colored("pointclouds/autzen_trim.laz", 110_000, AUTZEN_MIN, AUTZEN_MAX),
    colored("pointclouds/same_cloud_many_formats/1.2-with-color.las", 1065, SMALL_MIN, SMALL_MAX),
    colored(
        "pointclouds/same_cloud_many_formats/1.2-with-color.copc.laz",
        1065,
        SMALL_MIN,
        SMALL_MAX,
    ),
    colored("pointclouds/same_cloud_many_formats/1.2-with-color.ptx", 1065, SMALL_MIN, SMALL_MAX),
    colored(
        "pointclouds/autzen-utm.pcd",
        1065,
        [493994.87, 4877429.62, 123.93],
        [494993.68, 4878817.02, 178.73],
    ),
    colored(
        "pointclouds/autzen.pts",
        10,
        [636102.84, 848968.8, 427.919998],
        [636126.400009, 849345.199997, 512.139999],
    ),
    plain("pointclouds/las_versions/1.0_1.las", 1, ONE, ONE),
    colored("pointclouds/las_versions/1.2_2.las", 1, ONE, ONE),
    colored(
        "pointclouds/lion_takanawa.copc.laz",
        341_989,
        [-4.985, 1.039, -3.445],
        [-0.789, 6.724, 1.124],
    ),
    colored(
        "pointclouds/milk_cartoon_all_small_clorox.pcd",
        241_407,
        [-1.0608, -0.21967, -2.063],
        [1.1525, 0.86923, -0.501],
    ),
    Expected {
        file: "pointclouds/kitten.xyz",
        points: 5210,
        min: [-0.32531, -0.49973, -0.29561],
        max: [0.32569, 0.4989, 0.29496],
        has_color: false,
        has_normals: true,
        tolerance: 1e-5,
    },
    colored(
        "pointclouds/pumpAVisualReferenceImage.e57",
        155_201,
        [-2.9038, -5.3011, -1.8997],
        [1.7216, -0.7926, 1.843],
    ),
    plain("pointclouds/bunnyFloat.e57", 30_571, BUNNY_MIN, BUNNY_MAX),
    plain("pointclouds/bunnyInt19.e57", 30_571, BUNNY_MIN, BUNNY_MAX),
    colored(
        "pointclouds/tinyCartesianFloatRgb.e57",
        2090,
        [-9.7795, 4.5139, 295.5247],
        [-6.7741, 7.5155, 298.5322],
    ),
    // Half of the 1024 points are flagged as withheld.
    colored("pointclouds/pdrf7-v4-1.4.las", 512, FIXTURE_MIN, FIXTURE_MAX),
    colored("pointclouds/pdrf7-v4-1.4.laz", 512, FIXTURE_MIN, FIXTURE_MAX),
    plain("trees/pine.laz", 73_851, [-1.2493, -1.24, -0.224071], [1.2407, 1.24, 19.935929]),
    plain("trees/tree33.xyz", 10_005, [-9.634, 0.50196, -1.1824], [-3.1473, 12.135, 9.2727]),
];

#[test]
fn real_files_hold_what_is_known_of_them() {
    let Some(data) = data() else { return };
    for expected in FILES {
        let file = expected.file;
        let asset = read(&data.join(file)).unwrap_or_else(|error| panic!("{error}"));
        let cloud = cloud(&asset);
        check_consistent(cloud);
        assert_eq!(cloud.positions.len(), expected.points, "{file}");
        assert_eq!(cloud.colors.is_some(), expected.has_color, "{file}");
        assert_eq!(cloud.normals.is_some(), expected.has_normals, "{file}");
        let bounds = asset.bounds();
        let (min, max) = (DVec3::from(expected.min), DVec3::from(expected.max));
        let error = (bounds.min - min).abs().max((bounds.max - max).abs()).max_element();
        assert!(error <= expected.tolerance, "{file}: {} .. {}", bounds.min, bounds.max);
        println!("{file}: {} points, {:?}", cloud.positions.len(), asset.warnings);
    }
}

/// The points with their colours, rounded and sorted, to compare the same cloud across formats.
fn sorted_points(asset: &Asset, tenths: bool) -> Vec<([i64; 3], [u8; 4])> {
    let unit = if tenths { 10.0 } else { 100.0 };
    let cloud = cloud(asset);
    let key = |p: &DVec3| (*p * unit).round().to_array().map(|v| v as i64);
    let colors = cloud.colors.as_ref().unwrap();
    let mut points: Vec<_> = cloud.positions.iter().map(key).zip(colors.iter().copied()).collect();
    points.sort_unstable();
    points
}

#[test]
fn the_same_cloud_is_the_same_in_every_format() {
    let Some(data) = data() else { return };
    let load = |file: &str| read(&data.join("pointclouds").join(file)).unwrap();
    let las = load("same_cloud_many_formats/1.2-with-color.las");
    for other in ["1.2-with-color.copc.laz", "1.2-with-color.ptx"] {
        let other = load(&format!("same_cloud_many_formats/{other}"));
        assert!(sorted_points(&las, false) == sorted_points(&other, false));
    }
    for (plain, packed) in
        [("autzen_trim.las", "autzen_trim.laz"), ("pdrf7-v4-1.4.las", "pdrf7-v4-1.4.laz")]
    {
        let (plain, packed) = (load(plain), load(packed));
        let (a, b) = (cloud(&plain), cloud(&packed));
        assert!(a.positions == b.positions && a.colors == b.colors);
        assert!(a.fields == b.fields);
    }
    // 8-bit values in 16-bit fields, or in their high bytes.
    for (file, max) in [("autzen_trim.las", 236), ("lion_takanawa.copc.laz", 255)] {
        let asset = load(file);
        let brightest = cloud(&asset).colors.iter().flatten().flat_map(|c| &c[..3]).max().copied();
        assert_eq!(brightest, Some(max), "{file}");
    }
}

#[test]
fn broken_files_are_refused_with_a_reason() {
    let Some(data) = data() else { return };
    for (file, reason) in [
        ("garbage_nVariableLength.las", "header, number of point records: is 719"),
        ("broken_version.laz", "LAZ item Point10 of version 6"),
        ("missingheader.pcd", "header, line 1: \"289814.15\" is no PCD keyword"),
        ("corrupt_crc.e57", "checksum"),
        ("InvalidCVHeader.e57", "scan 0: Invalid E57 content: Section ID"),
    ] {
        let error = read(&data.join("corrupt").join(file)).unwrap_err().to_string();
        println!("{error}");
        assert!(error.starts_with(&format!("{file}: ")), "{error}");
        assert!(error.contains(reason), "{error}");
    }
    // The header declares one variable length record too many, but all points can be read.
    let asset = read(&data.join("corrupt/bad_vlr_count.las")).unwrap();
    println!("{:?}", asset.warnings);
    assert_eq!(cloud(&asset).positions.len(), 10);
    assert!(asset.warnings[0].contains("declares 3 variable length records; 2 fit"));
    // A reader given a file of another format does not crash either.
    for entry in std::fs::read_dir(data.join("corrupt")).unwrap() {
        let path = entry.unwrap().path();
        let options = ReadOptions::default();
        for read in [
            assets::las::read,
            assets::e57::read,
            assets::pcd::read,
            assets::ptx::read,
            assets::xyz::read,
        ] {
            if let Err(error) = read(&path, "file", &options) {
                assert!(error.to_string().starts_with("file: "), "{error}");
            }
        }
    }
}
