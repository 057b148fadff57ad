//! Trees over instances: an edited scene is drawn like one loaded in its final state, and an edit rebuilds only what it affects.

use std::fmt::Write as _;

use glam::{DAffine3, DVec3};
use pointillist::engine::{FrameRequest, NodePatch, Pose};
use pointillist::math::Camera;
use pointillist::plan::{Lod, MaxError, Output, Reconstruct, Settings};
use pointillist::scene::random::SplitMix64;
use serde_json::{Value, json};

use super::studio::{
    Disk, Studio, covered, disk_sphere, disks, fit, front, mesh, same, sphere, spt,
};

/// Nodes with 40 × 40 instances each, in rows of [`ROW`] nodes.
const NODES: usize = 18;
const ROW: usize = 6;
const SIDE: usize = 40;
const INSTANCES: u64 = (NODES * SIDE * SIDE) as u64;

#[derive(Clone, Copy)]
struct Place {
    at: DVec3,
    visible: bool,
}

fn places() -> Vec<Place> {
    let at = |node: usize| DVec3::new((node % ROW) as f64 * 14.0, 0.0, (node / ROW) as f64 * 14.0);
    (0..NODES).map(|node| Place { at: at(node), visible: true }).collect()
}

fn scene(places: &[Place]) -> Value {
    let nodes: Vec<Value> = places
        .iter()
        .enumerate()
        .map(|(number, place)| {
            json!({
                "name": format!("n{number}"),
                "asset": if number % 2 == 0 { "a" } else { "b" },
                "translate": place.at.to_array(),
                "visible": place.visible,
                "repeat": { "grid": [SIDE, 1, SIDE], "step": [0.3, 0, 0.3] },
            })
        })
        .collect();
    json!({
        "assets": { "a": { "file": "a.ply" }, "b": { "file": "b.ply" } },
        "nodes": nodes,
    })
}

fn studio() -> Studio {
    let studio = Studio::new();
    let ball = |color: [u8; 3]| -> Vec<Disk> { disk_sphere(10, 0.15, |_| color) };
    studio.write("a.ply", disks(&ball([250, 120, 10])));
    studio.write("b.ply", disks(&ball([30, 120, 220])));
    studio
}

/// Frames from near, where many instances are seen one by one, and from afar.
fn looks(studio: &Studio, scene: &str) -> Vec<Vec<u8>> {
    let centre = DVec3::new(35.0, 0.0, 14.0);
    let mut found = Vec::new();
    for (eye, side) in [(DVec3::new(-9.0, 3.0, 8.0), 120), (DVec3::new(30.0, 90.0, 120.0), 100)] {
        for (reconstruct, output) in [
            (Reconstruct::Points, Output::Id),
            (Reconstruct::Splats, Output::Color),
            (Reconstruct::Points, Output::Depth),
        ] {
            let max_error = MaxError::new(2.0).unwrap();
            let settings = Settings {
                lod: Lod::Spt,
                max_error_px: max_error,
                reconstruct,
                ..Settings::default()
            };
            let camera = Camera::perspective(eye, centre, 50.0);
            let request = front(scene, side, side);
            let pose = Pose::Camera(camera);
            found.push(studio.bytes(&FrameRequest { pose, output, settings, ..request }));
        }
    }
    found
}

fn compare(studio: &Studio, places: &[Place], what: &str) {
    studio.load_json("fresh", &scene(places));
    let (edited, fresh) = (looks(studio, "edited"), looks(studio, "fresh"));
    for (number, (edited, fresh)) in edited.iter().zip(&fresh).enumerate() {
        same(edited, fresh, &format!("{what}, look {number}"));
    }
    studio.engine.remove("fresh").unwrap();
}

fn moved(at: DVec3) -> NodePatch {
    NodePatch { world_from_node: Some(DAffine3::from_translation(at)), ..NodePatch::default() }
}

/// Small and large moves, hiding and showing, also several times between two frames.
#[test]
fn edits_in_any_order_end_at_the_scene_as_it_is() {
    let studio = studio();
    let mut places = places();
    studio.load_json("edited", &scene(&places));
    let first = looks(&studio, "edited");
    let mut random = SplitMix64::new(11);
    for round in 0..6 {
        for _ in 0..1 + round % 3 {
            let node = (random.range(0.0, NODES as f64) as usize).min(NODES - 1);
            let patch = if random.chance(0.3) {
                places[node].visible = !places[node].visible;
                NodePatch { visible: Some(places[node].visible), ..NodePatch::default() }
            } else {
                let far = if random.chance(0.5) { 1.0 } else { 40.0 };
                let by = DVec3::new(random.range(-far, far), 0.0, random.range(-far, far));
                places[node].at += by;
                moved(places[node].at)
            };
            studio.engine.patch("edited", &format!("n{node}"), &patch).unwrap();
        }
        compare(&studio, &places, &format!("round {round}"));
    }
    // Return to the initial state.
    for (node, place) in self::places().into_iter().enumerate() {
        let patch = NodePatch { visible: Some(true), ..moved(place.at) };
        studio.engine.patch("edited", &format!("n{node}"), &patch).unwrap();
    }
    assert!(looks(&studio, "edited") == first, "as at first");
}

#[test]
fn an_edit_writes_what_it_moved_and_its_neighbours() {
    let studio = studio();
    let mut places = places();
    studio.load_json("edited", &scene(&places));
    looks(&studio, "edited");
    let before = studio.engine.stats();
    assert!(before.instances_written >= INSTANCES);
    for step in 1..=8 {
        places[0].at.y = 0.1 * f64::from(step);
        studio.engine.patch("edited", "n0", &moved(places[0].at)).unwrap();
        looks(&studio, "edited");
    }
    let after = studio.engine.stats();
    let (written, uploads) =
        (after.instances_written - before.instances_written, after.uploads - before.uploads);
    // A node's 1600 instances are in one or a few blocks of up to 4096. There are seven or more blocks.
    assert!(written >= 8 * 1600, "{written}");
    assert!(written < 8 * INSTANCES / 2, "{written} of {INSTANCES} in eight edits");
    assert!(uploads < 8 * 8, "{uploads} trees");
    compare(&studio, &places, "after eight steps");
    // Hiding the last node changes no other instance's number.
    let before = studio.engine.stats().instances_written;
    let last = NODES - 1;
    places[last].visible = false;
    let hide = NodePatch { visible: Some(false), ..NodePatch::default() };
    studio.engine.patch("edited", &format!("n{last}"), &hide).unwrap();
    compare(&studio, &places, "one hidden");
    let written = studio.engine.stats().instances_written - before;
    // The scene for comparison was written completely.
    assert!(written < INSTANCES + INSTANCES / 2, "{written}");
}

/// Instances of an asset without samples are drawn by themselves, beside the trees.
#[test]
fn a_crowd_with_some_that_are_nowhere() {
    let studio = Studio::new();
    studio.write("ball.ply", sphere(8));
    // A triangle without area has no samples.
    studio.write("none.ply", mesh(&[DVec3::ZERO, DVec3::X, DVec3::X], &[[0, 1, 2]]));
    let scene = |x: f64| {
        json!({
            "assets": { "ball": { "file": "ball.ply" }, "none": { "file": "none.ply" } },
            "nodes": [
                { "asset": "none", "repeat": { "grid": [5, 1, 5], "step": [1, 0, 1] } },
                { "name": "balls", "asset": "ball", "scale": 0.2, "translate": [x, 0, 0],
                  "repeat": { "grid": [6, 1, 6], "step": [1, 0, 1] } },
                { "name": "flat", "asset": "ball", "scale": [0.5, 0.001, 0.5], "translate": [0, 1, 0] },
            ],
        })
    };
    studio.load_json("edited", &scene(0.0));
    studio.load_json("fresh", &scene(0.7));
    let first = looks(&studio, "edited");
    studio
        .engine
        .patch(
            "edited",
            "balls",
            &NodePatch {
                world_from_node: Some(DAffine3::from_scale_rotation_translation(
                    DVec3::splat(0.2),
                    glam::DQuat::IDENTITY,
                    DVec3::new(0.7, 0.0, 0.0),
                )),
                ..NodePatch::default()
            },
        )
        .unwrap();
    let (edited, fresh) = (looks(&studio, "edited"), looks(&studio, "fresh"));
    assert!(edited == fresh && edited != first);
}

/// Panes of glass with a small opaque patch each: where the patches are smaller than the accepted error, the panes stay.
#[test]
fn glass_stays_however_small_what_is_opaque_beside_it() {
    let studio = Studio::new();
    studio.write("pane.mtl", "newmtl pane\nKd 0.8 0.2 0.1\nd 0.5\nnewmtl clay\nKd 0.5 0.4 0.3\n");
    let mut text = "mtllib pane.mtl\nusemtl pane\nv -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nf 1 2 3 4\nusemtl clay\n".to_owned();
    let side = 7;
    for number in 0..side * side {
        let [x, y] = [number % side, number / side].map(|i| f64::from(i) * 0.02);
        writeln!(text, "v {x} {y} 0.01").unwrap();
    }
    for number in (0..side * (side - 1)).filter(|number| number % side != side - 1) {
        let [a, b] = [number + 5, number + 5 + side];
        writeln!(text, "f {a} {} {} {b}", a + 1, b + 1).unwrap();
    }
    studio.write("pane.obj", text);
    studio.load_json(
        "panes",
        &json!({
            "assets": { "pane": { "file": "pane.obj" } },
            "nodes": [{ "asset": "pane", "repeat": { "grid": [5, 5, 1], "step": [2.5, 2.5, 0] } }],
        }),
    );
    let full = fit("panes", 128, Output::Depth);
    let tree = FrameRequest { settings: spt(8.0, Reconstruct::Points), ..full.clone() };
    let [full, tree] = [full, tree].map(|request| covered(&studio.bytes(&request)));
    assert!(full > 2000 && tree * 100 >= full * 95, "{tree} of {full} pixels");
}
