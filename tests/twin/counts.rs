//! Compares the counts in the receipt, of what is tested and drawn, with the frustum in f64.

use std::f64::consts::TAU;

use glam::{DAffine3, DMat3, DVec2, DVec3};
use pointillist::assets::PointCloud;
use pointillist::bake::pack::pack_samples;
use pointillist::engine::Receipt;
use pointillist::math::{Bounds, Camera, View};
use pointillist::scene::random::SplitMix64;
use serde_json::{Value, json};

use super::files::{Shape, random_direction};
use super::stage::{Case, look};
use super::verdict::Tolerance;

/// Transforms a camera-space vector (z ahead, y up) to world space.
fn turned(view: &View, camera: DVec3) -> DVec3 {
    view.view_from_world.transpose() * (camera * DVec3::new(1.0, 1.0, -1.0))
}

/// The world point behind an image position at a depth.
fn behind_pixel(view: &View, x: f64, y: f64, depth: f64) -> DVec3 {
    view.eye + view.view_from_world.transpose() * (view.ray(DVec2::new(x, y)) * depth)
}

/// In a wide frame, chunks of a single sample in the outermost rows and columns are drawn, and those just outside are not tested.
#[test]
fn lone_samples_along_the_frames_edges() {
    let camera = Camera::perspective(DVec3::new(1.0, 2.0, 5.0), DVec3::ZERO, 55.0);
    let view = camera.view(640, 480).unwrap();
    let (w, h) = (640.0, 480.0);
    let mut nodes = Vec::new();
    let mut inside = 0;
    let mut place = |x: f64, y: f64, is_inside: bool| {
        let depth = 2.0 + 0.01 * ((x + 3.0 * y) % 97.0).abs();
        let at = behind_pixel(&view, x, y, depth).to_array();
        nodes.push(json!({ "asset": "one", "translate": at }));
        inside += u64::from(is_inside);
    };
    // Distance of a sample from the frame's edge, within the first or last pixel.
    let depths_px = [0.01, 0.1, 0.5, 0.99];
    for k in 0..640 {
        let (x, into) = (f64::from(k) + 0.5, depths_px[k as usize % 4]);
        place(x, into, true);
        place(x, h - into, true);
        place(x, if k % 2 == 0 { -into } else { h + into }, false);
    }
    for k in 1..479 {
        let (y, into) = (f64::from(k) + 0.5, depths_px[k as usize % 4]);
        place(into, y, true);
        place(w - into, y, true);
        place(if k % 2 == 0 { -into } else { w + into }, y, false);
    }
    assert_eq!(inside, 2 * (640 + 478));
    let one = Shape {
        positions: vec![DVec3::ZERO],
        colors: vec![[200, 120, 40, 255]],
        ..Shape::default()
    };
    let scene = json!({ "assets": { "one": { "file": "one.ply" } }, "nodes": nodes });
    let case = Case::new("edge-instances", &[("one.ply", one.ply())], &scene);
    let exact = Tolerance { unexplained: 0, at_edges: 0, shift_px: 0.0, ..Tolerance::samples() };
    let frames = case.check(&view, &exact);
    assert_eq!(frames.covered() as u64, inside);
    let receipt = &frames.receipt;
    assert_eq!(receipt.samples.drawn, Some(inside));
    assert_eq!(receipt.samples.tested, Some(inside));
    assert_eq!(receipt.instances.drawn, Some(inside));
}

/// A chunk of an asset: its box and how many samples or triangles it has.
struct Part {
    bounds: Bounds,
    count: u64,
}

/// Whether a placed box intersects the frustum; `None` if rounding decides.
fn meets_frustum(view: &View, world_from_asset: &DAffine3, bounds: &Bounds) -> Option<bool> {
    let (f, c) = (view.focal_px, view.principal_px);
    let size = DVec2::new(f64::from(view.width), f64::from(view.height));
    // Normals in camera space with z ahead and y up.
    let planes = [
        DVec3::Z,
        DVec3::new(f.x, 0.0, c.x),
        DVec3::new(-f.x, 0.0, size.x - c.x),
        DVec3::new(0.0, -f.y, c.y),
        DVec3::new(0.0, f.y, size.y - c.y),
    ];
    let corners = bounds.corners().map(|corner| {
        view.to_view(world_from_asset.transform_point3(corner)) * DVec3::new(1.0, 1.0, -1.0)
    });
    let mut meets = Some(true);
    for plane in planes {
        let terms = corners.iter().map(|corner| (plane.abs() * corner.abs()).element_sum());
        let doubt = 2e-5 * terms.fold(0.0, f64::max);
        let reach = corners.iter().map(|corner| plane.dot(*corner)).fold(f64::MIN, f64::max);
        if reach < -doubt {
            return Some(false);
        }
        if reach < doubt {
            meets = None;
        }
    }
    meets
}

/// Transforms of small objects everywhere: around the eye, across every side of the frustum, and flat behind the eye, where only
/// the camera plane tells that they are not in view.
fn strewn(view: &View, random: &mut SplitMix64) -> Vec<DAffine3> {
    let mut all = Vec::new();
    let (w, h) = (f64::from(view.width), f64::from(view.height));
    let mut put = |at: DVec3, linear: DMat3| {
        all.push(DAffine3::from_mat3_translation(linear, at));
    };
    for number in 0..300 {
        let turn = DMat3::from_axis_angle(random_direction(random), random.range(0.0, TAU));
        let scale = DVec3::new(1.0, random.range(0.3, 1.0), 1.0) * random.range(0.05, 0.3);
        let linear = turn * DMat3::from_diagonal(scale);
        let depth = random.range(3.0, 9.0);
        // The number of pixels that the scale spans.
        let around = 2.0 * scale.x * view.focal_px.x / depth;
        let off = random.range(-around, around);
        let (x, y) = (random.range(0.0, w), random.range(0.0, h));
        let at = match number % 6 {
            0 => behind_pixel(view, off, y, depth),
            1 => behind_pixel(view, w + off, y, depth),
            2 => behind_pixel(view, x, off, depth),
            3 => behind_pixel(view, x, h + off, depth),
            4 => behind_pixel(view, x, y, depth),
            _ => view.eye + random_direction(random) * depth,
        };
        put(at, linear);
    }
    for number in 0..8 {
        // Columns in camera axes.
        let axes = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| turned(view, axis));
        let plate = DMat3::from_cols(axes[0] * 6.0, axes[1] * 6.0, axes[2] * 0.1);
        put(view.eye - axes[2] * (0.2 + 0.1 * f64::from(number)), plate);
    }
    all
}

fn node(asset: &str, at: &DAffine3) -> Value {
    let m = at.matrix3;
    let columns = [
        m.x_axis.extend(0.0),
        m.y_axis.extend(0.0),
        m.z_axis.extend(0.0),
        at.translation.extend(1.0),
    ];
    let matrix: Vec<f64> = columns.iter().flat_map(|column| column.to_array()).collect();
    json!({ "asset": asset, "matrix": matrix })
}

/// The chunks of a packed cloud.
fn parts_of_cloud(cloud: &Shape) -> Vec<Part> {
    let positions = cloud.positions.clone();
    let packed = pack_samples(&PointCloud { positions, ..PointCloud::default() }).unwrap();
    let part = |chunk: &pointillist::bake::pack::PackedChunk| Part {
        bounds: Bounds::of([
            packed.grid.position(chunk.origin),
            packed.grid.position(chunk.origin + chunk.extent),
        ]),
        count: u64::from(chunk.count),
    };
    packed.chunks.iter().map(part).collect()
}

/// Many instances inside, outside and across every plane, with one chunk or several.
#[test]
fn tested_counts_are_the_frustums() {
    let small = Shape::cloud(37, [-1.0; 3], [1.0; 3], 21);
    let large = Shape::cloud(3_500, [-1.0; 3], [1.0; 3], 22);
    let ball = Shape::ball(6, 1.0);
    let whole = |shape: &Shape, count: usize| {
        vec![Part { bounds: Bounds::of(shape.positions.iter().copied()), count: count as u64 }]
    };
    let assets = [
        ("small", whole(&small, small.positions.len())),
        ("large", parts_of_cloud(&large)),
        ("ball", whole(&ball, ball.triangles.len())),
    ];
    assert_eq!(assets[1].1.len(), 4);
    let files = [("small.ply", small.ply()), ("large.ply", large.ply()), ("ball.ply", ball.ply())];
    for (number, fov) in [(0, 40.0), (1, 75.0)] {
        let mut view = look([1.5, 0.8, -2.0], [0.2, 0.1, 3.0], fov);
        if number == 1 {
            view.principal_px += DVec2::new(31.0, -22.0);
        }
        let mut random = SplitMix64::new(77 + number);
        let (mut nodes, mut samples, mut triangles, mut drawn, mut partly) = (vec![], 0, 0, 0, 0);
        for (index, at) in strewn(&view, &mut random).iter().enumerate() {
            let (name, parts) = &assets[index % 3];
            let met: Option<Vec<bool>> =
                parts.iter().map(|part| meets_frustum(&view, at, &part.bounds)).collect();
            // Leave out instances that rounding decides.
            let Some(met) = met else { continue };
            nodes.push(node(name, at));
            let seen: u64 =
                parts.iter().zip(&met).filter(|(_, met)| **met).map(|(part, _)| part.count).sum();
            *(if *name == "ball" { &mut triangles } else { &mut samples }) += seen;
            drawn += u64::from(met.contains(&true));
            partly += u32::from(met.contains(&true) && met.contains(&false));
        }
        let stored = nodes.len() as u64;
        assert!(
            stored > 290 && drawn > 80 && drawn < stored - 40 && partly > 5,
            "{drawn} {partly}"
        );
        let scene = json!({ "assets": { "small": { "file": "small.ply" },
            "large": { "file": "large.ply" }, "ball": { "file": "ball.ply" } }, "nodes": nodes });
        let case = Case::new(&format!("strewn-{number}"), &files, &scene);
        let seen = case.check(&view, &Tolerance::samples()).receipt;
        assert!(seen.samples.tested <= Some(samples) && seen.triangles.tested <= Some(triangles));
        let [.., all] = case.each(&view);
        let receipt = all.receipt;
        assert_eq!(receipt.instances.stored, stored);
        assert_eq!(receipt.instances.drawn, Some(drawn));
        assert_eq!(receipt.samples.tested, Some(samples));
        assert_eq!(receipt.triangles.tested, Some(triangles));
    }
}

/// The counts of a receipt.
fn counts(receipt: &Receipt) -> [Option<u64>; 5] {
    let (samples, triangles) = (&receipt.samples, &receipt.triangles);
    let drawn = receipt.instances.drawn;
    [samples.tested, samples.drawn, triangles.tested, triangles.rasterised, drawn]
}

/// All engines count the same, however many passes they take: large and small triangles on several pages.
#[test]
fn every_engine_counts_the_same() {
    let mut mesh = Shape::ball(12, 1.0);
    mesh.normals.clear();
    mesh.uvs.clear();
    let mut floor = Shape::quad(
        DVec3::new(-9.0, -1.0, 9.0),
        DVec3::new(18.0, 0.0, 0.0),
        DVec3::new(0.0, 0.0, -18.0),
        1.0,
    );
    floor.uvs.clear();
    floor.colors = vec![[90, 140, 60, 255]; 4];
    mesh.add(&floor);
    let cloud = Shape::cloud(3_000, [-2.0, -0.8, -2.0], [2.0, 1.5, 2.0], 31);
    let scene = json!({
        "assets": { "mesh": { "file": "mesh.ply" }, "cloud": { "file": "cloud.ply" } },
        "nodes": [{ "asset": "mesh" }, { "asset": "cloud" },
            { "asset": "mesh", "translate": [3, 0.5, -2], "scale": 0.7 },
            { "asset": "mesh", "translate": [0, 0, 60] }],
    });
    let files = [("mesh.ply", mesh.ply()), ("cloud.ply", cloud.ply())];
    let case = Case::new("counted", &files, &scene);
    for view in
        [look([1.0, 1.5, 4.0], [0.0; 3], 50.0), look([0.0, 0.2, 1.2], [0.5, 0.0, 0.0], 80.0)]
    {
        let [wide, narrow, rasterising] = case.each(&view).map(|frames| counts(&frames.receipt));
        println!("{wide:?} (samples tested, drawn; triangles tested, rasterised; instances)");
        assert!(wide.iter().all(|count| count.is_some_and(|count| count > 0)), "{wide:?}");
        assert_eq!(narrow, wide, "with 32-bit words");
        assert_eq!(rasterising, wide, "with the rasteriser");
    }
}
