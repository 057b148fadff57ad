//! Surfaces are closed: nothing behind them shows through.

use glam::DVec3;
use pointillist::engine::{FrameRequest, Pose};
use pointillist::math::Camera;
use pointillist::plan::{ColorBy, Lod, Output, Reconstruct, Settings};
use pointillist::scene::Filter;
use pointillist::scene::random::SplitMix64;
use serde_json::json;

use super::sheets::{Triangulation, ball, crumpled, delaunay, sheet, split};
use super::studio::{Studio, cloud, cloud_scene, front, ids, mesh, spt};

/// Pixels of the background that are not connected with the frame's border.
fn enclosed(is_seen: &[bool], side: usize) -> usize {
    let mut is_outside = is_seen.to_vec();
    let mut open: Vec<usize> =
        (0..side).flat_map(|i| [i, (side - 1) * side + i, i * side, i * side + side - 1]).collect();
    while let Some(at) = open.pop() {
        if std::mem::replace(&mut is_outside[at], true) {
            continue;
        }
        let (x, y) = (at % side, at / side);
        open.extend((x > 0).then(|| at - 1));
        open.extend((x + 1 < side).then_some(at + 1));
        open.extend((y > 0).then(|| at - side));
        open.extend((y + 1 < side).then_some(at + side));
    }
    is_outside.iter().filter(|is_reached| !**is_reached).count()
}

/// Width and height of a frame of [`seen`].
const SIDE: u32 = 120;

/// The pixels that show a scene of one asset, seen along −z from this distance. With `lod=spt` they show its tree, even where full
/// detail would take less time.
fn seen(studio: &Studio, scene: &str, distance: f64, settings: Settings) -> Vec<bool> {
    let color_by = if settings.lod == Lod::Spt { ColorBy::Levels } else { settings.color_by };
    let settings = Settings { color_by, ..settings };
    let camera = Camera::perspective(DVec3::Z * distance, DVec3::ZERO, 40.0);
    let request = FrameRequest {
        pose: Pose::Camera(camera),
        settings,
        output: Output::Id,
        ..front(scene, SIDE, SIDE)
    };
    let is_seen: Vec<bool> = ids(&studio.bytes(&request)).iter().map(|&id| id != 0).collect();
    assert!(is_seen.iter().filter(|&&is_seen| is_seen).count() > 500);
    is_seen
}

/// Holes in a scene of one asset, seen along −z from this distance.
fn holes(studio: &Studio, scene: &str, distance: f64, settings: Settings) -> usize {
    enclosed(&seen(studio, scene, distance, settings), SIDE as usize)
}

fn load_mesh(studio: &Studio, name: &str, (positions, triangles): Triangulation) {
    let file = format!("{name}.ply");
    studio.write(&file, mesh(&positions, &triangles));
    let scene = json!({ "assets": { "g": { "file": file } }, "nodes": [{ "asset": "g" }] });
    studio.load_json(name, &scene);
}

/// Small triangles beside larger ones are drawn, or the samples over them are.
#[test]
fn irregular_meshes_have_no_holes_as_point_trees() {
    let studio = Studio::new();
    let mut numbers = SplitMix64::new(1);
    let mut random = || numbers.unit();
    let even = sheet(90, 0.45, 1.0, &mut random);
    let graded = sheet(90, 0.3, 2.0, &mut random);
    let divided = split(sheet(70, 0.4, 1.0, &mut random), 0.5, &mut random);
    let round = ball(50, 0.4, &mut random);
    // Back faces of solids are not drawn. Samples stand for triangles that face other ways than they do.
    let solid = crumpled(ball(60, 0.4, &mut random), 0.1, &mut random);
    for (name, triangulation) in [
        ("even", even),
        ("graded", graded),
        ("divided", divided),
        ("ball", round),
        ("crumpled", solid),
    ] {
        load_mesh(&studio, name, triangulation);
        for distance in [3.3, 4.0, 4.8, 5.6, 6.6, 8.0] {
            for px in [0.5, 1.0, 2.0, 4.0] {
                let found = holes(&studio, name, distance, spt(px, Reconstruct::Splats));
                assert_eq!(found, 0, "{name} from {distance} with an error of {px} px");
            }
            for px in [0.5, 0.75, 1.0, 2.0, 4.0] {
                let found = holes(&studio, name, distance, spt(px, Reconstruct::Points));
                assert_eq!(found, 0, "points of {name} from {distance} with an error of {px} px");
            }
        }
    }
}

/// The hull of a triangulation of random points consists of needles. Pixels that full detail covers stay covered.
#[test]
fn needles_along_a_border_leave_no_holes() {
    const ROW: u32 = 60;
    let studio = Studio::new();
    let mut numbers = SplitMix64::new(9);
    let mut random = || numbers.unit();
    let mut on_grid = |at: u32| 2.0 * (f64::from(at) + 0.9 * random()) / f64::from(ROW) - 1.0;
    let jittered =
        (0..ROW * ROW).map(|i| DVec3::new(on_grid(i % ROW), on_grid(i / ROW), 0.0)).collect();
    let scattered = (0..12_000).map(|_| {
        let [x, y] = [0; 2].map(|_| numbers.range(-1.0, 1.0));
        DVec3::new(x, y, 0.0)
    });
    for (name, positions) in [("jittered", jittered), ("scattered", scattered.collect())] {
        load_mesh(&studio, name, delaunay(positions));
        for distance in [3.3, 4.0, 4.8, 5.6, 6.6, 8.0] {
            let full = seen(&studio, name, distance, Settings::drawn_as(Reconstruct::Points));
            for px in [0.5, 1.0, 2.0, 4.0, 8.0] {
                for reconstruct in [Reconstruct::Splats, Reconstruct::Points] {
                    let found = seen(&studio, name, distance, spt(px, reconstruct));
                    let open = full.iter().zip(&found).filter(|(full, found)| **full && !**found);
                    let open = open.count();
                    assert_eq!(open, 0, "{name} from {distance}: {reconstruct:?}, {px} px");
                }
            }
        }
    }
}

/// Nodes that stand for samples in several pixels cover all of them.
#[test]
fn points_of_coarse_nodes_leave_no_holes() {
    let studio = Studio::new();
    let mut numbers = SplitMix64::new(2);
    let mut random = || numbers.unit();
    let (positions, _) = sheet(260, 0.45, 1.0, &mut random);
    studio.write("sheet.ply", cloud(positions.into_iter().map(|at| (at, [90, 120, 150]))));
    let scene = json!({ "assets": { "g": { "file": "sheet.ply" } }, "nodes": [{ "asset": "g" }] });
    studio.load_json("sheet", &scene);
    for distance in [3.0, 4.5, 7.0] {
        let full = Settings::drawn_as(Reconstruct::Points);
        assert_eq!(holes(&studio, "sheet", distance, full), 0, "from {distance}");
        for px in [0.7, 1.0, 1.5, 2.0, 4.0, 8.0] {
            let found = holes(&studio, "sheet", distance, spt(px, Reconstruct::Points));
            assert_eq!(found, 0, "from {distance} with an error of {px} px");
        }
    }
}

/// Random samples leave gaps of all sizes. The far side of a ball is red, and nothing of it is seen.
#[test]
fn randomly_sampled_surfaces_hide_what_is_behind_them() {
    const SIDE: u32 = 400;
    let studio = Studio::new();
    for seed in 4..7 {
        let mut numbers = SplitMix64::new(seed);
        let points = (0..100_000).map(|_| {
            let height = numbers.range(-1.0, 1.0);
            let (sin, cos) = numbers.range(0.0, std::f64::consts::TAU).sin_cos();
            let width = (1.0 - height * height).sqrt();
            let color = if height > 0.0 { [0, 255, 0] } else { [255, 0, 0] };
            (DVec3::new(width * cos, width * sin, height), color)
        });
        studio.write("ball.ply", cloud(points));
        studio.load_json("ball", &cloud_scene("ball.ply"));
        for way in [DVec3::Z, DVec3::new(0.3, 0.0, 1.0), DVec3::new(-0.2, -0.3, 1.0)] {
            let camera = Camera::perspective(way.normalize_or(DVec3::Z) * 1.6, DVec3::ZERO, 40.0);
            let settings =
                Settings { filter: Some(Filter::Exact), ..Settings::drawn_as(Reconstruct::Splats) };
            let request =
                FrameRequest { pose: Pose::Camera(camera), settings, ..front("ball", SIDE, SIDE) };
            let bytes = studio.bytes(&request);
            let far = bytes.chunks_exact(4).filter(|pixel| pixel[0] > pixel[1]).count();
            let near = bytes.chunks_exact(4).filter(|pixel| pixel[1] > 100).count();
            println!("seed {seed}, {way}: {far} pixels of {near} show the far side");
            assert!(near > 150_000 && far == 0, "seed {seed}, {way}: {far} pixels of {near}");
        }
        studio.engine.remove("ball").unwrap();
    }
}
