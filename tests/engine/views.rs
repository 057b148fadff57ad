//! Several views of one scene that share dispatches.

use std::fmt::Write as _;
use std::time::Duration;

use glam::DVec3;
use pointillist::engine::{EngineConfig, EngineError, FrameRequest, Pose, Receipt};
use pointillist::math::Camera;
use pointillist::plan::Output;
use serde_json::json;

use super::studio::{OUTPUTS, Studio, fit, front, orbit, same, sphere};

/// An engine whose batches are as long as on a fast machine.
fn long_batches(adjust: impl FnOnce(&mut EngineConfig)) -> Studio {
    Studio::with(|config| {
        config.batch_time = Duration::MAX;
        adjust(config);
    })
}

/// The counts of a receipt.
fn counts(receipt: &Receipt) -> [Option<u64>; 5] {
    [
        receipt.samples.tested,
        receipt.samples.drawn,
        receipt.triangles.tested,
        receipt.triangles.rasterised,
        receipt.instances.drawn,
    ]
}

/// Submits all requests at once until most were drawn together, and compares each with its frame alone.
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

/// Poses all around, some so near that triangles intersect the camera plane.
fn poses(scene: &str, output: Output) -> Vec<FrameRequest> {
    (0..11)
        .map(|number| {
            let mut request = orbit(scene, number, 61);
            request.height = 47;
            request.output = output;
            if number % 4 == 3 {
                let eye = DVec3::new(0.1 * f64::from(number) - 0.6, -0.35, -0.9);
                let target = DVec3::new(-0.4, 0.1, -1.0);
                let camera = Camera::perspective(eye, target, 70.0);
                request.pose = Pose::Camera(camera);
            }
            request
        })
        .collect()
}

/// Loads translucent panes that cross, before and behind a ball.
fn load_panes(studio: &Studio) {
    studio.write("pane.mtl", "newmtl pane\nKd 0.8 0.2 0.1\nd 0.5\n");
    studio.write(
        "pane.obj",
        "mtllib pane.mtl\nusemtl pane\nv -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nf 1 2 3 4\n",
    );
    studio.write("marble.ply", sphere(12));
    studio.load_json(
        "panes",
        &json!({
            "assets": { "pane": { "file": "pane.obj" }, "marble": { "file": "marble.ply" } },
            "nodes": [
                { "asset": "pane", "rotate": [0, 30, 0] },
                { "asset": "pane", "rotate": [0, 110, 20] },
                { "asset": "pane", "rotate": [60, 0, 0], "scale": 0.1, "translate": [0.2, 0.1, 0.6] },
                { "asset": "marble", "scale": 0.5 },
            ],
            "lights": [{ "kind": "headlight" }],
        }),
    );
}

/// Where a binding is too small for a picture's translucent fragments, the picture is drawn window by window.
#[test]
fn windows_change_no_pixel() {
    let [small, whole] = [Some(1 << 20), None].map(|max_binding_bytes| {
        let studio = Studio::with(|config| config.max_binding_bytes = max_binding_bytes);
        load_panes(&studio);
        studio
    });
    let mut most = 0;
    for request in poses("panes", Output::Color) {
        // Three windows, which begin within a row.
        let request = FrameRequest { width: 251, height: 163, ..request };
        let [found, all] = [&small, &whole].map(|studio| studio.frame(&request));
        same(&found.bytes, &all.bytes, &format!("{request:?}"));
        let deepest = [&found, &all].map(|frame| frame.receipt.translucent.unwrap().deepest);
        assert_eq!(deepest[0], deepest[1], "{request:?}");
        assert_eq!(counts(&found.receipt), counts(&all.receipt), "{request:?}");
        most = most.max(deepest[0]);
    }
    assert!(most >= 2, "{most} layers");
}

#[test]
fn each_view_is_what_it_is_alone() {
    for (force_32_bit, rasterise) in [(false, false), (false, true), (true, false), (true, true)] {
        let studio = long_batches(|config| {
            config.force_32_bit = force_32_bit;
            config.rasterise = Some(rasterise);
        });
        studio.load_two();
        load_panes(&studio);
        for scene in ["solid", "cloud", "panes"] {
            for output in OUTPUTS {
                let what = format!("{scene}, 32 bit: {force_32_bit}, rasterised: {rasterise}");
                together_as_alone(&studio, &poses(scene, output), &what);
            }
        }
    }
}

/// Several pages, and therefore several segments, and views that see different parts of them.
#[test]
fn views_of_several_pages() {
    let studio = long_batches(|config| config.max_binding_bytes = Some(1 << 20));
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

/// Views that share more than samples: textures with alpha, many lights, large and small triangles on several pages, frames of
/// several bands, and lists that have to grow.
#[test]
fn views_of_textured_and_lit_pages() {
    let studio = long_batches(|config| config.max_binding_bytes = Some(2 << 20));
    studio.load_two();
    studio.write("ball.ply", sphere(150));
    studio.write("leaf.mtl", "newmtl leaf\nmap_Kd leaf.png\nmap_d leaf.png\n");
    studio.write(
        "leaf.obj",
        "mtllib leaf.mtl\nusemtl leaf\nv -1 -1 0.6\nv 1 -1 0.6\nv 1 1 0.6\nv -1 1 0.6\nvt 0 0\nvt 2 0\nvt 2 2\nvt 0 2\n\
         f 1/1 2/2 3/3 4/4\n",
    );
    let pixels = image::RgbaImage::from_fn(16, 16, |x, y| {
        image::Rgba([
            (x * 15) as u8,
            (y * 15) as u8,
            90,
            if (x / 4 + y / 4) % 2 == 0 { 255 } else { 0 },
        ])
    });
    pixels.save(studio.folder().join("leaf.png")).unwrap();
    let lights: Vec<_> = (0..6)
        .map(
            |n| json!({ "kind": "point", "position": [n, 3 - n, 2], "range": 3, "intensity": 0.3 }),
        )
        .collect();
    studio.load_json(
        "full",
        &json!({
            "assets": { "ball": { "file": "ball.ply" }, "leaf": { "file": "leaf.obj" }, "wall": { "file": "wall.ply" } },
            "nodes": [
                { "asset": "ball", "scale": 0.7, "repeat": { "grid": [2, 1, 1], "step": [1.2, 0, 0] } },
                { "asset": "leaf" },
                { "asset": "wall", "translate": [0, 0, -1] },
            ],
            "lights": lights,
        }),
    );
    for output in [Output::Color, Output::Normal] {
        let tall: Vec<_> = poses("full", output)
            .into_iter()
            .map(|request| FrameRequest { height: 300, ..request })
            .collect();
        together_as_alone(&studio, &tall, "textured and lit");
    }
}

/// If one view exceeds the limit of large triangles, only its frame fails, and the sum over all views is not limited.
#[test]
fn a_view_over_the_limit_is_refused_alone() {
    let studio = long_batches(|config| config.large_units_limit = Some(150));
    studio.load_two();
    let (mut text, mut faces) = (String::new(), String::new());
    for quad in 0..60 {
        for (x, y) in [(-1, -1), (1, -1), (1, 1), (-1, 1)] {
            writeln!(text, "{x} {y} {}", f64::from(quad) * 1e-3).unwrap();
        }
        let [a, b, c, d] = [0, 1, 2, 3].map(|corner| 4 * quad + corner);
        writeln!(faces, "3 {a} {b} {c}\n3 {a} {c} {d}").unwrap();
    }
    let head = "ply\nformat ascii 1.0\nelement vertex 240\nproperty double x\nproperty double y\nproperty double z\n\
                element face 120\nproperty list uchar int vertex_indices\nend_header\n";
    studio.write("stack.ply", format!("{head}{text}{faces}"));
    studio.load("stack", "stack.ply");
    // At the first distance 120 triangles are some 50 px wide and count as one unit each. At half the distance each counts as
    // three.
    let from = |distance: f64, target: f64| {
        let (eye, target) = (DVec3::new(0.01, 0.02, distance), DVec3::Z * target);
        let camera = Camera::perspective(eye, target, 60.0);
        FrameRequest { pose: Pose::Camera(camera), ..fit("stack", 128, Output::Depth) }
    };
    let over = from(2.0, 0.0);
    assert!(matches!(studio.submit(&over).wait(), Err(EngineError::OverLimit { .. })));
    let fine = [from(30.0, 0.0), from(4.0, 0.0), from(3.95, 0.1), from(2.0, 7.0)];
    let expected = fine.each_ref().map(|request| studio.bytes(request));
    let mut most = 0;
    for _ in 0..20 {
        let busy: Vec<_> = (0..6).map(|n| studio.submit(&front("cloud", 340, 340 - n))).collect();
        let first = studio.submit(&fine[0]);
        let refused = studio.submit(&over);
        let rest: Vec<_> = fine[1..].iter().map(|request| studio.submit(request)).collect();
        for (ticket, bytes) in std::iter::once(first).chain(rest).zip(&expected) {
            let frame = ticket.wait().unwrap();
            most = most.max(frame.receipt.views);
            same(&frame.bytes, bytes, "beside one over the limit");
        }
        assert!(matches!(refused.wait(), Err(EngineError::OverLimit { .. })));
        drop(busy);
        if most >= 5 {
            return;
        }
    }
    panic!("only {most} views were ever drawn together");
}
