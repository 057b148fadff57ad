//! Colours by scalar fields of the points and lines.

use std::fmt::Write;

use glam::DVec3;
use pointillist::accuracy::metrics;
use pointillist::math::View;
use pointillist::oracle::{self, OracleScene};
use pointillist::plan::{
    ColorBound, ColorBy, Edl, Lod, MaxError, Pass, Reconstruct, Reconstruction, Settings,
};
use pointillist::scene::Filter;
use pointillist::scene::recolor::ColorMap;
use serde_json::json;

use super::files::Shape;
use super::lines;
use super::orthographic;
use super::splats::ball;
use super::stage::{Case, Frames, look};

/// A ball whose points have fields: some smooth, some classes, and some without a value at every seventh point.
fn measured(count: usize, seed: u64, warmth: f64) -> Shape {
    let shape = ball(count, seed);
    let of = |value: fn(DVec3) -> f64| shape.positions.iter().copied().map(value).collect();
    let strength: Vec<f64> = of(|p| (20_000.0 + 20_000.0 * p.x).round());
    let class = of(|p| f64::from(2 + u8::from(p.y > 0.2) * 3 + u8::from(p.z > 0.4)));
    let warm = of(|p| p.y + 0.3 * p.z);
    let warm = warm.iter().enumerate();
    let warm = warm.map(|(i, v): (usize, &f64)| if i % 7 == 3 { f64::NAN } else { warmth + v });
    let warm = warm.collect();
    let time = of(|p| 1.0e9 + (1000.0 * p.z).round() / 8.0);
    let fields = vec![
        ("intensity", "ushort", strength),
        ("classification", "uchar", class),
        ("scalar_warmth", "float", warm),
        ("gps_time", "double", time),
    ];
    Shape { fields, ..shape }
}

/// Colours by a field, with bounds of a map if there are any.
fn by(color_by: ColorBy, field: Option<&str>, bounds: Option<[f64; 2]>) -> Settings {
    Settings {
        color_by,
        field: field.map(|name| name.parse().unwrap()),
        color_map: if bounds.is_some() { ColorMap::Spectral } else { ColorMap::Viridis },
        color_least: bounds.map(|[least, _]| ColorBound::from(least)),
        color_most: bounds.map(|[_, most]| ColorBound::from(most)),
        edl: Edl::Off,
        ..Settings::default()
    }
}

/// Compares a frame with the oracle's, both with the colours of a field.
fn check(case: &Case, view: &View, settings: Settings, least_db: f64) -> Frames {
    let frames = match settings.reconstruct {
        // Sums of 32 bits cannot blend in a single pass.
        Reconstruct::Fuzzy => case.each_with(view, settings).into_iter().next().unwrap(),
        _ => case.draw_with(view, settings),
    };
    let reconstruction = Reconstruction::new(&settings, &case.reference.description().splats);
    let scene = OracleScene {
        splats: reconstruction.splats().copied(),
        recolor: settings.recolor(DVec3::Y, || [0.0; 2], &case.fields()),
        ..case.reference.scene()
    };
    let twin = oracle::render(&scene, view, 1).to_rgba8();
    let psnr = metrics::psnr(&twin, &frames.color).unwrap();
    let plain = OracleScene { recolor: None, ..scene };
    let without =
        metrics::psnr(&oracle::render(&plain, view, 1).to_rgba8(), &frames.color).unwrap();
    let what = (settings.color_by, settings.field, settings.reconstruct);
    println!("{} {what:?}: {psnr} dB, without {without} dB", case.id);
    assert!(psnr >= least_db && psnr > without + 8.0, "{}: {what:?}: {psnr}, {without}", case.id);
    frames
}

fn all() -> Vec<Settings> {
    vec![
        by(ColorBy::Intensity, None, None),
        by(ColorBy::Intensity, None, Some([10_000.0, 50_000.0])),
        by(ColorBy::Classification, None, None),
        by(ColorBy::Field, Some("warmth"), None),
        by(ColorBy::Field, Some("warmth"), Some([0.5, -0.5])),
        by(ColorBy::Field, Some("gps_time"), None),
    ]
}

#[test]
fn colours_of_fields_are_the_oracles() {
    let view = look([0.4, 1.0, 3.0], [0.0; 3], 45.0);
    let flat = orthographic::look([0.4, 1.0, 3.0], [0.0; 3], 2.4);
    let lights = json!([{ "kind": "sun", "direction": [1, -1, -0.5] }]);
    for (name, lights) in [("fields", json!([])), ("fields-lit", lights)] {
        // A triangle has no fields and is grey, and materials do not tint what a field colours.
        let scene = json!({
            "assets": { "c": { "file": "c.ply" }, "t": { "file": "t.ply" } },
            "materials": { "red": { "color": "#ff2020" } },
            "nodes": [{ "asset": "c", "material": "red" }, { "asset": "t" }],
            "lights": lights,
        });
        let corners = [[1.1, -0.5, 0.0], [1.6, -0.5, 0.0], [1.3, 0.8, 0.2]];
        let files = [
            ("c.ply", measured(4000, 61, 0.0).ply()),
            ("t.ply", Shape::triangle(corners, [20, 200, 90]).ply()),
        ];
        let case = Case::new(name, &files, &scene);
        for settings in all() {
            let points = Settings { reconstruct: Reconstruct::Points, ..settings };
            let frames = check(&case, &view, points, 44.0);
            assert!(!frames.ran(Pass::WriteOutput));
            check(&case, &flat, points, 44.0);
            let splats = Settings {
                reconstruct: Reconstruct::Splats,
                filter: Some(Filter::Exact),
                ..settings
            };
            check(&case, &view, splats, 43.0);
        }
        let fuzzy = by(ColorBy::Field, Some("warmth"), None);
        check(&case, &view, Settings { reconstruct: Reconstruct::Fuzzy, ..fuzzy }, 33.0);
    }
}

#[test]
fn clouds_with_different_fields_share_one_range() {
    let scene = json!({
        "assets": { "a": { "file": "a.ply" }, "b": { "file": "b.ply" }, "c": { "file": "c.ply" } },
        "nodes": [
            { "asset": "a" },
            { "asset": "b", "translate": [2.2, 0, 0] },
            { "asset": "c", "translate": [-2.2, 0, 0] }
        ],
    });
    let a = measured(3000, 62, 0.0);
    // That field at another place among others, on another scale.
    let mut b = measured(3000, 63, 5.0);
    b.fields.reverse();
    let files = [("a.ply", a.ply()), ("b.ply", b.ply()), ("c.ply", ball(2000, 64).ply())];
    let case = Case::new("fields-several", &files, &scene);
    let fields = case.fields();
    let names: Vec<&str> = fields.iter().map(|field| field.name.as_str()).collect();
    assert_eq!(names, ["classification", "gps_time", "intensity", "warmth"]);
    assert!(fields[3].shown[0] < -0.9 && fields[3].shown[1] > 5.9, "{fields:?}");
    assert_eq!(fields[0].classes.as_deref(), Some(&[2, 3, 5, 6][..]));
    let view = look([0.4, 1.0, 6.0], [0.0; 3], 45.0);
    for settings in all() {
        check(&case, &view, Settings { reconstruct: Reconstruct::Points, ..settings }, 55.0);
    }
}

#[test]
fn nodes_of_point_trees_have_the_fields_of_their_samples() {
    let scene = json!({ "assets": { "c": { "file": "c.ply" } }, "nodes": [{ "asset": "c" }] });
    let case = Case::new("fields-tree", &[("c.ply", measured(30_000, 65, 0.0).ply())], &scene);
    let view = look([0.4, 1.0, 3.0], [0.0; 3], 45.0);
    for settings in all().into_iter().filter(|settings| settings.field.is_none()) {
        for (px, least_db) in [(0.05, 50.0), (2.0, 38.0)] {
            let max_error_px = MaxError::new(px).unwrap();
            let settings = Settings {
                lod: Lod::Spt,
                max_error_px,
                reconstruct: Reconstruct::Splats,
                filter: Some(Filter::Exact),
                ..settings
            };
            check(&case, &view, settings, least_db);
        }
    }
}

/// Adds fields to a file of strands: one that changes evenly, one without a value at every seventh vertex, and classes.
fn with_fields(file: Vec<u8>, places: &[DVec3]) -> Vec<u8> {
    let mut text = String::from_utf8(file).unwrap();
    let even = places.iter().map(|p| p.x + 0.5 * p.y).collect();
    let gaps = places.iter().enumerate();
    let gaps = gaps.map(|(i, p)| if i % 7 == 3 { f64::NAN } else { p.z }).collect();
    let classes = places.iter().map(|p| f64::from(2 + 4 * u8::from(p.y > 0.1))).collect();
    let fields: [(&str, Vec<f64>); 3] =
        [("even", even), ("gaps", gaps), ("classification", classes)];
    for (name, values) in fields {
        writeln!(text, "SCALARS {name} double 1\nLOOKUP_TABLE default").unwrap();
        values.iter().for_each(|value| writeln!(text, "{value}").unwrap());
    }
    text.into_bytes()
}

#[test]
fn lines_have_the_colours_of_their_fields() {
    let strands = lines::scattered(14, [0.03, 0.12], 5);
    let places: Vec<DVec3> = strands.iter().flatten().map(|vertex| vertex.0).collect();
    let normals = vec![DVec3::new(0.3, 0.2, 1.0).normalize_or_zero(); places.len()];
    let view = look([0.0, 0.4, 5.0], [0.0; 3], 40.0);
    let scene = json!({
        "assets": { "l": { "file": "l.vtk" } },
        "materials": { "red": { "color": "#ff2020" } },
        "nodes": [{ "asset": "l", "material": "red" }],
        "lights": [],
    });
    let files = [("tubes", lines::vtk(&strands)), ("ribbons", lines::ribbons(&strands, &normals))];
    for (name, file) in files {
        let file = with_fields(file, &places);
        let case = Case::new(&format!("fields-{name}"), &[("l.vtk", file)], &scene);
        let names: Vec<String> = case.fields().into_iter().map(|field| field.name).collect();
        assert_eq!(names, ["classification", "even", "gaps"]);
        for settings in [
            by(ColorBy::Field, Some("even"), None),
            by(ColorBy::Field, Some("even"), Some([0.5, -0.5])),
            by(ColorBy::Field, Some("gaps"), None),
            by(ColorBy::Classification, None, None),
        ] {
            let points = Settings { reconstruct: Reconstruct::Points, ..settings };
            check(&case, &view, points, 40.0);
            let max_error_px = MaxError::new(0.05).unwrap();
            check(&case, &view, Settings { lod: Lod::Spt, max_error_px, ..points }, 36.0);
        }
    }
}
