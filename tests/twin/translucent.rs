//! Translucent surfaces, points and lines, in the order of their depths.

use glam::{DVec3, Vec3};
use pointillist::accuracy::metrics;
use pointillist::math::View;
use pointillist::oracle::{self, OracleScene};
use pointillist::plan::{Antialias, Edl, Lod, Pass, Reconstruct, Settings, Shadows};
use pointillist::scene::Filter;
use serde_json::{Value, json};

use super::files::{Glb, Shape, picture};
use super::lines;
use super::splats;
use super::stage::{Case, Frames, look};
use super::verdict::Tolerance;

/// A material of one colour and alpha; from both sides, so that whatever is nearest shows first.
fn glass([r, g, b, alpha]: [f64; 4]) -> Value {
    json!({ "alphaMode": "BLEND", "doubleSided": true,
        "pbrMetallicRoughness": { "baseColorFactor": [r, g, b, alpha] } })
}

fn solid([r, g, b]: [f64; 3]) -> Value {
    json!({ "doubleSided": true, "pbrMetallicRoughness": { "baseColorFactor": [r, g, b, 1] } })
}

/// A scene of shapes with their materials, in the order of the list.
fn case(name: &str, parts: &[(Shape, Value)]) -> Case {
    let mut glb = Glb::new();
    for (shape, material) in parts {
        let material = glb.material(material.clone());
        let mesh = glb.mesh(shape, Some(material));
        glb.node(mesh, json!({}));
    }
    let scene = json!({ "assets": { "m": { "file": "m.glb" } }, "nodes": [{ "asset": "m" }] });
    Case::new(name, &[("m.glb", glb.finish())], &scene)
}

/// A pane of width and height 2 around a point, turned about the y axis.
fn pane(centre: DVec3, degrees: f64) -> Shape {
    let (sin, cos) = degrees.to_radians().sin_cos();
    let (u, v) = (DVec3::new(2.0 * cos, 0.0, -2.0 * sin), DVec3::Y * 2.0);
    Shape::quad(centre - 0.5 * (u + v), u, v, 1.0)
}

fn view() -> View {
    look([0.4, 0.3, 4.0], [0.0; 3], 45.0)
}

/// No order of whole panes is right for panes that cross; each pixel has its own.
#[test]
fn panes_that_cross() {
    let panes =
        [(20.0, [0.9, 0.1, 0.1, 0.5]), (80.0, [0.1, 0.8, 0.2, 0.4]), (140.0, [0.2, 0.2, 0.9, 0.7])];
    let ball = (Shape::ball(24, 0.5), solid([0.8, 0.8, 0.6]));
    let mut parts: Vec<(Shape, Value)> =
        panes.map(|(degrees, color)| (pane(DVec3::ZERO, degrees), glass(color))).into();
    parts.insert(1, ball);
    let case = case("panes", &parts);
    let frames = case.check(&view(), &Tolerance::default());
    assert!(frames.ran(Pass::CompositeLayers));
    // The order of the parts in the file changes no more than roundings.
    parts.reverse();
    let reversed = self::case("panes-reversed", &parts).check(&view(), &Tolerance::default());
    let far = frames
        .color
        .iter()
        .zip(&reversed.color)
        .filter(|(a, b)| a.iter().zip(*b).any(|(a, b)| a.abs_diff(*b) > 1));
    assert_eq!(far.count(), 0);
}

/// Small triangles, which single threads draw: balls within a ball, beside and in something opaque.
#[test]
fn balls_within_balls() {
    let parts = [
        (Shape::ball(40, 1.2), glass([0.7, 0.9, 1.0, 0.3])),
        (Shape::ball(30, 0.8), glass([1.0, 0.6, 0.2, 0.5])),
        (Shape::ball(20, 0.5).moved(DVec3::new(0.5, 0.2, 0.1)), solid([0.3, 0.6, 0.2])),
    ];
    let case = case("balls", &parts);
    case.check(&view(), &Tolerance::default());
    // From within the outermost ball, which then crosses the camera plane.
    case.check(&look([0.1, 0.1, 1.0], [0.2, 0.0, 0.0], 70.0), &Tolerance::default());
}

/// Alpha of texels and of materials, multiplied.
#[test]
fn textures_with_alpha() {
    let png = picture(16, 16, |x, y| {
        [
            (x * 16) as u8,
            120,
            (y * 16) as u8,
            if (x / 4 + y / 4) % 2 == 0 { 0 } else { (x * 17) as u8 },
        ]
    });
    let mut glb = Glb::new();
    let texture = glb.texture(&png, json!({ "magFilter": 9729 }));
    let mut material = glass([1.0, 0.9, 0.8, 0.8]);
    material["pbrMetallicRoughness"]["baseColorTexture"] = json!({ "index": texture });
    let material = glb.material(material);
    for (z, degrees) in [(0.0, 15.0), (-0.6, -30.0)] {
        let mesh = glb.mesh(&pane(DVec3::Z * z, degrees), Some(material));
        glb.node(mesh, json!({}));
    }
    let wall = glb.material(solid([0.2, 0.3, 0.5]));
    let wall = glb.mesh(&pane(DVec3::new(0.7, 0.0, -1.5), 0.0), Some(wall));
    glb.node(wall, json!({}));
    let scene = json!({ "assets": { "m": { "file": "m.glb" } }, "nodes": [{ "asset": "m" }] });
    let case = Case::new("translucent-texture", &[("m.glb", glb.finish())], &scene);
    case.check(&view(), &Tolerance::default());
}

/// Alpha of vertices, in files without materials.
#[test]
fn vertex_colors_with_alpha() {
    let mut shape = Shape::ball(24, 1.0);
    let colors = shape.positions.iter().map(|p| {
        let alpha = ((p.y + 1.0) * 127.5).round() as u8;
        [200, 90, ((p.x + 1.0) * 100.0) as u8, alpha]
    });
    shape.colors = colors.collect();
    let scene = json!({ "assets": { "m": { "file": "m.ply" }, "b": { "file": "b.ply" } },
        "nodes": [{ "asset": "m" }, { "asset": "b", "scale": 0.5, "translate": [0.4, 0, -0.2] }] });
    let files = [("m.ply", shape.ply()), ("b.ply", Shape::ball(12, 1.0).ply())];
    let frames = Case::new("vertex-alpha", &files, &scene).check(&view(), &Tolerance::default());
    assert!(frames.ran(Pass::CompositeLayers));
}

/// Nodes with translucent colours beside opaque copies of one asset, which is a cut-out or plain.
#[test]
fn nodes_with_translucent_colors() {
    let png = picture(8, 8, |x, y| [200, 180, 90, if (x + y) % 3 == 0 { 0 } else { 255 }]);
    let mut glb = Glb::new();
    let texture = glb.texture(&png, json!({}));
    let mut leaf = solid([0.9, 0.9, 0.9]);
    leaf["alphaMode"] = json!("MASK");
    leaf["alphaCutoff"] = json!(0.5);
    leaf["pbrMetallicRoughness"]["baseColorTexture"] = json!({ "index": texture });
    let leaf = glb.material(leaf);
    let mesh = glb.mesh(&pane(DVec3::ZERO, 20.0), Some(leaf));
    glb.node(mesh, json!({}));
    let scene = json!({
        "assets": { "leaf": { "file": "leaf.glb" }, "ball": { "file": "ball.ply" } },
        "materials": {
            "glass": { "color": "#4080ff80" }, "mist": { "color": "#ffffff60" }, "gone": { "color": "#ff000000" }
        },
        "nodes": [
            { "asset": "ball", "material": "glass" },
            { "asset": "ball", "scale": 0.5, "translate": [0.2, 0.1, 0.0] },
            { "asset": "ball", "scale": 0.4, "translate": [-0.9, 0.3, 0.4] },
            { "asset": "ball", "scale": 1.6, "material": "gone" },
            { "asset": "leaf", "material": "mist", "translate": [0.2, 0.0, 1.1] },
            { "asset": "leaf", "translate": [0.0, 0.0, -1.2] },
        ]
    });
    let files = [("leaf.glb", glb.finish()), ("ball.ply", Shape::ball(40, 0.9).ply())];
    let case = Case::new("node-alpha", &files, &scene);
    let frames = case.check(&view(), &Tolerance::default());
    assert!(frames.ran(Pass::CompositeLayers) && frames.ran(Pass::ResolveTriangles));
    assert!(frames.receipt.translucent.unwrap().deepest >= 2);
    // The alpha of the node's colour is below the cut-off of the leaf, which is there nevertheless.
    let leaf = frames.id.iter().filter(|&&id| id == 5).count();
    assert!(leaf > 3000, "{leaf} pixels of the translucent leaf");
    // Nodes without alpha are in no output.
    assert!(!frames.id.contains(&4));
    // Trees have opaque samples, so all outputs have full detail.
    let tree = Settings { lod: Lod::Spt, ..Settings::drawn_as(Reconstruct::Points) };
    let tree = case.draw_wide(&view(), tree);
    assert!(tree.receipt.settings.full_because.is_some() && tree.same_pixels(&frames));
}

/// Surfaces at one place are as many layers as there are, in the order of their numbers.
#[test]
fn panes_at_one_place() {
    let colors = [[1.0, 0.0, 0.0, 0.5], [0.0, 1.0, 0.0, 0.5], [0.0, 0.0, 1.0, 0.5]];
    let parts: Vec<(Shape, Value)> =
        colors.map(|color| (pane(DVec3::ZERO, 0.0), glass(color))).into();
    let case = case("same-place", &parts);
    let first = case.draw(&view());
    assert!(first.same_pixels(&case.draw(&view())));
    assert_eq!(first.receipt.translucent.map(|drawn| drawn.deepest), Some(3));
    case.check(&view(), &Tolerance::default());
}

/// Eight layers are kept. Further ones are left out, and the receipt says where that may be.
#[test]
fn more_layers_than_are_kept() {
    let stack = |count: u32, alpha: f64| -> Vec<(Shape, Value)> {
        let pane = |i| {
            let [r, g, b] = if i % 2 == 0 { [0.9, 0.2, 0.1] } else { [0.1, 0.3, 0.9] };
            (pane(DVec3::Z * -0.2 * f64::from(i), 0.0), glass([r, g, b, alpha]))
        };
        (0..count).map(pane).collect()
    };
    let seven = case("seven", &stack(7, 0.2)).check(&view(), &Tolerance::default());
    let drawn = seven.receipt.translucent.unwrap();
    assert_eq!((drawn.layers, drawn.deepest, drawn.pixels_of_all_layers), (8, 7, 0));
    assert_eq!(drawn.most_left_out, 0.0);
    let few = case("eight", &stack(8, 0.2)).check(&view(), &Tolerance::default());
    let mut parts = stack(12, 0.2);
    let many = case("twelve", &parts).draw(&view());
    let drawn = many.receipt.translucent.unwrap();
    assert!(drawn.deepest == 8 && drawn.pixels_of_all_layers > 1000, "{drawn:?}");
    // Each of the eight panes lets 0.8 pass.
    assert!((drawn.most_left_out - 0.8f32.powi(8)).abs() < 1e-3, "{drawn:?}");
    // The eight nearest are kept, whichever triangles came first.
    parts.reverse();
    let reversed = case("twelve-reversed", &parts).draw(&view());
    assert_eq!(reversed.color, many.color);
    let middle = |frames: &Frames| -> Vec<[u8; 4]> {
        let at = |i: usize| frames.color[(50 + i / 20) * frames.width as usize + 70 + i % 20];
        (0..400).map(at).collect()
    };
    assert_eq!(middle(&many), middle(&few));
    // Nothing shows through nearly opaque panes, so nothing is missed.
    let dense = case("dense", &stack(12, 0.9)).check(&view(), &Tolerance::default());
    assert_eq!(dense.receipt.translucent.unwrap().pixels_of_all_layers, 0);
}

/// Glass that lets one channel pass is as clear as that channel: the mean of all three is below what counts here.
#[test]
fn glass_of_one_channel_counts_by_that_channel() {
    let blue = json!({ "doubleSided": true,
        "pbrMetallicRoughness": { "baseColorFactor": [0, 0, 0.5, 1], "metallicFactor": 0 },
        "extensions": { "KHR_materials_transmission": { "transmissionFactor": 1 } } });
    let parts: Vec<(Shape, Value)> =
        (0..12).map(|i| (pane(DVec3::Z * -0.2 * f64::from(i), 0.0), blue.clone())).collect();
    let frames = case("blue", &parts).draw(&view());
    let drawn = frames.receipt.translucent.unwrap();
    assert!(drawn.pixels_of_all_layers > 1000, "{drawn:?}");
    // Each of the eight panes reflects 4 % of the light and lets half of the blue in the rest pass, and nothing else.
    assert!((drawn.most_left_out - (0.96 * 0.5f32).powi(8)).abs() < 1e-4, "{drawn:?}");
}

/// Surfaces whose alpha is 0 are not drawn, and take no layer.
#[test]
fn clear_shells_hide_nothing() {
    let shell = |i: u32| (pane(DVec3::Z * 0.1 * f64::from(i), 0.0), glass([0.5, 0.5, 0.5, 0.0]));
    let mut parts: Vec<(Shape, Value)> = (1..12).map(shell).collect();
    parts.push((pane(DVec3::ZERO, 0.0), glass([0.9, 0.1, 0.1, 0.5])));
    let frames = case("clear", &parts).check(&view(), &Tolerance::default());
    assert_eq!(frames.receipt.translucent.unwrap().deepest, 1);
}

/// Glass a little behind a wall of splats is hidden, with eye-dome lighting and without; before it, it shows.
#[test]
fn glass_among_splats() {
    let mut wall = Shape::default();
    for i in 0..3600 {
        let (x, y) = (f64::from(i % 60) / 30.0 - 1.0, f64::from(i / 60) / 30.0 - 1.0);
        wall.positions.push(DVec3::new(x, y, 0.0));
        wall.normals.push(Vec3::Z);
        wall.colors.push([120, 140, 90, 255]);
    }
    let mut glb = Glb::new();
    let material = glb.material(glass([0.9, 0.1, 0.2, 0.5]));
    for (x, z) in [(-0.6, -0.02), (0.6, 0.02)] {
        let half = Shape::quad(DVec3::new(x - 0.4, -0.8, z), DVec3::X * 0.8, DVec3::Y * 1.6, 1.0);
        let mesh = glb.mesh(&half, Some(material));
        glb.node(mesh, json!({}));
    }
    let scene = json!({ "assets": { "m": { "file": "m.glb" }, "w": { "file": "w.ply" } },
        "nodes": [{ "asset": "m" }, { "asset": "w" }] });
    let files = [("m.glb", glb.finish()), ("w.ply", wall.ply())];
    let case = Case::new("glass-among-splats", &files, &scene);
    let view = look([0.0, 0.0, 3.0], [0.0; 3], 45.0);
    for edl in [Edl::Off, Edl::On] {
        let settings = Settings { edl, ..Settings::drawn_as(Reconstruct::Splats) };
        let frames = case.draw_with(&view, settings);
        let red = |x: usize| {
            let [r, g, ..] = frames.color[60 * frames.width as usize + x];
            r > g
        };
        assert!(!red(50) && red(110), "{edl:?}");
    }
    let settings = Settings::drawn_as(Reconstruct::Splats);
    splats::check(&case, &view, settings, settings, 40.0);
}

/// Points of every alpha in and about two panes that cross and something opaque.
fn mist(name: &str, count: usize) -> Case {
    let mut glb = Glb::new();
    let parts = [
        (pane(DVec3::ZERO, 25.0), glass([0.9, 0.2, 0.1, 0.4])),
        (pane(DVec3::ZERO, 115.0), glass([0.1, 0.3, 0.9, 0.6])),
        (Shape::ball(20, 0.4), solid([0.7, 0.7, 0.5])),
    ];
    for (shape, material) in parts {
        let material = glb.material(material);
        let mesh = glb.mesh(&shape, Some(material));
        glb.node(mesh, json!({}));
    }
    let mut cloud = Shape::cloud(count, [-0.9; 3], [0.9; 3], 17).without_normals();
    let alphas = [255, 128, 40, 200, 0].into_iter().cycle();
    cloud.colors.iter_mut().zip(alphas).for_each(|(color, alpha)| color[3] = alpha);
    // Splats as large as their spacing would be more layers than are kept.
    cloud.fields = vec![("radius", "float", vec![0.03; count])];
    let scene = json!({ "assets": { "m": { "file": "m.glb" }, "c": { "file": "c.ply" } },
        "nodes": [{ "asset": "m" }, { "asset": "c" }] });
    Case::new(name, &[("m.glb", glb.finish()), ("c.ply", cloud.ply())], &scene)
}

/// Points among glass: each is a layer of its pixel. Those without alpha are in no output.
#[test]
fn points_among_panes() {
    let case = mist("mist", 4000);
    let frames = case.check(&view(), &Tolerance::default());
    assert!(frames.ran(Pass::ProjectSamplesLayers) && frames.ran(Pass::ResolveSamplesLayers));
    assert!(frames.ran(Pass::ProjectSamples) && frames.ran(Pass::ResolveTrianglesLayers));
    let drawn = frames.receipt.translucent.unwrap();
    assert!(drawn.deepest >= 3 && drawn.deepest < 8, "{drawn:?}");
    assert!(frames.receipt.samples.drawn.unwrap() > 1000);
    // Point trees have opaque nodes.
    let tree = Settings { lod: Lod::Spt, ..Settings::drawn_as(Reconstruct::Points) };
    let tree = case.draw_wide(&view(), tree);
    assert!(tree.receipt.settings.full_because.is_some() && tree.same_pixels(&frames));
}

/// Discs and the disks of splats are flat: each pixel that they cover has their alpha.
#[test]
fn disks_among_panes() {
    let case = mist("mist-disks", 500);
    let sized = Settings { point_size_px: 5.0.into(), ..Settings::drawn_as(Reconstruct::Points) };
    for settings in [sized, splats::splats(Filter::Perspective)] {
        let frames = case.draw_with(&view(), Settings { shadows: Shadows::Off, ..settings });
        let twin = if settings.has_point_size() {
            let scene = OracleScene { discs: settings.discs(), ..case.reference.scene() };
            oracle::render(&scene, &view(), 1)
        } else {
            splats::oracle(&case, &view(), settings)
        };
        let psnr = metrics::psnr(&twin.to_rgba8(), &frames.color).unwrap();
        println!("{psnr:.1} dB, {:?}", frames.receipt.translucent);
        if psnr < 45.0 {
            splats::save_both(&case, &view(), twin.to_rgba8(), frames.color.clone());
            panic!("{psnr:.1} dB: {settings:?}");
        }
        assert!(frames.ran(Pass::ProjectSplatsLayers) && frames.ran(Pass::WalkSplatsLayers));
        assert!(!frames.ran(Pass::ProjectSamplesLayers));
    }
}

/// Tubes and ribbons among panes. Where segments of a tube meet, they lie over each other and count once; where strands cross, each counts.
#[test]
fn lines_among_panes() {
    let strands = lines::scattered(10, [0.05, 0.12], 5);
    let normals = vec![DVec3::Z; strands.iter().flatten().count()];
    let mut glb = Glb::new();
    let material = glb.material(glass([0.9, 0.2, 0.1, 0.4]));
    let mesh = glb.mesh(&pane(DVec3::ZERO, 25.0), Some(material));
    glb.node(mesh, json!({}));
    let glb = glb.finish();
    for (name, plain) in [
        ("smoke-tubes", lines::vtk(&strands)),
        ("smoke-ribbons", lines::ribbons(&strands, &normals)),
    ] {
        let file = lines::with_alpha(plain, 0.5);
        let scene = json!({ "assets": { "m": { "file": "m.glb" }, "l": { "file": "l.vtk" } },
            "nodes": [{ "asset": "m" }, { "asset": "l" }] });
        let case = Case::new(name, &[("m.glb", glb.clone()), ("l.vtk", file)], &scene);
        let points = Settings::drawn_as(Reconstruct::Points);
        let frames = case.draw_with(&view(), Settings { shadows: Shadows::Off, ..points });
        let exact = case.reference.frame(&view(), 1).to_rgba8();
        let psnr = metrics::psnr(&exact, &frames.color).unwrap();
        println!("{name}: {psnr:.1} dB, {:?}", frames.receipt.translucent);
        if psnr < 45.0 {
            splats::save_both(&case, &view(), exact, frames.color.clone());
            panic!("{name}: {psnr:.1} dB");
        }
        assert!(frames.ran(Pass::ProjectLinesLayers) && frames.ran(Pass::ResolveLinesLayers));
        let tree = case.draw_wide(&view(), Settings { lod: Lod::Spt, ..points });
        assert!(tree.receipt.settings.full_because.is_some(), "levels of detail lack alpha");
    }
}

/// Nodes of opaque points and lines with translucent colours, beside opaque nodes of the same files.
#[test]
fn nodes_of_points_and_lines_with_translucent_colors() {
    let cloud = Shape::cloud(1500, [-0.7; 3], [0.7; 3], 23).without_normals();
    let tubes = lines::vtk(&lines::scattered(6, [0.05, 0.12], 8));
    let scene = json!({
        "assets": { "c": { "file": "c.ply" }, "l": { "file": "l.vtk" } },
        "materials": { "glass": { "color": "#80c0ff80" }, "gone": { "color": "#ff000000" } },
        "nodes": [
            { "asset": "c", "material": "glass" },
            { "asset": "c", "translate": [0.5, 0.2, -0.4] },
            { "asset": "l", "material": "glass", "scale": 0.7 },
            { "asset": "l", "translate": [-0.4, 0.1, -0.3], "scale": 0.6 },
            { "asset": "c", "material": "gone", "scale": 1.2 },
            { "asset": "l", "material": "gone" },
        ]
    });
    let case = Case::new("node-alpha-points", &[("c.ply", cloud.ply()), ("l.vtk", tubes)], &scene);
    let points = Settings::drawn_as(Reconstruct::Points);
    let frames = case.draw_with(&view(), Settings { shadows: Shadows::Off, ..points });
    let exact = case.reference.frame(&view(), 1);
    let psnr = metrics::psnr(&exact.to_rgba8(), &frames.color).unwrap();
    println!("{psnr:.1} dB, {:?}", frames.receipt.translucent);
    if psnr < 45.0 {
        splats::save_both(&case, &view(), exact.to_rgba8(), frames.color.clone());
        panic!("{psnr:.1} dB");
    }
    for pass in [Pass::ResolveSamples, Pass::ResolveLines, Pass::ResolveSamplesLayers] {
        assert!(frames.ran(pass), "{pass:?}");
    }
    assert!(frames.ran(Pass::ResolveLinesLayers) && !frames.ran(Pass::ResolveTrianglesLayers));
    // Nodes without alpha are in no output.
    assert!([1, 2, 3, 4].iter().all(|id| frames.id.contains(id)));
    assert!([5, 6].iter().all(|id| !frames.id.contains(id) && !exact.id.contains(id)));
}

/// The frame of wide tubes of these strands before white; each lets half of the light pass.
fn half_tubes(name: &str, strands: &[Vec<DVec3>]) -> Frames {
    let strands: Vec<Vec<_>> =
        strands.iter().map(|strand| strand.iter().map(|&at| (at, 0.2, [0; 3])).collect()).collect();
    let file = lines::with_alpha(lines::vtk(&strands), 0.5);
    let scene = json!({ "assets": { "l": { "file": "l.vtk" } }, "nodes": [{ "asset": "l" }],
        "lights": [], "background": "#ffffff" });
    let case = Case::new(name, &[("l.vtk", file)], &scene);
    let points = Settings::drawn_as(Reconstruct::Points);
    case.draw_with(&look([0.0, 0.0, 4.0], [0.0; 3], 45.0), points)
}

/// Counts the pixels that are not white, those that half of the white reaches, and those that a quarter of it reaches.
fn hidden_pixels(name: &str, frames: &Frames) -> [usize; 3] {
    let count = |is_counted: &dyn Fn(u8) -> bool| {
        frames.color.iter().filter(|pixel| is_counted(pixel[0])).count()
    };
    let byte =
        |linear: f64| (pointillist::scene::color::srgb_from_linear(linear) * 255.0).round() as u8;
    let [half, quarter] = [byte(0.5), byte(0.25)];
    let found = [
        count(&|red| red < 255),
        count(&|red| red.abs_diff(half) <= 1),
        count(&|red| red.abs_diff(quarter) <= 1),
    ];
    println!("{name}: {found:?}");
    found
}

/// A tube hides once in every pixel, however short its segments are.
#[test]
fn tubes_of_short_segments_hide_once() {
    for (name, step, bend) in [("long", 0.4, 0.0), ("short", 0.06, 0.0), ("wave", 0.06, 0.4)] {
        let count = (2.4 / step) as usize;
        let along = |i: usize| -1.2 + i as f64 * step;
        let strand = (0..=count).map(|i| DVec3::new(along(i), bend * (2.0 * along(i)).sin(), 0.0));
        let frames = half_tubes(&format!("once-{name}"), &[strand.collect()]);
        let [crossed, once, _] = hidden_pixels(name, &frames);
        assert!(crossed > 1000 && crossed - once <= crossed / 200, "{name}: {once} of {crossed}");
    }
}

/// The two ends of a ring of 84 segments hide once where they meet.
#[test]
fn rings_hide_once_where_they_close() {
    let place = |i: usize| {
        let (sin, cos) = (std::f64::consts::TAU * (i % 84) as f64 / 84.0).sin_cos();
        DVec3::new(0.8 * cos, 0.8 * sin, 0.0)
    };
    let frames = half_tubes("once-ring", &[(0..=84).map(place).collect()]);
    let [crossed, once, _] = hidden_pixels("ring", &frames);
    assert!(crossed > 1000 && crossed - once <= crossed / 200, "{once} of {crossed}");
}

/// A strand that begins or ends on another one hides once with it, though many vertices lie between them in the file.
#[test]
fn branches_hide_once_where_they_begin() {
    let [left, right] = [DVec3::X * -1.2, DVec3::X * 1.2];
    let far: Vec<DVec3> = (0..80).map(|i| DVec3::new(0.02 * f64::from(i), -50.0, 0.0)).collect();
    let strands = [
        vec![left, DVec3::ZERO, right],
        far,
        vec![DVec3::ZERO, DVec3::Y],
        vec![DVec3::NEG_Y, DVec3::ZERO],
    ];
    let [crossed, once, _] = hidden_pixels("fork", &half_tubes("once-fork", &strands));
    assert!(crossed > 1000 && crossed - once <= crossed / 200, "{once} of {crossed}");
}

/// Strands that cross hide twice where they do, also if they are neighbours in the file.
#[test]
fn strands_that_cross_hide_twice() {
    let strands = [vec![DVec3::NEG_X, DVec3::X], vec![DVec3::NEG_Y, DVec3::Y]];
    let [crossed, once, twice] = hidden_pixels("cross", &half_tubes("twice-cross", &strands));
    assert!(twice > 150 && crossed - once - twice <= crossed / 200, "{twice} of {crossed}");
}

/// A line far thinner than a pixel dims what is behind it by its alpha times its width, in every pixel that it crosses.
#[test]
fn thin_lines_cover_by_their_width() {
    let place = |x: f64| (DVec3::new(x, 0.013, 0.0), 0.004, [0; 3]);
    let file = lines::with_alpha(lines::vtk(&[vec![place(-1.0), place(1.0)]]), 0.5);
    let scene = json!({ "assets": { "l": { "file": "l.vtk" } }, "nodes": [{ "asset": "l" }],
        "lights": [], "background": "#ffffff" });
    let case = Case::new("thin-smoke", &[("l.vtk", file)], &scene);
    let view = look([0.0, 0.0, 4.0], [0.0; 3], 45.0);
    let frames = case.draw_with(&view, Settings::drawn_as(Reconstruct::Points));
    // Its width in pixels: 120 pixels show 2 · 4 · tan(22.5°) units.
    let width_px = 0.008 * 120.0 / (8.0 * 22.5f64.to_radians().tan());
    let expected = pointillist::scene::color::srgb_from_linear(1.0 - 0.5 * width_px) * 255.0;
    for x in [60, 80, 100] {
        let darkest = (0..120).map(|y| frames.color[y * 160 + x][0]).min().unwrap();
        assert!((f64::from(darkest) - expected).abs() < 2.0, "{darkest} at {x}, not {expected}");
    }
}

/// Parts of pixels are composited before they are averaged, as the reference does it.
#[test]
fn antialiasing() {
    let parts = [
        (pane(DVec3::ZERO, 30.0), glass([0.9, 0.3, 0.2, 0.5])),
        (pane(DVec3::ZERO, 120.0), glass([0.2, 0.4, 0.9, 0.5])),
        (Shape::ball(16, 0.4), solid([0.9, 0.9, 0.9])),
    ];
    let case = case("ways", &parts);
    let points = Settings::drawn_as(Reconstruct::Points);
    let smooth = case.draw_with(&view(), Settings { antialias: Antialias::Parts4, ..points });
    let exact = case.reference.frame(&view(), 2).to_rgba8();
    let psnr = metrics::psnr(&exact, &smooth.color).unwrap();
    println!("{psnr:.1} dB");
    assert!(psnr > 45.0, "{psnr}");
}

/// Point trees keep translucent triangles, at any error.
#[test]
fn point_trees_keep_what_shows_through() {
    let parts = [
        (Shape::ball(60, 1.2), glass([0.7, 0.9, 1.0, 0.4])),
        (Shape::ball(60, 0.6), solid([0.9, 0.5, 0.2])),
    ];
    let case = case("glass-tree", &parts);
    let settings =
        Settings { lod: Lod::Spt, reconstruct: Reconstruct::Splats, ..Settings::default() };
    let far = look([4.0, 3.0, 30.0], [0.0; 3], 8.0);
    let full = case.draw_wide(&far, Settings::default());
    let tree = case.draw_wide(&far, settings);
    assert!(tree.ran(Pass::CompositeLayers) && tree.ran(Pass::ProjectSplats));
    let close = full
        .color
        .iter()
        .zip(&tree.color)
        .filter(|(a, b)| a.iter().zip(*b).all(|(a, b)| a.abs_diff(*b) < 24));
    let (close, all) = (close.count(), full.color.len());
    assert!(close * 100 > all * 97, "{close} of {all}");
}

/// Methods that leave no depths are replaced, and the receipt says why.
#[test]
fn methods_without_depths_are_replaced() {
    let mut glb = Glb::new();
    let material = glb.material(glass([0.9, 0.3, 0.2, 0.5]));
    let mesh = glb.mesh(&pane(DVec3::Z * 0.5, 0.0), Some(material));
    glb.node(mesh, json!({}));
    let cloud = Shape::cloud(2000, [-1.0, -1.0, -0.3], [1.0, 1.0, 0.3], 5);
    let scene = json!({
        "assets": { "m": { "file": "m.glb" }, "c": { "file": "c.ply" } },
        "nodes": [{ "asset": "m" }, { "asset": "c" }],
        "lights": [{ "kind": "ambient", "intensity": 0.5 }],
        "ambient_occlusion": { "radius": 0.4 }
    });
    let files = [("m.glb", glb.finish()), ("c.ply", cloud.ply())];
    let case = Case::new("glass-and-points", &files, &scene);
    let splats = "fuzzy and painted splats leave no depths for translucent surfaces";
    for (method, because) in [
        (Reconstruct::Fuzzy, splats),
        (Reconstruct::Painted, splats),
        (Reconstruct::PullPush, "pull-push leaves no depths for translucent surfaces"),
    ] {
        let frames = case.draw_wide(&view(), Settings::drawn_as(method));
        assert_eq!(frames.receipt.settings.instead_because, Some(because), "{method:?}");
        assert!(frames.receipt.translucent.is_some(), "{method:?}");
        // In place of the other two, splats are lit one by one.
        let is_occluded = frames.ran(Pass::AmbientOcclusion);
        assert_eq!(is_occluded, method == Reconstruct::PullPush, "{method:?}");
    }
}
