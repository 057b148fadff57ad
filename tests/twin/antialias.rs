//! Antialiasing: pixels are the means of their parts, as in the reference.

use glam::{DVec3, Vec3};
use pointillist::accuracy::metrics::psnr;
use pointillist::plan::{Antialias, Edl, Pass, Reconstruct, Settings};
use pointillist::scene::color::linear_from_srgb;
use serde_json::json;

use super::files::Shape;
use super::lines::vtk;
use super::stage::{Case, look};

fn settings(antialias: Antialias) -> Settings {
    Settings { antialias, ..Settings::drawn_as(Reconstruct::Points) }
}

fn case(name: &str, background: &str, radius: f64) -> Case {
    let spoke = |i: u32| {
        let (sin, cos) = (f64::from(i) * 0.7).sin_cos();
        let at = |reach: f64| (DVec3::new(cos, sin, 0.2) * reach, radius, [250, 220, 120]);
        vec![at(0.7), at(1.6)]
    };
    let spokes: Vec<_> = (0..9).map(spoke).collect();
    let files = [("m.ply", Shape::ball(24, 0.6).ply()), ("l.vtk", vtk(&spokes))];
    let scene = json!({
        "assets": { "m": { "file": "m.ply" }, "l": { "file": "l.vtk" } },
        "nodes": [{ "asset": "m" }, { "asset": "l" }],
        "lights": [{ "kind": "ambient", "intensity": 0.2 }, { "kind": "sun", "direction": [0.3, -1, -0.2] }],
        "background": background,
    });
    Case::new(name, &files, &scene)
}

#[test]
fn pixels_are_means_of_their_parts() {
    let case = case("antialias", "#304050", 0.03);
    let view = look([0.3, 0.4, 4.0], [0.0; 3], 45.0);
    let plain = case.draw_with(&view, settings(Antialias::Off));
    assert!(!plain.ran(Pass::Average));
    let truth = case.reference.frame(&view, 8).to_rgba8();
    let mut before = psnr(&truth, &plain.color).unwrap();
    for (antialias, parts) in [(Antialias::Parts4, 2), (Antialias::Parts16, 4)] {
        let frames = case.draw_with(&view, settings(antialias));
        let exact = case.reference.frame(&view, parts).to_rgba8();
        let (like, near) =
            (psnr(&exact, &frames.color).unwrap(), psnr(&truth, &frames.color).unwrap());
        println!(
            "{parts} × {parts}: {like:.1} dB from the reference, {near:.1} dB from 8 × 8 ({before:.1} before)"
        );
        assert!(like > 45.0, "{like}");
        assert!(near > before + 2.0, "{near} after {before}");
        before = near;
        // The other outputs have no means.
        assert_eq!((&frames.id, &frames.depth), (&plain.id, &plain.depth));
        assert_eq!(frames.normal, plain.normal);
        // Where nothing changes from part to part, a pixel is what it was.
        assert_eq!(frames.color[0], plain.color[0]);
        assert_eq!(case.draw_with(&view, settings(Antialias::Off)).color, plain.color);
    }
}

#[test]
fn edges_before_a_transparent_background_have_the_colours_of_what_they_show() {
    let case = case("antialias-alpha", "#304050", 0.004);
    let background = serde_json::from_value(json!("transparent")).unwrap();
    let settings = |antialias| Settings { background: Some(background), ..settings(antialias) };
    let view = look([0.3, 0.4, 4.0], [0.0; 3], 45.0);
    let plain = case.draw_with(&view, settings(Antialias::Off));
    let frames = case.draw_with(&view, settings(Antialias::Parts16));
    let shades = |color: &[[u8; 4]]| {
        let mut alphas: Vec<u8> = color.iter().map(|pixel| pixel[3]).collect();
        alphas.sort_unstable();
        alphas.dedup();
        alphas
    };
    assert_eq!(shades(&plain.color), [0, 255]);
    let shades = shades(&frames.color);
    assert!((12..=17).contains(&shades.len()), "sixteenths: {shades:?}");
    // Lines are of one colour, however little of a pixel they cover.
    let line = plain.id.iter().position(|&id| id == 2).unwrap();
    let [r, g, b, _] = plain.color[line];
    let ratio = |[r, g, ..]: [u8; 4]| f64::from(r) / f64::from(g.max(1));
    let thin = frames
        .color
        .iter()
        .filter(|pixel| (1..100).contains(&pixel[3]) && pixel[2] < pixel[0] / 2 + 40);
    let mut count = 0;
    for pixel in thin.filter(|pixel| pixel[0] > r / 2) {
        assert!(
            (ratio(*pixel) - ratio([r, g, b, 255])).abs() < 0.25,
            "{pixel:?} for {r}, {g}, {b}"
        );
        count += 1;
    }
    assert!(count > 20, "{count}");
}

/// Points cover a pixel, and splats have a filter of their pixels, however many parts a pixel has.
#[test]
fn samples_are_as_large_as_without() {
    let side = 24;
    let mut points = Shape::default();
    for i in 0..side * side {
        let [x, y] = [i % side, i / side].map(|k| f64::from(k) / f64::from(side) - 0.48);
        points.positions.push(DVec3::new(x, y, 0.0));
        points.colors.push([250, 220, 120, 255]);
        points.normals.push(Vec3::Z);
    }
    let files = [("p.ply", points.ply())];
    let scene = json!({
        "assets": { "p": { "file": "p.ply" } },
        "nodes": [{ "asset": "p" }],
        "background": "#000000",
        "splats": { "lowpass": 2.5 },
    });
    let case = Case::new("antialias-samples", &files, &scene);
    let view = look([0.1, 0.2, 3.0], [0.0; 3], 45.0);
    for reconstruct in [Reconstruct::Points, Reconstruct::Splats, Reconstruct::Fuzzy] {
        let [plain, fine] = [Antialias::Off, Antialias::Parts16].map(|antialias| {
            let settings = Settings { antialias, ..Settings::drawn_as(reconstruct) };
            mean(&case.draw_wide(&view, settings).color)
        });
        println!("{reconstruct:?}: {plain:.4}, of 16 parts {fine:.4}");
        // A round point has π/4 of the light of a square one.
        let least = if reconstruct == Reconstruct::Points { 0.7 } else { 0.95 };
        assert!((least..1.05).contains(&(fine / plain)), "{reconstruct:?}: {fine} and {plain}");
    }
}

/// The mean red of a picture, in linear light.
fn mean(color: &[[u8; 4]]) -> f64 {
    let linear = |pixel: &[u8; 4]| linear_from_srgb(f64::from(pixel[0]) / 255.0);
    color.iter().map(linear).sum::<f64>() / color.len() as f64
}

/// Lengths in pixels are those of pixels, not of their parts.
#[test]
fn lengths_stay_what_they_are() {
    let case = case("antialias-lengths", "#000000", 0.004);
    let view = look([0.3, 0.4, 4.0], [0.0; 3], 45.0);
    for base in [
        Settings { line_width_px: 3.0.into(), ..settings(Antialias::Off) },
        Settings {
            edl: Edl::On,
            edl_radius_px: 4.0.into(),
            line_width_px: 3.0.into(),
            ..settings(Antialias::Off)
        },
    ] {
        let [plain, fine] = [Antialias::Off, Antialias::Parts16]
            .map(|antialias| mean(&case.draw_with(&view, Settings { antialias, ..base }).color));
        assert!((fine / plain - 1.0).abs() < 0.03, "{fine} and {plain}: {base:?}");
    }
}
