//! Effects that depend on neighbouring pixels, and the background.

use pointillist::accuracy::metrics;
use pointillist::math::View;
use pointillist::oracle::{self, OracleScene};
use pointillist::plan::{
    Background, Edl, EdlStrength, Pass, Reconstruct, Reconstruction, Settings,
};
use pointillist::scene::{EyeDome, Filter};
use serde_json::json;

use super::files::Shape;
use super::splats::{ball, case, splats};
use super::stage::{Case, Frames, look};

/// Compares a frame with eye-dome lighting with the oracle's.
pub fn check_edl(case: &Case, view: &View, settings: Settings, least: f64) -> Frames {
    let lit = Settings { edl: Edl::On, edl_strength: EdlStrength::from(0.5), ..settings };
    let frames = case.draw_with(view, lit);
    let edl = EyeDome { strength: 0.5, radius_px: lit.edl_radius_px.get() };
    let reconstruction = Reconstruction::new(&settings, &case.reference.description().splats);
    let splats = reconstruction.splats().copied();
    let scene = OracleScene { splats, edl: Some(edl), ..case.reference.scene() };
    let twin = oracle::render(&scene, view, 1);
    let psnr = |frames: &Frames| metrics::psnr(&twin.to_rgba8(), &frames.color).unwrap();
    let without = case.draw_with(view, settings);
    let (with, without) = (psnr(&frames), psnr(&without));
    println!("{} {settings:?}: {with} dB, without {without} dB", case.id);
    assert!(with >= least && with > without + 6.0, "{}: {with} dB, {without} dB", case.id);
    assert!(frames.ran(Pass::WriteOutput));
    frames
}

#[test]
fn eye_dome_light_is_the_oracles() {
    let lights = json!({ "lights": [{ "kind": "sun", "direction": [1, -1, -0.5] }] });
    let view = look([0.4, 1.0, 3.0], [0.0; 3], 45.0);
    let points = Settings { reconstruct: Reconstruct::Points, ..Settings::default() };
    for (name, rest) in [("edl-unlit", json!({})), ("edl-lit", lights)] {
        let cloud = case(name, &ball(4000, 31), rest.clone());
        check_edl(&cloud, &view, points, 35.0);
        check_edl(&cloud, &view, splats(Filter::Exact), 35.0);
        let mesh = Shape { colors: Vec::new(), ..Shape::ball(16, 1.0) };
        let mesh = case(&format!("{name}-mesh"), &mesh, rest);
        check_edl(&mesh, &view, points, 35.0);
    }
}

#[test]
fn eye_dome_light_needs_depths() {
    let cloud = case("edl-fuzzy", &ball(2000, 32), json!({}));
    let view = look([0.4, 1.0, 3.0], [0.0; 3], 45.0);
    let fuzzy = Settings { reconstruct: Reconstruct::Fuzzy, ..Settings::default() };
    let frames = cloud.draw_with(&view, Settings { edl: Edl::On, ..fuzzy });
    let used = &frames.receipt.settings;
    assert_eq!(used.applied.edl, Some(Edl::On));
    assert_eq!(used.applied.reconstruct, Some(Reconstruct::Splats));
    assert_eq!(
        used.instead_because,
        Some("fuzzy and painted splats leave no depths for eye-dome lighting")
    );
}

#[test]
fn a_request_chooses_the_background() {
    let cloud = case("background", &ball(300, 33), json!({ "background": "#102030" }));
    let view = look([0.4, 1.0, 3.0], [0.0; 3], 45.0);
    let points = Settings::drawn_as(Reconstruct::Points);
    let plain = cloud.draw_with(&view, points);
    for (text, color) in
        [("transparent", [0; 4]), ("#ff8000", [255, 128, 0, 255]), ("#01020304", [1, 2, 3, 4])]
    {
        let background: Background = text.parse().unwrap();
        let frames = cloud.draw_with(&view, Settings { background: Some(background), ..points });
        assert_eq!((&frames.id, &frames.depth), (&plain.id, &plain.depth));
        let shown = frames.id.iter().zip(frames.color.iter().zip(&plain.color));
        for (id, (found, before)) in shown {
            assert_eq!(*found, if *id == 0 { color } else { *before }, "{text}");
        }
    }
}
