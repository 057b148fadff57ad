//! Compares splats that are blended and depth-tested in a single pass (Dachsbacher et al. 2003, §5) with the oracle's, which
//! blends them as three passes do. The differences are weights of eight bits, and depths that are distinguished by slabs.

use glam::DVec3;
use pointillist::accuracy::metrics;
use pointillist::math::View;
use pointillist::passes::srgb8;
use pointillist::plan::{Lod, MaxError, Pass, Reconstruct, Settings};
use pointillist::scene::{Blend, Filter, Shading};
use serde_json::json;

use super::files::Shape;
use super::splats::{ball, case, oracle};
use super::stage::{Case, Frames, look};

fn fuzzy(filter: Filter) -> Settings {
    Settings { reconstruct: Reconstruct::Fuzzy, filter: Some(filter), ..Settings::default() }
}

/// Draws a frame in a single pass, and compares it with the oracle and with a frame in three passes. The engine without 64-bit
/// atomics must draw three passes in both cases. Returns the frames of the single pass and of three passes.
///
/// A single pass only draws colours. Depths, normals and ids of `single` are drawn in three passes and prove nothing.
fn check(case: &Case, view: &View, settings: Settings, least: f64) -> [Frames; 2] {
    let [single, narrow, _] = case.each_with(view, settings);
    let drawn = &single.receipt.settings;
    assert_eq!(
        drawn.applied.reconstruct,
        Some(Reconstruct::Fuzzy),
        "{}: {:?}",
        case.id,
        drawn.instead_because
    );
    assert!(single.ran(Pass::FuzzySplats) && !single.ran(Pass::ProjectSplats));
    let three = Settings {
        reconstruct: Reconstruct::Splats,
        blend: Some(Blend::Weighted),
        shading: Some(Shading::Splat),
        ..settings
    };
    let twin = oracle(case, view, three);
    let found = metrics::psnr(&twin.to_rgba8(), &single.color).unwrap();
    let [_, three_narrow, _] = case.each_with(view, three);
    let drawn = &narrow.receipt.settings;
    assert_eq!(drawn.applied.reconstruct, Some(Reconstruct::Splats));
    assert!(drawn.instead_because.unwrap().contains("64-bit atomics"));
    assert_eq!(narrow.color, three_narrow.color);
    let passes = metrics::psnr(&twin.to_rgba8(), &three_narrow.color).unwrap();
    println!("{} {settings:?}: {found:.1} dB, three passes {passes:.1} dB", case.id);
    assert!(found >= least, "{}: {settings:?}: {found} dB, least {least}", case.id);
    // Footprints do not depend on the number of passes, so both cover the same pixels. No object has the background's colour.
    let background = srgb8(case.reference.description().background).to_le_bytes();
    let shown: Vec<bool> = three_narrow.id.iter().map(|&id| id != 0).collect();
    for frames in [&single, &three_narrow] {
        let colored: Vec<bool> = frames.color.iter().map(|&color| color != background).collect();
        assert!(colored == shown, "{}: {settings:?}: other pixels are covered", case.id);
    }
    [single, three_narrow]
}

#[test]
fn every_filter_is_near_the_oracles() {
    let case = case("fuzzy-filters", &ball(1500, 11), json!({}));
    for view in [look([0.4, 1.0, 3.0], [0.0; 3], 45.0), look([0.2, 0.4, 1.35], [0.0; 3], 70.0)] {
        for filter in [Filter::Affine, Filter::Perspective, Filter::Exact] {
            for prefilter in [false, true] {
                check(&case, &view, Settings { prefilter: Some(prefilter), ..fuzzy(filter) }, 34.0);
            }
        }
    }
}

/// Stretched, mirrored and turned copies of a cloud of samples, and a floor of triangles at a height.
pub fn over_a_floor(name: &str, cloud: &Shape, height: f64) -> Case {
    let scene = json!({
        "assets": { "c": { "file": "c.ply" }, "t": { "file": "t.ply" } },
        "nodes": [
            { "asset": "c", "scale": [1, 0.4, 1.3], "rotate": [20, 30, 5] },
            { "asset": "c", "scale": [-0.5, 0.5, 0.5], "translate": [1.1, 0.3, 0] },
            { "asset": "t", "translate": [0, height, 0] }
        ]
    });
    let (u, v) = (DVec3::new(0.0, 0.0, 4.0), DVec3::new(4.0, 0.0, 0.0));
    let floor = Shape::quad(DVec3::new(-2.0, 0.0, -2.0), u, v, 1.0);
    let files = [("c.ply", cloud.ply()), ("t.ply", floor.ply())];
    Case::new(name, &files, &scene)
}

/// Triangles in front and behind, instances, and splats that reach the camera plane.
#[test]
fn a_single_pass_shares_its_depth_with_triangles() {
    let case = over_a_floor("fuzzy-mixed", &ball(900, 14), -0.75);
    // From below, the floor hides most of the splats.
    for eye in [[1.0, 1.2, 2.5], [-2.0, 0.4, 1.0], [0.2, 0.1, 1.1], [0.6, -1.6, 2.5]] {
        let view = look(eye, [0.3, 0.0, 0.0], 55.0);
        let [single, three] = check(&case, &view, fuzzy(Filter::Perspective), 31.0);
        let of_triangles: Vec<usize> =
            (0..three.id.len()).filter(|&pixel| three.id[pixel] == 3).collect();
        for &pixel in &of_triangles {
            assert_eq!(single.color[pixel], three.color[pixel], "a triangle at {pixel}");
        }
        // From within the splats no triangle is visible.
        let count = of_triangles.len();
        assert!(count > 200 || eye[0] == 0.2, "{count} pixels of triangles");
    }
}

#[test]
fn committed_scenes() {
    for (scene, camera, least) in
        [("town", "overview", 34.0), ("part", "front", 46.0), ("part", "detail", 46.0)]
    {
        let case = Case::committed(scene);
        check(&case, &case.view(camera, 480, 360), fuzzy(Filter::Perspective), least);
    }
}

/// A single pass over point trees gives nearly the frame of three passes over the same nodes.
#[test]
fn a_single_pass_draws_point_trees() {
    for (scene, camera) in [("town", "overview"), ("town", "street"), ("relief", "front")] {
        let case = Case::committed(scene);
        let view = case.view(camera, 320, 240);
        for px in [1.0, 4.0] {
            let max_error = MaxError::new(px).unwrap();
            let single =
                Settings { lod: Lod::Spt, max_error_px: max_error, ..fuzzy(Filter::Perspective) };
            let [found, ..] = case.each_with(&view, single);
            let [expected, ..] = case.each_with(&view, single.in_three_passes());
            assert!(found.ran(Pass::FuzzySplats) && expected.ran(Pass::BlendSplats));
            let db = metrics::psnr(&expected.color, &found.color).unwrap();
            println!("{scene} {camera}, {px} px: {db:.1} dB");
            assert!(db >= 31.0, "{scene} {camera}, {px} px: {db}");
        }
    }
}

/// Splats whose depths are alike, so near each other that all cover the same pixels.
fn flat_crowd(count: usize) -> Shape {
    let mut crowd = ball(count, 3);
    crowd.positions.iter_mut().for_each(|p| *p *= DVec3::new(1e-3, 1e-3, 1e-6));
    crowd
}

/// Outputs other than colour, and pixels with too many splats, take three passes, and the receipt says why.
#[test]
fn three_passes_where_one_will_not_do() {
    let crowd = flat_crowd(9000);
    let case = case("fuzzy-crowd", &crowd, json!({ "splats": { "width": 60 } }));
    let view = look([0.0, 0.0, 0.02], [0.0; 3], 45.0);
    let [frames, _, _] = case.each_with(&view, fuzzy(Filter::Perspective));
    let because = frames.receipt.settings.instead_because.unwrap();
    assert!(because.contains("over one pixel"), "{because}");
    let three = fuzzy(Filter::Perspective).in_three_passes();
    let [expected, _, _] = case.each_with(&view, three);
    assert!(frames.same_pixels(&expected));
    assert!(frames.covered() > 200, "{}", frames.covered());
    assert!(frames.ran(Pass::BlendSplats) && !frames.ran(Pass::FuzzySplats));
}

/// Thousands of splats over a pixel still fit a single pass.
#[test]
fn a_crowded_pixel_is_near_three_passes() {
    let crowd = flat_crowd(3000);
    let case = case("fuzzy-fewer", &crowd, json!({ "splats": { "width": 8 } }));
    let view = look([0.0, 0.0, 0.02], [0.0; 3], 45.0);
    let [single, _, _] = case.each_with(&view, fuzzy(Filter::Perspective));
    assert!(single.ran(Pass::FuzzySplats) && !single.ran(Pass::BlendSplats));
    let three = fuzzy(Filter::Perspective).in_three_passes();
    let [expected, _, _] = case.each_with(&view, three);
    let db = metrics::psnr(&expected.color, &single.color).unwrap();
    assert!(db >= 40.0, "{db} dB");
}
