//! Compares splats that are painted over each other (Coconu & Hege 2002) with the oracle's. The differences are colours of 16 bits, and the
//! order of splats at distances that f32 does not tell apart.

use glam::{DAffine3, DVec3, Vec3};
use pointillist::accuracy::metrics;
use pointillist::math::{Camera, Lens, View};
use pointillist::oracle::{OracleFrame, OracleScene, render};
use pointillist::plan::{
    Antialias, Edl, Lod, MaxError, Pass, Reconstruct, Reconstruction, Settings,
};
use pointillist::scene::clipping::ClipRegion;
use pointillist::scene::color::{linear_from_srgb, srgb_from_linear};
use pointillist::scene::random::SplitMix64;
use pointillist::scene::{Blend, Filter, Painting};
use serde_json::json;

use super::files::Shape;
use super::fuzzy::over_a_floor;
use super::orthographic;
use super::splats::{ball, case, save_both};
use super::stage::{Case, Frames, look};

fn painted(filter: Filter) -> Settings {
    Settings { filter: Some(filter), ..Settings::drawn_as(Reconstruct::Painted) }
}

fn oracle(case: &Case, view: &View, settings: Settings) -> OracleFrame {
    let scene = case.reference.description().splats;
    let splats = Reconstruction::new(&settings, &scene).splats().copied();
    let painted = Some(settings.painted_as);
    let box_from_world = DAffine3::IDENTITY;
    let clip = settings.clip_boxes.map(|boxes| ClipRegion { boxes, box_from_world });
    render(&OracleScene { splats, painted, clip, ..case.reference.scene() }, view, 1)
}

/// Draws a frame with all engines, whose pictures must be the same, and compares it with the oracle's.
fn check(case: &Case, view: &View, settings: Settings, least: f64) -> Frames {
    let [wide, narrow, rasterising] = case.each_with(view, settings);
    let drawn = &wide.receipt.settings;
    let method = drawn.applied.reconstruct;
    assert_eq!(method, Some(Reconstruct::Painted), "{}: {:?}", case.id, drawn.instead_because);
    assert!(wide.ran(Pass::PaintSplats) && !wide.ran(Pass::ProjectSplats));
    assert!(wide.color == narrow.color, "{}: the 32-bit path differs", case.id);
    if !wide.ran(Pass::ProjectTriangles) {
        assert!(wide.color == rasterising.color, "{}: hidden chunks differ", case.id);
    }
    let twin = oracle(case, view, settings).to_rgba8();
    let found = metrics::psnr(&twin, &wide.color).unwrap();
    println!("{} {settings:?}: {found:.1} dB", case.id);
    if found < least {
        save_both(case, view, twin, wide.color.clone());
        panic!("{}: {settings:?}: {found} dB, least {least}", case.id);
    }
    wide
}

#[test]
fn every_filter_is_near_the_oracles() {
    let case = case("painted-filters", &ball(1500, 11), json!({}));
    for view in [look([0.4, 1.0, 3.0], [0.0; 3], 45.0), look([0.2, 0.4, 1.35], [0.0; 3], 70.0)] {
        for filter in [Filter::Affine, Filter::Perspective, Filter::Exact] {
            for painted_as in [Painting::Surfaces, Painting::Splats] {
                check(&case, &view, Settings { painted_as, ..painted(filter) }, 45.0);
            }
        }
    }
}

/// Splats all through a volume show their order everywhere: from outside, from within, and along the axes.
#[test]
fn the_order_is_that_of_distances() {
    let cloud = Shape::cloud(1200, [-1.0; 3], [1.0; 3], 21);
    let case = case("painted-volume", &cloud, json!({ "splats": { "width": 1.5 } }));
    for eye in [[0.0, 0.0, 4.0], [3.0, 2.0, 1.0], [0.1, 0.05, 0.2], [-4.0, 0.01, 0.0]] {
        let view = look(eye, [0.0, 0.0, -0.1], 60.0);
        for painted_as in [Painting::Surfaces, Painting::Splats] {
            check(&case, &view, Settings { painted_as, ..painted(Filter::Perspective) }, 45.0);
        }
    }
}

/// Stacks of splats at random heights, seen from both ends: each shows the colour of its nearest.
#[test]
fn the_nearest_splat_hides_the_others() {
    const COLORS: [[u8; 3]; 4] = [[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 0]];
    let mut random = SplitMix64::new(7);
    let mut cloud = Shape::default();
    let mut ends = Vec::new();
    for stack in 0..100 {
        let (x, y) = (f64::from(stack % 10) - 4.5, f64::from(stack / 10) - 4.5);
        let mut heights = [-9.0, -3.0, 3.0, 9.0].map(|level| level + random.range(-1.0, 1.0));
        for end in (1..4).rev() {
            heights.swap(end, random.index(end + 1));
        }
        for (z, [r, g, b]) in heights.into_iter().zip(COLORS) {
            cloud.positions.push(DVec3::new(x, y, z));
            cloud.normals.push(Vec3::Z);
            cloud.colors.push([r, g, b, 255]);
        }
        let by_height = |&a: &usize, &b: &usize| heights[a].total_cmp(&heights[b]);
        let [lowest, highest] =
            [(0..4).min_by(by_height).unwrap(), (0..4).max_by(by_height).unwrap()];
        ends.push((x, y, [highest, lowest]));
    }
    let scene = json!({
        "assets": { "c": { "file": "c.ply" } }, "nodes": [{ "asset": "c" }], "lights": []
    });
    let case = Case::new("painted-stacks", &[("c.ply", cloud.ply())], &scene);
    for (end, z) in [40.0, -40.0].into_iter().enumerate() {
        let camera = Camera {
            eye: DVec3::Z * z,
            target: DVec3::ZERO,
            up: DVec3::Y,
            lens: Lens::Orthographic { height: 11.0 },
        };
        let view = camera.view(220, 220).unwrap();
        let frame = case.draw_wide(&view, painted(Filter::Perspective));
        for (x, y, nearest) in &ends {
            // Every unit is 20 pixels; from behind, x runs to the left.
            let column = 110.0 + 20.0 * x * z.signum();
            let row = 110.0 - 20.0 * y;
            let [r, g, b, _] = frame.color[row as usize * 220 + column as usize];
            let expected = COLORS[nearest[end]];
            let off = [r, g, b].iter().zip(expected).map(|(a, b)| a.abs_diff(b)).max().unwrap();
            assert!(off < 40, "{x} {y} from {z}: {:?} for {expected:?}", [r, g, b]);
        }
    }
}

/// Triangles and lines in front and behind, instances, and splats that reach the camera plane.
#[test]
fn triangles_hide_what_is_behind_them() {
    let case = over_a_floor("painted-mixed", &ball(900, 14), -0.75);
    for eye in [[1.0, 1.2, 2.5], [-2.0, 0.4, 1.0], [0.2, 0.1, 1.1], [0.6, -1.6, 2.5]] {
        check(&case, &look(eye, [0.3, 0.0, 0.0], 55.0), painted(Filter::Perspective), 42.0);
    }
}

/// Images smaller than the tiles are many, and images that tiles do not divide.
#[test]
fn frames_of_any_size() {
    let case = case("painted-sizes", &ball(900, 17), json!({}));
    for (width, height, least) in
        [(1, 1, 30.0), (7, 5, 40.0), (15, 64, 42.0), (130, 33, 42.0), (517, 3, 42.0)]
    {
        let camera = Camera::perspective(DVec3::new(0.5, 0.8, 2.0), DVec3::ZERO, 50.0);
        let view = camera.view(width, height).unwrap();
        check(&case, &view, painted(Filter::Perspective), least);
    }
}

#[test]
fn parallel_rays_and_clip_boxes() {
    let lights = json!({ "lights": [{ "kind": "sun", "direction": [1, -1, -0.5] }] });
    let case = case("painted-clip", &ball(4000, 61), lights);
    let boxes = "-2,-2,-2,-0.2,0.4,2;0.1,*,*,*,*,*;outside:-0.4,-0.4,0,0.5,0.3,2".parse().unwrap();
    let flat = orthographic::look([0.4, 1.0, 3.0], [0.0; 3], 2.4);
    // The eye is within the ball.
    let within = orthographic::look([0.1, 0.2, 0.3], [0.0; 3], 2.4);
    for view in [look([0.4, 1.0, 3.0], [0.0; 3], 45.0), flat, within] {
        for clip_boxes in [None, Some(boxes)] {
            for painted_as in [Painting::Surfaces, Painting::Splats] {
                let settings = Settings { clip_boxes, painted_as, ..painted(Filter::Perspective) };
                check(&case, &view, settings, 45.0);
            }
        }
    }
}

/// More splats over one tile than one launch paints.
#[test]
fn a_crowd_over_few_pixels() {
    let mut crowd = ball(60_000, 3);
    crowd.positions.iter_mut().for_each(|p| *p *= DVec3::new(0.02, 0.02, 0.02));
    let case = case("painted-crowd", &crowd, json!({}));
    let view = look([0.0, 0.0, 3.0], [0.0; 3], 45.0);
    let [first, again, _] = case.each_with(&view, painted(Filter::Perspective));
    assert!(first.ran(Pass::PaintSplats) && first.color == again.color);
    let twin = oracle(&case, &view, painted(Filter::Perspective)).to_rgba8();
    let db = metrics::psnr(&twin, &first.color).unwrap();
    println!("crowd: {db:.1} dB");
    assert!(db >= 45.0, "{db} dB");
}

/// Among them solids, whose splats have clip lines.
#[test]
fn committed_scenes() {
    for (scene, camera) in [("town", "overview"), ("part", "front"), ("part", "detail")] {
        let case = Case::committed(scene);
        check(&case, &case.view(camera, 480, 360), painted(Filter::Perspective), 42.0);
    }
}

/// Samples at the same depth have equal distances where rays are parallel. Their order is their place, in every frame.
#[test]
fn equal_distances_have_one_order() {
    let mut grid = Shape::default();
    for number in 0..40_000 {
        let (x, y) = (f64::from(number % 200), f64::from(number / 200));
        grid.positions.push(DVec3::new(x - 99.5, y - 99.5, 0.0) * 0.01);
        grid.normals.push(Vec3::Z);
        grid.colors.push([(number * 37 % 256) as u8, (number * 101 % 256) as u8, 128, 255]);
    }
    let case = case("painted-grid", &grid, json!({}));
    let view = orthographic::look([0.0, 0.0, 3.0], [0.0; 3], 2.4);
    let settings = painted(Filter::Perspective);
    let first = case.draw_wide(&view, settings);
    for _ in 0..4 {
        assert!(first.color == case.draw_wide(&view, settings).color);
    }
}

/// Parts of pixels, point trees, and the outputs and effects that painted splats have no surfaces for.
#[test]
fn what_else_a_request_may_ask_for() {
    let case = Case::committed("town");
    let view = case.view("street", 320, 240);
    let settings = painted(Filter::Perspective);
    let plain = case.draw_wide(&view, settings);
    let smooth = case.draw_wide(&view, Settings { antialias: Antialias::Parts4, ..settings });
    assert!(smooth.ran(Pass::PaintSplats) && smooth.ran(Pass::Average));
    let db = metrics::psnr(&plain.color, &smooth.color).unwrap();
    assert!(db > 22.0 && db < 60.0, "{db} dB");
    // Outputs that are no colours are those of three passes.
    let three = case.draw_wide(&view, settings.in_three_passes());
    assert!(plain.id == three.id && plain.normal == three.normal && plain.depth == three.depth);
    for px in [1.0, 3.0] {
        let max_error_px = MaxError::new(px).unwrap();
        let trees = Settings { lod: Lod::Spt, max_error_px, ..settings };
        let [found, narrow, _] = case.each_with(&view, trees);
        assert!(found.ran(Pass::PaintSplats) && found.color == narrow.color);
        let db = metrics::psnr(&plain.color, &found.color).unwrap();
        println!("town street, {px} px: {db:.1} dB against full detail");
        assert!(db >= 24.0, "{px} px: {db}");
    }
    let receipt = case.draw_wide(&view, Settings { edl: Edl::On, ..settings }).receipt;
    assert!(receipt.settings.instead_because.unwrap().contains("eye-dome"));
}

/// A surface over the square from −1 to 1, of `cells` cells a side: its height and its grey, which is that of a cell's middle where `flat`.
fn mesh(
    cells: u32,
    height: impl Fn(f64, f64) -> f64,
    grey: impl Fn(f64, f64) -> f64,
    flat: bool,
) -> Shape {
    let mut shape = Shape::default();
    let place = |i: u32| 2.0 * f64::from(i) / f64::from(cells) - 1.0;
    for number in 0..cells * cells {
        let (column, row) = (number % cells, number / cells);
        let middle = [column, row].map(|i| place(i) + 1.0 / f64::from(cells));
        let first = shape.positions.len() as u32;
        for [i, j] in [[0, 0], [1, 0], [1, 1], [0, 1]] {
            let (x, y) = (place(column + i), place(row + j));
            shape.positions.push(DVec3::new(x, y, height(x, y)));
            let grey = if flat { grey(middle[0], middle[1]) } else { grey(x, y) };
            shape.colors.push([[grey as u8; 3].as_slice(), &[255]].concat().try_into().unwrap());
        }
        shape.triangles.push([first, first + 1, first + 2]);
        shape.triangles.push([first, first + 2, first + 3]);
    }
    shape
}

/// The same surface as `side`² samples, whose greys are means over their cells in linear light. `jitter`: how far a sample may be beside the
/// middle of its cell, in cells.
fn sampled(
    side: u32,
    height: impl Fn(f64, f64) -> f64,
    grey: impl Fn(f64, f64) -> f64,
    jitter: f64,
) -> Shape {
    let mut random = SplitMix64::new(5);
    let mut shape = Shape::default();
    let step = 2.0 / f64::from(side);
    for number in 0..side * side {
        let [x, y] = [number % side, number / side]
            .map(|i| (f64::from(i) + 0.5 + random.range(-jitter, jitter)) * step - 1.0);
        let slope = |x2: f64, y2: f64| (height(x2, y2) - height(x, y)) / 1e-4;
        let normal =
            DVec3::new(-slope(x + 1e-4, y), -slope(x, y + 1e-4), 1.0).normalize_or(DVec3::Z);
        shape.positions.push(DVec3::new(x, y, height(x, y)));
        shape.normals.push(normal.as_vec3());
        let parts = (0..64).map(|part| {
            let [i, j] = [part % 8, part / 8].map(|i| (f64::from(i) - 3.5) / 8.0 * step);
            linear_from_srgb(grey(x + i, y + j) / 255.0)
        });
        let mean = srgb_from_linear(parts.sum::<f64>() / 64.0) * 255.0;
        shape
            .colors
            .push([[mean.round() as u8; 3].as_slice(), &[255]].concat().try_into().unwrap());
    }
    shape
}

/// Textures that are seen at an angle (Coconu & Hege 2002, Fig. 8): painted splats are nearer to the surface itself, drawn at sixteen times
/// the pixels, than opaque splats are.
#[test]
fn textures_are_nearer_to_the_truth_than_with_opaque_splats() {
    let checkers = |x: f64, y: f64| {
        let cell = |v: f64| ((v + 1.0) * 8.0).floor() as i64;
        if (cell(x) + cell(y)) % 2 == 0 { 235.0 } else { 25.0 }
    };
    let waves = |x: f64, y: f64| {
        128.0 + 60.0 * (61.0 * x + 3.0 * (5.0 * y).sin()).sin() + 50.0 * (53.0 * y - 17.0 * x).cos()
    };
    let hills = |x: f64, y: f64| 0.12 * (3.0 * x).sin() * (2.6 * y + 0.4).cos();
    let flat = |_: f64, _: f64| 0.0;
    // By how many decibels it is nearer, at least: where samples are dense, as in the paper, and where they are several pixels apart.
    let surfaces = [
        ("checkers", 6.0, mesh(16, flat, checkers, true), sampled(400, flat, checkers, 0.0)),
        ("hills", 6.0, mesh(300, hills, waves, false), sampled(400, hills, waves, 0.0)),
        ("sparse", 1.0, mesh(16, flat, checkers, true), sampled(110, flat, checkers, 0.0)),
        ("random", 3.0, mesh(300, hills, waves, false), sampled(220, hills, waves, 1.0)),
    ];
    for (name, nearer, surface, samples) in surfaces {
        let scene = |file: &str| json!({ "assets": { "a": { "file": file } }, "nodes": [{ "asset": "a" }], "lights": [] });
        let of = |kind: &str, shape: &Shape| {
            Case::new(&format!("painted-{name}-{kind}"), &[("a.ply", shape.ply())], &scene("a.ply"))
        };
        let (truth, samples) = (of("surface", &surface), of("samples", &samples));
        let camera = Camera {
            eye: DVec3::new(0.5, -2.0, 1.1),
            target: DVec3::new(0.0, -0.15, 0.0),
            up: DVec3::Z,
            lens: Lens::Perspective { fov_deg: 42.0 },
        };
        let view = camera.view(320, 240).unwrap();
        let truth = truth.reference.frame(&view, 4).to_rgba8();
        let db = |settings: Settings| {
            let frame = samples.draw_wide(&view, settings);
            save_both(&samples, &view, truth.clone(), frame.color.clone());
            metrics::psnr(&truth, &frame.color).unwrap()
        };
        let opaque =
            Settings { blend: Some(Blend::Opaque), ..Settings::drawn_as(Reconstruct::Splats) };
        let by_itself = Settings { painted_as: Painting::Splats, ..painted(Filter::Perspective) };
        let weighted = Settings::drawn_as(Reconstruct::Splats);
        let [surfaces, splats, weighted, opaque] =
            [painted(Filter::Perspective), by_itself, weighted, opaque].map(db);
        println!(
            "{name}: surfaces {surfaces:.1}, each splat {splats:.1}, three passes {weighted:.1}, opaque {opaque:.1} dB"
        );
        assert!(surfaces >= opaque + nearer, "{name}: {surfaces} dB, opaque splats {opaque}");
        assert!(surfaces > splats, "{name}: {surfaces} dB, each splat by itself {splats}");
    }
}
