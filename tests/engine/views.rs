//! Views of one scene that the same dispatches draw.

use std::fmt::Write as _;

use glam::DVec3;
use pointillist::engine::{EngineError, FrameRequest, Pose, Receipt};
use pointillist::math::Camera;
use pointillist::plan::Output;
use serde_json::json;

use super::studio::{OUTPUTS, Studio, fit, front, orbit, same};

/// What a receipt counts.
fn counts(receipt: &Receipt) -> [Option<u64>; 5] {
    [
        receipt.samples.tested,
        receipt.samples.drawn,
        receipt.triangles.tested,
        receipt.triangles.rasterised,
        receipt.instances.drawn,
    ]
}

/// Asks for all at once until most were drawn together, and compares each with what it is alone.
fn together_as_alone(studio: &Studio, requests: &[FrameRequest], what: &str) {
    let alone: Vec<_> = requests.iter().map(|request| studio.frame(request)).collect();
    assert!(alone.iter().all(|frame| frame.receipt.views == 1));
    let mut most = 0;
    for _ in 0..30 {
        let busy: Vec<_> = (0..6).map(|n| studio.submit(&front("cloud", 340, 340 - n))).collect();
        let tickets: Vec<_> = requests.iter().map(|request| studio.submit(request)).collect();
        for (ticket, (request, alone)) in tickets.into_iter().zip(requests.iter().zip(&alone)) {
            let frame = ticket.wait().unwrap();
            most = most.max(frame.receipt.views);
            assert!(frame.receipt.views <= frame.receipt.batch_size);
            same(&frame.bytes, &alone.bytes, &format!("{what}: {request:?}"));
            assert_eq!(counts(&frame.receipt), counts(&alone.receipt), "{what}: {request:?}");
        }
        drop(busy);
        if most as usize > requests.len() / 2 {
            return;
        }
    }
    panic!("{what}: only {most} views were ever drawn together");
}

/// Poses all around, some of them so near that triangles meet the camera plane.
fn poses(scene: &str, output: Output) -> Vec<FrameRequest> {
    (0..11)
        .map(|number| {
            let mut request = orbit(scene, number, 61);
            request.height = 47;
            request.output = output;
            if number % 4 == 3 {
                let eye = DVec3::new(0.1 * f64::from(number) - 0.6, -0.35, -0.9);
                let target = DVec3::new(-0.4, 0.1, -1.0);
                let camera = Camera { eye, target, up: DVec3::Y, fov_deg: 70.0 };
                request.pose = Pose::Camera(camera);
            }
            request
        })
        .collect()
}

#[test]
fn each_view_is_what_it_is_alone() {
    for (force_32_bit, rasterise) in [(false, false), (false, true), (true, true)] {
        let studio = Studio::with(|config| {
            config.force_32_bit = force_32_bit;
            config.rasterise = Some(rasterise);
        });
        studio.load_two();
        for scene in ["solid", "cloud"] {
            for output in OUTPUTS {
                let what = format!("{scene}, 32 bit: {force_32_bit}, rasterised: {rasterise}");
                together_as_alone(&studio, &poses(scene, output), &what);
            }
        }
    }
}

/// Several pages, hence several segments, and views that see different parts of them.
#[test]
fn views_of_several_pages() {
    let studio = Studio::with(|config| config.max_binding_bytes = Some(1 << 20));
    let mut text = String::new();
    for x in 0..400 {
        for y in 0..400 {
            writeln!(text, "{} {} {}", f64::from(x) * 0.004, f64::from(y) * 0.004, x * y % 7)
                .unwrap();
        }
    }
    studio.load_two();
    studio.write("many.xyz", text);
    studio.load_json(
        "many",
        &json!({
            "assets": { "many": { "file": "many.xyz" } },
            "nodes": [{ "asset": "many", "scale": 0.4,
                        "repeat": { "grid": [3, 3, 1], "step": [1, 1, 0] }, "translate": [-1, -1, 0] }],
            "lights": [{ "kind": "headlight" }],
        }),
    );
    for output in [Output::Color, Output::Id] {
        together_as_alone(&studio, &poses("many", output), "several pages");
    }
}

/// One view's large triangles must not cost the others their frames.
#[test]
fn a_view_over_the_limit_is_refused_alone() {
    const QUADS: u32 = 8300;
    let mut text = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty double x\nproperty double y\nproperty double z\n\
         element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        4 * QUADS,
        2 * QUADS
    );
    for quad in 0..QUADS {
        for (x, y) in [(-1, -1), (1, -1), (1, 1), (-1, 1)] {
            writeln!(text, "{x} {y} {}", f64::from(quad) * 1e-5).unwrap();
        }
    }
    for quad in 0..QUADS {
        let [a, b, c, d] = [0, 1, 2, 3].map(|corner| 4 * quad + corner);
        writeln!(text, "3 {a} {b} {c}\n3 {a} {c} {d}").unwrap();
    }
    let studio = Studio::new();
    studio.load_two();
    studio.write("stack.ply", text);
    studio.load("stack", "stack.ply");
    let from = |distance: f64, target: f64| {
        let eye = DVec3::Z * distance;
        let target = DVec3::Z * target;
        let camera = Camera { eye, target, up: DVec3::Y, fov_deg: 60.0 };
        FrameRequest { pose: Pose::Camera(camera), ..fit("stack", 512, Output::Depth) }
    };
    let (near, far, away) = (from(1.2, 0.0), from(60.0, 0.0), from(3.0, 9.0));
    let refused = studio.submit(&near).wait().map(|_| ());
    assert!(matches!(refused, Err(EngineError::OverLimit { .. })), "{refused:?}");
    let expected = [&far, &away].map(|request| studio.bytes(request));
    for _ in 0..10 {
        let busy = studio.keep_busy("cloud");
        let tickets = [&far, &near, &away].map(|request| studio.submit(request));
        let [first, second, third] = tickets.map(|ticket| ticket.wait());
        same(&first.unwrap().bytes, &expected[0], "beside one over the limit");
        assert!(matches!(second, Err(EngineError::OverLimit { .. })));
        same(&third.unwrap().bytes, &expected[1], "beside one over the limit");
        drop(busy);
    }
}
