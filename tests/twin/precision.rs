//! Precision far from the world's origin and near to the eye.

use std::collections::BTreeSet;

use glam::{DAffine3, DMat3, DVec2, DVec3};
use pointillist::accuracy::metrics::psnr;
use pointillist::math::{Camera, View};
use pointillist::scene::random::SplitMix64;
use serde_json::{Value, json};

use super::files::{Shape, random_color, random_direction};
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

/// Survey coordinates, in the file or in the node, give the same image as the scene at the origin.
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

/// The eye moves by hundredths of a millimetre at UTM coordinates: the image follows without jumps.
#[test]
fn small_steps_far_out() {
    let there = case("steps", UTM, DVec3::ZERO);
    let view = moved(&look([0.0, -0.9, 2.25], [0.25, -1.0, 0.0], 60.0), UTM);
    for step in [1.0 / 131_072.0, 3.0 / 131_072.0] {
        there.check(&moved(&view, DVec3::new(step, -step, step)), &Tolerance::samples());
    }
}

/// A view from a millimetre above a surface of several kilometres.
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

/// Half the length of an asset of nearly 4096 units, whose grid has steps of 2⁻¹⁷.
const FAR: f64 = 2040.0;

/// Coordinates in multiples of this are on the grid, wherever its centre is.
const ON_GRID: f64 = 1.0 / 65_536.0;

fn on_grid(v: DVec3) -> DVec3 {
    (v / ON_GRID).round() * ON_GRID
}

/// About a chunk of samples some 10 mm in front of the eye, at most one in three pixels each way. Each is between 1/16 and 1/6
/// pixel inside its pixel, so a frame that is off by more than that shows it elsewhere.
fn pattern(view: &View, world_from_asset: &DAffine3, random: &mut SplitMix64) -> Shape {
    let asset_from_world = world_from_asset.inverse();
    let (w, h) = (f64::from(view.width), f64::from(view.height));
    let (mut taken, mut shape) = (BTreeSet::new(), Shape::default());
    while shape.positions.len() < 1024 {
        let ray = view.ray(DVec2::new(random.range(1.0, w - 1.0), random.range(1.0, h - 1.0)));
        let wanted =
            view.eye + view.view_from_world.transpose() * (ray * random.range(0.0095, 0.0105));
        let position = on_grid(asset_from_world.transform_point3(wanted));
        let seen = view.to_view(world_from_asset.transform_point3(position));
        let pixel = view.project(seen).unwrap();
        let into = pixel.fract().min(1.0 - pixel.fract()).min_element();
        let (column, row) = (pixel.x as u32, pixel.y as u32);
        let apart = column < view.width && row < view.height;
        if (1.0 / 16.0..1.0 / 6.0).contains(&into) && apart && taken.insert((column / 3, row / 3)) {
            shape.positions.push(position);
            shape.colors.push(random_color(random));
        }
    }
    shape
}

/// Ten millimetres from samples that are two kilometres from the origin of their asset, which is at UTM coordinates, rotated and
/// scaled. The matrices are f32 numbers of 24 bits, as on the GPU.
#[test]
fn millimetres_away_kilometres_from_the_grids_origin() {
    let turned = |axis: DVec3, angle: f64, scale: DVec3| {
        let linear =
            DMat3::from_axis_angle(axis / axis.length(), angle) * DMat3::from_diagonal(scale);
        let linear = DMat3::from_cols_array(&linear.to_cols_array().map(|v| f64::from(v as f32)));
        DAffine3::from_mat3_translation(linear, UTM + DVec3::splat(0.123))
    };
    let placed = [
        DAffine3::from_translation(UTM),
        turned(DVec3::new(1.0, 2.0, -0.5), 0.7, DVec3::splat(1.3)),
        turned(DVec3::new(-1.0, 0.3, 0.8), 2.1, DVec3::new(0.9, 1.1, 0.77)),
    ];
    // In different octants, so that a chunk contains only one of them.
    let places = [
        DVec3::new(-FAR, -1700.3, -FAR),
        DVec3::new(FAR, FAR, 1234.5),
        DVec3::new(812.7, -1900.1, FAR),
    ];
    for (number, world_from_asset) in placed.iter().enumerate() {
        let mut random = SplitMix64::new(90 + number as u64);
        let (mut cloud, mut views) = (Shape::default(), Vec::new());
        for place in places {
            let target = world_from_asset.transform_point3(on_grid(place));
            // The other places are behind the eye.
            let is_behind = |ahead: DVec3, other: DVec3| {
                other == place || ahead.dot(world_from_asset.transform_vector3(other - place)) < 0.0
            };
            let mut ahead = random_direction(&mut random);
            while !places.iter().all(|&other| is_behind(ahead, other)) {
                ahead = random_direction(&mut random);
            }
            let camera = Camera::perspective(target - ahead * 0.01, target, 22.6);
            let view = camera.view(160, 120).unwrap();
            cloud.add(&pattern(&view, world_from_asset, &mut random));
            views.push(view);
        }
        let m = world_from_asset.matrix3;
        let columns = [m.x_axis, m.y_axis, m.z_axis, world_from_asset.translation];
        let matrix: Vec<f64> = (columns.iter().enumerate())
            .flat_map(|(k, column)| column.extend(if k == 3 { 1.0 } else { 0.0 }).to_array())
            .collect();
        let scene = json!({ "assets": { "c": { "file": "c.ply" } },
            "nodes": [{ "asset": "c", "matrix": matrix }] });
        let case = Case::new(&format!("millimetres-{number}"), &[("c.ply", cloud.ply())], &scene);
        let exact = Tolerance {
            unexplained: 0,
            at_edges: 0,
            shift_px: 0.0,
            depth: 4e-5,
            ..Tolerance::default()
        };
        for view in &views {
            let frames = case.check(view, &exact);
            assert_eq!(frames.covered(), 1024);
            assert_eq!(frames.receipt.samples.tested, Some(1024));
        }
    }
}
