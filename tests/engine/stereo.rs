//! Images of stereo pairs: seen from beside the camera, with what lies at one distance in the same place.

use glam::{DVec2, DVec3};
use pointillist::engine::{EngineError, FrameRequest, Pose};
use pointillist::math::{Camera, Lens, View};
use pointillist::plan::{Output, Reconstruct, Settings};
use serde_json::json;

use super::studio::{Studio, etag, front, same, wall};

fn camera() -> Camera {
    Camera::perspective(DVec3::new(0.0, 0.3, 4.0), DVec3::ZERO, 45.0)
}

fn request(settings: Settings) -> FrameRequest {
    FrameRequest { pose: Pose::Camera(camera()), settings, ..front("solid", 96, 70) }
}

fn view() -> View {
    camera().view(96, 70).unwrap()
}

#[test]
fn images_are_those_of_skewed_frusta() {
    let studio = Studio::with_two();
    for (offset, at) in [(-0.4, None), (0.4, None), (0.25, Some(2.0))] {
        let plain = Settings::drawn_as(Reconstruct::Points);
        let shifted = plain.shifted(offset);
        let shifted = at.map_or(shifted, |distance| shifted.stereo_from(distance));
        for output in [Output::Color, Output::Depth, Output::Id] {
            let found = studio.bytes(&FrameRequest { output, ..request(shifted) });
            // By default the plane goes through the target.
            let distance = at.unwrap_or(camera().eye.length());
            let pose = Pose::View(view().from_lens(DVec2::new(offset, 0.0), distance));
            let expected = FrameRequest { pose, output, ..request(plain) };
            same(&found, &studio.bytes(&expected), &format!("{offset} {output:?}"));
        }
        let frame = studio.frame(&request(shifted));
        let receipt = serde_json::to_value(&frame.receipt).unwrap();
        let told = receipt["settings"]["stereo_distance"].as_f64().unwrap();
        assert!((told - at.unwrap_or(camera().eye.length())).abs() < 1e-6, "{receipt}");
    }
    let of = |offset: f64| {
        let settings = Settings::drawn_as(Reconstruct::Points).shifted(offset);
        etag(&studio.engine, &request(settings)).unwrap()
    };
    assert!(of(0.1) != of(-0.1) && of(0.0) != of(0.1));
}

/// An upright edge: at the distance of the plane both eyes see it in the same column, nearer or farther away at a distance of
/// `focal · offset · (1 / depth − 1 / plane)` pixels.
#[test]
fn an_edge_moves_by_its_parallax() {
    let studio = Studio::new();
    studio.load_half();
    let straight = Camera { eye: DVec3::new(0.0, 0.0, 4.0), ..camera() };
    let edge = |offset: f64, plane: f64| {
        let settings = Settings::drawn_as(Reconstruct::Points).shifted(offset).stereo_from(plane);
        let pose = Pose::Camera(straight);
        let request = FrameRequest { pose, settings, ..front("half", 400, 40) };
        let bytes = studio.bytes(&request);
        let row = &bytes.as_chunks::<4>().0[20 * 400..21 * 400];
        row.iter().position(|pixel| pixel[0] > 60).unwrap() as f64
    };
    let focal = straight.view(400, 40).unwrap().focal_px.x;
    for (offset, plane) in [(0.0, 4.0), (0.5, 4.0), (-0.5, 4.0), (0.5, 8.0), (-0.5, 2.0)] {
        let expected = 200.0 - focal * offset * (1.0 / 4.0 - 1.0 / plane);
        let found = edge(offset, plane);
        assert!((found - expected).abs() <= 1.0, "{offset} {plane}: {found}, not {expected}");
    }
}

/// Both images have the choices of the unshifted eye, even where each shows another part of the scene.
#[test]
fn both_images_are_drawn_alike() {
    let studio = Studio::new();
    studio.write("dense.ply", wall(40, |_, _| [200; 3]));
    studio.write("sparse.ply", wall(9, |_, _| [200; 3]));
    let far = |asset: &str, x: f64| json!({ "asset": asset, "scale": 2, "translate": [x, 0, -36] });
    studio.load_json(
        "walls",
        &json!({
            "assets": { "dense": { "file": "dense.ply" }, "sparse": { "file": "sparse.ply" } },
            "nodes": [far("dense", -12.0), far("sparse", 12.0)],
            "lights": [],
        }),
    );
    let straight = Camera { eye: DVec3::new(0.0, 0.0, 4.0), ..camera() };
    // The right eye sees the dense wall alone, the left one the sparse wall alone.
    let drawn = |offset: f64| {
        let settings = Settings::default().shifted(offset);
        let pose = Pose::Camera(straight);
        let request = FrameRequest { pose, settings, ..front("walls", 96, 70) };
        studio.engine.resolve_blocking(request).unwrap().settings().reconstruct
    };
    assert_eq!([-2.0, 0.0, 2.0].map(drawn), [Reconstruct::Splats; 3]);
}

#[test]
fn cameras_without_such_images_are_refused() {
    let studio = Studio::with_two();
    let refused = |request: FrameRequest| match studio.engine.resolve_blocking(request) {
        Err(EngineError::BadParameter { parameter, reason, .. }) => (parameter, reason),
        other => panic!("{:?}", other.map(|_| ())),
    };
    let settings = Settings::drawn_as(Reconstruct::Points).shifted(0.1);
    let parallel = Camera { lens: Lens::Orthographic { height: 3.0 }, ..camera() };
    let (parameter, reason) =
        refused(FrameRequest { pose: Pose::Camera(parallel), ..request(settings) });
    assert!(parameter == "eye_offset" && reason.contains("parallel"), "{reason}");
    let far = settings.shifted(1e8).stereo_from(1e-6);
    let (parameter, reason) = refused(request(far));
    assert!(parameter == "eye_offset" && reason.contains("beside the frame"), "{reason}");
}
