//! Fog against the oracle's: before every kind of surface, however it is drawn, and before the background.

use glam::DVec3;
use pointillist::accuracy::metrics;
use pointillist::math::View;
use pointillist::oracle::color::srgb8_from_linear;
use pointillist::oracle::{self, OracleScene};
use pointillist::plan::{Background, Edl, Effect, Pass, Reconstruct, Reconstruction, Settings};
use pointillist::scene::{Blend, EyeDome, Filter, Shading};
use serde_json::{Value, json};

use super::files::{Glb, Shape};
use super::lines::vtk;
use super::orthographic;
use super::splats::{self, ball, save_both};
use super::stage::{Case, Frames, look};
use super::verdict::Tolerance;

fn even() -> Value {
    json!({ "color": "#c0d0e8", "density": 0.12 })
}

fn layered() -> Value {
    json!({ "color": "#e8d8c0", "density": 0.5, "scale_height": 0.6, "base_height": -0.8 })
}

fn lights() -> Value {
    json!([{ "kind": "ambient", "intensity": 0.3 }, { "kind": "sun", "direction": [0.3, -1, -0.6], "intensity": 0.8 }])
}

/// Balls, samples, tubes and a pane over a floor that reaches far away.
fn everything(name: &str, fog: &Value) -> Case {
    let mut floor =
        Shape::quad(DVec3::new(-40.0, -1.0, 40.0), DVec3::X * 80.0, DVec3::NEG_Z * 80.0, 1.0);
    floor.uvs.clear();
    let cloud = Shape { triangles: vec![], uvs: vec![], ..Shape::ball(50, 0.8) };
    let strand = |x: f64| {
        vec![
            (DVec3::new(x, -1.0, 0.4), 0.08, [200, 90, 60]),
            (DVec3::new(x - 0.5, 1.2, -2.0), 0.05, [60, 90, 200]),
        ]
    };
    let mut glb = Glb::new();
    let glass = glb.material(json!({ "alphaMode": "BLEND", "doubleSided": true,
        "pbrMetallicRoughness": { "baseColorFactor": [0.2, 0.7, 0.4, 0.4] } }));
    let pane = glb.mesh(
        &Shape::quad(DVec3::new(-2.0, -1.0, 0.9), DVec3::X * 2.2, DVec3::Y * 1.4, 1.0),
        Some(glass),
    );
    glb.node(pane, json!({}));
    let files = [
        ("floor.ply", floor.ply()),
        ("ball.ply", Shape::ball(32, 0.9).ply()),
        ("cloud.ply", cloud.ply()),
        ("l.vtk", vtk(&[strand(0.2), strand(1.4)])),
        ("pane.glb", glb.finish()),
    ];
    let scene = json!({
        "assets": { "floor": { "file": "floor.ply" }, "ball": { "file": "ball.ply" }, "cloud": { "file": "cloud.ply" },
            "l": { "file": "l.vtk" }, "pane": { "file": "pane.glb" } },
        "nodes": [{ "asset": "floor" }, { "asset": "l" }, { "asset": "pane" },
            { "asset": "ball", "translate": [-1, 0, -1], "repeat": { "grid": [1, 1, 5], "step": [0, 0, 3] } },
            { "asset": "cloud", "translate": [1.2, 0, -2], "repeat": { "grid": [1, 1, 3], "step": [0, 0, 4] } }],
        "lights": lights(), "fog": fog, "background": "#3060a0",
    });
    Case::new(name, &files, &scene)
}

#[test]
fn fog_lies_before_triangles_points_lines_layers_and_the_background() {
    for (name, fog) in [("fog-even", even()), ("fog-layered", layered())] {
        let case = everything(name, &fog);
        let tolerance = Tolerance { unexplained: 8, at_edges: 24, ..Tolerance::samples() };
        for view in [
            look([0.4, 0.6, 6.5], [0.0, 0.0, -1.0], 55.0),
            look([0.4, 3.0, 7.5], [0.0, 1.5, -1.0], 70.0),
            orthographic::look([0.8, 2.0, 7.0], [0.0, 0.0, -1.0], 5.0),
        ] {
            let frames = case.check(&view, &tolerance);
            assert_eq!(frames.ran(Pass::FogBackground), name == "fog-layered");
            assert!(frames.ran(Pass::CompositeLayers));
            let clear = case.draw_wide(
                &view,
                Settings { fog: Effect::Off, ..Settings::drawn_as(Reconstruct::Points) },
            );
            let differ = frames
                .color
                .iter()
                .zip(&clear.color)
                .filter(|(a, b)| a[0].abs_diff(b[0]) > 12)
                .count();
            assert!(differ > 3000, "{differ} pixels are foggy");
        }
        // Splats beside all of that, lit before or after they are blended.
        let view = look([0.4, 0.6, 6.5], [0.0, 0.0, -1.0], 55.0);
        for shading in [Shading::Deferred, Shading::Splat] {
            let settings =
                Settings { shading: Some(shading), ..splats::splats(Filter::Perspective) };
            splats::check(&case, &view, settings, settings, 36.0);
        }
    }
}

fn samples(name: &str, fog: &Value, lights: &Value) -> Case {
    splats::case(
        name,
        &ball(3000, 7),
        json!({ "fog": fog, "lights": lights, "background": "#203040",
        "nodes": [{ "asset": "c", "repeat": { "grid": [2, 1, 3], "step": [2.4, 0, 3] } }] }),
    )
}

fn psnr(case: &Case, view: &View, frames: &Frames, scene: &OracleScene<'_>) -> f64 {
    let twin = oracle::render(scene, view, 1).to_rgba8();
    let found = metrics::psnr(&twin, &frames.color).unwrap();
    save_both(case, view, twin, frames.color.clone());
    found
}

/// Splats are seen through fog once they are blended, lit or not; methods that leave no depths see each splat through it.
#[test]
fn fog_lies_before_splats_in_every_method() {
    let views = [
        look([0.4, 1.0, 7.0], [0.0, 0.0, -1.0], 45.0),
        orthographic::look([0.4, 1.0, 7.0], [0.0, 0.0, -1.0], 5.0),
    ];
    for (name, fog, lights) in [("lit", layered(), lights()), ("unlit", even(), json!([]))] {
        let case = samples(&format!("fog-splats-{name}"), &fog, &lights);
        for view in &views {
            for (blend, shading, least) in [
                (Blend::Weighted, Shading::Deferred, 40.0),
                (Blend::Weighted, Shading::Splat, 40.0),
                (Blend::Opaque, Shading::Deferred, 32.0),
            ] {
                let settings = Settings {
                    blend: Some(blend),
                    shading: Some(shading),
                    ..splats::splats(Filter::Perspective)
                };
                splats::check(&case, view, settings, settings, least);
            }
            let three =
                Settings { shading: Some(Shading::Splat), ..splats::splats(Filter::Perspective) };
            let own =
                Reconstruction::new(&three, &case.reference.description().splats).splats().copied();
            let scene = OracleScene { splats: own, ..case.reference.scene() };
            for reconstruct in [Reconstruct::Fuzzy, Reconstruct::Painted, Reconstruct::PullPush] {
                let settings = Settings::drawn_as(reconstruct);
                let frames = case.draw_wide(view, settings);
                assert_eq!(frames.receipt.settings.instead_because, None);
                let method = Reconstruction::new(&settings, &case.reference.description().splats);
                let scene = match reconstruct {
                    Reconstruct::Painted => {
                        OracleScene { painted: Some(settings.painted_as), ..scene.clone() }
                    }
                    Reconstruct::PullPush => OracleScene {
                        splats: None,
                        pull_push: method.pull_push().copied(),
                        ..scene.clone()
                    },
                    _ => scene.clone(),
                };
                let found = psnr(&case, view, &frames, &scene);
                let clear = case.draw_wide(view, Settings { fog: Effect::Off, ..settings });
                let without = psnr(&case, view, &clear, &OracleScene { fog: None, ..scene });
                println!("{name} {reconstruct:?}: {found:.1} dB, {without:.1} dB without fog");
                assert!(found >= without - 1.5, "{name} {reconstruct:?}: {found} dB, {without} dB");
            }
        }
    }
}

#[test]
fn fog_lies_before_the_shade_of_eye_dome_lighting() {
    let case = samples("fog-edl", &even(), &json!([]));
    let view = look([0.4, 1.0, 7.0], [0.0, 0.0, -1.0], 45.0);
    let settings = Settings { edl: Edl::On, ..Settings::drawn_as(Reconstruct::Points) };
    let frames = case.draw_with(&view, settings);
    let edl =
        EyeDome { strength: settings.edl_strength.get(), radius_px: settings.edl_radius_px.get() };
    let found =
        psnr(&case, &view, &frames, &OracleScene { edl: Some(edl), ..case.reference.scene() });
    assert!(found > 38.0, "{found} dB");
}

/// White that is not lit, behind black fog: bytes are those of the formula in f64 for the frame's own depths.
fn check_bytes(
    name: &str,
    fog: &Value,
    offset: DVec3,
    views: &[View],
    transmittance: impl Fn(DVec3, DVec3) -> f64,
) {
    let mut floor =
        Shape::quad(offset + DVec3::new(-3e3, 0.0, 3e3), DVec3::X * 6e3, DVec3::NEG_Z * 6e3, 1.0);
    floor.uvs.clear();
    floor.colors = vec![[255; 4]; 4];
    let mut wall =
        Shape::quad(offset + DVec3::new(-2e3, 0.0, -1e3), DVec3::X * 4e3, DVec3::Y * 4e3, 1.0);
    wall.uvs.clear();
    wall.colors = vec![[255; 4]; 4];
    let scene = json!({ "assets": { "f": { "file": "f.ply" }, "w": { "file": "w.ply" } },
        "nodes": [{ "asset": "f" }, { "asset": "w" }], "lights": [], "fog": fog, "background": "#000000",
        "materials": {} });
    let case = Case::new(name, &[("f.ply", floor.ply()), ("w.ply", wall.ply())], &scene);
    for view in views {
        let view = View { eye: view.eye + offset, ..*view };
        let frames = case.draw_with(&view, Settings::drawn_as(Reconstruct::Points));
        let mut worst = 0;
        for (i, (color, &depth)) in frames.color.iter().zip(&frames.depth).enumerate() {
            if !depth.is_finite() {
                continue;
            }
            let (x, y) = (i as u32 % view.width, i as u32 / view.width);
            let ray = view.ray(glam::DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5));
            let place = view.at_depth(ray, f64::from(depth));
            let start = if view.is_orthographic() { place.with_z(0.0) } else { DVec3::ZERO };
            let world = |place: DVec3| view.eye - offset + view.view_from_world.transpose() * place;
            let expected = srgb8_from_linear(transmittance(world(start), world(place)));
            worst = worst.max(expected.abs_diff(color[0]));
        }
        println!("{name}: {worst} steps of a byte");
        assert!(worst <= 1, "{name}: {worst} steps");
        assert!(frames.covered() > 2000, "{}", frames.covered());
    }
}

/// The mean of exp(-h / scale) between two heights, times the density and the length of the way.
fn depth_by_height(density: f64, base: f64, scale: f64, from: DVec3, to: DVec3) -> f64 {
    let [low, high] = [from.y.min(to.y), from.y.max(to.y)];
    let rise = (high - low) / scale;
    let mean = if rise == 0.0 { 1.0 } else { -(-rise).exp_m1() / rise };
    density * from.distance(to) * (-(low - base) / scale).exp() * mean
}

#[test]
fn f32_keeps_the_formula_to_a_step_of_a_byte() {
    let far = DVec3::new(4_123_456.0, 0.0, 9_653_210.0);
    let views = [
        look([0.0, 2.0, 100.0], [0.0, 2.0, 0.0], 60.0),
        look([30.0, 900.0, 700.0], [0.0, 0.0, -200.0], 50.0),
        orthographic::look([0.0, 300.0, 800.0], [0.0, 0.0, -300.0], 1500.0),
    ];
    for (offset, place) in [(DVec3::ZERO, "here"), (far, "far")] {
        for density in [1e-12, 1e-4, 2e-3, 1e9] {
            let fog = json!({ "color": "#000000", "density": density });
            let name = format!("fog-bytes-{place}-{density}");
            check_bytes(&name, &fog, offset, &views, |from, to| {
                (-density * from.distance(to)).exp()
            });
        }
        // Thin layers far below the eye, thick ones, and ones whose base lies far above or below.
        for (density, base, scale) in [
            (0.05, 0.0, 1.0),
            (0.002, 40.0, 1e3),
            (1.0, -30.0, 4.0),
            (1e-6, 60.0, 10.0),
            (0.5, 0.0, 1e-3),
            (3e-4, 0.0, 1e9),
        ] {
            let fog = json!({ "color": "#000000", "density": density, "base_height": base, "scale_height": scale });
            let name = format!("fog-bytes-{place}-{density}-{scale}");
            check_bytes(&name, &fog, offset, &views, |from, to| {
                (-depth_by_height(density, base, scale, from, to)).exp()
            });
        }
    }
}

/// An eye a thousand scale heights above a layer, as it is seen from the air.
#[test]
fn an_eye_far_above_the_fog_sees_its_top() {
    let fog = json!({ "color": "#000000", "density": 0.4, "scale_height": 1.5 });
    let views = [
        look([0.0, 1500.0, 10.0], [0.0, 0.0, 0.0], 60.0),
        look([0.0, 1500.0, 2000.0], [0.0, 0.0, 0.0], 60.0),
    ];
    check_bytes("fog-above", &fog, DVec3::ZERO, &views, |from, to| {
        (-depth_by_height(0.4, 0.0, 1.5, from, to)).exp()
    });
}

#[test]
fn transparent_backgrounds_stay_transparent() {
    for (name, fog) in [("fog-clear-even", even()), ("fog-clear-layered", layered())] {
        let case = samples(name, &fog, &lights());
        let view = look([0.4, 1.0, 7.0], [0.0, 0.0, -1.0], 45.0);
        let draw = |text: &str| {
            let background = Some(text.parse::<Background>().unwrap());
            case.draw_with(
                &view,
                Settings { background, ..Settings::drawn_as(Reconstruct::Points) },
            )
        };
        let empty = |frames: &Frames| {
            let pixels = frames.id.iter().zip(&frames.color).filter(|(id, _)| **id == 0);
            pixels.map(|(_, color)| *color).collect::<Vec<[u8; 4]>>()
        };
        assert!(empty(&draw("transparent")).iter().all(|&color| color == [0; 4]));
        assert!(empty(&draw("#10203000")).iter().all(|&color| color == [16, 32, 48, 0]));
        let half = empty(&draw("#10203080"));
        assert!(
            half.iter().all(|color| color[3] == 128) && half.iter().any(|color| color[0] > 100)
        );
        let opaque = empty(&draw("#102030"));
        assert!(opaque.iter().zip(&half).all(|(a, b)| a[..3] == b[..3] && a[3] == 255));
    }
    // Fog that is as dense everywhere hides what is infinitely far away.
    let case = samples("fog-sky", &even(), &lights());
    let frames = case.draw(&look([0.4, 1.0, 7.0], [0.0, 9.0, -1.0], 45.0));
    assert!(frames.color.contains(&[0xc0, 0xd0, 0xe8, 255]));
}

/// Without fog, with a density of 0 and with fog off, frames have the same passes and the same bytes.
#[test]
fn frames_without_fog_have_the_same_bytes() {
    let off = Settings { fog: Effect::Off, ..Settings::drawn_as(Reconstruct::Splats) };
    let on = Settings::drawn_as(Reconstruct::Splats);
    let view = look([0.4, 1.0, 7.0], [0.0, 0.0, -1.0], 45.0);
    let foggy = samples("fog-off", &layered(), &lights());
    let none = samples("fog-none", &Value::Null, &lights());
    let thin = samples("fog-zero", &json!({ "color": "#ffffff", "density": 0 }), &lights());
    let frames =
        [foggy.draw_with(&view, off), none.draw_with(&view, on), thin.draw_with(&view, on)];
    assert!(frames[0].same_pixels(&frames[1]) && frames[1].same_pixels(&frames[2]));
    assert!(!foggy.draw_with(&view, on).same_pixels(&frames[0]));
    let why = |frames: &Frames| {
        let mut passes = frames.receipt.passes.iter();
        passes.find(|pass| pass.name == Pass::FogBackground.name()).unwrap().why.clone().unwrap()
    };
    assert_eq!(
        frames.each_ref().map(why),
        ["fog is off", "the scene has no fog", "the scene has no fog"]
    );
    let ran = |frames: &Frames| -> Vec<&str> {
        frames.receipt.passes.iter().filter(|pass| pass.ran).map(|pass| pass.name).collect()
    };
    assert_eq!(ran(&frames[0]), ran(&frames[1]));
}
