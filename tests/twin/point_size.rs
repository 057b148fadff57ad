//! Points of a size: discs that face the image plane.

use pointillist::math::View;
use pointillist::oracle::{self, OracleScene};
use pointillist::plan::{
    Edl, ErrorMode, Lod, MaxError, Pass, PointSize, PointSizePx, Reconstruct, Settings,
};
use serde_json::json;

use super::files::Shape;
use super::orthographic;
use super::splats::{ball, case};
use super::stage::{Case, Frames, look};

fn sized(px: f32, size: f32) -> Settings {
    Settings {
        reconstruct: Reconstruct::Points,
        edl: Edl::Off,
        point_size_px: PointSizePx::new(px).unwrap(),
        point_size: PointSize::new(size).unwrap(),
        ..Settings::default()
    }
}

/// Draws with every engine, and compares with the oracle. Where f32 decides about a disc's edge, pixels may differ.
fn check(case: &Case, view: &View, settings: Settings) -> Frames {
    let [wide, narrow, rasterising] = case.each_with(view, settings);
    assert!(wide.same_pixels(&narrow), "{}: the 32-bit path differs", case.id);
    assert!(wide.same_pixels(&rasterising), "{}: occlusion culling takes pixels away", case.id);
    let scene = OracleScene { discs: settings.discs(), ..case.reference.scene() };
    assert!(scene.discs.is_some());
    let twin = oracle::render(&scene, view, 1);
    let colors = twin.to_rgba8();
    let pixels = wide.id.len();
    let near = |a: f64, b: f64| a == b || (a - b).abs() <= 1e-4 * a.abs();
    let is_same = |(i, color): (usize, &[u8; 4])| {
        let is_like = |(a, b): (&u8, &u8)| a.abs_diff(*b) <= 2;
        wide.id[i] == twin.id[i]
            && near(f64::from(wide.depth[i]), twin.depth[i])
            && wide.color[i].iter().zip(color).all(is_like)
    };
    let differ = colors.iter().enumerate().filter(|pixel| !is_same(*pixel)).count();
    let covered = wide.id.iter().filter(|&&id| id != 0).count();
    println!("{} {:?}: {differ} of {pixels} differ, {covered} covered", case.id, settings.discs());
    assert!(covered > 100 && differ * 500 <= pixels, "{}: {differ} of {pixels}", case.id);
    assert!(wide.ran(Pass::ProjectSplats) && !wide.ran(Pass::ProjectSamples));
    assert!(wide.receipt.settings.splats.is_none(), "settings of splats in a frame of points");
    wide
}

#[test]
fn round_points_are_the_oracles() {
    let lights = json!({ "lights": [{ "kind": "sun", "direction": [1, -1, -0.5] }] });
    for (name, rest) in [("discs", json!({})), ("discs-lit", lights)] {
        let cloud = case(name, &ball(900, 41), rest);
        let far = look([0.4, 1.0, 3.0], [0.0; 3], 45.0);
        for settings in [sized(1.5, 0.0), sized(6.0, 0.0), sized(40.0, 0.0), sized(1.0, 0.08)] {
            check(&cloud, &far, settings);
        }
        let flat = orthographic::look([0.4, 1.0, 3.0], [0.0; 3], 2.4);
        check(&cloud, &flat, sized(5.0, 0.0));
        check(&cloud, &flat, sized(1.0, 0.08));
        // Inside the ball, where near points are large and those behind the eye are not drawn.
        check(&cloud, &look([0.2, 0.1, 0.8], [0.0; 3], 70.0), sized(3.0, 0.1));
    }
}

#[test]
fn round_points_keep_their_size_in_scaled_instances_and_without_normals() {
    let scene = json!({
        "assets": { "c": { "file": "c.ply" } },
        "nodes": [
            { "asset": "c", "scale": [1, 0.4, 1.3], "rotate": [20, 30, 5] },
            { "asset": "c", "matrix": [0.1, 0, 0, 0, 0, 0.1, 0, 0, 0, 0, -0.1, 0, 1.1, 0.3, 0, 1] }
        ]
    });
    let cloud = ball(500, 42).without_normals();
    let case = Case::new("discs-scaled", &[("c.ply", cloud.ply())], &scene);
    check(&case, &look([0.4, 1.0, 3.0], [0.0; 3], 45.0), sized(1.0, 0.05));
}

/// Centres beside the image, discs that reach into it.
#[test]
fn round_points_reach_into_the_image() {
    let mut cloud = Shape::cloud(4000, [-1.0; 3], [1.0; 3], 43).without_normals();
    cloud.positions.retain(|p| p.x.abs().max(p.y.abs()) > 0.55);
    cloud.colors.truncate(cloud.positions.len());
    let case = case("discs-beside", &cloud, json!({}));
    let view = look([0.0, 0.0, 3.0], [0.0; 3], 16.0);
    check(&case, &view, sized(50.0, 0.0));
    check(&case, &view, sized(1.0, 0.3));
}

/// Nodes of point trees: what is drawn of them covers what all samples cover, but for the accepted error.
#[test]
fn round_points_of_trees_cover_what_the_samples_cover() {
    let case = case("discs-tree", &ball(20_000, 44), json!({}));
    for (settings, view) in [
        (sized(5.0, 0.0), look([0.4, 1.0, 3.0], [0.0; 3], 45.0)),
        (sized(1.0, 0.06), look([0.4, 1.0, 6.0], [0.0; 3], 45.0)),
        (sized(1.0, 0.2), look([0.0, 0.0, 1.6], [0.0, 0.4, 0.0], 30.0)),
    ] {
        let full = case.draw_with(&view, settings);
        for px in [0.25, 1.0, 2.0] {
            let max_error_px = MaxError::new(px).unwrap();
            let tree = Settings { lod: Lod::Spt, max_error_px, ..settings };
            let tree = Settings { error_mode: ErrorMode::Unified, ..tree };
            let drawn = case.draw_with(&view, tree);
            let count = |frames: &Frames| frames.id.iter().filter(|&&id| id != 0).count();
            let both = full.id.iter().zip(&drawn.id).filter(|(a, b)| (**a != 0) != (**b != 0));
            let differ = both.count();
            println!("{px} px: {differ} of {}", count(&full));
            assert!(differ * 25 <= count(&full), "{px} px: {differ} of {}", count(&full));
        }
    }
}
