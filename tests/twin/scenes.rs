//! The committed scenes, as users see them.

use serde_json::Value;

use super::lines::compared;
use super::stage::{Case, folder, look};
use super::verdict::Tolerance;

fn check(scene: &str, cameras: &[&str], tolerance: &Tolerance) {
    let case = Case::committed(scene);
    for camera in cameras {
        case.check(&case.view(camera, 200, 150), tolerance);
    }
}

#[test]
fn town() {
    check("town", &["overview", "square", "street"], &Tolerance::samples());
    // Level ground seen from straight above: many samples have equal depths up to f32 rounding, and any of them may be visible.
    // There are 10 such pixels from 94 m above, and 3 from 78 m, where fewer samples share a pixel. Points have no kernels, so
    // kernels do not matter.
    check("town", &["above"], &Tolerance { unexplained: 10, ..Tolerance::samples() });
}

#[test]
fn relief() {
    check("relief", &["front", "detail", "above"], &Tolerance::default());
}

#[test]
fn textured() {
    check("textured", &["front", "detail", "grazing"], &Tolerance::default());
}

/// Balls of many materials, and a lantern with maps. Highlights of smooth balls, and what they mirror of the studio's lamps, are as steep as a triangle's
/// interpolated normals are coarse.
#[test]
fn materials() {
    let tolerance = Tolerance {
        color: 16,
        unexplained: 16,
        at_edges: 12,
        shift_px: 0.0,
        ..Tolerance::default()
    };
    check("materials", &["front", "lantern", "gold"], &tolerance);
}

/// Up to a dozen panes, and balls within balls, before and behind leaves.
#[test]
fn glasshouse() {
    let tolerance = Tolerance { unless_noise: true, ..Tolerance::default() };
    check("glasshouse", &["corner", "bench", "inside", "through"], &tolerance);
}

/// The same under a lamp. `shadows` compares what it casts.
#[test]
fn glasshouse_night() {
    let tolerance = Tolerance { unless_noise: true, ..Tolerance::default() };
    check("glasshouse-night", &["corner", "inside"], &tolerance);
}

/// Thin lines are drawn by their keys, in other pixels than the reference; here they are three pixels wide.
#[test]
fn neurons() {
    let case = Case::committed("neurons");
    for camera in ["front", "detail"] {
        let [differ, covered] = compared(&case, &case.view(camera, 200, 150), 3.0);
        println!("neurons, {camera}: {differ} of {covered} covered pixels differ");
        assert!(covered > 1000 && differ * 100 < covered, "{differ} of {covered}");
    }
}

/// All 40 × 40 assemblies. Distant trees are a pixel tall, and their leaves a twentieth of a pixel.
#[test]
fn plaza_as_a_whole() {
    let tolerance = Tolerance {
        unless_noise: true,
        // A single frame of eight million triangles is enough.
        shift_px: 0.0,
        unexplained: 4,
        at_edges: 200 * 150 / 75,
        ..Tolerance::default()
    };
    check("plaza", &["overview"], &tolerance);
}

/// The plaza with 8 × 8 assemblies, seen from inside.
#[test]
fn plaza_from_within() {
    let text = std::fs::read_to_string(folder().join("plaza.json")).unwrap();
    let mut scene: Value = serde_json::from_str(&text).unwrap();
    scene["prototypes"]["row"]["children"][0]["repeat"]["grid"][0] = 8.into();
    scene["nodes"][0]["repeat"]["grid"][2] = 8.into();
    let path = folder().join("plaza-8.json");
    std::fs::write(&path, serde_json::to_vec(&scene).unwrap()).unwrap();
    let case = Case::load("plaza-8", &path);
    let tolerance =
        Tolerance { unless_noise: true, at_edges: 12, unexplained: 2, ..Tolerance::default() };
    case.check(&case.view("assembly", 200, 150), &tolerance);
    case.check(&look([0.0, 1.7, 24.0], [0.4, 1.6, -32.0], 50.0), &tolerance);
    case.check(&look([1.0, 0.4, 20.5], [-0.5, 1.2, 19.0], 70.0), &tolerance);
}
