//! Samples drawn as single pixels.

use glam::{DVec2, DVec3, Vec3};
use pointillist::math::{Camera, Lens};
use serde_json::json;

use super::files::Shape;
use super::stage::{Case, look};
use super::verdict::Tolerance;

fn case(name: &str, cloud: &Shape) -> Case {
    let scene = json!({ "assets": { "c": { "file": "c.ply" } }, "nodes": [{ "asset": "c" }] });
    Case::new(name, &[("c.ply", cloud.ply())], &scene)
}

#[test]
fn dense_samples() {
    let case = case("dense", &Shape::cloud(60_000, [-1.0; 3], [1.0; 3], 1));
    let frames = case.check(&look([1.0, 1.5, 4.0], [0.0; 3], 40.0), &Tolerance::samples());
    let covered = frames.covered();
    assert!(covered > 6_000, "{covered}");
    assert_eq!(frames.receipt.samples.stored, 60_000);
    assert_eq!(frames.receipt.samples.drawn, Some(covered as u64));
}

#[test]
fn sparse_samples_without_normals() {
    let case = case("sparse", &Shape::cloud(400, [-1.0; 3], [1.0; 3], 2).without_normals());
    for eye in [[3.0, 1.0, 2.0], [-0.3, 4.0, 0.2], [0.0, -2.0, -3.0]] {
        case.check(&look(eye, [0.0; 3], 50.0), &Tolerance::samples());
    }
}

#[test]
fn samples_on_a_sphere_turn_towards_the_eye() {
    let mut cloud = Shape::cloud(20_000, [-1.0; 3], [1.0; 3], 3);
    for (position, normal) in cloud.positions.iter_mut().zip(&mut cloud.normals) {
        *position /= position.length();
        // Half of the normals point inwards.
        *normal = position.as_vec3() * if normal.x > 0.0 { 1.0 } else { -1.0 };
    }
    let case = case("sphere-samples", &cloud);
    case.check(&look([0.0, 1.0, 3.0], [0.0; 3], 45.0), &Tolerance::samples());
}

/// The eye is inside the cloud, with samples beside, behind and in front of it.
#[test]
fn samples_around_the_eye() {
    let mut cloud = Shape::cloud(8_000, [-5.0; 3], [5.0; 3], 4);
    let eye = DVec3::new(0.3, -0.2, 0.5);
    let near: Vec<bool> = cloud.positions.iter().map(|p| (p - eye).length() < 0.3).collect();
    for (position, near) in cloud.positions.iter_mut().zip(near) {
        // With 21 bits per coordinate, a sample of a large chunk is uncertain by a few millionths of the chunk's size.
        *position *= if near { 5.0 } else { 1.0 };
    }
    let case = case("around", &cloud);
    for target in [[1.0, 0.0, 0.0], [-1.0, 2.0, 0.5], [0.0, -3.0, 1.0]] {
        case.check(&look(eye.into(), target, 75.0), &Tolerance::samples());
    }
}

/// A sample a hundredth of a pixel inside the frame is drawn, and one outside is not.
#[test]
fn samples_at_the_frames_edges() {
    let view = look([0.0, 0.0, 5.0], [0.0; 3], 40.0);
    let (w, h) = (f64::from(view.width), f64::from(view.height));
    let mut cloud = Shape::default();
    let mut place = |x: f64, y: f64| {
        let ray = view.view_from_world.transpose() * view.ray(DVec2::new(x, y));
        cloud.positions.push(view.eye + ray * (4.0 + 0.01 * x));
        cloud.colors.push([(x as i64 & 255) as u8, (y as i64 & 255) as u8, 200, 255]);
        cloud.normals.push(Vec3::Z);
    };
    let mut inside = 0;
    for k in 0..30 {
        let centre = |size: f64| (f64::from(k) / 30.0 * size).floor() + 0.5;
        for off in [-0.01, 0.01] {
            place(centre(w), -off);
            place(centre(w), h + off);
            place(-off, centre(h));
            place(w + off, centre(h));
            inside += if off < 0.0 { 4 } else { 0 };
        }
    }
    for (x, y) in [(0.0, 0.0), (w, 0.0), (0.0, h), (w, h)] {
        for (dx, dy) in [(-0.01, -0.01), (0.01, -0.01), (-0.01, 0.01), (0.01, 0.01)] {
            place(x + dx, y + dy);
        }
    }
    let frames = case("edges", &cloud).check(&view, &Tolerance::samples());
    let covered = frames.covered();
    // One of the four samples around each corner is inside. The ends of the rows share its pixel.
    assert!(covered <= inside + 4 && covered >= inside - 12, "{covered} of {inside}");
    let on_edge = |i: usize| {
        let (x, y) = (i % 160, i / 160);
        x == 0 || y == 0 || x == 159 || y == 119
    };
    assert!((0..frames.id.len()).all(|i| frames.id[i] == 0 || on_edge(i)));
}

/// The nearest of many samples in a pixel wins, at the smallest depth differences that 24 bits resolve.
#[test]
fn the_nearest_of_a_column_wins() {
    let mut cloud = Shape::default();
    for k in 0..500 {
        // Not in order of depth.
        let step = f64::from(k * 137 % 500);
        cloud.positions.push(DVec3::new(0.001, 0.002, -1e-5 * step));
        cloud.colors.push([(step as u32 / 2) as u8, 255 - (step as u32 / 2) as u8, 0, 255]);
        cloud.normals.push(Vec3::Z);
    }
    let case = case("column", &cloud);
    let frames = case.check(&look([0.0, 0.0, 2.0], [0.0; 3], 40.0), &Tolerance::samples());
    assert_eq!(frames.covered(), 1);
}

#[test]
fn a_lone_sample_and_a_view_that_sees_nothing() {
    let case = case("lone", &Shape::cloud(1, [-0.1; 3], [0.1; 3], 5));
    let seen = case.check(&look([0.0, 0.0, 2.0], [0.0; 3], 40.0), &Tolerance::samples());
    assert_eq!(seen.covered(), 1);
    let unseen = case.check(&look([0.0, 0.0, 2.0], [0.0, 0.0, 4.0], 40.0), &Tolerance::samples());
    assert!(unseen.id.iter().all(|&id| id == 0));
}

/// Off-centre, anisotropic projections are given as matrices.
#[test]
fn an_off_centre_view() {
    let case = case("off-centre", &Shape::cloud(20_000, [-1.0; 3], [1.0; 3], 6));
    let (eye, up) = (DVec3::new(2.0, 1.0, 3.0), DVec3::new(0.3, 1.0, 0.1));
    let camera = Camera { eye, target: DVec3::ZERO, up, lens: Lens::Perspective { fov_deg: 45.0 } };
    let mut view = camera.view(161, 97).unwrap();
    view.focal_px.x *= 1.3;
    view.principal_px += DVec2::new(23.3, -11.7);
    case.check(&view, &Tolerance::samples());
}
