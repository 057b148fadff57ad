//! Lines in the engine: at levels of detail, beside point trees, picked, counted, and refused where a scene asks for what they do not have.

use std::fmt::Write;

use glam::DVec3;
use pointillist::engine::pick::{HitKind, request_of};
use pointillist::engine::{Client, FrameRequest, Pose};
use pointillist::math::Camera;
use pointillist::plan::{Output, Pass, Reconstruct, Settings};
use pointillist::scene::color::linear_from_srgb;
use pointillist::scene::random::SplitMix64;
use serde_json::{Value, json};

use super::studio::{Studio, cloud, covered, depths, front, spt};

/// A VTK file of two strands: one along x, one along y.
const CROSS: &str = "# vtk DataFile Version 3.0\ncross\nASCII\nDATASET POLYDATA\nPOINTS 5 float\n\
    -1 0 0\n0 0 0\n1 0 0\n0.5 -1 -0.5\n0.5 1 -0.5\nLINES 2 7\n3 0 1 2\n2 3 4\n\
    POINT_DATA 5\nSCALARS radius float 1\nLOOKUP_TABLE default\n0.1\n0.1\n0.1\n0.05\n0.05\n";

fn load(studio: &Studio) {
    studio.write("cross.vtk", CROSS);
    let points = (0..4000).map(|i| {
        let (x, y) = (f64::from(i % 64) / 32.0 - 1.0, f64::from(i / 64) / 32.0 - 1.0);
        (DVec3::new(x, y, -1.5), [90, (i % 200) as u8, 40])
    });
    studio.write("cloud.ply", cloud(points));
    let scene = json!({
        "assets": { "cross": { "file": "cross.vtk" }, "cloud": { "file": "cloud.ply" } },
        "nodes": [{ "asset": "cross" }, { "asset": "cloud" }],
        "cameras": { "front": { "eye": [0.2, 0.1, 4], "target": [0, 0, 0], "fov": 45 } },
    });
    let info = studio.load_json("both", &scene);
    assert_eq!((info.segments, info.samples, info.triangles), (3, 4000, 0));
    // Assets are in the order of their names.
    assert_eq!(info.assets.iter().map(|asset| asset.segments).collect::<Vec<_>>(), [0, 3]);
}

#[test]
fn lines_are_drawn_beside_point_trees() {
    let studio = Studio::new();
    load(&studio);
    let ids = |settings| {
        let request = FrameRequest { settings, output: Output::Id, ..front("both", 90, 80) };
        let frame = studio.frame(&request);
        let ran = |pass: Pass| frame.receipt.passes.iter().any(|p| p.ran && p.name == pass.name());
        assert!(ran(Pass::ProjectLines) && ran(Pass::ResolveLines));
        assert_eq!(frame.receipt.segments.stored, 3);
        super::studio::ids(&frame.bytes)
    };
    let full = ids(Settings::drawn_as(Reconstruct::Points));
    let lines = |ids: &[u32]| -> Vec<bool> { ids.iter().map(|&id| id == 1).collect() };
    // Tubes of 52 × 4.8 and 45 × 2.1 pixels, which cover four rows and two columns of centres.
    let covered = lines(&full).iter().filter(|&&line| line).count();
    assert!((280..340).contains(&covered), "{covered}");
    for settings in [spt(1.0, Reconstruct::Points), spt(3.0, Reconstruct::Splats)] {
        assert_eq!(lines(&ids(settings)), lines(&full), "{settings:?}");
    }
}

#[test]
fn picks_name_strand_and_place() {
    let studio = Studio::new();
    load(&studio);
    // Both have the strands of the file.
    for settings in [Settings::drawn_as(Reconstruct::Points), spt(1.0, Reconstruct::Points)] {
        picks_of(&studio, settings);
    }
}

fn picks_of(studio: &Studio, settings: Settings) {
    let request = FrameRequest { settings, ..front("both", 90, 80) };
    let ids = studio.bytes(&FrameRequest { output: Output::Id, ..request.clone() });
    let depths = studio.bytes(&FrameRequest { output: Output::Depth, ..request.clone() });
    let (ids, depths) = (super::studio::ids(&ids), super::studio::depths(&depths));
    let pixels: Vec<[u32; 2]> = (0..80)
        .flat_map(|y| (0..90).map(move |x| [x, y]))
        .filter(|[x, y]| ids[(y * 90 + x) as usize] == 1)
        .collect();
    let frame = studio.engine.resolve_blocking(request_of(request)).unwrap();
    let (ticket, picker) = studio.engine.pick(Client::Unnamed, &frame, pixels.clone()).unwrap();
    let picks = picker.read(&ticket.wait().unwrap()).unwrap();
    let mut strands = [0; 2];
    for (pick, [x, y]) in picks.iter().zip(pixels) {
        let hit = pick.hit.as_ref().unwrap();
        let strand = hit.strand.unwrap();
        assert_eq!(hit.kind, HitKind::Segment);
        strands[strand.index as usize] += 1;
        let depth = f64::from(depths[(y * 90 + x) as usize]);
        assert!((hit.depth - depth).abs() < 1e-4 * depth, "{hit:?} {depth}");
        let place = DVec3::from(hit.position);
        let axis = match strand.index {
            0 => DVec3::new(f64::from(strand.vertex) - 1.0 + strand.share, 0.0, 0.0),
            _ => DVec3::new(0.5, 2.0 * strand.share - 1.0, -0.5),
        };
        let radius = if strand.index == 0 { 0.1 } else { 0.05 };
        assert!((place.distance(axis) - radius).abs() < 1e-5, "{hit:?}");
        let normal = DVec3::from(hit.normal.unwrap());
        assert!(normal.dot((place - axis).normalize_or_zero()) > 0.9999);
    }
    assert!(strands.iter().all(|&count| count > 30), "{strands:?}");
}

#[test]
fn a_scene_says_how_thick_lines_are() {
    let studio = Studio::new();
    studio.write("cross.vtk", CROSS);
    studio.write("bare.obj", "v -1 0 0\nv 0 0.2 0\nv 1 0 0\nl 1 2 3\n");
    let mut scenes = 0;
    let mut seen = |file: &str, radius: Option<f64>| {
        scenes += 1;
        let id = format!("lines-{scenes}");
        let mut asset = json!({ "file": file });
        if let Some(radius) = radius {
            asset["line_radius"] = radius.into();
        }
        studio
            .load_json(&id, &json!({ "assets": { "a": asset }, "nodes": [{ "asset": "a" }], "cameras": { "front": { "eye": [0.2, 0.1, 4], "target": [0, 0, 0], "fov": 45 } } }));
        let settings = Settings::drawn_as(Reconstruct::Points);
        covered(&studio.bytes(&FrameRequest {
            settings,
            output: Output::Depth,
            ..front(&id, 90, 80)
        }))
    };
    let (own, thick) = (seen("cross.vtk", None), seen("cross.vtk", Some(0.3)));
    assert!(thick > 2 * own, "{own} {thick}");
    let (chosen, thick) = (seen("bare.obj", None), seen("bare.obj", Some(0.1)));
    assert!(chosen > 0 && thick > 5 * chosen, "{chosen} {thick}");
    for (radius, reason) in [(0.0, "line_radius"), (-1.0, "line_radius"), (1e300, "line_radius")] {
        studio.write(
            "bad.json",
            json!({ "assets": { "a": { "file": "cross.vtk", "line_radius": radius } },
            "nodes": [{ "asset": "a" }] })
            .to_string(),
        );
        let error = studio.try_load("bad", "bad.json").unwrap_err().to_string();
        assert!(error.contains(reason), "{error}");
    }
    studio.write("p.ply", cloud([(DVec3::ZERO, [1, 2, 3])].into_iter()));
    studio.write("bad.json", r#"{ "assets": { "a": { "file": "p.ply", "line_radius": 1 } }, "nodes": [{ "asset": "a" }] }"#);
    let error = studio.try_load("bad", "bad.json").unwrap_err().to_string();
    assert!(error.contains("line_radius") && error.contains("no lines"), "{error}");
}

/// A leaf of a quad over a floor: both are drawn where they were, and the leaf counts as a segment.
#[test]
fn leaves_of_a_mesh_become_lines() {
    let studio = Studio::new();
    let corners = "v -1 0 0.1\nv -1 0.2 0.1\nv 1 0.2 0.1\nv 1 0 0.1\n";
    let floor = "v -9 -9 0\nv 9 -9 0\nv 9 9 0\nv -9 9 0\n";
    studio.write("leaf.obj", format!("{corners}{floor}f 1 2 3 4\nf 5 6 7 8\n"));
    let scene = |as_lines: Value| {
        let mut scene = json!({
            "assets": { "a": { "file": "leaf.obj" } },
            "nodes": [{ "asset": "a" }],
            "cameras": { "front": { "eye": [0, 0, 3], "target": [0, 0, 0], "fov": 45 } }
        });
        if !as_lines.is_null() {
            scene["assets"]["a"]["as_lines"] = as_lines;
        }
        scene
    };
    let drawn = |id: &str| {
        depths(&studio.bytes(&FrameRequest { output: Output::Depth, ..front(id, 90, 80) }))
    };
    studio.load_json("mesh", &scene(Value::Null));
    studio.load_json("lines", &scene(json!({})));
    let info = studio.engine.scene("lines").unwrap();
    assert_eq!((info.triangles, info.segments), (2, 1));
    let [mesh, lines] = ["mesh", "lines"].map(drawn);
    let differing = mesh.iter().zip(&lines).filter(|(a, b)| (*a - *b).abs() > 1e-3).count();
    assert!(differing < 90, "{differing} pixels show another depth");
    for (as_lines, reason) in [
        (json!({ "leaves": false }), "no leaves"),
        (json!({ "max_radius": 0.01 }), "no leaves"),
        (json!({ "leaves": false, "branches": false }), "needs `leaves` or `branches`"),
        (json!({ "max_radius": 0 }), "max_radius"),
        (json!({ "twigs": true }), "twigs"),
    ] {
        studio.write("bad.json", scene(as_lines).to_string());
        let error = studio.try_load("bad", "bad.json").unwrap_err().to_string();
        assert!(error.contains("as_lines") && error.contains(reason), "{error}");
    }
    let mut both = scene(json!({}));
    both["assets"]["a"]["line_radius"] = 0.1.into();
    studio.write("bad.json", both.to_string());
    let error = studio.try_load("bad", "bad.json").unwrap_err().to_string();
    assert!(error.contains("cannot stand beside `as_lines`"), "{error}");
}

/// A sheaf of white fibres along z that spread at its ends, 1.2 wide and 2 long.
fn sheaf(strands: usize, vertices: usize, radius: f64) -> String {
    let mut random = SplitMix64::new(21);
    let mut text = String::from("# vtk DataFile Version 3.0\nsheaf\nASCII\nDATASET POLYDATA\n");
    writeln!(text, "POINTS {} float", strands * vertices).unwrap();
    for _ in 0..strands {
        let (x, y) = (random.range(-0.3, 0.3), random.range(-0.3, 0.3));
        for vertex in 0..vertices {
            let t = 2.0 * vertex as f64 / (vertices - 1) as f64 - 1.0;
            let spread = 1.0 + t * t;
            writeln!(text, "{} {} {t}", x * spread + 0.02 * (9.0 * t).sin(), y * spread).unwrap();
        }
    }
    writeln!(text, "LINES {strands} {}", strands * (vertices + 1)).unwrap();
    for strand in 0..strands {
        let places: Vec<String> =
            (0..vertices).map(|v| (strand * vertices + v).to_string()).collect();
        writeln!(text, "{vertices} {}", places.join(" ")).unwrap();
    }
    writeln!(text, "POINT_DATA {}\nSCALARS radius float 1", strands * vertices).unwrap();
    text.push_str("LOOKUP_TABLE default\n");
    (0..strands * vertices).for_each(|_| writeln!(text, "{radius}").unwrap());
    text
}

/// Sum over all pixels of what is brighter than a black background, in linear light.
fn light(rgba: &[u8]) -> f64 {
    let green = rgba.iter().skip(1).step_by(4);
    green.map(|&byte| linear_from_srgb(f64::from(byte) / 255.0)).sum()
}

fn sheaves(studio: &Studio, places: &[[f64; 3]], radius: f64) {
    studio.write("sheaf.vtk", sheaf(1500, 40, radius));
    let nodes: Vec<_> =
        places.iter().map(|at| json!({ "asset": "sheaf", "translate": at })).collect();
    let scene = json!({
        "assets": { "sheaf": { "file": "sheaf.vtk" } },
        "nodes": nodes,
        "background": [0, 0, 0],
        "lights": [],
    });
    studio.load_json("sheaf", &scene);
}

/// With the true widths of the strands.
fn look_at_sheaf(distance: f64, settings: Settings) -> FrameRequest {
    let settings = Settings { line_width_px: 0.0.into(), ..settings };
    let eye = DVec3::new(0.8, 0.3, 0.5).normalize_or(DVec3::Z) * distance;
    let camera = Camera::perspective(eye, DVec3::ZERO, 40.0);
    FrameRequest { settings, pose: Pose::Camera(camera), ..front("sheaf", 256, 256) }
}

#[test]
fn far_strands_are_fewer_and_as_bright() {
    let studio = Studio::new();
    sheaves(&studio, &[[0.0; 3]], 0.0004);
    let full = Settings::drawn_as(Reconstruct::Points);
    for (distance, error_px, saving) in [(24.0, 1.0, 2), (64.0, 1.0, 4), (32.0, 4.0, 6)] {
        let [exact, coarse] = [full, spt(error_px, Reconstruct::Points)].map(|settings| {
            let frame = studio.frame(&look_at_sheaf(distance, settings));
            (light(&frame.bytes), frame.receipt.segments.tested.unwrap())
        });
        let ratio = coarse.0 / exact.0;
        println!(
            "{distance} away at {error_px} px: {} of {} segments, {ratio:.3} of the light",
            coarse.1, exact.1
        );
        assert!(coarse.1 * saving < exact.1, "{} of {} at {distance}", coarse.1, exact.1);
        assert!((0.85..1.15).contains(&ratio), "{ratio} of the light at {distance}");
    }
}

/// The lines of a scene that would be lost as scattered pixels are a pixel wide. Dense bundles have the brightness of their true widths.
#[test]
fn lines_that_would_be_lost_are_a_pixel_wide() {
    let studio = Studio::new();
    let scene = json!({
        "assets": { "cross": { "file": "cross.vtk" } },
        "nodes": [{ "asset": "cross" }],
        "cameras": { "front": { "eye": [0, 0.1, 4], "target": [0, 0, 0], "fov": 45 } },
    });
    let of_radii = |radii: &str| CROSS.replace("0.1\n0.1\n0.1\n0.05\n0.05", radii);
    let drawn = |name: &str, file: &str, line_width_px: Option<f64>| {
        studio.write("cross.vtk", file);
        studio.load_json(name, &scene);
        let width = line_width_px.map_or_else(Default::default, Into::into);
        let settings = Settings { line_width_px: width, ..Settings::drawn_as(Reconstruct::Points) };
        let frame =
            studio.frame(&FrameRequest { settings, output: Output::Id, ..front(name, 90, 80) });
        let used = serde_json::to_value(&frame.receipt.settings).unwrap()["line_width_px"].clone();
        let ids = super::studio::ids(&frame.bytes);
        (ids.iter().filter(|&&id| id != 0).count(), used.as_f64().unwrap())
    };
    let thin = of_radii(&["1e-4"; 5].join("\n"));
    let (pixels, used) = drawn("thin", &thin, None);
    // Lines of 48 and 43 pixels, which cross.
    assert_eq!(used, 1.0);
    assert!((85..100).contains(&pixels), "{pixels}");
    // A single straight line has no area between its ends.
    let straight = "# vtk DataFile Version 3.0\nline\nASCII\nDATASET POLYDATA\nPOINTS 2 float\n-1 0 0\n1 0 0\nLINES 1 3\n2 0 1\n\
        POINT_DATA 2\nSCALARS radius float 1\nLOOKUP_TABLE default\n1e-4\n1e-4\n";
    let (pixels, used) = drawn("straight", straight, None);
    assert_eq!(used, 1.0);
    assert!(pixels > 40, "{pixels}");
    let (pixels, used) = drawn("true", &thin, Some(0.0));
    assert_eq!(used, 0.0);
    assert!(pixels < 5, "{pixels}");
    let (pixels, used) = drawn("wide", &thin, Some(6.0));
    assert_eq!(used, 6.0);
    assert!((480..620).contains(&pixels), "{pixels}");
    let (_, used) = drawn("thick", &of_radii(&["0.2"; 5].join("\n")), None);
    assert_eq!(used, 0.0);
}

#[test]
fn outlines_of_strands_grow_by_the_error_at_most() {
    let studio = Studio::new();
    sheaves(&studio, &[[0.0; 3]], 0.004);
    let covered = |settings| {
        let request = FrameRequest { output: Output::Id, ..look_at_sheaf(18.0, settings) };
        super::studio::ids(&studio.frame(&request).bytes)
    };
    let full = covered(Settings::drawn_as(Reconstruct::Points));
    for error_px in [1.0, 3.0] {
        let reach = error_px as i32 + 2;
        let coarse = covered(spt(error_px, Reconstruct::Points));
        assert!(coarse.iter().filter(|&&id| id != 0).count() > 300);
        for (at, _) in coarse.iter().enumerate().filter(|(_, id)| **id != 0) {
            let (x, y) = (at as i32 % 256, at as i32 / 256);
            let near = (-reach..=reach).any(|dy| {
                (-reach..=reach).any(|dx| {
                    let (x, y) = (x + dx, y + dy);
                    let inside = (0..256).contains(&x) && (0..256).contains(&y);
                    inside && full[(y * 256 + x) as usize] != 0
                })
            });
            assert!(near, "({x}, {y}) at {error_px} px");
        }
    }
}

/// Scenes of so many instances have trees over them.
#[test]
fn crowds_of_strands_are_as_bright() {
    let studio = Studio::new();
    let places: Vec<[f64; 3]> = (0..36)
        .map(|i| [3.0 * f64::from(i % 6) - 7.5, 3.0 * f64::from(i / 6) - 7.5, 0.0])
        .collect();
    sheaves(&studio, &places, 0.0006);
    let [exact, coarse] = [Settings::drawn_as(Reconstruct::Points), spt(1.0, Reconstruct::Points)]
        .map(|settings| {
            let frame = studio.frame(&look_at_sheaf(120.0, settings));
            (light(&frame.bytes), frame.receipt.segments.tested.unwrap())
        });
    let ratio = coarse.0 / exact.0;
    println!("{} of {} segments, {ratio:.3} of the light", coarse.1, exact.1);
    assert!(coarse.1 * 6 < exact.1, "{} of {}", coarse.1, exact.1);
    // Strands that are left cover each other less.
    assert!((0.85..1.2).contains(&ratio), "{ratio}");
}
