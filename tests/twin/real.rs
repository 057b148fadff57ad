//! Compares splats of real scans and models with the oracle's. `POINTILLIST_DATA` names their folder. Without it, or
//! `../shared/data` beside the checkout, the test prints "skipped" and passes.

use std::path::{Path, PathBuf};

use glam::DVec3;
use pointillist::assets::Geometry;
use pointillist::math::{Bounds, Camera, Lens, View};
use pointillist::scene::Filter;
use serde_json::json;

use super::pull_push::faults_beside_splats;
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
fn overview(case: &Case, width: u32, height: u32) -> View {
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
        .view(width, height)
        .unwrap()
}

/// A scene of one file; `None` without the file. `sampled` says that the file is a mesh, which the scene samples. `folder` begins the
/// name of the scene's folder.
fn case_of(folder: &str, file: &str, sampled: bool) -> Option<Case> {
    let Some(data) = data() else {
        println!("skipped: no folder of real data");
        return None;
    };
    let Ok(bytes) = std::fs::read(data.join(file)) else {
        println!("skipped: no {file}");
        return None;
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
    let folder = format!("{folder}-{}", name.replace('.', "-"));
    Some(Case::new(&folder, &[(name, bytes)], &scene))
}

/// Draws one file as `exact` and as `perspective` splats.
fn splats_are_the_oracles(file: &str, sampled: bool) {
    let Some(case) = case_of("real", file, sampled) else { return };
    let view = overview(&case, 160, 120);
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

/// Draws one file by pull-push, and counts holes and leaks beside its splats.
fn pull_push_closes(file: &str, sampled: bool) {
    let Some(case) = case_of("pulled", file, sampled) else { return };
    for (width, height) in [(320, 240), (640, 480)] {
        let view = overview(&case, width, height);
        let [holes, leaks, covered] = faults_beside_splats(&case, &view);
        assert!(covered > 1000, "{file}: {covered}");
        assert!(holes * 2_000 <= covered, "{file}, {width} pixels: {holes} holes of {covered}");
        assert!(leaks * 200 <= covered, "{file}, {width} pixels: {leaks} leaks of {covered}");
    }
}

macro_rules! pull_push_of {
    ($($name:ident: $file:literal, sampled: $sampled:literal;)+) => {
        $(#[test]
        fn $name() {
            pull_push_closes($file, $sampled);
        })+
    };
}

pull_push_of! {
    pull_push_of_kitten: "pointclouds/kitten.xyz", sampled: false;
    pull_push_of_bunny_e57: "pointclouds/bunnyFloat.e57", sampled: false;
    pull_push_of_lion: "pointclouds/lion_takanawa.copc.laz", sampled: false;
    pull_push_of_bunny_scan: "scans/bunny_range/bun000.ply", sampled: false;
    pull_push_of_bunny_mesh: "scans/bun_zipper.ply", sampled: true;
    pull_push_of_armadillo: "scans/armadillo.obj", sampled: true;
}
