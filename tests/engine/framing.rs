//! The default view fills the frame, cameras of the shipped scenes show their subject as a whole, and an empty view gives a
//! reason.

use std::path::Path;

use glam::DVec3;
use pointillist::encode::ImageFormat;
use pointillist::engine::{EncodedFrame, FrameRequest, Pose};
use pointillist::math::{Camera, Lens, Projection};
use pointillist::plan::{Output, Reconstruct, Settings};
use serde_json::json;

use super::studio::{Studio, cloud, fit, front, mesh};

const SIZES: [(u32, u32); 4] = [(200, 150), (240, 135), (128, 128), (90, 190)];

/// Ids of an image, row by row: instance numbers plus one.
fn ids(frame: &EncodedFrame) -> Vec<u32> {
    let (words, _) = frame.bytes.as_chunks();
    words.iter().map(|&word| u32::from_le_bytes(word)).collect()
}

/// Shares of the frame's width and height that pixels with `seen` ids span, and the middle of these pixels from 0 to 1.
fn taken(ids: &[u32], width: u32, seen: impl Fn(u32) -> bool) -> ([f64; 2], [f64; 2]) {
    let height = ids.len() as u32 / width;
    let mut low = [u32::MAX; 2];
    let mut high = [0; 2];
    for (index, _) in (0u32..).zip(ids).filter(|&(_, &id)| seen(id)) {
        for (axis, at) in [index % width, index / width].into_iter().enumerate() {
            low[axis] = low[axis].min(at);
            high[axis] = high[axis].max(at + 1);
        }
    }
    assert!(low[0] < u32::MAX, "nothing is seen");
    let size = [width, height].map(f64::from);
    let share = |axis: usize| f64::from(high[axis] - low[axis]) / size[axis];
    let middle = |axis: usize| f64::from(high[axis] + low[axis]) / 2.0 / size[axis];
    ([share(0), share(1)], [middle(0), middle(1)])
}

/// Holds the default view of a scene to nine tenths of the frame, in its middle, in either projection.
fn fills(studio: &Studio, scene: &str) {
    let projections = [Projection::Perspective, Projection::Orthographic];
    for (size, projection) in SIZES.iter().flat_map(|&size| projections.map(|one| (size, one))) {
        let request = fit(scene, 1, Output::Id);
        let settings = Settings { projection: Some(projection), ..request.settings };
        let request = FrameRequest { width: size.0, height: size.1, settings, ..request };
        let frame = studio.frame(&request);
        assert_eq!(frame.receipt.camera.fov_deg.is_none(), projection == Projection::Orthographic);
        let (share, middle) = taken(&ids(&frame), size.0, |id| id > 0);
        let most = share[0].max(share[1]);
        // Allow for a pixel on either side and for gaps between samples.
        assert!((0.86..0.93).contains(&most), "{scene} at {size:?} takes {share:?}");
        for at in middle {
            assert!((0.46..0.54).contains(&at), "{scene} at {size:?} is at {middle:?}");
        }
    }
}

fn grid(side: usize, place: impl Fn(f64, f64) -> DVec3) -> String {
    let at = move |i: usize| i as f64 / (side - 1) as f64 * 2.0 - 1.0;
    cloud((0..side * side).map(|i| (place(at(i % side), at(i / side)), [200, 90, 40])))
}

#[test]
fn default_view_fills_the_frame_whatever_the_content() {
    let studio = Studio::new();
    let utm = DVec3::new(412_000.0, 5_653_000.0, 110.0);
    let waves = |x: f64, y: f64| DVec3::new(80.0 * x, 60.0 * y, (5.0 * x).sin() * (4.0 * y).cos());
    studio.write("terrain.ply", grid(160, |x, y| utm + waves(x, y)));
    studio.write("wall.ply", grid(120, |x, y| DVec3::new(0.0, 3.0 * y, 5.0 * x)));
    studio.write("sheet.ply", grid(120, |x, y| DVec3::new(2.0 * x, 0.0, y)));
    studio.write("speck.ply", grid(60, |x, y| DVec3::new(x, y, x * y) * 1e-4));
    let steps = [0.0, 1.0].map(|x| DVec3::new(x, 2.5 * x, 0.0));
    let corners = [steps[0], DVec3::X, DVec3::Z, steps[1]];
    studio.write("mesh.ply", mesh(&corners, &[[0, 1, 2], [0, 1, 3], [1, 2, 3], [0, 2, 3]]));
    for scene in ["terrain", "wall", "sheet", "speck", "mesh"] {
        studio.load(scene, &format!("{scene}.ply"));
        fills(&studio, scene);
    }
    studio.load_two();
    fills(&studio, "solid");
    let copies = json!({ "assets": { "s": { "file": "speck.ply" } },
        "nodes": [{ "asset": "s", "scale": 1e4, "repeat": { "grid": [50, 3, 20], "step": [3, 3, 3] } }] });
    studio.load_json("copies", &copies);
    fills(&studio, "copies");
}

/// The part that clip boxes leave is shown as large as a whole scene would be; boxes that leave nothing are given as the reason.
#[test]
fn default_view_is_of_what_clip_boxes_show() {
    let studio = Studio::new();
    let places = (0..30_000).map(|i| {
        let [x, y, z] = [i % 31, i / 31 % 31, i / 961].map(|at| f64::from(at) / 15.0 - 1.0);
        (DVec3::new(x, y, z), [90, 160, 90])
    });
    studio.write("block.ply", cloud(places));
    studio.load("block", "block.ply");
    let (width, height) = SIZES[0];
    let clipped = |boxes: &str| {
        let request = fit("block", 1, Output::Id);
        let settings = Settings { clip_boxes: Some(boxes.parse().unwrap()), ..request.settings };
        studio.frame(&FrameRequest { width, height, settings, ..request })
    };
    for boxes in ["0.5,0.5,0.5,5,5,5", "*,*,0.9,*,*,*", "0.5,0.5,0.5,5,5,5;0.5,-9,*,9,-0.5,*"] {
        let frame = clipped(boxes);
        let (share, middle) = taken(&ids(&frame), width, |id| id > 0);
        assert!((0.6..0.93).contains(&share[0].max(share[1])), "{boxes}: {share:?}");
        assert!(middle.iter().all(|at| (0.4..0.6).contains(at)), "{boxes}: {middle:?}");
        assert_eq!(frame.receipt.nothing_visible, None);
    }
    let why = clipped("outside:*,*,*,*,*,*").receipt.nothing_visible.clone().unwrap();
    assert!(why.contains("is hidden by clip boxes"), "{why}");
}

#[test]
fn default_view_is_not_thrown_by_strays_and_says_so() {
    let studio = Studio::new();
    let ball = |count: usize| {
        (0..count).map(move |i| {
            let y = 1.0 - 2.0 * (i as f64 + 0.5) / count as f64;
            let (sin, cos) = (2.399_963_229_728_653 * i as f64).sin_cos();
            let r = (1.0 - y * y).sqrt();
            (DVec3::new(r * cos, y, r * sin), [90, 160, 90])
        })
    };
    let far = [DVec3::new(4e3, 0.0, 0.0), DVec3::new(-900.0, 2e3, 50.0)];
    let strays = far.map(|place| (place, [255; 3])).into_iter();
    studio.write("noisy.ply", cloud(ball(20_000).chain(strays)));
    studio.write("clean.ply", cloud(ball(20_000)));
    let info = studio.load("noisy", "noisy.ply");
    let warning = info.warnings.iter().find(|text| text.contains("2 of 20002 points"));
    assert!(warning.is_some(), "{:?}", info.warnings);
    assert!(studio.load("clean", "clean.ply").warnings.iter().all(|text| !text.contains("far")));
    fills(&studio, "clean");
    fills(&studio, "noisy");
}

#[test]
fn odd_scenes_have_a_default_view() {
    let studio = Studio::new();
    studio.write("one.ply", cloud([(DVec3::new(4e5, 5e6, 9.0), [255, 0, 0])].into_iter()));
    studio.load("one", "one.ply");
    let splats = Settings { reconstruct: Reconstruct::Splats, ..Settings::default() };
    for (width, height) in [(64, 64), (1, 257), (257, 1)] {
        let request = FrameRequest { width, height, ..fit("one", 1, Output::Id) };
        let shown = ids(&studio.frame(&request)).into_iter().filter(|&id| id > 0).count();
        assert_eq!(shown, 1, "{width} × {height}");
        studio.frame(&FrameRequest { settings: splats, ..request });
    }
    let nothing = json!({ "assets": { "g": { "file": "one.ply" } },
        "nodes": [{ "asset": "g", "visible": false }] });
    studio.load_json("nothing", &nothing);
    let frame = studio.frame(&fit("nothing", 32, Output::Color));
    let why = frame.receipt.nothing_visible.as_deref().unwrap_or_default();
    assert!(why.contains("nothing to draw"), "{why}");
}

#[test]
fn a_frame_that_shows_nothing_says_why() {
    let studio = Studio::with_two();
    let looking = |scene: &str, target: [f64; 3], output| {
        let (eye, target) = (DVec3::new(0.0, 0.0, 4.0), DVec3::from_array(target));
        let camera = Camera::perspective(eye, target, 40.0);
        let request = FrameRequest { pose: Pose::Camera(camera), ..fit(scene, 48, output) };
        let format = ImageFormat::Raw;
        studio.frame(&FrameRequest { format, ..request }).receipt.nothing_visible.clone()
    };
    for scene in ["solid", "cloud"] {
        for output in super::studio::OUTPUTS {
            assert_eq!(looking(scene, [0.0; 3], output), None, "{scene} {output:?}");
            let behind = looking(scene, [0.0, 0.0, 9.0], output).unwrap_or_default();
            assert!(behind.contains("behind the camera"), "{scene} {output:?}: {behind}");
            let beside = looking(scene, [9.0, 0.0, 0.0], output).unwrap_or_default();
            assert!(beside.contains("to the left"), "{scene} {output:?}: {beside}");
        }
    }
}

#[test]
fn named_cameras_keep_their_width_in_narrow_frames() {
    let studio = Studio::with_two();
    let camera =
        |width, height| studio.frame(&front("solid", width, height)).receipt.camera.clone();
    assert_eq!(camera(64, 48).fov_deg, Some(45.0));
    assert_eq!(camera(64, 64).fov_deg, Some(45.0));
    let expected = 2.0 * (2.0 * 22.5f64.to_radians().tan()).atan().to_degrees();
    assert!((camera(40, 80).fov_deg.unwrap() - expected).abs() < 1e-9);
    // A field of view that the request gives stays vertical.
    let eye = DVec3::new(0.0, 0.0, 4.0);
    let pose =
        Pose::Upright { eye, target: DVec3::ZERO, lens: Lens::Perspective { fov_deg: 45.0 } };
    let own = FrameRequest { pose, ..front("solid", 40, 80) };
    assert_eq!(studio.frame(&own).receipt.camera.fov_deg, Some(45.0));
}

#[test]
fn shipped_cameras_show_their_subject_whole() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    let studio = Studio::below(&root, |_| {});
    // Cameras that show a whole object, and its instances.
    for (scene, cameras, subject) in [
        ("relief", &["front", "above"][..], 1..2),
        ("part", &["front", "above"], 1..2),
        ("textured", &["front"], 1..2),
        ("town", &["overview", "above"], 1..2),
        ("plaza", &["overview"], 1..u32::MAX),
    ] {
        let info = studio.engine.load(scene, &root.join(format!("{scene}.json"))).unwrap();
        assert!(info.warnings.is_empty(), "{scene}: {:?}", info.warnings);
        for camera in cameras {
            for (width, height) in SIZES {
                let request = FrameRequest { output: Output::Id, ..front(scene, width, height) };
                let pose = Pose::Named((*camera).to_owned());
                let frame = studio.frame(&FrameRequest { pose, ..request });
                let ids = ids(&frame);
                let what = format!("{scene}/{camera} at {width} × {height}");
                let edge = |index: usize| {
                    let (x, y) = (index as u32 % width, index as u32 / width);
                    x == 0 || y == 0 || x + 1 == width || y + 1 == height
                };
                let is_cut = (0..ids.len()).filter(|&i| edge(i) && subject.contains(&ids[i]));
                // The town's scan has stray points.
                assert!(is_cut.count() <= 2, "{what} is cut off at the frame's edge");
                let (share, _) = taken(&ids, width, |id| subject.contains(&id));
                let most = share[0].max(share[1]);
                assert!(most > 0.25, "{what} takes {share:?}");
            }
        }
    }
}

#[test]
fn scene_with_a_subject_shows_the_subject_by_default() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    let studio = Studio::below(&root, |_| {});
    studio.engine.load("textured", &root.join("textured.json")).unwrap();
    for (width, height) in SIZES {
        let request = FrameRequest { width, height, ..fit("textured", 1, Output::Id) };
        let (share, _) = taken(&ids(&studio.frame(&request)), width, |id| id == 1);
        let most = share[0].max(share[1]);
        // The amphora does not fill the corners of its box.
        assert!((0.6..0.93).contains(&most), "at {width} × {height} the amphora takes {share:?}");
    }
}
