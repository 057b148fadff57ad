//! Requests that cannot be drawn are refused with a message.

use glam::{DMat3, DVec2, DVec3};
use pointillist::encode::ImageFormat;
use pointillist::engine::{EngineError, FrameRequest, Pose};
use pointillist::math::{Camera, Lens, View};
use pointillist::plan::{Antialias, Output, Settings};

use super::studio::{Studio, front};

fn camera() -> Camera {
    Camera::perspective(DVec3::Z * 3.0, DVec3::ZERO, 45.0)
}

#[test]
fn sizes_have_limits() {
    let studio = Studio::with(|config| (config.max_side, config.max_pixels) = (300, 40_000));
    studio.load_two();
    let refuse = |width, height| studio.engine.submit(front("cloud", width, height)).err();
    for (width, height, wrong) in [(0, 10, "w"), (10, 0, "h"), (0, 0, "w")] {
        let error = refuse(width, height);
        assert!(
            matches!(error, Some(EngineError::BadParameter { parameter, .. }) if parameter == wrong),
            "{error:?}"
        );
    }
    for (width, height, most) in
        [(301, 10, 300), (10, 301, 300), (u32::MAX, u32::MAX, 300), (300, 134, 40_000)]
    {
        let error = refuse(width, height);
        assert!(
            matches!(error, Some(EngineError::OverLimit { limit, .. }) if limit == most),
            "{width} × {height}: {error:?}"
        );
    }
    for (width, height) in [(300, 133), (1, 300), (300, 1), (1, 1), (200, 200)] {
        assert!(refuse(width, height).is_none());
        let bytes = studio.bytes(&front("cloud", width, height));
        assert_eq!(bytes.len() as u32, width * height * 4);
    }
    let limits = studio.engine.limits();
    assert_eq!((limits.max_side, limits.max_pixels), (300, 40_000));
    // Parts of pixels count as pixels do.
    let averaged = |width, height, output| {
        let settings = Settings { antialias: Antialias::Parts16, ..front("cloud", 1, 1).settings };
        let request = FrameRequest { settings, output, ..front("cloud", width, height) };
        studio.engine.submit(request).err()
    };
    for (width, height, most) in [(76, 10, 75), (75, 34, 2_500)] {
        let error = averaged(width, height, Output::Color);
        assert!(
            matches!(error, Some(EngineError::OverLimit { limit, .. }) if limit == most),
            "{width} × {height}: {error:?}"
        );
        assert!(averaged(width, height, Output::Depth).is_none());
    }
    assert!(averaged(75, 33, Output::Color).is_none());
}

#[test]
fn a_limit_of_the_adapter_is_told_apart_from_one_of_the_settings() {
    let studio = Studio::with(|config| {
        (config.max_pixels, config.max_binding_bytes) = (1 << 30, Some(1 << 20));
    });
    studio.load_two();
    assert_eq!(studio.engine.limits().max_pixels, 1 << 17);
    let refused = |studio: &Studio, width, height| {
        studio.engine.submit(front("cloud", width, height)).err().unwrap().to_string()
    };
    let said = refused(&studio, 4096, 4096);
    assert!(said.starts_with("16777216 is more than the limit of 131072 pixels"), "{said}");
    assert!(said.contains("this adapter"), "{said}");
    let studio = Studio::with(|config| config.max_pixels = 100);
    studio.load_two();
    let said = refused(&studio, 11, 10);
    assert_eq!(said, "110 is more than the limit of 100 pixels");
}

#[test]
fn the_largest_frame_is_drawn() {
    let studio = Studio::with_two();
    let limits = studio.engine.limits();
    let side = limits.max_side;
    let other = (limits.max_pixels / u64::from(side)) as u32;
    for (width, height) in [(side, other), (other, side)] {
        let request = FrameRequest { output: Output::Depth, ..front("solid", width, height) };
        let bytes = studio.bytes(&request);
        assert!(super::studio::covered(&bytes) > bytes.len() / 400);
    }
}

#[test]
fn poses_that_are_none() {
    let studio = Studio::with_two();
    let bad = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY];
    let mut poses = vec![
        (Pose::Camera(Camera { target: DVec3::Z * 3.0, ..camera() }), "target"),
        (Pose::Camera(Camera { up: DVec3::ZERO, ..camera() }), "up"),
        (Pose::Camera(Camera { lens: Lens::Perspective { fov_deg: 0.0 }, ..camera() }), "fov"),
        (Pose::Camera(Camera { lens: Lens::Perspective { fov_deg: 180.0 }, ..camera() }), "fov"),
        (Pose::Camera(Camera { lens: Lens::Perspective { fov_deg: -40.0 }, ..camera() }), "fov"),
        (
            Pose::Upright {
                eye: DVec3::ONE,
                target: DVec3::ONE,
                lens: Lens::Perspective { fov_deg: 40.0 },
            },
            "target",
        ),
        (Pose::Named("back".to_owned()), "camera"),
    ];
    for value in bad {
        for axis in 0..3 {
            for place in 0..3 {
                let mut pose = camera();
                let (vector, name) = match place {
                    0 => (&mut pose.eye, "eye"),
                    1 => (&mut pose.target, "target"),
                    _ => (&mut pose.up, "up"),
                };
                vector[axis] = value;
                poses.push((Pose::Camera(pose), name));
            }
        }
        poses.push((
            Pose::Camera(Camera { lens: Lens::Perspective { fov_deg: value }, ..camera() }),
            "fov",
        ));
    }
    let view = camera().view(40, 40).unwrap();
    for broken in [
        View { width: 41, ..view },
        View { height: 4000, ..view },
        View { eye: DVec3::NAN, ..view },
        View { view_from_world: DMat3::NAN, ..view },
        View { focal_px: DVec2::ZERO, ..view },
        View { focal_px: DVec2::INFINITY, ..view },
        View { principal_px: DVec2::NAN, ..view },
    ] {
        poses.push((Pose::View(broken), "view"));
    }
    for (pose, wrong) in poses {
        let request = FrameRequest { pose, ..front("cloud", 40, 40) };
        let error = studio.engine.submit(request.clone()).err();
        let Some(EngineError::BadParameter { parameter, reason, accepted }) = error else {
            panic!("{:?}: {error:?}", request.pose);
        };
        assert_eq!(parameter, wrong, "{:?}", request.pose);
        assert!(!reason.is_empty() && !accepted.is_empty());
        assert!(super::studio::etag(&studio.engine, &request).is_err());
    }
    let mut request = front("cloud", 40, 40);
    for quality in [0, 101, 255] {
        request.quality = quality;
        assert!(studio.engine.submit(request.clone()).is_err(), "quality {quality}");
    }
    request.quality = 90;
    for (output, format) in [
        (Output::Color, ImageFormat::Pfm),
        (Output::Depth, ImageFormat::Jpeg),
        (Output::Id, ImageFormat::Jpeg),
    ] {
        (request.output, request.format) = (output, format);
        let error = studio.engine.submit(request.clone()).err();
        assert!(matches!(error, Some(EngineError::BadParameter { parameter: "format", .. })));
    }
    studio.frame(&front("cloud", 40, 40));
}

#[test]
fn odd_poses_are_drawn() {
    let studio = Studio::with_two();
    for pose in [
        // Looking along `up`; almost nothing in view; almost everything in view; very near; inside; far away.
        Camera { up: DVec3::Z, ..camera() },
        Camera { lens: Lens::Perspective { fov_deg: 1e-6 }, ..camera() },
        Camera { lens: Lens::Perspective { fov_deg: 179.999_999 }, ..camera() },
        Camera { eye: DVec3::Z * 1e-12, ..camera() },
        Camera { eye: DVec3::ZERO, target: DVec3::Z, ..camera() },
        Camera { eye: DVec3::Z * 1e12, ..camera() },
        Camera { eye: DVec3::Z * 1e25, ..camera() },
        Camera { eye: DVec3::splat(1e30), ..camera() },
        Camera { eye: DVec3::splat(1e200), ..camera() },
        Camera { target: DVec3::new(1e300, 0.0, 0.0), ..camera() },
        Camera { up: DVec3::Y * 1e-300, ..camera() },
        Camera { up: DVec3::Y * 1e300, ..camera() },
        Camera { eye: DVec3::splat(-1.7e308), target: DVec3::splat(1.7e308), ..camera() },
    ] {
        for scene in ["solid", "cloud"] {
            let request = FrameRequest {
                pose: Pose::Camera(pose),
                output: Output::Depth,
                ..front(scene, 50, 40)
            };
            match studio.engine.submit(request) {
                // Panics if a depth is NaN.
                Ok(ticket) => {
                    let frame = ticket.wait().unwrap_or_else(|error| panic!("{pose:?}: {error}"));
                    super::studio::covered(&frame.bytes);
                }
                Err(EngineError::BadParameter { .. }) => {}
                Err(error) => panic!("{pose:?}: {error}"),
            }
        }
    }
    assert_eq!(studio.engine.stats().device_losses, 0);
}
