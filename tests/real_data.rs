//! Real files through the whole path: read, baked, uploaded to the GPU, drawn, encoded. `POINTILLIST_DATA` names the folder.
//! Without it, or `../shared/data` beside the checkout, these tests print "skipped" and pass.
//!
//! The tables list files that must be drawn and files that must be refused. A file in neither table must show something or be
//! refused with a message that names it. If `POINTILLIST_PICTURES` names a folder, every frame is written there for inspection.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test that unwraps says where it failed"
)]

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use pointillist::encode::ImageFormat;
use pointillist::engine::{Engine, EngineConfig, FrameRequest, Pose, SceneInfo};
use pointillist::plan::{Output, Reconstruct, Settings};

const SIDE: u32 = 256;

/// Files that must be drawn, whatever else is in the folder.
const DRAWN: &[&str] = &[
    "cad/1002_tray_bottom.STL",
    "cad/ADIS16480.STL",
    "cad/anchor_dense.off",
    "cad/cycloidal.ply",
    "cad/fandisk.obj",
    "cad/featuretype.STL",
    "cad/three_cylinders.obj",
    "corrupt/bad_vlr_count.las",
    "corrupt/float_inf_point_cloud.ply",
    "corrupt/fuzz.glb",
    "corrupt/issue_2421.ply",
    "corrupt/nancolor.obj",
    "corrupt/points_emptyface.ply",
    "lines/722817260.ply",
    "pointclouds/autzen-utm.pcd",
    "pointclouds/autzen.pts",
    "pointclouds/autzen_trim.las",
    "pointclouds/autzen_trim.laz",
    "pointclouds/b9_training.ply",
    "pointclouds/bunnyFloat.e57",
    "pointclouds/bunnyInt19.e57",
    "pointclouds/kitten.xyz",
    "pointclouds/las_versions/1.0_1.las",
    "pointclouds/las_versions/1.2_2.las",
    "pointclouds/lion_takanawa.copc.laz",
    "pointclouds/milk_cartoon_all_small_clorox.pcd",
    "pointclouds/pdrf7-v4-1.4.las",
    "pointclouds/pumpAVisualReferenceImage.e57",
    "pointclouds/same_cloud_many_formats/1.2-with-color.copc.laz",
    "pointclouds/same_cloud_many_formats/1.2-with-color.las",
    "pointclouds/same_cloud_many_formats/1.2-with-color.obj",
    "pointclouds/same_cloud_many_formats/1.2-with-color.ptx",
    "pointclouds/tinyCartesianFloatRgb.e57",
    "scans/armadillo.obj",
    "scans/bun_zipper.ply",
    "scans/bun_zipper_res4.ply",
    "scans/bunny_range/bun000.ply",
    "scans/bunny_range/bun045.ply",
    "scans/bunny_range/bun090.ply",
    "scans/bunny_range/bun180.ply",
    "scans/bunny_range/bun270.ply",
    "scans/bunny_range/bun315.ply",
    "scans/bunny_range/chin.ply",
    "scans/bunny_range/ear_back.ply",
    "scans/bunny_range/top2.ply",
    "scans/bunny_range/top3.ply",
    "scans/dragon_vrip.ply.gz",
    "scans/dragon_vrip_res4.ply.gz",
    "scans/laurana.ply",
    "textured/BoxTextured.glb",
    "textured/CesiumMilkTruck.glb",
    "textured/bunny_attribute_color.ply",
    "textured/capsule/capsule.obj",
    "textured/fuze/fuze.obj",
    "textured/spot/spot_quadrangulated.obj",
    "textured/spot/spot_triangulated.obj",
    "textured/statue.glb",
    "trees/AlmondWP.obj.gz",
    "trees/pine.laz",
    "trees/tree-lime-2-0.glb",
    "trees/tree33.xyz",
];

/// Files that must be refused, with these words.
const REFUSED: &[(&str, &str)] = &[
    ("corrupt/InvalidCVHeader.e57", ""),
    ("corrupt/OutOfMemory.off", "declares 353535235358"),
    ("corrupt/badArray.gltf", "meshes[0].primitives"),
    ("corrupt/badNumber.gltf", "normalTexture.scale"),
    ("corrupt/broken_version.laz", ""),
    ("corrupt/corrupt_crc.e57", ""),
    ("corrupt/corrupted_invalid_double.obj", "vertex 5"),
    ("corrupt/corrupted_invalid_facet_vertex.obj", "does not exist"),
    ("corrupt/corrupted_invalid_vertex_count.ply", "face"),
    ("corrupt/crash-30d6d0f7c529b3b66b4131700b7a4580cd7082df.ply", "header line"),
    ("corrupt/empty.ply", "is empty"),
    ("corrupt/garbage_nVariableLength.las", "number of point records"),
    ("corrupt/malformed.obj", "face 5"),
    ("corrupt/missingheader.pcd", ""),
    ("corrupt/no_magic_number.tck", "a track file begins with \"mrtrix tracks\""),
    ("corrupt/no_vertex.ply", "no vertex element"),
    ("corrupt/truncated.off", "vertex 3"),
    ("corrupt/truncated.ply", "ends here"),
    ("corrupt/truncated.stl", "declares 20 triangles"),
    ("lines/bio_neuron-000.asc", "convert it to SWC"),
    ("pointclouds/pc_color.drc", "Draco"),
    ("scans/bunny_range/README", "known format"),
    ("splats/fourth_st.spz", "Gaussian splats"),
    ("splats/guitar.compressed.ply", "Gaussian splats"),
    ("splats/train-1000.ply", "Gaussian splats"),
    ("trees/AlmondLeaf.png", "image"),
];

/// Valid files of which nothing is visible: triangles without an area, and lines, which no pass draws yet.
const INVISIBLE: &[&str] = &[
    "corrupt/degenerate_mesh.obj",
    "corrupt/Neuron_missing_parents.swc",
    "corrupt/matlab_nan.tck",
    "corrupt/neurite_wrong_root_point.swc",
    "lines/722817260.swc",
    "lines/754534424.swc",
    "lines/Neuron.swc",
    "lines/complex.trk",
    "lines/complex_big_endian.trk",
    "lines/political.vtp",
    "lines/standard.tck",
    "lines/standard.trk",
    "lines/track1.binary.vtk",
    "lines/tracks300.trk",
];

fn data() -> Option<PathBuf> {
    let folder = std::env::var_os("POINTILLIST_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"),
        PathBuf::from,
    );
    match folder.canonicalize() {
        Ok(folder) if folder.is_dir() => Some(folder),
        _ => {
            println!("skipped: there is no folder {}", folder.display());
            None
        }
    }
}

/// Every file below `folder`, as a path relative to `root`.
fn list(root: &Path, folder: &Path, into: &mut BTreeSet<String>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            list(root, &path, into);
        } else {
            into.insert(path.strip_prefix(root).unwrap().to_string_lossy().into_owned());
        }
    }
}

fn request(output: Output, format: ImageFormat) -> FrameRequest {
    FrameRequest {
        scene: "x".to_owned(),
        pose: Pose::FIT,
        width: SIDE,
        height: SIDE,
        settings: Settings::drawn_as(Reconstruct::Points),
        output,
        format,
        quality: 90,
        deadline: None,
    }
}

fn words(bytes: &[u8]) -> impl Iterator<Item = [u8; 4]> {
    bytes.as_chunks::<4>().0.iter().copied()
}

/// Statistics of a scene's frame.
struct Seen {
    covered: usize,
    /// Covered pixels that differ from the background.
    colored: usize,
    /// Covered pixels with a normal.
    with_normal: usize,
    info: SceneInfo,
}

/// Draws the loaded scene `x`, and checks the invariants of every scene.
fn look(engine: &Engine, name: &str) -> Seen {
    let info = engine.scene("x").unwrap();
    let draw = |output| {
        let frame = engine.submit(request(output, ImageFormat::Raw)).unwrap().wait();
        frame.unwrap_or_else(|error| panic!("{name}: {error}"))
    };
    let (color, depth, normal) = (draw(Output::Color), draw(Output::Depth), draw(Output::Normal));
    let depths: Vec<f32> = words(&depth.bytes).map(f32::from_le_bytes).collect();
    assert!(depths.iter().all(|depth| !depth.is_nan() && *depth > 0.0), "{name}: a depth is none");
    let bounds = info.bounds.unwrap_or_else(|| panic!("{name} has no bounds"));
    assert!(bounds.as_flattened().iter().all(|v| v.is_finite()), "{name}: {bounds:?}");
    let seen = || depths.iter().map(|depth| depth.is_finite());
    // Dark files have the light background.
    let backgrounds = [[0x20, 0x24, 0x28, 0xff], [0xc4, 0xca, 0xd0, 0xff]];
    let empty = seen().zip(words(&color.bytes)).find(|(seen, _)| !seen);
    let background = empty.map_or(backgrounds[0], |(_, word)| word);
    assert!(backgrounds.contains(&background), "{name}: {background:?} where nothing is");
    let count = |test: &dyn Fn([u8; 4]) -> bool, bytes: &[u8]| {
        seen().zip(words(bytes)).filter(|(seen, word)| *seen && test(*word)).count()
    };
    for (seen, word) in seen().zip(words(&color.bytes)) {
        assert!(seen || word == background, "{name}: {word:?} where nothing is");
    }
    Seen {
        covered: seen().filter(|seen| *seen).count(),
        colored: count(&|word| word != background, &color.bytes),
        with_normal: count(&|word| word[3] != 0, &normal.bytes),
        info,
    }
}

/// Checks that a scene covers enough: half a per cent of the frame (a neuron is thin), or a pixel for every fourth point of a
/// small cloud.
fn check_seen(name: &str, seen: &Seen) {
    let pixels = (SIDE * SIDE) as usize;
    let samples = seen.info.samples as usize;
    let expected = if samples > 0 { (pixels / 200).min(samples.div_ceil(4)) } else { pixels / 200 };
    assert!(seen.covered >= expected, "{name}: {} pixels of {expected}", seen.covered);
    assert!(2 * seen.colored >= seen.covered, "{name}: {} pixels in colour", seen.colored);
    if seen.info.triangles > 0 {
        assert!(
            100 * seen.with_normal >= 98 * seen.covered,
            "{name}: {} of {} pixels with a normal",
            seen.with_normal,
            seen.covered
        );
    }
}

fn keep_picture(engine: &Engine, name: &str) {
    let Some(folder) = std::env::var_os("POINTILLIST_PICTURES") else { return };
    let frame = engine.submit(request(Output::Color, ImageFormat::Png)).unwrap().wait().unwrap();
    let file = format!("{}.png", name.replace('/', "_"));
    std::fs::write(Path::new(&folder).join(file), &frame.bytes).unwrap();
}

/// Peak resident size of this process in bytes.
fn peak_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    line.trim().strip_suffix(" kB")?.trim().parse::<u64>().ok().map(|kib| kib << 10)
}

/// Whether a file may declare more than it holds. Such files are opened by a process with little memory.
fn is_hostile(name: &str) -> bool {
    name.starts_with("corrupt/")
}

#[test]
fn every_file_is_drawn_or_refused() {
    let Some(folder) = data() else { return };
    let mut files = BTreeSet::new();
    list(&folder, &folder, &mut files);
    let engine = Engine::start(EngineConfig::new(&folder)).unwrap();
    let mut drawn = 0;
    for name in files.iter().filter(|name| !is_hostile(name)) {
        let start = Instant::now();
        let refusal = REFUSED.iter().find(|(file, _)| file == name).map(|(_, words)| *words);
        match engine.load("x", &folder.join(name)) {
            Ok(_) => {
                assert!(refusal.is_none(), "{name} is drawn");
                let seen = look(&engine, name);
                println!(
                    "{name}: {} samples, {} triangles, {} % covered, {:.1?}",
                    seen.info.samples,
                    seen.info.triangles,
                    seen.covered * 100 / (SIDE * SIDE) as usize,
                    start.elapsed()
                );
                for warning in &seen.info.warnings {
                    println!("    {warning}");
                }
                if !INVISIBLE.contains(&name.as_str()) {
                    check_seen(name, &seen);
                }
                keep_picture(&engine, name);
                engine.remove("x").unwrap();
                drawn += 1;
            }
            Err(error) => {
                assert!(!DRAWN.contains(&name.as_str()), "{name} is refused: {error}");
                check_refusal(name, refusal, &error.to_string());
            }
        }
    }
    assert!(engine.scenes().is_empty());
    assert_eq!(engine.stats().failed, 0);
    println!("{drawn} of {} files drawn", files.len());
    if let Some(peak) = peak_bytes() {
        println!("{} MB of memory at most", peak / 1_000_000);
        assert!(peak < 4 << 30, "{peak} bytes of memory");
    }
}

/// Checks that a refusal names the file, gives a reason, and says what was expected.
fn check_refusal(name: &str, words: Option<&str>, text: &str) {
    println!("{text}");
    let file = name.rsplit('/').next().unwrap_or(name);
    let Some((_, rest)) = text.split_once(&format!("{file}: ")) else {
        panic!("the file is not named: {text}");
    };
    assert!(rest.len() > 8, "{text}");
    assert!(words.is_none_or(|words| rest.contains(words)), "{name}: {text}");
    assert!(!text.contains("panicked"), "{text}");
}

#[test]
fn broken_files_are_refused_in_little_memory() {
    const MEMORY_KIB: u64 = 3 << 20;
    let Some(folder) = data() else { return };
    let mut files = BTreeSet::new();
    list(&folder, &folder, &mut files);
    for name in files.iter().filter(|name| is_hostile(name)) {
        let output = Command::new("sh")
            .args(["-c", &format!("ulimit -v {MEMORY_KIB}; exec \"$0\" \"$@\"")])
            .arg(env!("CARGO_BIN_EXE_pointillist"))
            .args(["inspect", "--json"])
            .arg(folder.join(name))
            .env("RAYON_NUM_THREADS", "2")
            .output()
            .unwrap();
        let errors = String::from_utf8_lossy(&output.stderr);
        let refusal = REFUSED.iter().find(|(file, _)| file == name).map(|(_, words)| *words);
        match output.status.code() {
            Some(0) => {
                assert!(refusal.is_none(), "{name} is accepted");
                let told: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
                println!("{name}: {} {}", told["samples"], told["triangles"]);
            }
            Some(1) => {
                assert!(!DRAWN.contains(&name.as_str()), "{name} is refused: {errors}");
                check_refusal(name, refusal, &errors);
            }
            code => panic!("{name} ended with {code:?}: {errors}"),
        }
    }
}

#[test]
fn odd_but_sound_files_are_drawn() {
    let Some(folder) = data() else { return };
    let engine = Engine::start(EngineConfig::new(&folder)).unwrap();
    for name in DRAWN.iter().chain(INVISIBLE).filter(|name| is_hostile(name)) {
        if !folder.join(name).exists() {
            println!("{name} is not there");
            continue;
        }
        engine.load("x", &folder.join(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
        let seen = look(&engine, name);
        println!("{name}: {} pixels, {:?}", seen.covered, seen.info.warnings);
        if !INVISIBLE.contains(name) {
            check_seen(name, &seen);
        }
        keep_picture(&engine, name);
        engine.remove("x").unwrap();
    }
}

#[test]
fn the_same_cloud_in_two_formats_is_the_same_picture() {
    let Some(folder) = data() else { return };
    let engine = Engine::start(EngineConfig::new(&folder)).unwrap();
    for [one, other] in [
        ["pointclouds/autzen_trim.las", "pointclouds/autzen_trim.laz"],
        [
            "pointclouds/same_cloud_many_formats/1.2-with-color.las",
            "pointclouds/same_cloud_many_formats/1.2-with-color.copc.laz",
        ],
    ] {
        let depths = [one, other].map(|name| {
            let path = folder.join(name);
            path.exists().then(|| {
                engine.load("x", &path).unwrap();
                let frame = engine.submit(request(Output::Depth, ImageFormat::Raw)).unwrap().wait();
                engine.remove("x").unwrap();
                frame.unwrap().bytes.clone()
            })
        });
        if let [Some(one), Some(other)] = &depths {
            assert!(one == other, "{one:?} and {other:?} differ");
        }
    }
}

#[test]
fn surveys_and_statues_stand_upright() {
    let Some(folder) = data() else { return };
    let engine = Engine::start(EngineConfig::new(&folder)).unwrap();
    let (y, z) = ([0.0, 1.0, 0.0], [0.0, 0.0, 1.0]);
    for (name, up) in [
        ("pointclouds/autzen_trim.las", z),
        ("pointclouds/autzen-utm.pcd", z),
        ("pointclouds/b9_training.ply", z),
        ("pointclouds/same_cloud_many_formats/1.2-with-color.obj", z),
        ("pointclouds/pumpAVisualReferenceImage.e57", z),
        ("pointclouds/lion_takanawa.copc.laz", z),
        ("pointclouds/kitten.xyz", y),
        ("pointclouds/bunnyFloat.e57", y),
        ("pointclouds/milk_cartoon_all_small_clorox.pcd", y),
        ("scans/bun_zipper_res4.ply", y),
        ("scans/bunny_range/bun000.ply", y),
        ("scans/dragon_vrip_res4.ply.gz", y),
        ("scans/armadillo.obj", y),
        ("scans/laurana.ply", y),
        ("textured/spot/spot_triangulated.obj", y),
        ("textured/fuze/fuze.obj", z),
        ("cad/cycloidal.ply", z),
        ("cad/featuretype.STL", z),
        ("trees/tree33.xyz", z),
        ("lines/722817260.ply", y),
        ("textured/BoxTextured.glb", y),
        ("cad/fandisk.obj", y),
    ] {
        if folder.join(name).exists() {
            let info = engine.load("x", &folder.join(name)).unwrap();
            assert_eq!(info.up, up, "{name}");
            engine.remove("x").unwrap();
        }
    }
}

#[test]
fn the_tables_agree() {
    let drawn: BTreeSet<&str> = DRAWN.iter().chain(INVISIBLE).copied().collect();
    assert_eq!(drawn.len(), DRAWN.len() + INVISIBLE.len());
    assert!(REFUSED.iter().all(|(file, _)| !drawn.contains(file)));
}
