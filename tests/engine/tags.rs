//! Entity tags are equal for equivalent requests, and differ where frames may.

use std::collections::HashMap;

use glam::DVec3;
use pointillist::encode::ImageFormat;
use pointillist::engine::{FrameRequest, NodePatch, Pose};
use pointillist::math::{Camera, Lens};
use pointillist::plan::{Given, Output};
use serde_json::json;

use super::studio::{OUTPUTS, Studio, cloud_scene, disk_sphere, disks, front, same, sphere};

fn camera() -> Camera {
    Camera::perspective(DVec3::new(0.0, 0.0, 3.0), DVec3::ZERO, 45.0)
}

/// A single pass that overflows is replaced by three, which may have ambient occlusion where the single pass has none.
#[test]
fn ambient_occlusion_is_in_the_tag_of_frames_that_may_have_it() {
    let studio = Studio::new();
    studio.write("ball.ply", disks(&disk_sphere(300, 1.0, |_| [200, 90, 60])));
    for (id, lights) in [("lit", json!([{ "kind": "headlight" }])), ("unlit", json!([]))] {
        let mut scene = cloud_scene("ball.ply");
        scene["lights"] = lights;
        scene["ambient_occlusion"] = json!({ "radius": 0.4 });
        studio.load_json(id, &scene);
    }
    let tag = |scene: &str, reconstruct: &str, ao: &str| {
        let mut given = Given::default();
        given.set_text("reconstruct", reconstruct).unwrap();
        given.set_text("ao", ao).unwrap();
        let settings = given.resolve().unwrap();
        let request = FrameRequest { settings, ..front(scene, 48, 32) };
        super::studio::etag(&studio.engine, &request).unwrap()
    };
    let differ = |scene, how| tag(scene, how, "on") != tag(scene, how, "off");
    assert!(!differ("lit", "fuzzy") && !differ("lit", "painted"));
    assert!(differ("unlit", "fuzzy") && differ("unlit", "painted"));
    assert!(differ("lit", "points") && differ("unlit", "points"));
}

#[test]
fn every_parameter_changes_the_tag() {
    let studio = Studio::with_two();
    let base = FrameRequest { pose: Pose::Camera(camera()), ..front("cloud", 128, 96) };
    let with = |adjust: &dyn Fn(&mut FrameRequest)| {
        let mut request = base.clone();
        adjust(&mut request);
        request
    };
    let posed = |adjust: &dyn Fn(&mut Camera)| {
        let mut changed = camera();
        adjust(&mut changed);
        FrameRequest { pose: Pose::Camera(changed), ..base.clone() }
    };
    let requests = [
        base.clone(),
        with(&|r| r.scene = "solid".to_owned()),
        with(&|r| r.width = 129),
        with(&|r| r.height = 97),
        with(&|r| (r.width, r.height) = (96, 128)),
        with(&|r| r.format = ImageFormat::Jpeg),
        with(&|r| (r.format, r.quality) = (ImageFormat::Jpeg, 89)),
        with(&|r| r.format = ImageFormat::Png),
        with(&|r| r.format = ImageFormat::Qoi),
        with(&|r| r.output = Output::Depth),
        with(&|r| r.output = Output::Normal),
        with(&|r| r.output = Output::Id),
        with(&|r| r.pose = Pose::FIT),
        posed(&|c| c.eye.x = 1e-9),
        posed(&|c| c.eye.z = 3.0 + 1e-12),
        posed(&|c| c.target.y = 0.1),
        posed(&|c| c.up = DVec3::X),
        posed(&|c| c.lens = Lens::Perspective { fov_deg: 45.0 + 1e-9 }),
    ];
    let mut seen: HashMap<String, &FrameRequest> = HashMap::new();
    for request in &requests {
        let tag = super::studio::etag(&studio.engine, request).unwrap();
        assert!(tag.starts_with('"') && tag.ends_with('"') && tag.len() == 34, "{tag}");
        assert_eq!(super::studio::etag(&studio.engine, request).unwrap(), tag, "a tag is stable");
        if let Some(other) = seen.insert(tag, request) {
            panic!("equal tags:\n{request:?}\n{other:?}");
        }
    }
}

/// A scene, settings of which the last one is to be compared, and the outputs that show it.
type Case<'a> = (&'a str, &'a [(&'a str, &'a str)], &'a [Output]);

/// Tags and receipts ask the output and the scene, so that clients keep frames whose pixels cannot have changed.
#[test]
fn settings_without_effect_leave_the_tag_as_it_is() {
    let studio = Studio::with_two();
    studio.write("plain.ply", sphere(8));
    studio.load_json("mesh", &cloud_scene("plain.ply"));
    let with = |scene: &str, output, pairs: &[(&str, &str)]| {
        let mut given = Given::default();
        for (name, value) in pairs {
            given.set_text(name, value).unwrap();
        }
        FrameRequest { settings: given.resolve().unwrap(), output, ..front(scene, 96, 96) }
    };
    let (color, all): (&[Output], &[Output]) = (&[Output::Color], &OUTPUTS);
    let cases: &[Case] = &[
        ("cloud", &[("reconstruct", "points"), ("color_by", "height")], color),
        ("cloud", &[("reconstruct", "points"), ("background", "#ff0000")], color),
        ("cloud", &[("reconstruct", "points"), ("edl", "off")], color),
        ("cloud", &[("reconstruct", "points"), ("edl", "on"), ("edl_strength", "3")], color),
        ("cloud", &[("reconstruct", "points"), ("point_size_px", "5")], all),
        ("cloud", &[("reconstruct", "splats")], all),
        ("cloud", &[("reconstruct", "splats"), ("prefilter", "false")], all),
        ("cloud", &[("reconstruct", "splats"), ("shading", "splat")], &[]),
        ("solid", &[("reconstruct", "splats"), ("shading", "splat")], color),
        ("solid", &[("reconstruct", "splats"), ("blend", "opaque"), ("shading", "splat")], &[]),
        ("mesh", &[("reconstruct", "points"), ("color_by", "height")], color),
        ("mesh", &[("reconstruct", "splats"), ("filter", "affine")], &[]),
        ("mesh", &[("reconstruct", "pull_push"), ("pull_push_weights", "box")], &[]),
    ];
    for &(scene, pairs, shown) in cases {
        let (last, first) = pairs.split_last().unwrap();
        for output in OUTPUTS {
            let [without, with] = [first, pairs].map(|pairs| with(scene, output, pairs));
            let case = format!("{scene} {pairs:?} {output:?}");
            let [before, after] =
                [&without, &with].map(|one| super::studio::etag(&studio.engine, one).unwrap());
            assert_eq!(before != after, shown.contains(&output), "{case}");
            let [before, after] = [&without, &with].map(|one| studio.frame(one));
            let named = serde_json::to_value(&after.receipt.settings).unwrap();
            assert_eq!(named.get(last.0).is_some(), shown.contains(&output), "{case}: {named}");
            if !shown.contains(&output) {
                same(&after.bytes, &before.bytes, &case);
            }
        }
    }
}

#[test]
fn quality_is_for_jpeg() {
    let studio = Studio::with_two();
    let tag = |format, quality| {
        let request = FrameRequest { format, quality, ..front("cloud", 64, 64) };
        super::studio::etag(&studio.engine, &request).unwrap()
    };
    assert_ne!(tag(ImageFormat::Jpeg, 80), tag(ImageFormat::Jpeg, 90));
    assert_eq!(tag(ImageFormat::Png, 80), tag(ImageFormat::Png, 90));
}

#[test]
fn equal_views_have_equal_tags_and_bytes() {
    let studio = Studio::with_two();
    let requests = [
        front("cloud", 128, 96),
        FrameRequest { pose: Pose::Camera(camera()), ..front("cloud", 128, 96) },
        FrameRequest {
            pose: Pose::Upright {
                eye: camera().eye,
                target: camera().target,
                lens: Lens::Perspective { fov_deg: 45.0 },
            },
            ..front("cloud", 128, 96)
        },
        FrameRequest {
            pose: Pose::View(camera().view(128, 96).unwrap()),
            ..front("cloud", 128, 96)
        },
        // Only the direction of `up` matters, and zero has no sign.
        FrameRequest {
            pose: Pose::Camera(Camera {
                up: DVec3::Y * 7.0,
                eye: DVec3::new(-0.0, -0.0, 3.0),
                ..camera()
            }),
            ..front("cloud", 128, 96)
        },
    ];
    let tag = super::studio::etag(&studio.engine, &requests[0]).unwrap();
    let bytes = studio.bytes(&requests[0]);
    for request in &requests[1..] {
        assert_eq!(super::studio::etag(&studio.engine, request).unwrap(), tag, "{request:?}");
        same(&studio.bytes(request), &bytes, &format!("{request:?}"));
    }
    let later = FrameRequest {
        deadline: Some(std::time::Instant::now() + std::time::Duration::from_secs(600)),
        ..requests[0].clone()
    };
    assert_eq!(
        super::studio::etag(&studio.engine, &later).unwrap(),
        tag,
        "patience is no part of a frame"
    );
}

#[test]
fn content_and_revision_change_the_tag() {
    let studio = Studio::with_two();
    let request = front("cloud", 64, 64);
    let first = super::studio::etag(&studio.engine, &request).unwrap();
    let hide = NodePatch { visible: Some(false), ..NodePatch::default() };
    let show = NodePatch { visible: Some(true), ..NodePatch::default() };
    studio.engine.patch("cloud", "wall", &hide).unwrap();
    let hidden = super::studio::etag(&studio.engine, &request).unwrap();
    assert_ne!(hidden, first);
    studio.engine.patch("cloud", "wall", &show).unwrap();
    assert_ne!(super::studio::etag(&studio.engine, &request).unwrap(), hidden);

    studio.engine.remove("cloud").unwrap();
    studio.load("cloud", "cloud.json");
    assert_eq!(
        super::studio::etag(&studio.engine, &request).unwrap(),
        first,
        "the same scene again"
    );
    studio.engine.remove("cloud").unwrap();
    studio.write("wall.ply", sphere(5));
    studio.load("cloud", "cloud.json");
    assert_ne!(super::studio::etag(&studio.engine, &request).unwrap(), first, "a file has changed");
}
