//! Triangles of all sizes, in the compute walk and in the rasteriser, and the border between both.

use glam::{DVec2, DVec3};
use pointillist::math::View;
use pointillist::scene::random::SplitMix64;
use serde_json::json;

use super::files::{Shape, random_direction};
use super::stage::{Case, Frames, look};
use super::verdict::Tolerance;

fn case(name: &str, mesh: &Shape) -> Case {
    let scene = json!({ "assets": { "m": { "file": "m.ply" } }, "nodes": [{ "asset": "m" }] });
    Case::new(name, &[("m.ply", mesh.ply())], &scene)
}

fn rasterised(frames: &Frames) -> u64 {
    frames.receipt.triangles.rasterised.unwrap()
}

/// The world point behind an image position at a depth.
fn unproject(view: &View, x: f64, y: f64, depth: f64) -> DVec3 {
    view.eye + view.view_from_world.transpose() * (view.ray(DVec2::new(x, y)) * depth)
}

/// A colour that varies smoothly with the position.
fn tint(p: DVec3) -> [u8; 4] {
    let wave = |v: f64| (128.0 + 90.0 * v.sin()) as u8;
    [wave(p.x), wave(p.y + 1.0), wave(p.z + p.x + 2.0), 255]
}

#[test]
fn small_triangles_of_a_closed_surface() {
    let case = case("ball", &Shape::ball(40, 1.0));
    for eye in [[0.0, 0.5, 4.0], [9.0, 4.0, -6.0], [0.3, 3.2, 0.1]] {
        let frames = case.check(&look(eye, [0.1, 0.0, 0.0], 45.0), &Tolerance::default());
        assert_eq!(rasterised(&frames), 0);
    }
}

#[test]
fn triangles_of_less_than_a_pixel() {
    let case = case("fine-ball", &Shape::ball(120, 1.0));
    // With many triangles per pixel, the 1/256-pixel grid decides which one covers a pixel's centre.
    let tolerance = Tolerance { color: 6, depth: 1e-3, normal: 6, ..Tolerance::default() };
    case.check(&look([0.0, 2.0, 7.0], [0.0; 3], 45.0), &tolerance);
    case.check(&look([0.0, 8.0, 28.0], [0.0; 3], 45.0), &tolerance);
}

fn cube(half: f64) -> Shape {
    let mut shape = Shape::default();
    for axis in 0..3 {
        for sign in [-1.0, 1.0] {
            let mut normal = DVec3::ZERO;
            normal[axis] = sign;
            let u = DVec3::from_array(std::array::from_fn(|k| f64::from(k == (axis + 1) % 3)));
            let v = normal.cross(u);
            let corner = (normal - u - v) * half;
            let mut face = Shape::quad(corner, u * 2.0 * half, v * 2.0 * half, 1.0);
            face.uvs.clear();
            face.colors = face.positions.iter().map(|&p| tint(p * 1.4)).collect();
            shape.add(&face);
        }
    }
    shape
}

#[test]
fn large_triangles() {
    let case = case("cube", &cube(1.0));
    let frames = case.check(&look([1.5, 1.2, 2.6], [0.0; 3], 45.0), &Tolerance::default());
    assert!(rasterised(&frames) >= 6, "{}", rasterised(&frames));
    // From inside all faces intersect the frame's edges or the camera plane.
    case.check(&look([0.3, -0.2, 0.4], [1.0, 0.1, -0.4], 80.0), &Tolerance::default());
}

/// A room whose walls and floor intersect the camera plane, and small triangles around the eye.
#[test]
fn triangles_through_the_camera_plane() {
    let far = 200.0;
    let floor = |y: f64| {
        Shape::quad(DVec3::new(-far, y, far), DVec3::X * 2.0 * far, DVec3::Z * -2.0 * far, 1.0)
    };
    let mut room = floor(-1.0);
    room.add(&floor(2.5));
    room.uvs.clear();
    room.colors = room.positions.iter().map(|&p| tint(p * 0.01)).collect();
    let ground = case("room", &room);
    for target in [[1.0, 0.0, 0.2], [0.3, -1.0, 0.1], [0.2, 0.9, -1.0], [-1.0, -0.3, 2.0]] {
        ground.check(&look([0.0; 3], target, 70.0), &Tolerance::default());
    }
    let shell = case("shell", &Shape::ball(30, 2.0));
    // Slightly inside and slightly outside the shell.
    for eye in [[0.0, 0.3, 1.9], [0.2, -1.3, 1.2], [0.0, 0.1, 2.05]] {
        let frames = shell.check(&look(eye, [1.0, 0.2, 1.9], 75.0), &Tolerance::default());
        assert!(rasterised(&frames) > 0);
    }
}

/// A disc of small triangles in a fan of large ones that fills the frame: there is no crack between the walk and the rasteriser.
#[test]
fn small_and_large_triangles_share_edges() {
    let mut mesh = Shape::default();
    let mut corner = |x: f64, y: f64| {
        let p = DVec3::new(x, y, 0.2 * x - 0.3 * y);
        mesh.positions.push(p);
        mesh.colors.push(tint(p * 2.0));
        mesh.positions.len() as u32 - 1
    };
    let steps = 96;
    let rings: Vec<Vec<u32>> = [0.05, 0.2, 0.35, 9.0]
        .into_iter()
        .map(|radius: f64| {
            let turn = |k: u32| f64::from(k) / f64::from(steps) * std::f64::consts::TAU;
            (0..steps).map(|k| corner(radius * turn(k).cos(), radius * turn(k).sin())).collect()
        })
        .collect();
    let middle = corner(0.0, 0.0);
    for k in 0..steps as usize {
        let next = (k + 1) % steps as usize;
        mesh.triangles.push([middle, rings[0][k], rings[0][next]]);
        for pair in rings.windows(2) {
            mesh.triangles.push([pair[0][k], pair[1][k], pair[1][next]]);
            mesh.triangles.push([pair[0][k], pair[1][next], pair[0][next]]);
        }
    }
    let case = case("disc", &mesh);
    for eye in [[0.0, 0.0, 2.0], [0.4, 0.9, 1.5], [-0.7, 0.1, 0.9]] {
        let frames = case.check(&look(eye, [0.01, 0.02, 0.0], 50.0), &Tolerance::default());
        assert_eq!(frames.covered(), 160 * 120);
        let (large, tested) = (rasterised(&frames), frames.receipt.triangles.tested.unwrap());
        assert!(large > 0 && large < tested / 2, "{large} of {tested}");
    }
}

/// A checkerboard of cells whose corners are pixel centres, drawn as two nodes of alternating triangles. Each pixel belongs to
/// exactly one of them.
#[test]
fn edges_through_pixel_centres_have_one_owner() {
    let view = look([0.2, 0.3, 5.0], [0.0; 3], 40.0);
    // Cells of 40 pixels go to the rasteriser, cells of 8 are walked, and in the third image both kinds meet.
    for (name, sizes) in [("cells-8", [8, 8]), ("cells-40", [40, 40]), ("cells-mixed", [8, 40])] {
        let mut halves = [Shape::default(), Shape::default()];
        for row in 0..120 / 40 {
            for column in 0..160 / 40 {
                let size = sizes[(row + column) % 2];
                for cell in 0..(40 / size) * (40 / size) {
                    let x = (column * 40 + cell % (40 / size) * size) as f64 + 0.5;
                    let y = (row * 40 + cell / (40 / size) * size) as f64 + 0.5;
                    let s = size as f64;
                    let at = |dx: f64, dy: f64| unproject(&view, x + dx, y + dy, 4.0).into();
                    let color = [(x as u8).wrapping_mul(3), (y as u8).wrapping_mul(5), 90];
                    let lower = [at(0.0, 0.0), at(0.0, s), at(s, s)];
                    let upper = [at(0.0, 0.0), at(s, s), at(s, 0.0)];
                    halves[0].add(&Shape::triangle(lower, color));
                    halves[1].add(&Shape::triangle(upper, color));
                }
            }
        }
        let scene = json!({
            "assets": { "a": { "file": "a.ply" }, "b": { "file": "b.ply" } }, "lights": [],
            "nodes": [{ "name": "a", "asset": "a" }, { "name": "b", "asset": "b" }],
        });
        let files = [("a.ply", halves[0].ply()), ("b.ply", halves[1].ply())];
        let case = Case::new(name, &files, &scene);
        let both = case.draw(&view);
        case.show("b", false);
        let first = case.draw(&view);
        case.show("b", true);
        case.show("a", false);
        let second = case.draw(&view);
        let mut inside = 0;
        for i in 0..both.id.len() {
            let owners = u32::from(first.id[i] != 0) + u32::from(second.id[i] != 0);
            let covered = u32::from(both.id[i] != 0);
            assert_eq!(owners, covered, "{name}: pixel {}, {}", i % 160, i / 160);
            inside += covered;
        }
        // The board's outer edge also runs through pixel centres, which belong to it on two sides.
        assert_eq!(inside, 160 * 120, "{name}");
    }
}

#[test]
fn slivers_and_triangles_without_area() {
    let mut random = SplitMix64::new(8);
    let mut mesh = Shape::default();
    for k in 0..120 {
        let at = random_direction(&mut random) * random.range(0.0, 1.5);
        let along = random_direction(&mut random) * random.range(0.2, 3.0);
        // From zero to about two pixels wide.
        let wide = random_direction(&mut random) * 0.05 * (f64::from(k) / 120.0).powi(3);
        let color = tint(at * 3.0);
        mesh.add(&Shape::triangle(
            [at.into(), (at + along).into(), (at + 0.4 * along + wide).into()],
            [color[0], color[1], color[2]],
        ));
    }
    // Two corners at one place, three corners on a line, all corners at one place.
    for corners in [[0.0, 0.0, 1.0], [0.0, 0.5, 1.0], [0.5, 0.5, 0.5]] {
        let point = |t: f64| [t, 2.0 * t - 1.0, 0.3 * t];
        mesh.add(&Shape::triangle(corners.map(point), [255, 255, 255]));
    }
    // Slivers narrower than the grid's step may vanish, and rounding of two edges at once decides whether a thin triangle covers
    // a pixel.
    let tolerance = Tolerance { psnr: 40.0, stray: 3, ..Tolerance::default() };
    case("slivers", &mesh).check(&look([0.5, 1.0, 4.5], [0.0; 3], 45.0), &tolerance);
    let mut flat = Shape::triangle([[-1.0, 0.0, 0.0], [0.0; 3], [1.0, 0.0, 0.0]], [255; 3]);
    flat.add(&Shape::triangle([[0.3; 3], [0.3; 3], [0.7; 3]], [255; 3]));
    let frames =
        case("flat", &flat).check(&look([0.0, 1.0, 3.0], [0.0; 3], 45.0), &Tolerance::default());
    assert_eq!(frames.covered(), 0);
}

/// Intersecting triangles of all sizes, some behind the eye.
#[test]
fn a_soup() {
    let mut random = SplitMix64::new(9);
    let mut mesh = Shape::default();
    for _ in 0..500 {
        let centre = random_direction(&mut random) * random.range(0.0, 3.0);
        let size = 10f64.powf(random.range(-2.0, 0.3));
        let corners = [(); 3].map(|()| (centre + random_direction(&mut random) * size).into());
        let color = tint(centre);
        mesh.add(&Shape::triangle(corners, [color[0], color[1], color[2]]));
    }
    let case = case("soup", &mesh);
    for (eye, target) in [
        ([0.0, 0.0, 6.0], [0.0; 3]),
        ([0.5, 0.2, 0.3], [3.0, 1.0, -1.0]),
        ([4.0, 3.0, 1.0], [0.0; 3]),
    ] {
        let frames = case
            .check(&look(eye, target, 60.0), &Tolerance { unexplained: 2, ..Tolerance::default() });
        assert!(rasterised(&frames) > 10);
    }
}

/// One triangle per file, from two millimetres to kilometres away, partly overlapping. Each has a grid of its own, and 1/z
/// decides which one is in front.
#[test]
fn depths_from_near_to_far() {
    let (mut files, mut assets, mut nodes) = (vec![], json!({}), vec![]);
    for k in 0..8 {
        let depth = 0.002 * 8f64.powi(k);
        let (x, y) = (f64::from(k % 4) * 0.4 - 0.8, f64::from(k / 4) * 0.7 - 0.5);
        let corners = [[x, y], [x + 0.9, y - 0.2], [x + 0.2, y + 0.8]]
            .map(|[x, y]| [x * depth, y * depth, -depth]);
        let color = [(30 * k) as u8, 200, (255 - 30 * k) as u8];
        let name = format!("{k}.ply");
        files.push((name.clone(), Shape::triangle(corners, color).ply()));
        assets[k.to_string()] = json!({ "file": name });
        nodes.push(json!({ "asset": k.to_string() }));
    }
    let files: Vec<(&str, Vec<u8>)> =
        files.iter().map(|(name, bytes)| (name.as_str(), bytes.clone())).collect();
    let case = Case::new("depths", &files, &json!({ "assets": assets, "nodes": nodes }));
    let frames = case.check(&look([0.0; 3], [0.0, 0.0, -1.0], 70.0), &Tolerance::default());
    assert!((1..=8).all(|id| frames.id.contains(&id)));
}
