//! Parallel rays: everything that is drawn in perspective, drawn orthographically beside the oracle.

use glam::{DVec2, DVec3, Vec3};
use pointillist::accuracy::metrics;
use pointillist::math::{Camera, Lens, Projection, View};
use pointillist::plan::{Pass, Reconstruct, Settings};
use pointillist::scene::{Blend, Filter, Shading};
use serde_json::json;

use super::effects::check_edl;
use super::files::Shape;
use super::splats::{ball, case, check, cube, difference, oracle, splats};
use super::stage::Case;
use super::verdict::Tolerance;

const FILTERS: [Filter; 3] = [Filter::Affine, Filter::Perspective, Filter::Exact];

fn camera(eye: [f64; 3], target: [f64; 3], height: f64) -> Camera {
    let (eye, target) = (DVec3::from(eye), DVec3::from(target));
    Camera { eye, target, up: DVec3::Y, lens: Lens::Orthographic { height } }
}

/// A view of 160 × 120 with y up, as high as `height`.
pub fn look(eye: [f64; 3], target: [f64; 3], height: f64) -> View {
    camera(eye, target, height).view(160, 120).unwrap()
}

fn lights() -> serde_json::Value {
    json!([
        { "kind": "ambient", "intensity": 0.2 }, { "kind": "headlight", "intensity": 0.4 },
        { "kind": "sun", "direction": [0.3, -1, 0.2], "color": "#fff0d0" },
        { "kind": "point", "position": [0, 2, 1], "range": 2, "intensity": 1.2 },
    ])
}

#[test]
fn samples_and_triangles_under_all_lights() {
    let cloud = Shape { triangles: vec![], uvs: vec![], ..Shape::ball(60, 0.9) };
    let files = [("ball.ply", Shape::ball(32, 0.9).ply()), ("cloud.ply", cloud.ply())];
    let scene = json!({
        "assets": { "ball": { "file": "ball.ply" }, "cloud": { "file": "cloud.ply" } },
        "materials": { "shiny": { "specular": [0.7, 0.7, 0.7], "shininess": 24 } },
        "nodes": [
            { "asset": "ball", "translate": [-1, 0.6, 0], "material": "shiny" },
            { "asset": "cloud", "translate": [1, 0.6, 0] },
            { "asset": "ball", "translate": [0, -0.9, -0.5], "scale": [2.2, 0.2, 1.4] },
        ],
        "lights": lights(),
    });
    let case = Case::new("ortho-lights", &files, &scene);
    for eye in [[0.4, 1.0, 4.6], [-3.0, 2.0, 1.0], [0.1, 9.0, 0.2]] {
        case.check(&look(eye, [0.0; 3], 3.8), &Tolerance::samples());
    }
}

/// Where the eye stands on the optical axis changes depths alone, however far away it is and wherever the scene lies.
#[test]
fn the_eyes_distance_is_in_the_depths_alone() {
    let base = DVec3::new(412_000.0, 5_653_000.0, 110.0);
    let scene = json!({
        "assets": { "m": { "file": "m.ply" }, "c": { "file": "c.ply" } },
        "nodes": [{ "asset": "m", "translate": base.to_array() },
                  { "asset": "c", "translate": (base + DVec3::Y).to_array() }],
        "lights": lights(),
    });
    let cloud = Shape::cloud(4000, [-1.0; 3], [1.0; 3], 71);
    let files = [("m.ply", Shape::ball(40, 1.0).ply()), ("c.ply", cloud.ply())];
    let case = Case::new("ortho-far", &files, &scene);
    let target = base + DVec3::new(0.0, 0.5, 0.0);
    let way = DVec3::new(0.3, 0.4, 1.0).normalize_or(DVec3::Z);
    let near =
        case.check(&look((target + way * 4.0).into(), target.into(), 4.0), &Tolerance::samples());
    assert!(near.covered() > 4000, "{}", near.covered());
    for distance in [1e3, 1e6] {
        let far = case.draw(&look((target + way * distance).into(), target.into(), 4.0));
        let same = |a: &[u32], b: &[u32]| a.iter().zip(b).filter(|(a, b)| a == b).count();
        // Depths that are equal in so many digits win by their order.
        let least = near.id.len() * if distance > 1e4 { 97 } else { 100 } / 100;
        assert!(same(&near.id, &far.id) >= least, "{distance}");
        for (a, b) in near.depth.iter().zip(&far.depth).filter(|(a, _)| a.is_finite()) {
            let expected = f64::from(*a) - 4.0 + distance;
            assert!((expected - f64::from(*b)).abs() <= 4e-7 * distance + 2.0, "{expected} {b}");
        }
    }
}

/// A plane through the eye, across the viewing direction, cuts samples, triangles and splats alike.
#[test]
fn what_lies_behind_the_eye_is_cut_off() {
    let inside = [0.2, 0.3, 0.25];
    let target = [-0.6, 0.1, -0.5];
    let view = look(inside, target, 2.6);
    let mut room = cube();
    room.colors = room
        .positions
        .iter()
        .map(|p| [(90.0 + 80.0 * p.x) as u8, 150, (90.0 + 80.0 * p.z) as u8, 255])
        .collect();
    for (name, mesh) in [("ortho-room", &room), ("ortho-shell", &Shape::ball(40, 1.0))] {
        let mut one = json!({ "materials": { "m": { "double_sided": true } } });
        one["nodes"] = json!([{ "asset": "c", "material": "m" }]);
        let case = case(name, mesh, one);
        let frames = case.check(&view, &Tolerance::default());
        assert!(frames.covered() > 6_000 && frames.covered() < 160 * 120, "{}", frames.covered());
    }
    let samples = case("ortho-inside", &Shape::cloud(9000, [-1.0; 3], [1.0; 3], 72), json!({}));
    samples.check(&view, &Tolerance { depth: 1e-3, ..Tolerance::samples() });
    let shell = case("ortho-splats-inside", &ball(1500, 73), json!({}));
    for filter in FILTERS {
        let twin = oracle(&shell, &view, splats(filter));
        let found = difference(&twin, &shell.draw_with(&view, splats(filter)));
        println!("{filter:?}: {found:?}");
        // Depths are compared by their ratio, and are none at the cut.
        assert!(found.psnr >= 42.0 && found.normal_psnr >= 35.0 && found.ids == 0, "{found:?}");
        assert!(found.holes + found.leaks <= 12 && found.depth_p99 < 0.05, "{found:?}");
    }
}

#[test]
fn textures_and_large_triangles() {
    let case = Case::committed("textured");
    for name in ["front", "grazing"] {
        let camera: Camera = case.reference.camera(name).unwrap();
        let flat = camera.with_projection(Projection::Orthographic).view(160, 120).unwrap();
        case.check(&flat, &Tolerance { at_edges: 8, ..Tolerance::default() });
    }
    let mut room = cube();
    room.colors = room
        .positions
        .iter()
        .map(|p| [(128.0 + 90.0 * p.x) as u8, 120, (128.0 + 90.0 * p.y) as u8, 255])
        .collect();
    let cube = self::case("ortho-cube", &room, json!({}));
    let frames = cube.check(&look([1.5, 1.2, 2.6], [0.0; 3], 3.0), &Tolerance::default());
    assert!(frames.receipt.triangles.rasterised.unwrap() >= 6);
    // Corners far beyond what can be snapped.
    let mut ground = Shape::quad(DVec3::new(-3e4, -1.0, 3e4), DVec3::X * 6e4, DVec3::Z * -6e4, 1.0);
    ground.uvs.clear();
    let ground = self::case("ortho-ground", &ground, json!({ "lights": lights() }));
    ground.check(
        &look([0.0, 4.0, 3.0], [0.0; 3], 3.0),
        &Tolerance { depth: 1e-3, ..Tolerance::default() },
    );
}

#[test]
fn an_off_centre_view() {
    let case = case("ortho-off-centre", &Shape::cloud(20_000, [-1.0; 3], [1.0; 3], 74), json!({}));
    let mut view = camera([2.0, 1.0, 3.0], [0.0; 3], 2.5).view(161, 97).unwrap();
    view.focal_px.x *= 1.3;
    view.principal_px += DVec2::new(23.3, -11.7);
    case.check(&view, &Tolerance::samples());
}

#[test]
fn splats_in_every_filter_and_setting() {
    let mut cloud = ball(2000, 75);
    for normal in cloud.normals.iter_mut().step_by(7) {
        *normal = Vec3::ZERO;
    }
    let scene = json!({ "lights": lights(), "nodes": [{ "asset": "c", "scale": [1, 0.7, 1.2] }] });
    let case = case("ortho-splats", &cloud, scene);
    // Small splats, and ones that several threads walk.
    let views = [
        (look([0.4, 1.0, 3.0], [0.0; 3], 2.6), 42.0),
        (look([0.4, 1.0, 3.0], [0.2, 0.3, 0.0], 0.4), 38.0),
    ];
    for (view, least) in views {
        for filter in FILTERS {
            for prefilter in [false, true] {
                let settings = Settings { prefilter: Some(prefilter), ..splats(filter) };
                check(&case, &view, settings, settings, least);
            }
        }
    }
    let view = look([1.4, 1.0, 2.0], [0.0; 3], 2.6);
    for (blend, shading, least) in
        [(Blend::Weighted, Shading::Splat, 42.0), (Blend::Opaque, Shading::Deferred, 34.0)]
    {
        let settings =
            Settings { blend: Some(blend), shading: Some(shading), ..splats(Filter::Perspective) };
        check(&case, &view, settings, settings, least);
    }
    let fuzzy = Settings { reconstruct: Reconstruct::Fuzzy, ..splats(Filter::Perspective) };
    let three = Settings { shading: Some(Shading::Splat), ..splats(Filter::Perspective) };
    let psnr = |view: &View| {
        let [single, ..] = case.each_with(view, fuzzy);
        assert!(single.ran(Pass::FuzzySplats));
        metrics::psnr(&oracle(&case, view, three).to_rgba8(), &single.color).unwrap()
    };
    // Slabs blend alike in both projections.
    let wide = super::stage::look([1.4, 1.0, 2.0], [0.0; 3], 52.0);
    let (flat, wide) = (psnr(&view), psnr(&wide));
    println!("a single pass: {flat} dB, in perspective {wide} dB");
    assert!(flat > 30.0 && flat > wide - 1.5, "{flat} dB, in perspective {wide} dB");
}

#[test]
fn clip_lines() {
    let case = Case::committed("part");
    let camera: Camera = case.reference.camera("front").unwrap();
    let view = camera.with_projection(Projection::Orthographic).view(160, 120).unwrap();
    for filter in FILTERS {
        check(&case, &view, splats(filter), splats(filter), 38.0);
    }
}

#[test]
fn eye_dome_light() {
    let lights = json!({ "lights": [{ "kind": "sun", "direction": [1, -1, -0.5] }] });
    let view = look([0.4, 1.0, 3.0], [0.0; 3], 2.4);
    let cloud = case("ortho-edl", &ball(4000, 31), lights);
    check_edl(&cloud, &view, Settings::drawn_as(Reconstruct::Points), 35.0);
    check_edl(&cloud, &view, splats(Filter::Exact), 35.0);
}

/// The error that was accepted is the same at every depth.
#[test]
fn point_trees() {
    let flat = |eye: [f64; 3], height: f64| camera(eye, [0.0; 3], height).view(200, 160).unwrap();
    let views =
        [flat([2.0, 1.0, 3.0], 3.0), flat([0.5, 7.0, 3.0], 12.0), flat([-60.0, 30.0, 9.0], 40.0)];
    let ball = case("ortho-trees", &ball(6000, 5), json!({}));
    super::trees::check(&ball, &views, Reconstruct::Splats, 42.0);
    let part = Case::committed("part");
    super::trees::check(&part, &views, Reconstruct::Splats, 42.0);
}
