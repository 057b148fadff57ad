//! On lavapipe all loops of a thread share 65535 iterations, and the rest is silently left out. Every pixel must be drawn,
//! however much there is to walk.

use glam::DVec3;
use pointillist::engine::{FrameRequest, Pose};
use pointillist::math::Camera;
use pointillist::plan::{Output, Reconstruct, Settings};
use pointillist::scene::Blend;
use serde_json::json;

use super::studio::{Disk, Studio, cloud_scene, depths, disks, front, mesh, same};

const SIDE: u32 = 512;
/// Pixels per unit at z = 0 for the camera below: a unit is half of the image.
const UNIT_PX: f64 = SIDE as f64 / 2.0;
const PER_ROW: u32 = 64;
const SHEETS: u32 = 600;

fn before(scene: &str, side: u32, settings: Settings, output: Output) -> FrameRequest {
    let camera = Camera::perspective(DVec3::Z, DVec3::ZERO, 90.0);
    FrameRequest { settings, output, pose: Pose::Camera(camera), ..front(scene, side, side) }
}

/// Disks of the largest size that a thread may walk, in four chunks.
fn wall_of_disks() -> String {
    let list: Vec<Disk> = (0..PER_ROW * PER_ROW)
        .map(|i| {
            let at = |i: u32| f64::from(i) / f64::from(PER_ROW) * 1.8 - 0.9;
            Disk {
                at: DVec3::new(at(i % PER_ROW), at(i / PER_ROW), -0.001 * f64::from(i % 7)),
                normal: DVec3::Z,
                color: [(i % 251) as u8, (i / PER_ROW * 4) as u8, 128],
                radius: 14.6 / UNIT_PX,
            }
        })
        .collect();
    disks(&list)
}

#[test]
fn a_thread_walks_as_many_splats_as_it_can() {
    // First none by a thread, then all by a thread.
    let [walked, threads] = [1, 32].map(|px| {
        let studio = Studio::with(|config| config.small_splat_px = Some(px));
        studio.write("wall.ply", wall_of_disks());
        studio.load_json("wall", &cloud_scene("wall.ply"));
        studio
    });
    let splats = Settings {
        reconstruct: Reconstruct::Splats,
        prefilter: Some(false),
        ..Settings::default()
    };
    let fuzzy = Settings { reconstruct: Reconstruct::Fuzzy, ..splats };
    for settings in [splats, Settings { blend: Some(Blend::Opaque), ..splats }, fuzzy] {
        let request = before("wall", SIDE, settings, Output::Color);
        let expected = walked.frame(&request);
        let found = threads.frame(&request);
        same(&found.bytes, &expected.bytes, &format!("{settings:?}"));
        let counts = found.receipt.splats;
        let [scattered, listed] = [counts.scattered, counts.rasterised].map(Option::unwrap);
        assert_eq!(scattered + listed, u64::from(PER_ROW * PER_ROW), "{settings:?}");
        // A thread has about 128 of 900 pixels.
        assert!(scattered > 1500 && listed > 500, "{scattered} by a thread, {listed} listed");
    }
}

/// The depth of a sheet that covers the frame. The last sheet is the nearest.
fn sheet_z(sheet: u32) -> f64 {
    0.5 * f64::from(sheet + 1) / f64::from(SHEETS) - 0.5
}

#[test]
fn large_triangles_and_splats_one_before_the_other() {
    let side = 1024;
    let studio = Studio::with(|config| config.large_units_limit = Some(u32::MAX));
    let mut positions = Vec::new();
    let mut triangles = Vec::new();
    let mut list = Vec::new();
    for sheet in 0..SHEETS {
        let (z, first) = (sheet_z(sheet), positions.len() as u32);
        positions
            .extend([(-4.0, -4.0), (8.0, -4.0), (-4.0, 8.0)].map(|(x, y)| DVec3::new(x, y, z)));
        triangles.push([first, first + 1, first + 2]);
        list.push(Disk { at: DVec3::Z * z, normal: DVec3::Z, color: [255; 3], radius: 6.0 });
    }
    studio.write("sheets.ply", mesh(&positions, &triangles));
    studio.write("disks.ply", disks(&list));
    studio.load_json("sheets", &cloud_scene("sheets.ply"));
    studio.load_json("disks", &cloud_scene("disks.ply"));
    let opaque = Settings {
        reconstruct: Reconstruct::Splats,
        blend: Some(Blend::Opaque),
        ..Settings::default()
    };
    // From both sides: in whatever order the sheets are listed, in one of both cases the nearest one is not among the first.
    for (eye, sheet) in [(DVec3::Z, SHEETS - 1), (DVec3::Z * -2.0, 0)] {
        let nearest = (eye.z - sheet_z(sheet)).abs() as f32;
        let camera = Camera::perspective(eye, DVec3::ZERO, 60.0);
        for (scene, settings) in
            [("sheets", Settings::drawn_as(Reconstruct::Points)), ("disks", opaque)]
        {
            let pose = Pose::Camera(camera);
            let request = FrameRequest { pose, ..before(scene, side, settings, Output::Depth) };
            let frame = studio.frame(&request);
            let wrong = depths(&frame.bytes).into_iter().filter(|z| (z - nearest).abs() > 1e-4);
            assert_eq!(wrong.count(), 0, "{scene}, {eye}: pixels that show another sheet");
        }
    }
}

#[test]
fn a_scene_has_so_many_lights_at_most() {
    let studio = Studio::new();
    studio.write("wall.ply", wall_of_disks());
    let mut scene = cloud_scene("wall.ply");
    scene["lights"] = json!(vec![json!({ "kind": "headlight", "intensity": 0.004 }); 256]);
    studio.load_json("lit", &scene);
    scene["lights"] = json!(vec![json!({ "kind": "ambient" }); 257]);
    studio.write("bright.json", scene.to_string());
    let error = studio.try_load("bright", "bright.json").unwrap_err().to_string();
    assert!(error.contains("257 lights, 256 are possible"), "{error}");
}
