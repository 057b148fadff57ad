//! Colours by a value of the surface.

use glam::DVec3;
use pointillist::accuracy::metrics;
use pointillist::math::View;
use pointillist::oracle::{self, OracleScene};
use pointillist::plan::{
    ColorBound, ColorBy, Edl, EdlStrength, Lod, MaxError, Pass, Reconstruct, Reconstruction,
    Settings,
};
use pointillist::scene::Filter;
use pointillist::scene::recolor::ColorMap;
use serde_json::json;

use super::files::Shape;
use super::orthographic;
use super::splats::{ball, case, splats};
use super::stage::{Case, Frames, look};

/// Checks a frame with colours by a value against the oracle's; `heights`: of the scene.
fn check(case: &Case, view: &View, settings: Settings, heights: [f64; 2]) -> Frames {
    let settings = Settings { edl: Edl::Off, ..settings };
    let frames = case.draw_with(view, settings);
    let reconstruction = Reconstruction::new(&settings, &case.reference.description().splats);
    let scene = OracleScene {
        splats: reconstruction.splats().copied(),
        recolor: settings.recolor(DVec3::Y, || heights, &[]),
        ..case.reference.scene()
    };
    let twin = oracle::render(&scene, view, 1).to_rgba8();
    let psnr = metrics::psnr(&twin, &frames.color).unwrap();
    let plain =
        case.draw_with(view, Settings { color_by: ColorBy::Colors, color_least: None, ..settings });
    let without = metrics::psnr(&twin, &plain.color).unwrap();
    println!("{} {:?}: {psnr} dB, without {without} dB", case.id, settings.color_by);
    assert!(psnr >= 38.0 && psnr > without + 10.0, "{}: {psnr} dB, {without} dB", case.id);
    // No neighbours are read, so the resolve pass writes the output.
    assert!(!frames.ran(Pass::WriteOutput));
    assert_eq!((&frames.id, &frames.depth), (&plain.id, &plain.depth));
    frames
}

#[test]
fn colours_by_a_value_are_the_oracles() {
    let lights = json!({ "lights": [{ "kind": "sun", "direction": [1, -1, -0.5] }] });
    let view = look([0.4, 1.0, 3.0], [0.0; 3], 45.0);
    let flat = orthographic::look([0.4, 1.0, 3.0], [0.0; 3], 2.4);
    let points = Settings { reconstruct: Reconstruct::Points, ..Settings::default() };
    let unlit = json!({ "lights": [] });
    for (name, rest) in [("by", json!({})), ("by-lit", lights), ("by-unlit", unlit)] {
        let cloud = case(name, &ball(4000, 51), rest.clone());
        let shape = Shape { colors: Vec::new(), ..Shape::ball(16, 1.0) };
        let mesh = case(&format!("{name}-mesh"), &shape, rest);
        for color_by in [ColorBy::Height, ColorBy::Normal, ColorBy::Instance] {
            // One map for heights, with bounds of the request.
            let given = Settings { color_by, ..points };
            let given = match color_by {
                ColorBy::Height => Settings {
                    color_map: ColorMap::Spectral,
                    color_least: Some(ColorBound::from(-0.75)),
                    color_most: Some(ColorBound::from(0.5)),
                    ..given
                },
                _ => given,
            };
            check(&cloud, &view, given, [0.0; 2]);
            let of_splats = splats(Filter::Exact);
            let of_splats =
                Settings { reconstruct: of_splats.reconstruct, filter: of_splats.filter, ..given };
            check(&cloud, &view, of_splats, [0.0; 2]);
            check(&mesh, &view, given, [0.0; 2]);
            check(&mesh, &flat, given, [0.0; 2]);
        }
    }
}

/// Nodes of point trees whose normals cancel are grey as samples without normals are, also where a later pass writes the output.
#[test]
fn nodes_of_all_normals_alike_are_grey() {
    let cloud = || Shape::cloud(8000, [-1.0; 3], [1.0; 3], 5);
    // Beside each sample lies one with the opposite normal.
    let (mut both, mut behind) = (cloud(), cloud().moved(DVec3::splat(1e-3)));
    behind.normals.iter_mut().for_each(|normal| *normal = -*normal);
    both.add(&behind);
    let case = case("by-normal-balls", &both, json!({ "lights": [] }));
    let view = look([0.4, 1.0, 6.0], [0.0; 3], 45.0);
    let max_error_px = MaxError::new(8.0).unwrap();
    for reconstruct in [Reconstruct::Points, Reconstruct::Splats] {
        let settings = Settings {
            color_by: ColorBy::Normal,
            lod: Lod::Spt,
            max_error_px,
            reconstruct,
            edl: Edl::Off,
            ..Settings::default()
        };
        let direct = case.draw_with(&view, settings);
        // So weak that it changes no byte by more than one.
        let weak = Settings { edl: Edl::On, edl_strength: EdlStrength::from(0.001), ..settings };
        let kept = case.draw_with(&view, weak);
        assert!(kept.ran(Pass::WriteOutput) && !direct.ran(Pass::WriteOutput));
        let grey = direct.color.iter().filter(|pixel| **pixel == [128, 128, 128, 255]).count();
        assert!(grey > 100, "{reconstruct:?}: {grey} grey pixels");
        let differ =
            |(a, b): &(&[u8; 4], &[u8; 4])| a.iter().zip(b.iter()).any(|(a, b)| a.abs_diff(*b) > 3);
        let differing = direct.color.iter().zip(&kept.color).filter(differ).count();
        // Normals of blended splats that are nearly too short differ by rounding.
        assert!(differing * 500 <= direct.color.len(), "{reconstruct:?}: {differing} pixels");
    }
}

#[test]
fn heights_go_from_the_lowest_to_the_highest_place_of_the_scene() {
    let scene = json!({
        "assets": { "t": { "file": "t.ply" } },
        "nodes": [{ "asset": "t", "translate": [500000, 3000, -4000000] }]
    });
    let shape = Shape { colors: Vec::new(), ..Shape::ball(24, 1.0) };
    let case = Case::new("by-height", &[("t.ply", shape.ply())], &scene);
    let at = [500_000.0, 3000.0, -4_000_000.0];
    let view = look([at[0] + 0.4, at[1] + 1.0, at[2] + 3.0], at, 45.0);
    let settings = Settings {
        color_by: ColorBy::Height,
        reconstruct: Reconstruct::Points,
        ..Settings::default()
    };
    let frames = check(&case, &view, settings, [2999.0, 3001.0]);
    let legend = frames.receipt.legend.unwrap();
    assert!(
        (legend.least - 2999.0).abs() < 0.01 && (legend.most - 3001.0).abs() < 0.01,
        "{legend:?}"
    );
    assert_eq!((legend.colors.len(), legend.colors[0].as_str()), (9, "#440154"));
}

#[test]
fn a_single_pass_gives_way_to_three() {
    let cloud = case("by-fuzzy", &ball(2000, 52), json!({}));
    let view = look([0.4, 1.0, 3.0], [0.0; 3], 45.0);
    let fuzzy = Settings {
        reconstruct: Reconstruct::Fuzzy,
        color_by: ColorBy::Instance,
        ..Settings::default()
    };
    let used = cloud.draw_with(&view, fuzzy).receipt.settings;
    assert_eq!(used.applied.reconstruct, Some(Reconstruct::Splats));
    assert_eq!(used.instead_because, Some("fuzzy and painted splats leave no surfaces to colour"));
}
