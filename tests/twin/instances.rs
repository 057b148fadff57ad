//! Transforms and nested instances.

use glam::DVec3;
use serde_json::{Value, json};

use super::files::{Glb, Shape};
use super::stage::{Case, look};
use super::verdict::Tolerance;

const SUN: &str = r#"[{ "kind": "sun", "direction": [-0.4, -1, -0.6] }, { "kind": "ambient", "intensity": 0.2 }]"#;

fn lights() -> Value {
    serde_json::from_str(SUN).unwrap()
}

/// Balls and clouds side by side under the same transform.
#[test]
fn transforms_of_every_kind() {
    let transforms = [
        ("uneven", json!({ "scale": [1.8, 0.4, 1.0], "rotate": [20, 30, 40] })),
        ("mirrored", json!({ "scale": [-1, 1, 1], "rotate": [0, 30, 20] })),
        ("turned inside out", json!({ "scale": -0.8 })),
        (
            "sheared",
            json!({ "matrix": [1, 0, 0, 0, 0.9, 1, 0.2, 0, -0.3, 0.4, 0.7, 0, 0.2, 0.1, 0, 1] }),
        ),
        ("tiny", json!({ "scale": 1e-5, "translate": [0, 0, 3.99995] })),
        ("nearly flat", json!({ "scale": [1, 1e-3, 1], "rotate": [50, 0, 0] })),
    ];
    let files = [
        ("ball.ply", Shape::ball(24, 1.0).ply()),
        ("cloud.ply", Shape::cloud(4_000, [-1.0; 3], [1.0; 3], 7).ply()),
    ];
    for (name, transform) in transforms {
        for asset in ["ball", "cloud"] {
            let mut node = transform.clone();
            node["asset"] = json!(asset);
            let file = format!("{asset}.ply");
            let scene = json!({ "assets": { asset: { "file": file } }, "nodes": [node], "lights": lights() });
            let case = Case::new(&format!("{name} {asset}"), &files, &scene);
            let tolerance =
                if asset == "cloud" { Tolerance::samples() } else { Tolerance::default() };
            let tolerance =
                if name == "tiny" { Tolerance { shift_px: 0.02, ..tolerance } } else { tolerance };
            let frames = case.check(&look([0.3, 1.0, 4.0], [0.0, 0.0, 0.0], 45.0), &tolerance);
            assert!(name == "tiny" || frames.covered() > 200, "{name}: {}", frames.covered());
        }
    }
}

/// A node that flattens its mesh completely. The result has two sides and a normal.
#[test]
fn a_flattened_mesh_is_lit() {
    let mut glb = Glb::new();
    let mesh = glb.mesh(&Shape::ball(16, 1.0), None);
    glb.node(mesh, json!({ "scale": [1, 0, 1] }));
    glb.node(mesh, json!({ "scale": [0.5, 0.5, 0], "translation": [0, 1, 0] }));
    let scene = json!({ "assets": { "m": { "file": "m.glb" } }, "nodes": [{ "asset": "m" }], "lights": lights() });
    let case = Case::new("flattened", &[("m.glb", glb.finish())], &scene);
    // The upper and lower half of the ball coincide.
    let frames = case.draw(&look([0.5, 2.0, 3.0], [0.0; 3], 45.0));
    assert!(frames.covered() > 1_000);
    case.check(&look([0.5, 2.0, 3.0], [0.0; 3], 45.0), &Tolerance::default());
}

/// Five levels of prototypes with grids, scatter, mirroring and overriding materials.
#[test]
fn instances_within_instances() {
    let scene = json!({
        "assets": { "ball": { "file": "ball.ply" }, "cloud": { "file": "cloud.ply" } },
        "materials": { "red": { "color": "#c03020" }, "dull": { "specular": "#404040", "shininess": 8 } },
        "prototypes": {
            "pair": { "children": [
                { "asset": "ball", "scale": 0.2, "translate": [0.3, 0, 0] },
                { "asset": "cloud", "scale": 0.25, "translate": [-0.3, 0, 0] } ] },
            "row": { "children": [ { "prototype": "pair", "repeat": { "grid": [3, 1, 1], "step": [1.2, 0, 0] } } ] },
            "plate": { "children": [
                { "prototype": "row", "repeat": { "grid": [1, 1, 3], "step": [0, 0, 1] }, "rotate": [0, 10, 0] },
                { "asset": "ball", "scale": [0.8, 0.1, 0.8], "material": "red" } ] },
            "tower": { "children": [
                { "prototype": "plate", "repeat": { "grid": [1, 3, 1], "step": [0, 0.9, 0] }, "scale": [-1, 1, 1] } ] },
        },
        "nodes": [
            { "prototype": "tower", "material": "dull" },
            { "prototype": "plate", "scale": 0.4, "repeat":
                { "scatter": 12, "half_extent": [3, 1, 3], "scale": [0.3, 1], "turn": true, "seed": 5 } },
        ],
        "lights": lights(),
    });
    let cloud = Shape::cloud(300, [-1.0; 3], [1.0; 3], 11);
    let files = [("ball.ply", Shape::ball(10, 1.0).ply()), ("cloud.ply", cloud.ply())];
    let case = Case::new("deep", &files, &scene);
    let tolerance = Tolerance::samples();
    let frames = case.check(&look([2.0, 2.5, 5.5], [0.0; 3], 50.0), &tolerance);
    let mut ids: Vec<u32> = frames.id.clone();
    ids.sort_unstable();
    ids.dedup();
    assert!(ids.len() > 100, "{} instances are seen", ids.len());
    // 3 plates of 9 pairs and a disc, and 12 more plates.
    assert_eq!(frames.receipt.instances.stored, 15 * 19);
    case.check(&look([0.4, 0.3, 0.2], [1.0, 0.2, -1.0], 70.0), &tolerance);
}

/// A file with several placements, drawn twice. Instances are numbered placement by placement.
#[test]
fn placements_of_an_asset_are_instances() {
    let mut glb = Glb::new();
    let ball = glb.mesh(&Shape::ball(12, 0.3), None);
    let quad = glb.mesh(&Shape::quad(DVec3::ZERO, DVec3::X, DVec3::Y, 1.0), None);
    glb.node(ball, json!({ "translation": [-0.5, 0, 0] }));
    glb.node(quad, json!({ "rotation": [0, 0.3826834, 0, 0.9238795] }));
    glb.node(ball, json!({ "translation": [0, -0.6, 0], "scale": [1, 0.5, 1] }));
    let scene = json!({ "assets": { "m": { "file": "m.glb" } },
        "nodes": [{ "asset": "m" }, { "asset": "m", "translate": [0.2, 0.3, -1.5], "rotate": [0, 0, 30] }] });
    let case = Case::new("placements", &[("m.glb", glb.finish())], &scene);
    let frames = case.check(&look([0.3, 0.4, 3.0], [0.0; 3], 50.0), &Tolerance::default());
    for id in 1..=6 {
        assert!(frames.id.contains(&id), "instance {id}");
    }
}
