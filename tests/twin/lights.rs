//! All kinds of lights on meshes and samples.

use serde_json::{Value, json};

use super::files::Shape;
use super::stage::{Case, look};
use super::verdict::Tolerance;

fn check(name: &str, lights: Value) {
    let cloud = Shape { triangles: vec![], uvs: vec![], ..Shape::ball(60, 0.9) };
    let files = [("ball.ply", Shape::ball(32, 0.9).ply()), ("cloud.ply", cloud.ply())];
    let mut scene = json!({
        "assets": { "ball": { "file": "ball.ply" }, "cloud": { "file": "cloud.ply" } },
        "materials": { "shiny": { "specular": [0.7, 0.7, 0.7], "shininess": 24 } },
        "nodes": [
            { "asset": "ball", "translate": [-1, 0.6, 0], "material": "shiny" },
            { "asset": "cloud", "translate": [1, 0.6, 0] },
            { "asset": "ball", "translate": [0, -0.9, -0.5], "scale": [2.2, 0.2, 1.4] },
        ],
    });
    scene["lights"] = lights;
    let case = Case::new(name, &files, &scene);
    case.check(&look([0.4, 1.0, 4.6], [0.0; 3], 45.0), &Tolerance::samples());
}

#[test]
fn no_lights() {
    check("unlit", json!([]));
}

#[test]
fn ambient() {
    check("ambient", json!([{ "kind": "ambient", "color": "#80c0ff", "intensity": 0.6 }]));
}

#[test]
fn headlight() {
    check("headlight", json!([{ "kind": "headlight", "color": "#ffe0c0" }]));
}

#[test]
fn sun() {
    check("sun", json!([{ "kind": "sun", "direction": [-1, -0.6, -0.8], "intensity": 1.2 }]));
}

#[test]
fn point_lights() {
    check(
        "points",
        json!([
            { "kind": "point", "position": [0.0, 0.4, 1.4], "range": 1.5, "color": "#ffb060" },
            { "kind": "point", "position": [-30, 50, 20], "range": 60, "color": "#6080ff", "intensity": 0.8 },
        ]),
    );
}

#[test]
fn all_together_and_too_bright() {
    check(
        "all",
        json!([
            { "kind": "ambient", "intensity": 0.3 }, { "kind": "headlight", "intensity": 0.5 },
            { "kind": "sun", "direction": [0.3, -1, 0.2], "color": "#fff0d0" },
            { "kind": "point", "position": [0, 2, 0], "range": 3, "intensity": 2 },
        ]),
    );
}
