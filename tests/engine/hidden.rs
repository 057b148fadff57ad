//! Hidden chunks are not drawn, and no pixel depends on this.

use std::collections::BTreeSet;

use glam::DVec3;
use pointillist::engine::{FrameRequest, Pose};
use pointillist::math::{Camera, Projection};
use pointillist::plan::{Antialias, Edl, ErrorMode, Output, Pass, Reconstruct, Settings};
use pointillist::scene::{Blend, Filter, Shading};
use serde_json::json;

use super::studio::{OUTPUTS, Studio, cloud, front, same, sphere, spt};

/// A bundle of strands, thick and thin, as a VTK file.
fn bundle() -> String {
    let (strands, vertices) = (12, 60);
    let mut text = String::from("# vtk DataFile Version 3.0\nbundle\nASCII\nDATASET POLYDATA\n");
    text += &format!("POINTS {} float\n", strands * vertices);
    for strand in 0..strands {
        for vertex in 0..vertices {
            let (sin, cos) = (f64::from(vertex) * 0.1 + f64::from(strand)).sin_cos();
            let x = 0.02 * f64::from(vertex) - 0.6;
            text += &format!("{x} {} {}\n", 0.2 * sin, 0.2 * cos + 0.02 * f64::from(strand));
        }
    }
    text += &format!("LINES {strands} {}\n", strands * (vertices + 1));
    for strand in 0..strands {
        let places = (0..vertices).map(|vertex| (strand * vertices + vertex).to_string());
        text += &format!("{vertices} {}\n", places.collect::<Vec<_>>().join(" "));
    }
    text += &format!(
        "POINT_DATA {}\nSCALARS radius float 1\nLOOKUP_TABLE default\n",
        strands * vertices
    );
    for strand in 0..strands * vertices {
        text += if strand / vertices % 2 == 0 { "0.03\n" } else { "0.002\n" };
    }
    text
}

/// A ball of points of every alpha, as a PLY file.
fn mist() -> String {
    let mut text = String::from("ply\nformat ascii 1.0\nelement vertex 600\n");
    for name in ["float x", "float y", "float z"] {
        text += &format!("property {name}\n");
    }
    for name in ["red", "green", "blue", "alpha"] {
        text += &format!("property uchar {name}\n");
    }
    text += "end_header\n";
    for i in 0..600 {
        let (sin, cos) = (2.4 * f64::from(i)).sin_cos();
        let y = 1.0 - f64::from(i) / 300.0;
        let flat = (1.0 - y * y).sqrt();
        text += &format!("{} {y} {} 90 160 220 {}\n", flat * cos, flat * sin, i % 256);
    }
    text
}

/// Loads rows of bundles, balls and clouds one behind the other, with walls that close the view in places.
fn load(studio: &Studio) {
    studio.write("ball.ply", sphere(24));
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    let on_ball = (0..4000).map(|i| {
        let y = 1.0 - 2.0 * (f64::from(i) + 0.5) / 4000.0;
        let around = golden * f64::from(i);
        let flat = (1.0 - y * y).sqrt();
        let place = DVec3::new(flat * around.cos(), y, flat * around.sin());
        (place, [(i % 251) as u8, (i % 83) as u8, 120])
    });
    studio.write("cloud.ply", cloud(on_ball));
    studio.write("bundle.vtk", bundle());
    studio.load_json(
        "rows",
        &json!({
            "assets": { "ball": { "file": "ball.ply" }, "cloud": { "file": "cloud.ply" },
                        "bundle": { "file": "bundle.vtk" } },
            "nodes": [
                { "asset": "bundle", "translate": [0.4, 0.2, 0.4],
                  "repeat": { "grid": [12, 2, 12], "step": [1.5, 1.5, 1.5] } },
                { "asset": "ball", "scale": 0.7, "repeat": { "grid": [12, 2, 12], "step": [1.5, 1.5, 1.5] } },
                { "asset": "cloud", "scale": 0.6, "translate": [0.75, 0, 0.75],
                  "repeat": { "grid": [12, 2, 12], "step": [1.5, 1.5, 1.5] } },
            ],
            "lights": [{ "kind": "headlight" }, { "kind": "ambient" }],
        }),
    );
    // Translucent triangles, small and large ones, and nothing else.
    studio.write("pane.mtl", "newmtl pane\nKd 0.8 0.2 0.1\nd 0.5\n");
    studio.write(
        "pane.obj",
        "mtllib pane.mtl\nusemtl pane\nv -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nv -1 1.1 0\nf 1 2 3 4\nf 3 4 5\n",
    );
    let sky =
        image::RgbImage::from_fn(8, 4, |x, y| image::Rgb([90, 40 + 20 * x as u8, 60 * y as u8]));
    let mut bytes = std::io::Cursor::new(Vec::new());
    sky.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    studio.write("sky.png", bytes.into_inner());
    studio.load_json(
        "glass",
        &json!({
            "assets": { "pane": { "file": "pane.obj" } },
            "nodes": [{ "asset": "pane", "repeat": { "grid": [8, 2, 10], "step": [1.5, 1.5, 1.5] } }],
            "lights": [
                { "kind": "ambient", "intensity": 0.3 },
                { "kind": "sun", "direction": [0.2, -1, 0.3], "shadows": true },
            ],
            "ambient_occlusion": { "radius": 0.5 },
            "environment": { "file": "sky.png", "strength": 0.4 },
            "fog": { "color": "#a0b0c0", "density": 0.05, "scale_height": 2 },
        }),
    );
    // Translucent points, translucent lines, and nothing else.
    let smoke = bundle() + "COLOR_SCALARS rgba 4\n" + &"0.3 0.6 0.9 0.5\n".repeat(720);
    studio.write("smoke.vtk", smoke);
    studio.load_json(
        "smoke",
        &json!({ "assets": { "smoke": { "file": "smoke.vtk" } }, "nodes": [{ "asset": "smoke" }] }),
    );
    studio.write("mist.ply", mist());
    studio.load_json(
        "mist",
        &json!({ "assets": { "mist": { "file": "mist.ply" } }, "nodes": [{ "asset": "mist", "scale": 3 }] }),
    );
    // Kernels that reach far beyond their centres, under a wide filter, in stretched and mirrored instances.
    studio.load_json(
        "wide",
        &json!({
            "assets": { "cloud": { "file": "cloud.ply" } },
            "nodes": [
                { "asset": "cloud", "scale": [0.9, -0.3, 0.6], "rotate": [20, 40, 10],
                  "repeat": { "grid": [8, 2, 8], "step": [2, 2, 2] } },
            ],
            "splats": { "lowpass": 3, "cutoff": 2.5, "width": 2 },
        }),
    );
}

fn views() -> Vec<FrameRequest> {
    let looks = [
        // Along the rows, among them, from above, from inside a ball, and past everything.
        ([0.3, 0.2, 14.0], [0.1, 0.0, -9.0], 50.0),
        ([1.1, -0.4, 2.2], [-4.0, 0.3, -7.0], 80.0),
        ([5.0, 25.0, 9.0], [0.0, 0.0, 0.0], 40.0),
        ([0.75, 0.75, 0.75], [8.0, 0.75, 0.75], 70.0),
        ([0.0, 2.0, 30.0], [0.0, 40.0, 0.0], 60.0),
    ];
    let view = |(eye, target, fov_deg): ([f64; 3], [f64; 3], f64)| {
        let camera = Camera::perspective(eye.into(), target.into(), fov_deg);
        FrameRequest { pose: Pose::Camera(camera), ..front("rows", 170, 131) }
    };
    let mut views: Vec<FrameRequest> = looks.into_iter().map(view).collect();
    // Parallel rays see these rows as well.
    let flat = |request: &FrameRequest| {
        let settings = Settings { projection: Some(Projection::Orthographic), ..request.settings };
        FrameRequest { settings, ..request.clone() }
    };
    views.extend([flat(&views[0]), flat(&views[2])]);
    views
}

fn settings() -> Vec<Settings> {
    let splats = Settings { reconstruct: Reconstruct::Splats, ..Settings::default() };
    let points = Reconstruct::Points;
    let small = spt(1.0, Reconstruct::Splats);
    vec![
        Settings::drawn_as(Reconstruct::Points),
        splats,
        spt(0.5, points),
        spt(2.0, points),
        Settings::drawn_as(Reconstruct::PullPush),
        Settings { line_width_px: 12.0.into(), ..Settings::drawn_as(points) },
        small,
        Settings { filter: Some(Filter::Exact), blend: Some(Blend::Opaque), ..splats },
        Settings { reconstruct: Reconstruct::Fuzzy, ..splats },
        Settings { reconstruct: Reconstruct::Painted, ..splats },
        Settings { filter: Some(Filter::Affine), shading: Some(Shading::Splat), ..small },
        Settings { error_mode: ErrorMode::Split, prefilter: Some(false), ..small },
    ]
}

#[test]
fn frames_are_those_that_draw_what_is_hidden() {
    frames_are_equal(false);
}

#[test]
fn frames_are_those_that_draw_what_is_hidden_without_64_bit_atomics() {
    frames_are_equal(true);
}

fn frames_are_equal(force_32_bit: bool) {
    let [hides, draws] = [false, true].map(|draw_hidden| {
        let studio = Studio::with(|config| {
            config.force_32_bit = force_32_bit;
            config.draw_hidden = draw_hidden;
        });
        load(&studio);
        studio
    });
    let (mut fewer, mut fewer_splats, mut fewer_segments) = (0, 0, 0);
    let wide =
        views().into_iter().take(2).map(|view| FrameRequest { scene: "wide".into(), ..view });
    for (number, view) in views().into_iter().chain(wide).enumerate() {
        // All filters for the first view.
        for settings in settings().into_iter().take(if number == 0 { usize::MAX } else { 7 }) {
            // Ids show anything that is missing. The other outputs are drawn on one kind of adapter: twin tests hold the two kinds against each other.
            let outputs = if number == 0 && !force_32_bit { &OUTPUTS[..] } else { &[Output::Id] };
            for &output in outputs {
                let settings = Settings { projection: view.settings.projection, ..settings };
                let request = FrameRequest { settings, output, ..view.clone() };
                let (found, all) = (hides.frame(&request), draws.frame(&request));
                let what = format!("view {number}, {settings:?}, {output:?}, {force_32_bit}");
                same(&found.bytes, &all.bytes, &what);
                let tested = [&found, &all].map(|frame| frame.receipt.triangles.tested);
                assert!(tested[0] <= tested[1], "{what}: {tested:?}");
                fewer += usize::from(2 * tested[0].unwrap_or(0) < tested[1].unwrap_or(0));
                let tested = [&found, &all].map(|frame| frame.receipt.segments.tested);
                assert!(tested[0] <= tested[1], "{what}: {tested:?}");
                fewer_segments +=
                    usize::from(4 * tested[0].unwrap_or(0) < 3 * tested[1].unwrap_or(0));
                let tested = [&found, &all].map(|frame| frame.receipt.samples.tested);
                assert!(tested[0] <= tested[1], "{what}: {tested:?}");
                let splats = settings.reconstruct == Reconstruct::Splats;
                fewer_splats +=
                    usize::from(splats && 4 * tested[0].unwrap() < 3 * tested[1].unwrap());
            }
        }
    }
    // Along the rows most chunks are hidden, at any level of detail.
    assert!(fewer >= 12, "in {fewer} frames less than half was drawn");
    assert!(
        fewer_segments >= 30,
        "in {fewer_segments} frames a quarter of the segments was left out"
    );
    assert!(fewer_splats >= 6, "in {fewer_splats} frames a quarter of the splats was left out");
}

#[test]
fn every_pass_is_recorded_by_some_frame_in_the_order_of_the_table() {
    let mut recorded = BTreeSet::new();
    for narrow in [false, true] {
        let studios = [false, true].map(|rasterises| {
            let studio = Studio::with(|config| {
                config.force_32_bit = narrow;
                config.rasterise = Some(rasterises);
            });
            load(&studio);
            studio
        });
        let shaped = Settings { edl: Edl::On, ..Settings::drawn_as(Reconstruct::Points) };
        let fine =
            Settings { antialias: Antialias::Parts4, ..Settings::drawn_as(Reconstruct::Points) };
        let lens = Settings { aperture: 0.1.into(), ..Settings::drawn_as(Reconstruct::Points) };
        let rows = settings().into_iter().take(10).chain([shaped, fine, lens]);
        let points = Settings::drawn_as(Reconstruct::Points);
        let splats = Settings::drawn_as(Reconstruct::Splats);
        let translucent =
            [("glass", points), ("mist", points), ("mist", splats), ("smoke", points)];
        let frames = rows.map(|settings| ("rows", settings)).chain(translucent);
        for (scene, settings) in frames {
            let scene = scene.to_owned();
            let request = FrameRequest { scene, settings, ..views().remove(0) };
            for studio in &studios {
                let receipt = &studio.frame(&request).receipt;
                let place = |name| Pass::ALL.iter().position(|pass| pass.name() == name).unwrap();
                let (ran, skipped): (Vec<_>, Vec<_>) = receipt.passes.iter().partition(|p| p.ran);
                let places: Vec<usize> = ran.iter().map(|pass| place(pass.name)).collect();
                assert!(places.is_sorted_by(|a, b| a < b), "{settings:?}: {ran:?}");
                let all = places.iter().copied().chain(skipped.iter().map(|p| place(p.name)));
                assert_eq!(all.collect::<BTreeSet<_>>().len(), Pass::ALL.len(), "{settings:?}");
                assert_eq!(receipt.passes.len(), Pass::ALL.len(), "{settings:?}");
                assert!(skipped.iter().all(|pass| pass.why.is_some()));
                recorded.extend(ran.iter().map(|pass| pass.name));
            }
        }
    }
    let mut all: BTreeSet<&str> = Pass::ALL.iter().map(|pass| pass.name()).collect();
    // Only picks record this pass; see `picks.rs`.
    all.remove(Pass::Identify.name());
    assert_eq!(recorded, all);
}

#[test]
fn a_wall_hides_what_is_behind_it() {
    let studio = Studio::new();
    load(&studio);
    let mut scene = json!({
        "assets": { "ball": { "file": "ball.ply" }, "wall": { "file": "wall.obj" } },
        "nodes": [
            { "asset": "ball", "scale": 0.7, "repeat": { "grid": [14, 14, 3], "step": [1.5, 1.5, 1.5] } },
            { "name": "wall", "asset": "wall", "translate": [0, 0, 6] },
        ],
    });
    studio.write("wall.obj", "v -9 -9 0\nv 9 -9 0\nv 9 9 0\nv -9 9 0\nf 1 2 3 4\n");
    studio.load_json("walled", &scene);
    scene["nodes"].as_array_mut().unwrap().pop();
    studio.load_json("open", &scene);
    let camera = Camera::perspective(DVec3::new(0.0, 0.0, 16.0), DVec3::ZERO, 60.0);
    let tested = |id: &str| {
        let request = FrameRequest { pose: Pose::Camera(camera), ..front(id, 160, 160) };
        studio.frame(&request).receipt.triangles.tested.unwrap()
    };
    let (walled, open) = (tested("walled"), tested("open"));
    assert!(open > 100_000 && walled < open / 4, "{walled} of {open}");
}

/// Dense points hide what is behind them. Points with gaps between them hide nothing, so nothing is asked there.
#[test]
fn points_with_gaps_between_them_are_drawn_without_asking() {
    let [hides, draws] = [false, true].map(|draw_hidden| {
        let studio = Studio::with(|config| config.draw_hidden = draw_hidden);
        let side = 280;
        let sheet = (0..side * side).map(|i| {
            let [x, y] = [i % side, i / side].map(|k| f64::from(k) / f64::from(side) - 0.5);
            (DVec3::new(4.0 * x, 3.0 * y, 0.0), [(i % 251) as u8, 90, 120])
        });
        studio.write("sheet.ply", cloud(sheet));
        studio.load_json(
            "sheets",
            &json!({
                "assets": { "sheet": { "file": "sheet.ply" } },
                "nodes": [{ "asset": "sheet", "repeat": { "grid": [1, 1, 8], "step": [1, 1, -0.02] } }],
            }),
        );
        studio
    });
    let camera = Camera::perspective(DVec3::new(0.0, 0.0, 4.0), DVec3::ZERO, 40.0);
    for (width, height, asks) in [(160, 120, true), (960, 720, false)] {
        let settings = Settings { edl: Edl::Off, ..Settings::drawn_as(Reconstruct::Points) };
        let pose = Pose::Camera(camera);
        let request = FrameRequest { pose, settings, ..front("sheets", width, height) };
        let [found, all] = [&hides, &draws].map(|studio| studio.frame(&request));
        same(&found.bytes, &all.bytes, &format!("{width} × {height}"));
        let [tested, of] = [&found, &all].map(|frame| frame.receipt.samples.tested.unwrap());
        assert_eq!(3 * tested < 2 * of, asks, "{width} × {height}: {tested} of {of}");
        assert!(asks || tested == of, "{width} × {height}: {tested} of {of}");
    }
}
