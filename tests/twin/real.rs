//! Compares splats of real scans and models with the oracle's. `POINTILLIST_DATA` names their folder. Without it, or
//! `../shared/data` beside the checkout, the test prints "skipped" and passes.

use std::path::{Path, PathBuf};

use glam::DVec3;
use pointillist::assets::Geometry;
use pointillist::math::{Bounds, Camera, Lens, View};
use pointillist::scene::Filter;
use serde_json::json;

use super::splats::{check, splats};
use super::stage::Case;

/// Scans, and models that are sampled.
const SCANS: &[&str] = &[
    "pointclouds/kitten.xyz",
    "pointclouds/bunnyFloat.e57",
    "pointclouds/lion_takanawa.copc.laz",
    "pointclouds/autzen_trim.laz",
    "pointclouds/milk_cartoon_all_small_clorox.pcd",
];
const MODELS: &[&str] =
    &["scans/bun_zipper.ply", "scans/armadillo.obj", "cad/fandisk.obj", "cad/three_cylinders.obj"];

fn data() -> Option<PathBuf> {
    let folder = std::env::var_os("POINTILLIST_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"),
        PathBuf::from,
    );
    folder.is_dir().then_some(folder)
}

/// A view of the whole scene from its front and above.
fn overview(case: &Case) -> View {
    let scene = case.reference.scene();
    let bounds = scene.items.iter().fold(Bounds::EMPTY, |all, item| {
        let Geometry::Points(cloud) = item.geometry else { return all };
        let positions = cloud.positions.iter().copied();
        all.union(Bounds::of(positions).transformed(&item.world_from_geometry))
    });
    let up = case.reference.description().up;
    let front = if up == DVec3::Z { DVec3::NEG_Y } else { DVec3::Z };
    let eye = bounds.centre() + (front + 0.5 * up + 0.3 * DVec3::X) * bounds.extent().length();
    Camera { eye, target: bounds.centre(), up, lens: Lens::Perspective { fov_deg: 40.0 } }
        .view(160, 120)
        .unwrap()
}

#[test]
fn splats_of_real_data_are_the_oracles() {
    let Some(data) = data() else {
        println!("skipped: no folder of real data");
        return;
    };
    for (number, file) in SCANS.iter().chain(MODELS).enumerate() {
        let Ok(bytes) = std::fs::read(data.join(file)) else {
            println!("skipped: no {file}");
            continue;
        };
        let name = file.rsplit('/').next().unwrap();
        let asset = match MODELS.contains(file) {
            true => json!({ "file": name, "sample": {} }),
            false => json!({ "file": name }),
        };
        let survey = name.ends_with("laz");
        let scene = json!({
            "assets": { "a": asset },
            "nodes": [{ "asset": "a" }],
            "up": if survey { "z" } else { "y" }
        });
        let case = Case::new(&format!("real-{number}"), &[(name, bytes)], &scene);
        let view = overview(&case);
        println!("{file}:");
        let exact = splats(Filter::Exact);
        let frames = check(&case, &view, exact, exact, 45.0);
        assert!(frames.covered() > 1000, "{file}: {}", frames.covered());
        check(&case, &view, splats(Filter::Perspective), exact, 38.0);
    }
}
