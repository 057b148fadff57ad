//! Far from the world's origin, and near to the eye.

use glam::DVec3;
use pointillist::accuracy::metrics::psnr;
use pointillist::math::View;
use serde_json::{Value, json};

use super::files::Shape;
use super::stage::{Case, look};
use super::verdict::Tolerance;

/// A place in UTM coordinates, up to ten million metres north. Sums with coordinates of 2⁻²⁰ are exact.
const UTM: DVec3 = DVec3::new(412_345.75, 9_653_210.25, 117.5);

/// Coordinates that stay exact beside [`UTM`].
fn rounded(mut shape: Shape) -> Shape {
    for position in &mut shape.positions {
        *position = (*position * 1_048_576.0).round() / 1_048_576.0;
    }
    shape
}

fn moved(view: &View, offset: DVec3) -> View {
    View { eye: view.eye + offset, ..*view }
}

fn case(name: &str, asset_offset: DVec3, node_offset: DVec3) -> Case {
    let ball = rounded(Shape::ball(24, 1.0)).moved(asset_offset);
    let cloud =
        rounded(Shape::cloud(5_000, [-3.0, -1.5, -3.0], [3.0, -1.0, 3.0], 12)).moved(asset_offset);
    let at = asset_offset + node_offset;
    let lights: Value = json!([
        { "kind": "point", "position": (at + DVec3::new(0.5, 1.5, 2.0)).to_array(), "range": 2 },
        { "kind": "ambient", "intensity": 0.2 },
    ]);
    let translate = node_offset.to_array();
    let scene = json!({
        "assets": { "ball": { "file": "ball.ply" }, "cloud": { "file": "cloud.ply" } }, "lights": lights,
        "nodes": [{ "asset": "ball", "translate": translate }, { "asset": "cloud", "translate": translate }],
    });
    Case::new(name, &[("ball.ply", ball.ply()), ("cloud.ply", cloud.ply())], &scene)
}

/// A survey's coordinates, in the file or in the node, give the picture that the same scene gives at the origin.
#[test]
fn utm_coordinates() {
    let here = case("origin", DVec3::ZERO, DVec3::ZERO);
    let views =
        [look([1.0, 1.5, 4.0], [0.0; 3], 45.0), look([0.0, -0.9, 2.25], [0.25, -1.0, 0.0], 60.0)];
    let tolerance = Tolerance::samples();
    for (name, in_asset, in_node) in
        [("utm-asset", UTM, DVec3::ZERO), ("utm-node", DVec3::ZERO, UTM), ("utm-back", UTM, -UTM)]
    {
        let there = case(name, in_asset, in_node);
        for view in &views {
            let near = here.check(view, &tolerance);
            let far = there.check(&moved(view, in_asset + in_node), &tolerance);
            let same = psnr(&near.color, &far.color).unwrap();
            let changed = (0..near.id.len()).filter(|&i| near.id[i] != far.id[i]).count();
            println!("{name}: {same:.1} dB beside the origin's picture, {changed} ids differ");
            assert!(same >= 55.0 && changed <= 4, "{name}: {same:.1} dB, {changed} ids differ");
        }
    }
}

/// The eye moves by hundredths of a millimetre at UTM coordinates: the picture follows, it does not jump.
#[test]
fn small_steps_far_out() {
    let there = case("steps", UTM, DVec3::ZERO);
    let view = moved(&look([0.0, -0.9, 2.25], [0.25, -1.0, 0.0], 60.0), UTM);
    for step in [1.0 / 131_072.0, 3.0 / 131_072.0] {
        there.check(&moved(&view, DVec3::new(step, -step, step)), &Tolerance::samples());
    }
}

/// A millimetre above a surface of several kilometres.
#[test]
fn close_to_something_large() {
    let mut ground = Shape::default();
    for i in 0..64 * 64 {
        let (x, z) = (f64::from(i % 64) * 100.0 - 3200.0, f64::from(i / 64) * 100.0 - 3200.0);
        let mut cell =
            Shape::quad(DVec3::new(x, 0.0, z + 100.0), DVec3::X * 100.0, DVec3::Z * -100.0, 1.0);
        cell.uvs.clear();
        cell.colors = cell
            .positions
            .iter()
            .map(|p| {
                [
                    (128.0 + 100.0 * (p.x * 0.005).sin()) as u8,
                    (128.0 + 100.0 * (p.z * 0.004).sin()) as u8,
                    80,
                    255,
                ]
            })
            .collect();
        ground.add(&cell);
    }
    let scene = json!({ "assets": { "g": { "file": "g.ply" } }, "nodes": [{ "asset": "g" }] });
    let case = Case::new("ground", &[("g.ply", ground.ply())], &scene);
    for (height, target) in
        [(0.001, [10.0, 0.0, 3.0]), (0.5, [813.0, -1.0, 411.0]), (2000.0, [812.0, 0.0, 412.0])]
    {
        let eye = [812.34, height, 411.17];
        case.check(&look(eye, target, 60.0), &Tolerance { depth: 1e-4, ..Tolerance::default() });
    }
}
