//! Surroundings against the oracle's integrals: reflected by every kind of surface, and behind them.

use std::f64::consts::{PI, TAU};

use glam::DVec3;
use pointillist::accuracy::metrics;
use pointillist::oracle::{self, OracleScene};
use pointillist::plan::{Effect, Pass, Reconstruct, Settings};
use pointillist::scene::{Shading, Tone, ToneMap};
use serde_json::{Value, json};

use super::files::{Glb, Shape};
use super::lines::vtk;
use super::orthographic;
use super::stage::{Case, Frames, folder, look};
use super::verdict::Tolerance;

/// A blue sky over a brown ground, with a warm lamp four times as bright as white.
fn sky() -> Vec<u8> {
    let (width, height) = (128u32, 64u32);
    let pixels: Vec<image::Rgb<f32>> = (0..width * height)
        .map(|i| {
            let turn = TAU * ((f64::from(i % width) + 0.5) / f64::from(width) - 0.5);
            let down = PI * (f64::from(i / width) + 0.5) / f64::from(height);
            let way = DVec3::new(down.sin() * turn.sin(), down.cos(), -down.sin() * turn.cos());
            let up = 0.5 + 0.5 * way.y;
            let lamp = DVec3::new(0.64, 0.48, 0.6);
            let bright = 4.0 * (-(way - lamp).length_squared() / 0.06).exp();
            let sky = [[0.25, 0.15], [0.2, 0.35], [0.12, 0.8]];
            let warm = [1.0, 0.8, 0.5];
            image::Rgb(std::array::from_fn(|c| {
                (sky[c][0] + (sky[c][1] - sky[c][0]) * up + bright * warm[c]) as f32
            }))
        })
        .collect();
    let mut bytes = Vec::new();
    let encoder = image::codecs::hdr::HdrEncoder::new(&mut bytes);
    encoder.encode(&pixels, width as usize, height as usize).unwrap();
    bytes
}

/// Balls of all roughnesses, of metal and not, a sheet, samples, and lines thick and thin, in a scene with these keys.
fn case(name: &str, more: Value) -> Case {
    let mut glb = Glb::new();
    for (row, metallic) in [0.0, 1.0].into_iter().enumerate() {
        for (column, roughness) in [0.0, 0.12, 0.35, 1.0].into_iter().enumerate() {
            let material = glb.material(json!({ "pbrMetallicRoughness": {
                "metallicFactor": metallic, "roughnessFactor": roughness, "baseColorFactor": [0.9, 0.7, 0.4, 1] } }));
            let ball = glb.mesh(&Shape::ball(48, 0.42), Some(material));
            glb.node(ball, json!({ "translation": [column as f64 - 1.5, row as f64, 0] }));
        }
    }
    let cloud = Shape { triangles: vec![], uvs: vec![], ..Shape::ball(60, 0.4) };
    let mut sheet = Shape::quad(DVec3::new(0.2, -1.3, 0.1), DVec3::X * 0.7, DVec3::Y * 0.6, 1.0);
    sheet.uvs.clear();
    let strand = |x: f64, radius: f64| {
        let color = [220, 210, 200];
        vec![
            (DVec3::new(x, -1.4, 0.0), radius, color),
            (DVec3::new(x + 0.3, -0.6, 0.2), radius, color),
        ]
    };
    let lines = vtk(&[strand(1.2, 0.1), strand(1.5, 0.008), strand(1.6, 0.006)]);
    let files = [
        ("m.glb", glb.finish()),
        ("cloud.ply", cloud.ply()),
        ("sheet.ply", sheet.ply()),
        ("l.vtk", lines),
        ("sky.hdr", sky()),
    ];
    let mut scene = json!({
        "assets": { "m": { "file": "m.glb" }, "cloud": { "file": "cloud.ply" }, "sheet": { "file": "sheet.ply" }, "l": { "file": "l.vtk" } },
        "materials": { "rough": { "metallic": 0.5, "roughness": 0.5 } },
        "nodes": [{ "asset": "m" }, { "asset": "cloud", "translate": [-1.5, -1, 0] }, { "asset": "sheet" }, { "asset": "l" },
            { "asset": "cloud", "translate": [-0.5, -1, 0], "material": "rough" }],
        "environment": { "file": "sky.hdr" },
    });
    for (key, value) in more.as_object().into_iter().flatten() {
        scene[key.as_str()] = value.clone();
    }
    Case::new(name, &files, &scene)
}

fn tolerance() -> Tolerance {
    Tolerance { unexplained: 8, at_edges: 60, shift_px: 0.0, ..Tolerance::samples() }
}

/// Without strands, whose outlines stand out against the background.
fn without_lines(name: &str, mut more: Value) -> Case {
    more["nodes"] = json!([{ "asset": "m" }, { "asset": "cloud", "translate": [-1.5, -1, 0] }, { "asset": "sheet" }]);
    case(name, more)
}

fn front() -> pointillist::math::View {
    look([0.3, 0.2, 5.0], [0.0, -0.1, 0.0], 42.0)
}

fn differences(frames: &Frames, found: &[[u8; 4]]) -> Vec<u8> {
    let apart = |(a, b): (&[u8; 4], &[u8; 4])| (0..3).map(|i| a[i].abs_diff(b[i])).max().unwrap();
    frames.color.iter().zip(found).map(apart).collect()
}

/// Triangles, points, tubes and lines thinner than a pixel, and what is behind them.
#[test]
fn surfaces_reflect_their_surroundings_as_the_reference_has_it() {
    let case = case("environment", json!({}));
    let tolerance = tolerance();
    for view in [
        front(),
        look([2.6, 1.2, 3.4], [0.0, -0.2, 0.0], 50.0),
        orthographic::look([-1.0, 1.5, 5.0], [0.0, -0.2, 0.0], 3.6),
    ] {
        let frames = case.check(&view, &tolerance);
        assert!(frames.ran(Pass::EnvironmentBackground));
    }
}

/// Turned, brighter, about another axis, beside other lights, through fog, and without being the background.
#[test]
fn surroundings_are_turned_and_seen_through_fog() {
    let turned = json!({ "file": "sky.hdr", "strength": 1.6, "turn": 130 });
    let tolerance = tolerance();
    without_lines("environment-turned", json!({ "environment": turned, "up": "z" }))
        .check(&front(), &tolerance);
    let unseen = json!({ "file": "sky.hdr", "background": false });
    let lights = json!([{ "kind": "sun", "direction": [-0.4, -1, -0.8], "intensity": 0.5 }, { "kind": "ambient", "intensity": 0.1 }]);
    let unseen =
        without_lines("environment-unseen", json!({ "environment": unseen, "lights": lights }));
    assert!(!unseen.check(&front(), &tolerance).ran(Pass::EnvironmentBackground));
    let even = json!({ "color": "#c0d0e8", "density": 0.08 });
    let foggy = without_lines("environment-even-fog", json!({ "fog": even }));
    assert!(!foggy.check(&front(), &tolerance).ran(Pass::EnvironmentBackground));
    let layered =
        json!({ "color": "#c0d0e8", "density": 0.3, "scale_height": 0.6, "base_height": -0.8 });
    let foggy = without_lines("environment-layered-fog", json!({ "fog": layered }));
    assert!(foggy.check(&front(), &tolerance).ran(Pass::EnvironmentBackground));
}

/// Splats that are lit one by one and afterwards, pulled and painted ones, and light that is mapped to what can be shown.
#[test]
fn splats_reflect_their_surroundings() {
    let case = case("environment-splats", json!({}));
    let view = front();
    let exact = Settings::exact();
    let scene = case.reference.scene();
    let splats = Some(case.reference.description().splats);
    let expected = oracle::render(&OracleScene { splats, ..scene.clone() }, &view, 1).to_rgba8();
    for shading in [Shading::Deferred, Shading::Splat] {
        let frames = case.draw_with(&view, Settings { shading: Some(shading), ..exact });
        let far = differences(&frames, &expected).iter().filter(|apart| **apart > 6).count();
        assert!(far * 500 < frames.color.len(), "{shading:?}: {far} pixels");
    }
    for how in [Reconstruct::PullPush, Reconstruct::Painted, Reconstruct::Fuzzy] {
        let frames = case.draw_wide(&view, Settings::drawn_as(how));
        let far = differences(&frames, &expected).iter().filter(|apart| **apart > 24).count();
        assert!(far * 40 < frames.color.len(), "{how:?}: {far} pixels");
    }
    let tone = Tone { map: ToneMap::Neutral, stops: 0.5 };
    let expected =
        oracle::render(&OracleScene { splats, tone: Some(tone), ..scene }, &view, 1).to_rgba8();
    let toned = Settings { tone_map: ToneMap::Neutral, exposure: 0.5.into(), ..exact };
    let frames = case.draw_with(&view, toned);
    let far = differences(&frames, &expected).iter().filter(|apart| **apart > 6).count();
    assert!(far * 500 < frames.color.len(), "toned: {far} pixels");
}

/// A file with metals, without a scene file. The studio is no background. Its lamps have sharp edges, so that the blurred images that shaders read are a little less exact.
#[test]
fn metals_of_bare_files_reflect_a_studio() {
    let mut glb = Glb::new();
    let metal =
        json!({ "metallicFactor": 1, "roughnessFactor": 0.2, "baseColorFactor": [1, 0.8, 0.5, 1] });
    let metal = glb.material(json!({ "pbrMetallicRoughness": metal }));
    let ball = glb.mesh(&Shape::ball(48, 1.0), Some(metal));
    glb.node(ball, json!({}));
    let path = folder().join("bare-metal.glb");
    std::fs::write(&path, glb.finish()).unwrap();
    let case = Case::load("bare-metal", &path);
    let view = look([0.4, 0.8, 4.0], [0.0; 3], 36.0);
    let frames = case.draw_with(&view, Settings::drawn_as(Reconstruct::Points));
    assert!(!frames.ran(Pass::EnvironmentBackground));
    let expected = case.reference.frame(&view, 1).to_rgba8();
    assert!(metrics::psnr(&expected, &frames.color).unwrap() > 41.0);
    let background = frames.color[0];
    let shown = frames.color.iter().filter(|color| **color != background);
    let bright = shown.clone().filter(|color| color[0] > 230).count();
    // The lamps of the studio, and its walls between them.
    assert!(bright * 50 > shown.clone().count() && bright * 2 < shown.count(), "{bright}");
}

/// Without the image, light of its mean comes from everywhere.
#[test]
fn surroundings_that_are_off_are_ambient_light() {
    let case = case("environment-off", json!({}));
    let points = Settings::drawn_as(Reconstruct::Points);
    let on = case.draw_with(&front(), points);
    let off = case.draw_with(&front(), Settings { environment: Effect::Off, ..points });
    assert!(!off.ran(Pass::EnvironmentBackground));
    let colors = |frames: &Frames, id: u32| -> Vec<[u8; 4]> {
        let shown = frames.id.iter().zip(&frames.color).filter(|(own, _)| **own == id);
        shown.map(|(_, color)| *color).collect()
    };
    // The eight balls of the file come before the samples and the sheet, whose model is Phong's.
    let sheet = colors(&off, 10);
    assert!(sheet.len() > 40 && sheet.iter().all(|color| *color == sheet[0]), "{sheet:?}");
    let mean = |frames: &Frames| {
        let shown: Vec<[u8; 4]> = (1..=10).flat_map(|id| colors(frames, id)).collect();
        shown.iter().map(|color| f64::from(color[1])).sum::<f64>() / shown.len() as f64
    };
    assert!((mean(&on) - mean(&off)).abs() < 30.0, "{} {}", mean(&on), mean(&off));
}
