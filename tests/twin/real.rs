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

/// Draws one file as `exact` and as `perspective` splats. `sampled` says that the file is a mesh, which the scene samples.
fn splats_are_the_oracles(file: &str, sampled: bool) {
    let Some(data) = data() else {
        println!("skipped: no folder of real data");
        return;
    };
    let Ok(bytes) = std::fs::read(data.join(file)) else {
        println!("skipped: no {file}");
        return;
    };
    let name = file.rsplit('/').next().unwrap();
    let asset = match sampled {
        true => json!({ "file": name, "sample": {} }),
        false => json!({ "file": name }),
    };
    let survey = name.ends_with("laz");
    let scene = json!({
        "assets": { "a": asset },
        "nodes": [{ "asset": "a" }],
        "up": if survey { "z" } else { "y" }
    });
    let folder = format!("real-{}", name.replace('.', "-"));
    let case = Case::new(&folder, &[(name, bytes)], &scene);
    let view = overview(&case);
    let exact = splats(Filter::Exact);
    let frames = check(&case, &view, exact, exact, 45.0);
    assert!(frames.covered() > 1000, "{file}: {}", frames.covered());
    check(&case, &view, splats(Filter::Perspective), exact, 38.0);
}

/// A test for each file, so that files are drawn in parallel and a failure names its file.
macro_rules! splats_of {
    ($($name:ident: $file:literal, sampled: $sampled:literal;)+) => {
        $(#[test]
        fn $name() {
            splats_are_the_oracles($file, $sampled);
        })+
    };
}

splats_of! {
    splats_of_kitten: "pointclouds/kitten.xyz", sampled: false;
    splats_of_bunny_e57: "pointclouds/bunnyFloat.e57", sampled: false;
    splats_of_lion: "pointclouds/lion_takanawa.copc.laz", sampled: false;
    splats_of_autzen: "pointclouds/autzen_trim.laz", sampled: false;
    splats_of_milk_cartoon: "pointclouds/milk_cartoon_all_small_clorox.pcd", sampled: false;
    splats_of_bunny_mesh: "scans/bun_zipper.ply", sampled: true;
    splats_of_armadillo: "scans/armadillo.obj", sampled: true;
    splats_of_fandisk: "cad/fandisk.obj", sampled: true;
    splats_of_three_cylinders: "cad/three_cylinders.obj", sampled: true;
}
