//! Objects smaller than a pixel cover as much of a frame, and are as bright, as in a larger frame.

use std::collections::BTreeSet;

use glam::DVec3;
use pointillist::engine::{FrameRequest, Pose};
use pointillist::math::Camera;
use pointillist::plan::{Output, Reconstruct, Settings};
use pointillist::scene::color::linear_from_srgb;
use pointillist::scene::random::SplitMix64;
use serde_json::{Value, json};

use super::studio::{Studio, front, ids, mesh, sphere, spt};

/// Triangles of random orientation, loosely distributed in a ball, like the crown of a tree.
fn crown() -> String {
    let mut random = SplitMix64::new(5);
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    while triangles.len() < 150 {
        let mut vector = || DVec3::from([0; 3].map(|_| random.range(-1.0, 1.0)));
        let (at, u, v) = (vector(), vector(), vector());
        if at.length() < 1.0 {
            let first = positions.len() as u32;
            positions.extend([at, at + 0.25 * u, at + 0.25 * v]);
            triangles.push([first, first + 1, first + 2]);
        }
    }
    mesh(&positions, &triangles)
}

/// Instances with gaps between them, seen from far above.
fn field(lights: &Value) -> Value {
    stretched_field(lights, [0.6; 3], [0.0, 330.0, 300.0])
}

fn stretched_field(lights: &Value, scale: [f64; 3], eye: [f64; 3]) -> Value {
    let repeat = json!({ "grid": [130, 1, 130], "step": [2.6, 0, 2.6] });
    json!({
        "assets": { "g": { "file": "g.ply" } },
        "nodes": [{ "asset": "g", "scale": scale, "repeat": repeat }],
        "lights": lights,
        "background": "#000000",
        "cameras": { "front": { "eye": eye, "target": [0, 0, 0], "fov": 45 } },
    })
}

/// Mean of all pixels in linear light.
fn brightness(studio: &Studio, settings: Settings, scale: u32) -> f64 {
    let request = FrameRequest { settings, ..front("field", 160 * scale, 120 * scale) };
    let bytes = studio.bytes(&request);
    let greens = bytes.chunks_exact(4).map(|pixel| linear_from_srgb(f64::from(pixel[1]) / 255.0));
    greens.sum::<f64>() / (bytes.len() / 4) as f64
}

fn compare(studio: &Studio, what: &str, slack: f64) {
    let truth = brightness(studio, Settings::drawn_as(Reconstruct::Points), 8);
    let methods =
        [Reconstruct::Points, Reconstruct::Splats, Reconstruct::Fuzzy, Reconstruct::Painted];
    for reconstruct in methods {
        let found = brightness(studio, spt(1.0, reconstruct), 1) / truth;
        // Less shines through a crown than between its leaves: a splat hides as much as five.
        let slack = if reconstruct == Reconstruct::Painted { 1.4 * slack } else { slack };
        println!("{what}, {reconstruct:?}: {found:.3}");
        assert!((found - 1.0).abs() < slack, "{what}, {reconstruct:?}: {found:.3}");
    }
}

#[test]
fn a_far_crowd_covers_as_much_as_it_does_in_a_larger_frame() {
    for (what, asset, slack) in [("balls", sphere(12), 0.06), ("crowns", crown(), 0.15)] {
        let studio = Studio::new();
        studio.write("g.ply", asset);
        studio.load_json("field", &field(&json!([])));
        compare(&studio, what, slack);
    }
}

/// Plates and poles, seen from above and from the side.
#[test]
fn a_far_crowd_of_stretched_copies_covers_as_much() {
    let studio = Studio::new();
    studio.write("g.ply", sphere(12));
    for scale in [[0.6, 0.06, 0.6], [0.06, 0.6, 0.06]] {
        for eye in [[0.0, 330.0, 300.0], [0.0, 60.0, 420.0]] {
            studio.load_json("field", &stretched_field(&json!([]), scale, eye));
            compare(&studio, &format!("{scale:?} from {eye:?}"), 0.35);
            studio.engine.remove("field").unwrap();
        }
    }
}

/// A merged ball, whose normals cancel, is as bright under a sun as the side that is seen.
#[test]
fn a_far_crowd_is_lit_as_it_is_in_a_larger_frame() {
    let studio = Studio::new();
    studio.write("g.ply", sphere(12));
    for direction in [[-1, -1, -1], [1, -1, 0], [0, -1, 3]] {
        studio.load_json("field", &field(&json!([{ "kind": "sun", "direction": direction }])));
        compare(&studio, &format!("{direction:?}"), 0.1);
        studio.engine.remove("field").unwrap();
    }
}

/// As the eye comes nearer, objects far smaller than a pixel appear one by one, and none of them disappears again.
#[test]
fn what_has_appeared_stays() {
    let studio = Studio::new();
    studio.write("sphere.ply", sphere(8));
    let repeat = json!({ "grid": [5, 3, 1], "step": [14, 14, 0] });
    let scene = json!({
        "assets": { "g": { "file": "sphere.ply" } },
        "nodes": [{ "asset": "g", "repeat": repeat }],
    });
    studio.load_json("few", &scene);
    let mut counts = Vec::new();
    for reconstruct in [Reconstruct::Points, Reconstruct::Splats] {
        let mut before = BTreeSet::new();
        for distance in [2400.0, 1600.0, 1100.0, 800.0, 600.0, 450.0, 350.0, 250.0, 160.0] {
            let eye = DVec3::new(0.0, 0.0, distance);
            let camera = Camera::perspective(eye, DVec3::ZERO, 40.0);
            let request = FrameRequest {
                pose: Pose::Camera(camera),
                settings: spt(1.0, reconstruct),
                output: Output::Id,
                ..front("few", 200, 200)
            };
            let bytes = studio.bytes(&request);
            let seen: BTreeSet<u32> = ids(&bytes).into_iter().filter(|&id| id != 0).collect();
            assert!(
                seen.is_superset(&before),
                "{reconstruct:?} from {distance}: {before:?} {seen:?}"
            );
            assert!(bytes == studio.bytes(&request));
            counts.push(seen.len());
            before = seen;
        }
        assert_eq!(before.len(), 15, "{counts:?}");
    }
    assert!(counts[0] < 5 && counts[3] > 1 && counts[3] < 14, "{counts:?}");
}

/// At a small error, points and splats of a mesh have the outlines of its triangles, not of all pixels that these touch, and nothing is
/// missing.
#[test]
fn nodes_of_a_mesh_reach_no_farther_than_its_triangles() {
    let studio = Studio::new();
    studio.write("g.ply", sphere(80));
    let scale = [1.0, 0.7, 0.4];
    let scene = json!({
        "assets": { "g": { "file": "g.ply" } },
        "nodes": [{ "asset": "g", "scale": scale, "rotate": [30, 20, 40] }],
    });
    studio.load_json("one", &scene);
    let nodes = [
        (0.25, Reconstruct::Points, 1.02),
        (0.5, Reconstruct::Points, 1.05),
        (0.25, Reconstruct::Splats, 1.02),
        (0.5, Reconstruct::Splats, 1.12),
    ];
    let (mut of_triangles, mut of_nodes) = (0, [0usize; 4]);
    for number in 0..12 {
        let seen = |settings| {
            let eye = DVec3::new(0.2, 0.1, 1.0).normalize_or(DVec3::Z)
                * (180.0 + 3.7 * f64::from(number));
            let camera = Camera::perspective(eye, DVec3::ZERO, 5.0);
            let request = FrameRequest {
                pose: Pose::Camera(camera),
                settings,
                output: Output::Id,
                ..front("one", 96, 96)
            };
            ids(&studio.bytes(&request)).iter().map(|&id| id != 0).collect::<Vec<_>>()
        };
        let whole = seen(Settings::drawn_as(Reconstruct::Points));
        for (sum, (px, reconstruct, _)) in of_nodes.iter_mut().zip(nodes) {
            let found = seen(spt(px, reconstruct));
            *sum += found.iter().filter(|&&is_seen| is_seen).count();
            let missing = (0..found.len()).filter(|&at| whole[at] && !found[at]).count();
            assert!(
                missing <= 1,
                "{number}, {px} px, {reconstruct:?}: {missing} pixels are missing"
            );
        }
        of_triangles += whole.iter().filter(|&&is_seen| is_seen).count();
    }
    for (sum, (px, reconstruct, most)) in of_nodes.into_iter().zip(nodes) {
        let ratio = sum as f64 / of_triangles as f64;
        println!("{px} px, {reconstruct:?}: {ratio:.3}");
        assert!(ratio < most, "{px} px, {reconstruct:?}: {ratio}");
    }
}
