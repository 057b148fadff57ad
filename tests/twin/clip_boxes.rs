//! Scenes that are clipped with boxes.

use glam::{DAffine3, DVec3};
use pointillist::accuracy::metrics;
use pointillist::math::View;
use pointillist::oracle::{self, OracleScene};
use pointillist::plan::{
    Edl, Lod, MaxError, Pass, PointSizePx, Reconstruct, Reconstruction, Settings,
};
use pointillist::scene::Filter;
use pointillist::scene::clipping::ClipRegion;
use serde_json::json;

use super::files::Shape;
use super::orthographic;
use super::splats::{ball, case, splats};
use super::stage::{Case, Frames, look};

const CORNER: &str = "*,*,*,0.3,0.2,0.55";
const PARTS: &str = "-2,-2,-2,-0.2,0.4,2;0.1,*,*,*,*,*;outside:-0.4,-0.4,0,0.5,0.3,2";

fn clipped(settings: Settings, boxes: &str) -> Settings {
    Settings { clip_boxes: Some(boxes.parse().unwrap()), edl: Edl::Off, ..settings }
}

fn points() -> Settings {
    Settings { reconstruct: Reconstruct::Points, ..Settings::default() }
}

/// Checks a frame with every engine against the oracle. Where f32 decides about a border, pixels may differ.
fn check(case: &Case, view: &View, settings: Settings) -> Frames {
    let [wide, narrow, rasterising] = case.each_with(view, settings);
    assert!(wide.same_pixels(&narrow), "{}: the 32-bit path differs", case.id);
    assert!(wide.same_pixels(&rasterising), "{}: occlusion culling takes pixels away", case.id);
    let reconstruction = Reconstruction::new(&settings, &case.reference.description().splats);
    let boxes = settings.clip_boxes.unwrap();
    let scene = OracleScene {
        splats: reconstruction.splats().copied(),
        discs: settings.discs(),
        clip: Some(ClipRegion { boxes, box_from_world: DAffine3::IDENTITY }),
        ..case.reference.scene()
    };
    let twin = oracle::render(&scene, view, 1);
    let pixels = wide.id.len();
    let near = |a: f64, b: f64| a == b || (a - b).abs() <= 1e-3 * a.abs();
    let is_same =
        |&i: &usize| wide.id[i] == twin.id[i] && near(f64::from(wide.depth[i]), twin.depth[i]);
    let differ = (0..pixels).filter(|i| !is_same(i)).count();
    let psnr = metrics::psnr(&twin.to_rgba8(), &wide.color).unwrap();
    let open = case.draw_with(view, Settings { clip_boxes: None, ..settings });
    let [covered, before] =
        [&wide, &open].map(|frames| frames.id.iter().filter(|&&id| id != 0).count());
    println!("{} {boxes}: {differ} of {pixels} differ, {psnr} dB, {covered} of {before}", case.id);
    assert!(differ * 500 <= pixels && psnr >= 34.0, "{}: {differ} of {pixels}, {psnr} dB", case.id);
    assert!(covered * 20 > before && !wide.same_pixels(&open), "{}: {covered}", case.id);
    wide
}

#[test]
fn clipped_scenes_are_the_oracles() {
    let lights = json!({ "lights": [{ "kind": "sun", "direction": [1, -1, -0.5] }] });
    let cloud = case("clip", &ball(4000, 61), lights.clone());
    let mesh = case("clip-mesh", &Shape::ball(16, 1.0), lights);
    let view = look([0.4, 1.0, 3.0], [0.0; 3], 45.0);
    let flat = orthographic::look([0.4, 1.0, 3.0], [0.0; 3], 2.4);
    let discs = Settings { point_size_px: PointSizePx::new(7.0).unwrap(), ..points() };
    for boxes in [CORNER, PARTS] {
        for view in [view, flat] {
            for settings in [points(), discs, splats(Filter::Perspective)] {
                check(&cloud, &view, clipped(settings, boxes));
            }
            check(&mesh, &view, clipped(points(), boxes));
        }
    }
    let fuzzy = Settings { reconstruct: Reconstruct::Fuzzy, ..splats(Filter::Perspective) };
    let [[single, ..], [three, ..]] =
        [fuzzy, splats(Filter::Perspective)].map(|way| cloud.each_with(&view, clipped(way, PARTS)));
    assert!(single.ran(Pass::FuzzySplats));
    let psnr = metrics::psnr(&three.color, &single.color).unwrap();
    assert!(psnr >= 30.0, "{psnr} dB");
}

/// Far from the origin, and near a border: surfaces end where the box does, to a thousandth of a pixel.
#[test]
fn borders_are_exact_at_large_coordinates() {
    let scene = json!({
        "assets": { "c": { "file": "c.ply" } },
        "nodes": [{ "asset": "c", "translate": [412_000.0, 5_653_000.0, 110.0] }]
    });
    let shape = Shape::quad(DVec3::new(-0.5, -0.5, 0.0), DVec3::X, DVec3::Y, 1.0);
    let case = Case::new("clip-far", &[("c.ply", shape.ply())], &scene);
    let at = DVec3::new(412_000.0, 5_653_000.0, 110.0);
    let view = orthographic::look((at + DVec3::new(0.0, 0.0, 5.0)).to_array(), at.to_array(), 2.0);
    let settings = clipped(points(), "411999.9,*,*,412000.1005,5653000.25,*");
    let frames = check(&case, &view, settings);
    // Each pixel is shown exactly where its centre lies within the box.
    let size = 2.0 / f64::from(view.height);
    for (index, &id) in frames.id.iter().enumerate() {
        let (x, y) = (index % view.width as usize, index / view.width as usize);
        let across = (x as f64 + 0.5 - f64::from(view.width) / 2.0) * size;
        let up = (f64::from(view.height) / 2.0 - y as f64 - 0.5) * size;
        let inside = (-0.1..=0.1005).contains(&across) && up <= 0.25;
        let is_near = [across + 0.1, across - 0.1005, up - 0.25].iter().any(|d| d.abs() < 1e-5);
        let is_on_square = across.abs().max(up.abs()) < 0.49;
        assert!(!is_on_square || is_near || (id != 0) == inside, "{across} {up}");
    }
}

/// Chunks outside of the boxes are not even looked at.
#[test]
fn what_is_outside_is_culled() {
    let cloud = case("clip-cull", &ball(40_000, 62), json!({}));
    let view = look([0.4, 1.0, 3.0], [0.0; 3], 45.0);
    let open = cloud.draw_with(&view, points());
    let shut = cloud.draw_with(&view, clipped(points(), "0.5,0.5,0.5,2,2,2"));
    let hole = cloud.draw_with(&view, clipped(points(), "outside:*,*,*,*,*,0.9"));
    let tested = |frames: &Frames| frames.receipt.samples.tested.unwrap();
    assert!(tested(&shut) * 3 < tested(&open), "{} of {}", tested(&shut), tested(&open));
    assert!(tested(&hole) * 3 < tested(&open), "{} of {}", tested(&hole), tested(&open));
}

/// Boxes of a node move with it.
#[test]
fn boxes_of_a_node_are_in_its_coordinates() {
    let node = json!([20, 30, 5]);
    let scene = |name: &str, child: serde_json::Value| {
        let scene = json!({ "assets": { "c": { "file": "c.ply" } }, "nodes": [child] });
        Case::new(name, &[("c.ply", ball(4000, 63).ply())], &scene)
    };
    let turned = scene(
        "clip-node",
        json!({ "name": "part", "asset": "c", "rotate": node, "scale": [1, 1, 1], "translate": [0.3, 0.1, 0.2] }),
    );
    let view = look([0.4, 1.0, 3.0], [0.0; 3], 45.0);
    let settings =
        Settings { clip_node: Some("part".parse().unwrap()), ..clipped(points(), CORNER) };
    let frames = turned.draw_with(&view, settings);
    let world_from_node = turned.reference.description().nodes[0].parent_from_node;
    let boxes = settings.clip_boxes.unwrap();
    let region = ClipRegion { boxes, box_from_world: world_from_node.inverse() };
    let scene = OracleScene { clip: Some(region), ..turned.reference.scene() };
    let twin = oracle::render(&scene, &view, 1);
    let differ = frames.id.iter().zip(&twin.id).filter(|(a, b)| a != b).count();
    assert!(differ * 500 <= twin.id.len(), "{differ}");
    let world = turned.draw_with(&view, clipped(points(), CORNER));
    assert!(!frames.same_pixels(&world));
}

/// Point trees under boxes cover what all samples cover, but for the accepted error.
#[test]
fn trees_are_clipped_as_samples_are() {
    let cloud = case("clip-tree", &ball(20_000, 64), json!({}));
    let mesh = case("clip-tree-mesh", &Shape::ball(64, 1.0), json!({}));
    let view = look([0.4, 1.0, 3.0], [0.0; 3], 45.0);
    for (case, settings) in
        [(&cloud, splats(Filter::Perspective)), (&mesh, splats(Filter::Perspective))]
    {
        let full = case.draw_with(&view, clipped(settings, CORNER));
        let tree =
            Settings { lod: Lod::Spt, max_error_px: MaxError::new(1.0).unwrap(), ..settings };
        let drawn = case.draw_with(&view, clipped(tree, CORNER));
        let count = |frames: &Frames| frames.id.iter().filter(|&&id| id != 0).count();
        let both = full.id.iter().zip(&drawn.id).filter(|(a, b)| (**a != 0) != (**b != 0));
        let differ = both.count();
        println!("{}: {differ} of {}", case.id, count(&full));
        assert!(differ * 20 <= count(&full), "{}: {differ} of {}", case.id, count(&full));
    }
}
