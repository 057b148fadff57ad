//! Depth of field and motion blur: frames are the means of their exposures, however these are drawn.

use glam::DVec3;
use pointillist::engine::{EngineError, FrameRequest, Pose};
use pointillist::math::{Camera, Projection, View, exposures};
use pointillist::plan::{BlurSamples, Output, Pass, Reconstruct, Settings};
use pointillist::scene::color::{linear_from_srgb, srgb_from_linear};
use serde_json::json;

use super::studio::{Studio, etag, front, same, spt};

const LENS: f64 = 0.3;

fn camera(x: f64) -> Camera {
    Camera::perspective(DVec3::new(x, 0.3, 4.0), DVec3::new(x, 0.0, 0.0), 45.0)
}

/// A frame through a lens whose plane of focus is 3 units away.
fn through_lens(scene: &str, settings: Settings) -> FrameRequest {
    let blur_samples = BlurSamples::Exposures32;
    let settings =
        Settings { aperture: LENS.into(), focus_distance: 3.0.into(), blur_samples, ..settings };
    FrameRequest { pose: Pose::Camera(camera(0.0)), settings, ..front(scene, 96, 70) }
}

/// The same frame, made of exposures that are drawn one by one.
fn one_by_one(studio: &Studio, request: &FrameRequest, views: &[View]) -> Vec<u8> {
    let mut sums = vec![[0.0; 4]; (request.width * request.height) as usize];
    for view in views {
        let settings = request.settings.without_blur();
        let one = FrameRequest { settings, pose: Pose::View(*view), ..request.clone() };
        for (sum, pixel) in sums.iter_mut().zip(studio.bytes(&one).as_chunks::<4>().0) {
            let alpha = f64::from(pixel[3]) / 255.0;
            for channel in 0..3 {
                sum[channel] += alpha * linear_from_srgb(f64::from(pixel[channel]) / 255.0);
            }
            sum[3] += alpha;
        }
    }
    let bytes = |sum: [f64; 4]| {
        let byte = |unit: f64| (255.0 * unit).round() as u8;
        let [r, g, b] = [0, 1, 2].map(|channel| byte(srgb_from_linear(sum[channel] / sum[3])));
        [r, g, b, byte(sum[3] / views.len() as f64)]
    };
    sums.into_iter().flat_map(bytes).collect()
}

fn views(request: &FrameRequest) -> Vec<View> {
    let Pose::Camera(camera) = &request.pose else { panic!("no camera") };
    let view = camera.view(request.width, request.height).unwrap();
    let beside =
        exposures(32).map(|one| view.from_lens(0.5 * LENS * one.on_lens, 3.0).moved(one.in_pixel));
    beside.collect()
}

/// Compares all bytes; a mean that lies between two bytes may be rounded to either.
fn nearly_same(found: &[u8], expected: &[u8], what: &str) {
    let off = found.iter().zip(expected).filter(|(a, b)| a != b).count();
    let worst = found.iter().zip(expected).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
    assert!(worst <= 1 && off * 50 < found.len(), "{what}: {off} bytes differ by up to {worst}");
}

#[test]
fn frames_are_the_means_of_their_exposures() {
    for (narrow, like_a_gpu) in [(false, false), (true, true)] {
        let studio = Studio::with(|config| {
            (config.force_32_bit, config.like_a_gpu) = (narrow, like_a_gpu);
        });
        studio.load_two();
        let points = Settings::drawn_as(Reconstruct::Points);
        for settings in [
            points,
            Settings::drawn_as(Reconstruct::Splats),
            Settings::drawn_as(Reconstruct::Painted),
            spt(2.0, Reconstruct::Points),
        ] {
            let request = through_lens("solid", settings);
            studio.engine.resolve_blocking(request.clone()).unwrap();
            let frame = studio.frame(&request);
            let ran = |pass: Pass| {
                frame.receipt.passes.iter().any(|line| line.name == pass.name() && line.ran)
            };
            assert!(ran(Pass::Accumulate), "{settings:?}");
            assert_eq!(frame.receipt.views, 1);
            let expected = one_by_one(&studio, &request, &views(&request));
            nearly_same(&frame.bytes, &expected, &format!("{settings:?} {narrow}"));
        }
    }
}

/// Exposures of a frame share dispatches with each other, and never with those of another frame.
#[test]
fn a_batch_changes_no_blurred_frame() {
    let studio = Studio::with_two();
    let requests: Vec<FrameRequest> = [1.0, 2.0, 3.0, 6.0]
        .into_iter()
        .flat_map(|focus: f64| {
            let lens = through_lens("solid", Settings::drawn_as(Reconstruct::Points));
            let settings = Settings { focus_distance: focus.into(), ..lens.settings };
            let sharp = FrameRequest { settings: settings.without_blur(), ..lens.clone() };
            [FrameRequest { settings, ..lens }, sharp]
        })
        .collect();
    let alone: Vec<Vec<u8>> = requests.iter().map(|request| studio.bytes(request)).collect();
    assert!(alone[0] != alone[2] && alone[1] == alone[3]);
    for _ in 0..3 {
        let busy = studio.keep_busy("solid");
        let tickets: Vec<_> = requests.iter().map(|request| studio.submit(request)).collect();
        for (ticket, (request, bytes)) in tickets.into_iter().zip(requests.iter().zip(&alone)) {
            same(&ticket.wait().unwrap().bytes, bytes, &format!("{request:?}"));
        }
        busy.into_iter().for_each(|ticket| drop(ticket.wait()));
    }
    let fresh = Studio::with(|config| config.max_batch = 1);
    fresh.load_two();
    for (request, bytes) in requests.iter().zip(&alone) {
        same(&fresh.bytes(request), bytes, &format!("{request:?}"));
        assert_eq!(etag(&fresh.engine, request).unwrap(), etag(&studio.engine, request).unwrap());
    }
}

/// Exposures are submitted part by part, so that a frame ends soon after its last client has gone.
#[test]
fn a_blurred_frame_ends_when_nobody_waits_for_it() {
    let studio = Studio::with_two();
    let lens = through_lens("solid", Settings::drawn_as(Reconstruct::Points));
    let blur_samples = BlurSamples::Exposures128;
    let long = FrameRequest {
        width: 256,
        height: 256,
        settings: Settings { blur_samples, ..lens.settings },
        ..lens
    };
    let whole = studio.bytes(&long);
    // A frame that is begun is dropped, once the frame before it has come, which does not wait for all exposures. If it is dropped too early, it is
    // asked for again.
    let mut tries = 0;
    while studio.engine.stats().given_up == 0 {
        tries += 1;
        assert!(tries < 50, "no frame was given up");
        let before = studio.submit(&front("solid", 16, 16 + tries));
        let moved =
            FrameRequest { pose: Pose::Camera(camera(1e-3 * f64::from(tries))), ..long.clone() };
        let ticket = studio.submit(&moved);
        before.wait().unwrap();
        while studio.engine.stats().queued > 0 {
            std::thread::yield_now();
        }
        drop(ticket);
        // It is through when the next one is.
        studio.bytes(&front("solid", 16, 16));
    }
    same(&studio.bytes(&long), &whole, "after a frame that was given up");
}

/// A camera that moves sideways while the shutter is open: an edge becomes a ramp as wide as the way in pixels.
#[test]
fn an_edge_becomes_a_ramp_while_the_camera_moves() {
    let studio = Studio::new();
    studio.load_half();
    let count = 64;
    let way = 0.8;
    let exposed: Vec<Camera> = exposures(count).map(|one| camera(way * (one.time - 0.5))).collect();
    let settings = Settings {
        shutter: 0.5.into(),
        blur_samples: BlurSamples::Exposures64,
        ..Settings::drawn_as(Reconstruct::Points)
    };
    let pose = Pose::Moving { camera: camera(0.0), exposed: exposed.into() };
    let request = FrameRequest { pose, settings, ..front("half", 128, 96) };
    let frame = studio.frame(&request);
    let view = camera(0.0).view(128, 96).unwrap();
    let depth = -view.to_view(DVec3::ZERO).z;
    let width = way * view.focal_px.x / depth;
    let row = 48;
    let mut worst = 0.0f64;
    for (column, pixel) in frame.bytes.as_chunks::<4>().0[row * 128..][..128].iter().enumerate() {
        // The eye moves right, so that the edge moves left.
        let share = |x: f64| ((x - 64.0) / width + 0.5).clamp(0.0, 1.0);
        let parts = (0..32).map(|k| share(column as f64 + (f64::from(k) + 0.5) / 32.0));
        let expected = parts.sum::<f64>() / 32.0;
        worst = worst.max((linear_from_srgb(f64::from(pixel[0]) / 255.0) - expected).abs());
    }
    println!("{width:.1} pixels wide, error {worst:.4}");
    assert!(width > 20.0 && worst < 1.5 / f64::from(count), "{width} {worst}");
    // Depths are those of the frame's own time.
    let depth = FrameRequest { output: Output::Depth, ..request.clone() };
    let still = FrameRequest { pose: Pose::Camera(camera(0.0)), ..depth.clone() };
    assert_eq!(etag(&studio.engine, &depth).unwrap(), etag(&studio.engine, &still).unwrap());
}

/// A shutter changes nothing where no path moves the camera, and a lens nothing of what has no colours.
#[test]
fn blur_without_a_cause_changes_no_byte() {
    let studio = Studio::with_two();
    let plain = front("solid", 96, 70);
    let sharp = studio.frame(&plain);
    let why = |frame: &pointillist::engine::EncodedFrame| {
        let mut lines = frame.receipt.passes.iter();
        lines.find(|line| line.name == Pass::Accumulate.name()).unwrap().why.clone()
    };
    let because = why(&sharp).unwrap();
    assert!(because.contains("aperture") && because.contains("shutter"), "{because}");
    let with = |settings: Settings, output| FrameRequest { settings, output, ..plain.clone() };
    let open = Settings { shutter: 0.5.into(), ..plain.settings };
    let found = studio.frame(&with(open, Output::Color));
    same(&found.bytes, &sharp.bytes, "an open shutter");
    assert_eq!(why(&found).as_deref(), Some(because.as_str()));
    let tag = |request: &FrameRequest| etag(&studio.engine, request).unwrap();
    assert_eq!(tag(&with(open, Output::Color)), tag(&plain));
    let lens = Settings { aperture: 0.2.into(), ..plain.settings };
    assert_ne!(tag(&with(lens, Output::Color)), tag(&plain));
    for output in [Output::Depth, Output::Normal, Output::Id] {
        assert_eq!(tag(&with(lens, output)), tag(&with(plain.settings, output)));
    }
    // The number of exposures has no effect either, nor has a pinhole's size.
    let many = Settings { blur_samples: BlurSamples::Exposures256, ..plain.settings };
    let pinhole = Settings { aperture: 0.0.into(), ..plain.settings };
    for settings in [many, pinhole] {
        assert_eq!(tag(&with(settings, Output::Color)), tag(&plain));
    }
}

#[test]
fn receipts_say_what_is_sharp_and_count_all_exposures() {
    let studio = Studio::with_two();
    let plain = FrameRequest { pose: Pose::Camera(camera(0.0)), ..front("cloud", 64, 48) };
    let lens = Settings { aperture: 0.1.into(), ..plain.settings };
    let frame = studio.frame(&FrameRequest { settings: lens, ..plain.clone() });
    let settings = serde_json::to_value(&frame.receipt.settings).unwrap();
    let target = camera(0.0).eye.distance(camera(0.0).target);
    let found = settings["focus_distance"].as_f64().unwrap();
    assert!((found - target).abs() < 1e-6, "{settings}");
    assert_eq!((&settings["aperture"], &settings["blur_samples"]), (&json!(0.1), &json!("32")));
    assert!(settings.get("shutter").is_none(), "{settings}");
    let sharp = studio.frame(&plain);
    let tested = |frame: &pointillist::engine::EncodedFrame| frame.receipt.samples.tested.unwrap();
    assert_eq!(tested(&frame), 32 * tested(&sharp));
    // A view that has no target is sharp at the middle of the scene.
    let view = View { focus: 0.0, ..camera(0.0).view(64, 48).unwrap() };
    let pose = Pose::View(view);
    let frame = studio.frame(&FrameRequest { settings: lens, pose, ..plain });
    let settings = serde_json::to_value(&frame.receipt.settings).unwrap();
    let found = settings["focus_distance"].as_f64().unwrap();
    let middle = -view.to_view(DVec3::ZERO).z;
    assert!((found - middle).abs() < 1e-6, "{settings}: {middle}");
}

#[test]
fn what_has_no_lens_or_too_many_exposures_is_refused() {
    let studio = Studio::with(|config| config.max_pixels = 20_000);
    studio.load_two();
    let lens = through_lens("cloud", Settings::drawn_as(Reconstruct::Points));
    let refused = |request: &FrameRequest| studio.engine.submit(request.clone()).err().unwrap();
    let with = |settings: Settings| FrameRequest { settings, ..lens.clone() };
    let flat = Settings { projection: Some(Projection::Orthographic), ..lens.settings };
    let wide = Settings { aperture: 1e9.into(), ..lens.settings };
    let goal = Settings { budget_ms: 9.0.into(), ..lens.settings };
    for (settings, text) in
        [(flat, "parallel"), (wide, "pixels beside the frame"), (goal, "single exposures")]
    {
        match refused(&with(settings)) {
            EngineError::BadParameter { parameter: "aperture", reason, accepted } => {
                assert!(reason.contains(text) && !accepted.is_empty(), "{reason}: {accepted}");
            }
            other => panic!("{settings:?}: {other:?}"),
        }
    }
    // Behind the eye lies nothing that could be in focus.
    let away = View { focus: 0.0, ..camera(0.0).view(96, 70).unwrap() };
    let away = View { eye: away.eye - away.view_from_world.transpose().z_axis * 50.0, ..away };
    let settings = Settings { aperture: 0.1.into(), ..front("cloud", 1, 1).settings };
    let request = FrameRequest { pose: Pose::View(away), settings, ..lens.clone() };
    assert!(
        matches!(refused(&request), EngineError::BadParameter { parameter: "aperture", reason, .. } if reason.contains("focus_distance"))
    );
    // 96 · 70 · 32 pixels are fewer than 16 · 20 000, and 64 times as many as a frame are not.
    assert!(studio.engine.submit(lens.clone()).is_ok());
    let many = Settings { blur_samples: BlurSamples::Exposures64, ..lens.settings };
    let error = refused(&with(many));
    assert!(
        matches!(
            error,
            EngineError::OverLimit {
                found: 430_080,
                limit: 320_000,
                parameter: Some("blur_samples"),
                ..
            }
        ),
        "{error:?}"
    );
    assert_eq!(studio.engine.limits().max_exposed_pixels, 320_000);
}

/// With a lens and a moving camera, each exposure has its own time and its own point of the lens.
#[test]
fn lens_and_shutter_go_together() {
    let studio = Studio::with_two();
    let lens = through_lens("solid", Settings::drawn_as(Reconstruct::Points));
    let exposed: Vec<Camera> = exposures(32).map(|one| camera(0.5 * one.time)).collect();
    let settings = Settings { shutter: 1.0.into(), ..lens.settings };
    let pose = Pose::Moving { camera: camera(0.25), exposed: exposed.clone().into() };
    let request = FrameRequest { pose, settings, ..lens };
    let views: Vec<View> = exposures(32)
        .zip(&exposed)
        .map(|(one, camera)| {
            let view = camera.view(request.width, request.height).unwrap();
            view.from_lens(0.5 * LENS * one.on_lens, 3.0).moved(one.in_pixel)
        })
        .collect();
    let expected = one_by_one(&studio, &request, &views);
    nearly_same(&studio.bytes(&request), &expected, "lens and shutter");
}
