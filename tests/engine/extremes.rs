//! Enormous, tiny, distant or flat scenes are drawn like others, or refused with a message.

use glam::DVec3;
use pointillist::engine::EngineError;
use pointillist::plan::Output;
use serde_json::json;

use super::studio::{OUTPUTS, Studio, cloud, covered, depths, fit, mesh, sphere_mesh};

/// A ball of points.
fn ball(scale: f64, offset: DVec3) -> String {
    let (positions, _) = sphere_mesh(40);
    cloud(positions.into_iter().map(|p| (p * scale + offset, [200, 120, 40])))
}

fn solid(scale: f64, offset: DVec3) -> String {
    let (positions, triangles) = sphere_mesh(20);
    let positions: Vec<DVec3> = positions.into_iter().map(|p| p * scale + offset).collect();
    mesh(&positions, &triangles)
}

#[test]
fn size_does_not_matter() {
    let studio = Studio::new();
    studio.write("cloud.ply", ball(1.0, DVec3::ZERO));
    studio.write("solid.ply", solid(1.0, DVec3::ZERO));
    studio.load("cloud", "cloud.ply");
    studio.load("solid", "solid.ply");
    let usual = ["cloud", "solid"].map(|id| covered(&studio.bytes(&fit(id, 96, Output::Depth))));
    assert!(usual[0] > 1500 && usual[1] > 2000, "{usual:?}");
    for power in [-300, -40, -30, -20, -12, -6, 6, 12, 15, 18, 20, 24, 29, 31, 38, 100, 300] {
        let scale = 10f64.powi(power);
        for (kind, (text, usual)) in
            [ball(scale, DVec3::ZERO), solid(scale, DVec3::ZERO)].into_iter().zip(usual).enumerate()
        {
            let id = format!("{kind}-{power}");
            studio.write("x.ply", text);
            match studio.try_load(&id, "x.ply") {
                Ok(_) => {
                    for output in OUTPUTS {
                        let bytes = studio.bytes(&fit(&id, 96, output));
                        if output == Output::Depth {
                            let found = covered(&bytes);
                            println!("1e{power}, kind {kind}: {found} of {usual} pixels");
                            // The default view leaves a margin by the spacing of samples. The spacing is measured in steps of a
                            // grid whose size relative to the cloud varies with the scale.
                            let most = usual / if kind == 0 { 20 } else { 100 };
                            if (-20..=20).contains(&power) {
                                assert!(found.abs_diff(usual) <= most, "1e{power}: {found}");
                            }
                        }
                    }
                }
                Err(error) => {
                    println!("1e{power}, kind {kind}: {error}");
                    assert!(power.abs() > 20, "1e{power} is refused: {error}");
                    assert!(error.to_string().contains("x.ply"), "{error}");
                }
            }
        }
    }
    assert_eq!(studio.engine.stats().device_losses, 0);
    assert_eq!(studio.engine.stats().failed, 0);
}

#[test]
fn distance_does_not_matter() {
    let studio = Studio::new();
    for (kind, make) in [ball, solid].into_iter().enumerate() {
        let mut usual: Option<Vec<f32>> = None;
        for offset in [0.0, 1e3, 5e6, 1e7] {
            let id = format!("{kind}-{offset}");
            studio.write("x.ply", make(1.0, DVec3::new(offset, -offset, offset / 2.0)));
            studio.load(&id, "x.ply");
            let found = depths(&studio.bytes(&fit(&id, 96, Output::Depth)));
            let usual = usual.get_or_insert_with(|| found.clone());
            let differing = found
                .iter()
                .zip(usual.iter())
                .filter(|(a, b)| {
                    a != b && (*a - *b).abs().partial_cmp(&1e-3) != Some(std::cmp::Ordering::Less)
                })
                .count();
            // Silhouettes may move by a pixel: doubles near 1e7 have steps of 2e-9.
            assert!(differing <= 96 * 96 / 200, "{offset}: {differing} pixels");
        }
    }
}

#[test]
fn degenerate_contents_are_drawn() {
    let studio = Studio::new();
    let o = DVec3::ZERO;
    let texts = [
        ("one", cloud([(DVec3::new(1.0, 2.0, 3.0), [255; 3])].into_iter())),
        ("same", cloud((0..500).map(|_| (DVec3::ONE, [255; 3])))),
        ("line", cloud((0..500).map(|i| (DVec3::X * f64::from(i), [255; 3])))),
        (
            "plane",
            cloud(
                (0..900).map(|i| (DVec3::new(f64::from(i % 30), f64::from(i / 30), 0.0), [255; 3])),
            ),
        ),
        ("origin", cloud([(o, [255; 3])].into_iter())),
        ("flat", mesh(&[o, DVec3::X, DVec3::X * 2.0], &[[0, 1, 2]])),
        ("point", mesh(&[o, o, o], &[[0, 1, 2], [0, 0, 0]])),
        ("needle", mesh(&[o, DVec3::X * 1e9, DVec3::Y * 1e-9], &[[0, 1, 2]])),
        (
            "mixed",
            cloud([(DVec3::splat(1e-20), [255; 3]), (DVec3::splat(1e20), [9; 3])].into_iter()),
        ),
    ];
    for (id, text) in texts {
        studio.write(&format!("{id}.ply"), text);
        match studio.try_load(id, &format!("{id}.ply")) {
            Ok(_) => {
                for output in OUTPUTS {
                    let bytes = studio.bytes(&fit(id, 80, output));
                    if output == Output::Depth {
                        let found = covered(&bytes);
                        println!("{id}: {found} pixels");
                        if ["one", "same", "line", "plane", "origin", "mixed"].contains(&id) {
                            assert!(found > 0, "{id} is in view");
                        }
                    }
                }
            }
            Err(error) => println!("{id}: {error}"),
        }
    }
    assert_eq!(studio.engine.stats().failed, 0);
}

#[test]
fn placements_beyond_all_bounds() {
    let studio = Studio::new();
    studio.write("cloud.ply", ball(1.0, DVec3::ZERO));
    studio.write("solid.ply", solid(1.0, DVec3::ZERO));
    for (number, change) in [
        json!({ "scale": 1e-30 }),
        json!({ "scale": 1e-200 }),
        json!({ "scale": 1e20 }),
        json!({ "scale": 1e37 }),
        json!({ "scale": 1e200 }),
        json!({ "scale": [1, 1, 0] }),
        json!({ "scale": [1, 1, 1e-40] }),
        json!({ "scale": [1e20, 1, 1e-20] }),
        json!({ "translate": [1e25, 0, 0] }),
        json!({ "translate": [1e38, 0, 0] }),
        json!({ "translate": [1e200, 0, 0] }),
        json!({ "translate": [-1e308, 1e308, 0] }),
        json!({ "matrix": [1, 1, 1, 0, 1, 1, 1, 0, 1, 1, 1, 0, 0, 0, 0, 1] }),
    ]
    .into_iter()
    .enumerate()
    {
        for asset in ["cloud", "solid"] {
            let mut node = change.clone();
            node["asset"] = json!("a");
            let scene = json!({
                "assets": { "a": { "file": format!("{asset}.ply") } },
                "nodes": [{ "asset": "a" }, node],
                "lights": [{ "kind": "point", "position": [0, 3, 0], "range": 4 }, { "kind": "headlight" }],
                "cameras": { "front": { "eye": [0, 0, 4], "target": [0, 0, 0], "fov": 45 } },
            });
            let id = format!("{asset}-{number}");
            studio.write("x.json", scene.to_string());
            if let Err(error) = studio.try_load(&id, "x.json") {
                println!("{change}: {error}");
                continue;
            }
            for output in OUTPUTS {
                let mut request = super::studio::front(&id, 60, 60);
                request.output = output;
                let bytes = studio.bytes(&request);
                if output == Output::Depth {
                    let found = covered(&bytes);
                    println!("{change} {asset}: {found} pixels");
                    assert!(found > 200, "{change}: the copy at the origin is still there");
                }
                let whole = super::studio::fit(&id, 60, output);
                match studio.engine.submit(whole) {
                    Ok(ticket) => drop(ticket.wait().unwrap()),
                    Err(EngineError::BadParameter { .. }) => {}
                    Err(error) => panic!("{change}: {error}"),
                }
            }
        }
    }
    assert_eq!(studio.engine.stats().device_losses, 0);
}
