//! Compares splats with the oracle's: the effects of settings, kernels and other objects in the scene.
//!
//! Rounding may move pixels at a footprint's rim to either side, which changes the visible splat there. A frame is therefore
//! judged by its signal-to-noise ratio, and by holes and leaks, which must be within a pixel of the oracle's outline.

use glam::{DVec3, Vec3};
use pointillist::accuracy::metrics;
use pointillist::encode::{FrameImage, png};
use pointillist::math::View;
use pointillist::oracle::OracleFrame;
use pointillist::plan::{Pass, Reconstruct, Reconstruction, Settings};
use pointillist::scene::{Blend, Filter, Shading};
use serde_json::{Value, json};

use super::files::Shape;
use super::stage::{Case, Frames, folder, look};

/// The scene's settings of splats with another filter.
pub fn splats(filter: Filter) -> Settings {
    Settings { reconstruct: Reconstruct::Splats, filter: Some(filter), ..Settings::default() }
}

/// The oracle's frame with the same settings.
pub fn oracle(case: &Case, view: &View, settings: Settings) -> OracleFrame {
    let scene = case.reference.description().splats;
    case.reference.frame_with(view, 1, Reconstruction::new(&settings, &scene).splats())
}

/// Differences of two frames.
#[derive(Debug)]
pub struct Difference {
    pub psnr: f64,
    /// PSNR of the normal images.
    pub normal_psnr: f64,
    pub depth_p99: f64,
    pub holes: u64,
    pub leaks: u64,
    pub covered: u64,
    /// Pixels with different instances where both frames show one.
    pub ids: usize,
}

pub fn difference(twin: &OracleFrame, frames: &Frames) -> Difference {
    let color = twin.to_rgba8();
    let (expected, found) = (metrics::covered_by_id(&twin.id), metrics::covered_by_id(&frames.id));
    let coverage = metrics::coverage(&expected, &found, frames.width, frames.height).unwrap();
    let depth = metrics::depth_error(&twin.depth, &frames.depth).unwrap();
    let image = pointillist::accuracy::reference::image(twin, pointillist::plan::Output::Normal);
    let FrameImage::Normal { rgba: normals, .. } = image else { unreachable!("asked for normals") };
    let ids = twin.id.iter().zip(&frames.id).filter(|(a, b)| a != b && **a != 0 && **b != 0);
    Difference {
        psnr: metrics::psnr(&color, &frames.color).unwrap(),
        normal_psnr: metrics::psnr(&normals, &frames.normal).unwrap(),
        depth_p99: depth.map_or(0.0, |spread| spread.p99),
        holes: coverage.holes,
        leaks: coverage.leaks,
        covered: coverage.covered_reference,
        ids: ids.count(),
    }
}

/// Draws a frame, compares it with the oracle's frame with the settings `against`, and fails with images.
pub fn check(
    case: &Case,
    view: &View,
    settings: Settings,
    against: Settings,
    least: f64,
) -> Frames {
    let frames = case.draw_with(view, settings);
    let twin = oracle(case, view, against);
    let found = difference(&twin, &frames);
    println!("{} {settings:?}: {found:?}", case.id);
    let rim = (found.covered / 200).max(8);
    let fits = found.psnr >= least
        && found.normal_psnr >= 30.0
        && found.depth_p99 < 2e-3
        && found.ids <= rim as usize
        && found.holes <= rim
        && found.leaks <= rim;
    if !fits {
        save_both(case, view, twin.to_rgba8(), frames.color.clone());
        panic!("{}: {settings:?} against {against:?}: {found:?}, least {least}", case.id);
    }
    frames
}

/// Writes the images of a failure.
pub fn save_both(case: &Case, view: &View, oracle: Vec<[u8; 4]>, engine: Vec<[u8; 4]>) {
    for (what, rgba) in [("oracle", oracle), ("engine", engine)] {
        let image = FrameImage::Color { width: view.width, height: view.height, rgba };
        let name = format!("splats-{}-{what}.png", case.id);
        std::fs::write(folder().join(&name), png::encode(&image).unwrap().bytes).unwrap();
    }
}

/// A sphere of samples with outward normals.
pub fn ball(count: usize, seed: u64) -> Shape {
    let mut cloud = Shape::cloud(count, [-1.0; 3], [1.0; 3], seed);
    for (position, normal) in cloud.positions.iter_mut().zip(&mut cloud.normals) {
        *position /= position.length();
        *normal = position.as_vec3();
    }
    cloud
}

/// A ball of which every seventh sample has no normal.
pub fn patchy_ball() -> Shape {
    let mut cloud = ball(900, 14);
    for normal in cloud.normals.iter_mut().step_by(7) {
        *normal = Vec3::ZERO;
    }
    cloud
}

pub fn case(name: &str, cloud: &Shape, rest: Value) -> Case {
    let mut scene = json!({ "assets": { "c": { "file": "c.ply" } }, "nodes": [{ "asset": "c" }] });
    for (key, value) in rest.as_object().unwrap() {
        scene[key] = value.clone();
    }
    Case::new(name, &[("c.ply", cloud.ply())], &scene)
}

const FILTERS: [Filter; 3] = [Filter::Affine, Filter::Perspective, Filter::Exact];

#[test]
fn every_filter_is_the_oracles() {
    let case = case("splat-filters", &ball(1500, 11), json!({}));
    for view in [look([0.4, 1.0, 3.0], [0.0; 3], 45.0), look([0.2, 0.4, 1.35], [0.0; 3], 70.0)] {
        for filter in FILTERS {
            for prefilter in [false, true] {
                let settings = Settings { prefilter: Some(prefilter), ..splats(filter) };
                let frames = check(&case, &view, settings, settings, 45.0);
                assert_eq!(frames.receipt.settings.applied.filter, Some(filter));
            }
        }
    }
}

#[test]
fn every_setting_is_the_oracles() {
    let lights = json!({ "lights": [
        { "kind": "point", "position": [2, 2, 2], "range": 2 },
        { "kind": "sun", "direction": [1, -1, -0.5], "color": "#ffcc88" },
        { "kind": "ambient", "intensity": 0.2 }
    ], "materials": { "m": { "color": "#ffe0c0", "specular": "#808080", "shininess": 20 } },
       "nodes": [{ "asset": "c", "material": "m" }] });
    let case = case("splat-settings", &ball(2500, 12), lights);
    let view = look([1.4, 1.0, 2.0], [0.0; 3], 50.0);
    for blend in [Blend::Weighted, Blend::Opaque] {
        for shading in [Shading::Deferred, Shading::Splat] {
            let settings = Settings {
                blend: Some(blend),
                shading: Some(shading),
                ..splats(Filter::Perspective)
            };
            // A pixel of opaque splats shows one splat's colour and normal. Where two splats intersect, rounding decides which.
            let least = if blend == Blend::Opaque { 36.0 } else { 44.0 };
            let frames = check(&case, &view, settings, settings, least);
            assert_eq!(frames.ran(Pass::BlendSplats), blend == Blend::Weighted);
        }
    }
}

/// Widths, cut-offs, offsets and low-pass filters other than the defaults.
#[test]
fn parameters_of_the_scene_are_the_oracles() {
    for (number, own) in [
        json!({ "cutoff": 1.2, "width": 1.5, "lowpass": 1.0 }),
        json!({ "cutoff": 3.0, "width": 0.7, "prefilter": false, "depth_offset": 0.3 }),
        json!({ "cutoff": 0.6, "width": 0.9, "lowpass": 0.2, "filter": "exact" }),
        json!({ "lowpass": 4.0, "depth_offset": 5 }),
    ]
    .into_iter()
    .enumerate()
    {
        let case =
            case(&format!("splat-parameters-{number}"), &ball(1200, 13), json!({ "splats": own }));
        let settings = Settings { reconstruct: Reconstruct::Splats, ..Settings::default() };
        // Disks that end at 0.6 standard deviations are all rim, and lengths are stored with an accuracy of a quarter of a
        // percent.
        let least = if number == 2 { 40.0 } else { 44.0 };
        check(&case, &look([0.0, 1.0, 3.0], [0.0; 3], 45.0), settings, settings, least);
    }
}

/// Instances that stretch, shear and mirror, beside samples without normals and triangles, with a common depth test.
#[test]
fn splats_share_their_depth_with_everything_else() {
    let cloud = patchy_ball();
    let scene = json!({
        "assets": { "c": { "file": "c.ply" }, "t": { "file": "t.ply" } },
        "nodes": [
            { "asset": "c", "scale": [1, 0.4, 1.3], "rotate": [20, 30, 5] },
            { "asset": "c", "matrix": [0.5, 0.2, 0, 0, 0, 0.5, 0.1, 0, 0, 0, -0.5, 0, 1.1, 0.3, 0, 1] },
            { "asset": "t", "translate": [0, -0.2, 0] }
        ]
    });
    let floor = Shape::quad(
        DVec3::new(-2.0, 0.0, -2.0),
        DVec3::new(0.0, 0.0, 4.0),
        DVec3::new(4.0, 0.0, 0.0),
        1.0,
    );
    let files = [("c.ply", cloud.ply()), ("t.ply", floor.ply())];
    let case = Case::new("splat-mixed", &files, &scene);
    for eye in [[1.0, 1.2, 2.5], [-2.0, 0.4, 1.0]] {
        for filter in FILTERS {
            let settings = splats(filter);
            let frames = check(&case, &look(eye, [0.3, 0.0, 0.0], 55.0), settings, settings, 40.0);
            let ids = |id: u32| frames.id.iter().filter(|&&found| found == id).count();
            assert!((1..=3).all(|id| ids(id) > 200), "{} {} {}", ids(1), ids(2), ids(3));
        }
    }
}

/// The eye is among the splats: some reach the camera plane, and many are large.
#[test]
fn splats_around_the_eye() {
    let case = case("splat-around", &ball(1500, 15), json!({ "splats": { "width": 1.5 } }));
    for (eye, target) in [
        ([0.0, 0.0, 0.93], [0.3, 0.2, 1.0]),
        ([0.5, 0.5, 0.6], [1.0, 0.0, 0.0]),
        ([0.0, 0.97, 0.0], [1.0, 0.8, 0.0]),
    ] {
        for filter in [Filter::Perspective, Filter::Exact] {
            let settings = splats(filter);
            let frames = check(&case, &look(eye, target, 80.0), settings, settings, 38.0);
            let counts = frames.receipt.splats;
            assert!(
                counts.clipped.unwrap() > 0 && counts.rasterised > counts.clipped,
                "{counts:?}"
            );
        }
    }
}

/// Sampled solids with sharp edges by clip lines, on both paths and with every filter.
#[test]
fn clip_lines_are_the_oracles() {
    let scene = json!({
        "assets": {
            "box": { "file": "box.ply", "sample": { "spacing": 0.25 } },
            "ball": { "file": "ball.ply", "sample": { "spacing": 0.2 } },
            "part": { "difference": [{ "asset": "box" }, { "asset": "ball", "translate": [0.7, 0.6, 0.8] }] }
        },
        "nodes": [{ "asset": "part", "rotate": [0, 25, 0] }]
    });
    let files = [("box.ply", cube().ply()), ("ball.ply", Shape::ball(24, 0.7).ply())];
    let case = Case::new("splat-clips", &files, &scene);
    for eye in [[1.6, 1.8, 2.4], [0.9, 1.1, 1.6]] {
        for filter in FILTERS {
            let settings = splats(filter);
            check(&case, &look(eye, [0.2, 0.2, 0.2], 50.0), settings, settings, 40.0);
        }
    }
}

/// A cube of edge 2 with outward faces, without normals.
pub fn cube() -> Shape {
    let mut shape = Shape::default();
    for axis in 0..3 {
        for side in [-1.0, 1.0] {
            let mut corner = DVec3::NEG_ONE;
            corner[axis] = side;
            let (mut u, mut v) = (DVec3::ZERO, DVec3::ZERO);
            u[(axis + 1) % 3] = 2.0;
            v[(axis + 2) % 3] = 2.0;
            if side < 0.0 {
                std::mem::swap(&mut u, &mut v);
            }
            shape.add(&Shape::quad(corner, u, v, 1.0));
        }
    }
    shape.uvs.clear();
    shape
}

/// Guarantees for the committed scenes: 45 dB for `exact` and 38 dB for `perspective`, each compared with the exact oracle.
#[test]
fn committed_scenes() {
    for (scene, cameras) in
        [("town", &["overview", "square", "street"][..]), ("part", &["front", "detail"][..])]
    {
        let case = Case::committed(scene);
        for camera in cameras {
            let view = case.view(camera, 200, 150);
            let exact = splats(Filter::Exact);
            check(&case, &view, exact, exact, 45.0);
            check(&case, &view, splats(Filter::Perspective), exact, 38.0);
        }
    }
}

#[test]
fn frames_repeat_to_the_bit() {
    let case = case("splat-repeats", &ball(4000, 16), json!({}));
    let view = look([0.6, 1.0, 2.4], [0.0; 3], 50.0);
    for filter in FILTERS {
        let first = case.draw_with(&view, splats(filter));
        for _ in 0..3 {
            assert!(first.same_pixels(&case.draw_with(&view, splats(filter))));
        }
    }
}
