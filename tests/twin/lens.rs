//! Depth of field and motion blur: frames are the means of their exposures, and blur is what a thin lens makes. Images of stereo pairs: as seen from beside the eye.

use std::f64::consts::PI;

use glam::{DVec2, DVec3, Vec3};
use pointillist::accuracy::metrics::psnr;
use pointillist::engine::Pose;
use pointillist::math::{Camera, View, exposures};
use pointillist::oracle::{self, OracleScene};
use pointillist::plan::{Antialias, BlurSamples, Pass, Reconstruct, Settings};
use pointillist::scene::Splats;
use pointillist::scene::color::{linear_from_srgb, srgb_from_linear};
use serde_json::json;

use super::files::Shape;
use super::lines::vtk;
use super::stage::{Case, Frames, look};
use super::verdict::{Tolerance, judge};

const LENS: f64 = 0.25;

fn settings(reconstruct: Reconstruct) -> Settings {
    Settings {
        aperture: LENS.into(),
        blur_samples: BlurSamples::Exposures16,
        ..Settings::drawn_as(reconstruct)
    }
}

/// A ball in focus, lines before it and a sheet of samples behind it.
fn case(name: &str, background: &str) -> Case {
    let spoke = |i: u32| {
        let (sin, cos) = (f64::from(i) * 0.7).sin_cos();
        let at = |reach: f64| (DVec3::new(cos, sin, 1.2) * reach, 0.03, [250, 220, 120]);
        vec![at(0.5), at(1.0)]
    };
    let spokes: Vec<_> = (0..9).map(spoke).collect();
    let mut sheet = Shape::default();
    let side = 40;
    for i in 0..side * side {
        let [x, y] = [i % side, i / side].map(|k| f64::from(k) / f64::from(side) - 0.48);
        sheet.positions.push(DVec3::new(5.0 * x, 4.0 * y, -2.0));
        sheet.colors.push([(i % 251) as u8, 120, 200, 255]);
        sheet.normals.push(Vec3::Z);
    }
    let files =
        [("m.ply", Shape::ball(24, 0.6).ply()), ("l.vtk", vtk(&spokes)), ("p.ply", sheet.ply())];
    let scene = json!({
        "assets": { "m": { "file": "m.ply" }, "l": { "file": "l.vtk" }, "p": { "file": "p.ply" } },
        "nodes": [{ "asset": "m" }, { "asset": "l" }, { "asset": "p" }],
        "lights": [{ "kind": "ambient", "intensity": 0.2 }, { "kind": "sun", "direction": [0.3, -1, -0.2] }],
        "background": background,
    });
    Case::new(name, &files, &scene)
}

/// The mean of images of words with straight alpha, in linear light.
fn mean(images: &[Vec<[u8; 4]>]) -> Vec<[u8; 4]> {
    let pixel = |i: usize| {
        let (mut light, mut alpha) = ([0.0; 3], 0.0);
        for image in images {
            let own = f64::from(image[i][3]) / 255.0;
            let linear = |byte: u8| linear_from_srgb(f64::from(byte) / 255.0);
            (0..3).for_each(|channel| light[channel] += linear(image[i][channel]) * own);
            alpha += own;
        }
        if alpha == 0.0 {
            return images[0][i];
        }
        let byte = |unit: f64| (255.0 * unit).round() as u8;
        let [r, g, b] = light.map(|sum| byte(srgb_from_linear(sum / alpha)));
        [r, g, b, byte(alpha / images.len() as f64)]
    };
    (0..images[0].len()).map(pixel).collect()
}

/// The views of a frame's exposures.
fn views(view: &View, count: u32, parts: u32) -> Vec<View> {
    exposures(count)
        .map(|one| {
            let beside = view.from_lens(0.5 * LENS * one.on_lens, view.focus);
            beside.moved(one.in_pixel / f64::from(parts))
        })
        .collect()
}

/// Ways to draw samples, in the engine and in the oracle.
fn ways() -> [(Reconstruct, Option<Splats>); 2] {
    [(Reconstruct::Points, None), (Reconstruct::Splats, Some(Splats::default()))]
}

/// Compares a blurred frame with the mean of the oracle's images from `views`. The `sharp` frame is that of a pinhole at the frame's own time.
fn judge_mean(
    case: &Case,
    splats: Option<Splats>,
    views: &[View],
    blurred: &Frames,
    sharp: &Frames,
) {
    assert!(!sharp.ran(Pass::Accumulate));
    assert!(blurred.ran(Pass::Accumulate) && !blurred.ran(Pass::Average));
    let scene = OracleScene { splats, ..case.reference.scene() };
    let drawn: Vec<_> =
        views.iter().map(|view| oracle::render(&scene, view, 1).to_rgba8()).collect();
    let exact = mean(&drawn);
    let [like, unlike] = [blurred, sharp].map(|frames| psnr(&exact, &frames.color).unwrap());
    println!("{}, {splats:?}: {like:.1} dB; without blur {unlike:.1} dB", case.id);
    assert!(like > 45.0 && like > unlike + 15.0, "{} {splats:?}: {like}", case.id);
    // The other outputs are sharp.
    assert_eq!((&blurred.id, &blurred.depth), (&sharp.id, &sharp.depth));
    assert_eq!(blurred.normal, sharp.normal);
}

#[test]
fn frames_are_means_of_what_the_oracle_shows() {
    let view = look([0.3, 0.4, 4.0], [0.0; 3], 45.0);
    for (name, background) in [("lens", "#304050"), ("lens-alpha", "#30405000")] {
        let case = case(name, background);
        for (reconstruct, splats) in ways() {
            let sharp = case.draw_with(&view, Settings::drawn_as(reconstruct));
            let blurred = case.draw_with(&view, settings(reconstruct));
            judge_mean(&case, splats, &views(&view, 16, 1), &blurred, &sharp);
        }
    }
}

/// A camera that moves sideways and turns while the shutter is open: each exposure shows the scene at its own time.
#[test]
fn moving_frames_are_means_of_what_the_oracle_shows() {
    let case = case("shutter", "#304050");
    let size @ (width, height) = (160, 120);
    let camera = |time: f64| {
        Camera::perspective(
            DVec3::new(0.05 + 0.5 * time, 0.4, 4.0),
            DVec3::new(0.15 - 0.3 * time, 0.0, 0.0),
            45.0,
        )
    };
    let view = |time: f64| camera(time).view(width, height).unwrap();
    let views: Vec<View> = exposures(16).map(|one| view(one.time).moved(one.in_pixel)).collect();
    let exposed: Vec<Camera> = exposures(16).map(|one| camera(one.time)).collect();
    let pose = Pose::Moving { camera: camera(0.5), exposed: exposed.into() };
    for (reconstruct, splats) in ways() {
        let sharp = case.draw_with(&view(0.5), Settings::drawn_as(reconstruct));
        let open = Settings {
            shutter: 0.5.into(),
            blur_samples: BlurSamples::Exposures16,
            ..Settings::drawn_as(reconstruct)
        };
        let blurred = case.draw_from(&pose, size, open);
        judge_mean(&case, splats, &views, &blurred, &sharp);
    }
}

/// With antialiasing, each exposure sees other points of the parts.
#[test]
fn parts_of_pixels_are_averaged_with_the_exposures() {
    let case = case("lens-parts", "#304050");
    let view = look([0.3, 0.4, 4.0], [0.0; 3], 45.0);
    let asked = Settings { antialias: Antialias::Parts4, ..settings(Reconstruct::Points) };
    let frames = case.draw_wide(&view, asked);
    assert!(frames.ran(Pass::Accumulate) && !frames.ran(Pass::Average));
    let fine = Settings { antialias: Antialias::Parts4, ..Settings::drawn_as(Reconstruct::Points) };
    let drawn: Vec<_> =
        views(&view, 16, 2).iter().map(|view| case.draw_wide(view, fine).color).collect();
    let expected = mean(&drawn);
    // Frames of bytes are rounded before they are averaged here.
    let worst = expected.as_flattened().iter().zip(frames.color.as_flattened());
    let worst = worst.map(|(a, b)| a.abs_diff(*b)).max().unwrap();
    assert!(worst <= 3, "{worst}");
}

/// Light of a pixel's red, linear.
fn light(pixel: [u8; 4]) -> f64 {
    linear_from_srgb(f64::from(pixel[0]) / 255.0)
}

/// A point out of focus becomes a disc of the circle of confusion's diameter, `focal · aperture · |1 / focus − 1 / depth|`, and keeps its light.
#[test]
fn a_point_becomes_the_circle_of_confusion() {
    for (number, depth) in [0.9, 1.2, 8.0, 1e4].into_iter().enumerate() {
        let shape = Shape {
            positions: vec![DVec3::new(0.0, 0.0, 2.0 - depth)],
            colors: vec![[255; 4]],
            ..Shape::default()
        };
        let scene = json!({
            "assets": { "p": { "file": "p.ply" } },
            "nodes": [{ "asset": "p" }],
            "lights": [],
            "background": "#000000",
        });
        let name = format!("lens-point-{number}");
        let case = Case::new(&name, &[("p.ply", shape.ply())], &scene);
        let view = look([0.0, 0.0, 2.0], [0.0; 3], 45.0);
        let asked = Settings {
            aperture: 0.12.into(),
            blur_samples: BlurSamples::Exposures256,
            ..Settings::drawn_as(Reconstruct::Points)
        };
        let frames = case.draw_wide(&view, asked);
        let radius = 0.5 * view.focal_px.x * 0.12 * (1.0 / 2.0 - 1.0 / depth).abs();
        let (mut sum, mut middle, mut square) = (0.0, DVec2::ZERO, 0.0);
        for (i, &pixel) in frames.color.iter().enumerate() {
            let at = DVec2::new((i % 160) as f64 + 0.5, (i / 160) as f64 + 0.5);
            let offset = at - view.principal_px;
            let own = light(pixel);
            sum += own;
            middle += offset * own;
            square += offset.length_squared() * own;
            assert!(own == 0.0 || offset.length() < radius + 1.5, "{depth}: {offset}");
        }
        // A point shows in the pixel that it falls into, which adds a sixth to the variance along each axis.
        let found = (2.0 * (square / sum - 1.0 / 3.0)).sqrt();
        println!(
            "depth {depth}: radius {found:.3} px, expected {radius:.3}; light {sum:.4}; middle {}",
            middle / sum
        );
        assert!((sum - 1.0).abs() < 0.03, "{depth}: {sum}");
        assert!((found / radius - 1.0).abs() < 0.02, "{depth}: {found} and {radius}");
        assert!((middle / sum).length() < 0.1, "{depth}: {}", middle / sum);
    }
}

/// Across the edge of a surface out of focus, brightness grows as the share of a disc on one side of a line.
#[test]
fn an_edge_is_blurred_as_by_a_disc() {
    let depth = 5.0;
    let corner = |x: f64, y: f64| DVec3::new(x, y, 2.0 - depth);
    let quad = Shape {
        positions: vec![corner(0.0, -9.0), corner(9.0, -9.0), corner(9.0, 9.0), corner(0.0, 9.0)],
        colors: vec![[255; 4]; 4],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Shape::default()
    };
    let scene = json!({
        "assets": { "q": { "file": "q.ply" } },
        "nodes": [{ "asset": "q" }],
        "lights": [],
        "background": "#000000",
    });
    let case = Case::new("lens-edge", &[("q.ply", quad.ply())], &scene);
    let view = look([0.0, 0.0, 2.0], [0.0; 3], 45.0);
    let radius = 0.5 * view.focal_px.x * 0.3 * (1.0 / 2.0 - 1.0 / depth);
    let share = |x: f64| {
        let t = (x / radius).clamp(-1.0, 1.0);
        0.5 + (t * (1.0 - t * t).sqrt() + t.asin()) / PI
    };
    let mut before = f64::INFINITY;
    for (count, most) in [(BlurSamples::Exposures32, 0.06), (BlurSamples::Exposures256, 0.016)] {
        let asked = Settings {
            aperture: 0.3.into(),
            blur_samples: count,
            ..Settings::drawn_as(Reconstruct::Points)
        };
        let frames = case.draw_wide(&view, asked);
        let error = |column: usize| {
            let part = |k: u32| column as f64 - 80.0 + (f64::from(k) + 0.5) / 64.0;
            let expected = (0..64).map(|k| share(part(k))).sum::<f64>() / 64.0;
            (light(frames.color[60 * 160 + column]) - expected).abs()
        };
        let worst = (0..160).map(error).fold(0.0, f64::max);
        println!("{count:?}: radius {radius:.2} px, error {worst:.4}");
        assert!(radius > 6.0 && worst < most && worst < before, "{count:?}: {worst}");
        before = worst;
    }
}

/// The oracle draws what an eye beside the camera sees, through a frustum whose plane of equal places goes through the target.
#[test]
fn images_of_stereo_pairs_are_the_oracles() {
    let scene = json!({ "assets": { "m": { "file": "m.ply" } }, "nodes": [{ "asset": "m" }] });
    let case = Case::new("stereo", &[("m.ply", Shape::ball(40, 1.0).ply())], &scene);
    let view = look([0.0, 0.5, 4.0], [0.1, 0.0, 0.0], 45.0);
    for offset in [-0.3, 0.3] {
        let asked = Settings::drawn_as(Reconstruct::Points).shifted(offset);
        let frames = case.draw_with(&view, asked);
        let beside = view.from_lens(DVec2::new(offset, 0.0), view.focus);
        judge(&case.id, &case.reference, &beside, &frames, &Tolerance::default());
    }
}
