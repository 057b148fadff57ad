//! Lines: tubes of all widths, hard cases, and the mean brightness of lines thinner than a pixel.

use std::fmt::Write;

use glam::DVec3;
use pointillist::math::View;
use pointillist::oracle::{self, OracleScene};
use pointillist::plan::{Pass, Reconstruct, Settings};
use pointillist::scene::color::linear_from_srgb;
use pointillist::scene::random::SplitMix64;
use serde_json::{Value, json};

use super::orthographic;
use super::stage::{Case, Frames, look};
use super::verdict::{Tolerance, judge};

/// A vertex: place, radius, colour.
type Vertex = (DVec3, f64, [u8; 3]);

/// A legacy VTK file of strands.
pub fn vtk(strands: &[Vec<Vertex>]) -> Vec<u8> {
    let all = || strands.iter().flatten();
    let count = all().count();
    let mut text = String::from("# vtk DataFile Version 3.0\nlines\nASCII\nDATASET POLYDATA\n");
    writeln!(text, "POINTS {count} double").unwrap();
    for (p, ..) in all() {
        writeln!(text, "{:.17e} {:.17e} {:.17e}", p.x, p.y, p.z).unwrap();
    }
    writeln!(text, "LINES {} {}", strands.len(), strands.len() + count).unwrap();
    let mut first = 0;
    for strand in strands {
        let places: Vec<String> = (first..first + strand.len()).map(|i| i.to_string()).collect();
        writeln!(text, "{} {}", strand.len(), places.join(" ")).unwrap();
        first += strand.len();
    }
    writeln!(text, "POINT_DATA {count}\nSCALARS radius float 1\nLOOKUP_TABLE default").unwrap();
    all().for_each(|(_, radius, _)| writeln!(text, "{radius}").unwrap());
    writeln!(text, "COLOR_SCALARS rgb 3").unwrap();
    for (.., color) in all() {
        let [r, g, b] = color.map(|byte| f64::from(byte) / 255.0);
        writeln!(text, "{r} {g} {b}").unwrap();
    }
    text.into_bytes()
}

/// As [`vtk`], of ribbons with these normals.
pub fn ribbons(strands: &[Vec<Vertex>], normals: &[DVec3]) -> Vec<u8> {
    let mut text = String::from_utf8(vtk(strands)).unwrap();
    writeln!(text, "VECTORS ribbon_normals float").unwrap();
    for n in normals {
        writeln!(text, "{} {} {}", n.x, n.y, n.z).unwrap();
    }
    text.into_bytes()
}

/// A file of [`vtk`] or [`ribbons`], whose colours have an alpha.
pub fn with_alpha(file: Vec<u8>, alpha: f64) -> Vec<u8> {
    let text = String::from_utf8(file).unwrap();
    let (head, tail) = text.split_once("COLOR_SCALARS rgb 3\n").unwrap();
    let colors = tail.lines().take_while(|line| !line.starts_with("VECTORS")).count();
    let mut text = format!("{head}COLOR_SCALARS rgba 4\n");
    for (number, line) in tail.lines().enumerate() {
        text += line;
        text += &if number < colors { format!(" {alpha}\n") } else { "\n".to_owned() };
    }
    text.into_bytes()
}

fn tint(p: DVec3) -> [u8; 3] {
    let wave = |v: f64| (128.0 + 90.0 * v.sin()) as u8;
    [wave(p.x), wave(p.y + 1.0), wave(p.z + p.x + 2.0)]
}

fn lights() -> Value {
    json!([
        { "kind": "ambient", "intensity": 0.1 }, { "kind": "headlight", "intensity": 0.3 },
        { "kind": "sun", "direction": [0.3, -1, 0.2], "color": "#fff0d0" },
        { "kind": "point", "position": [0, 2, 1], "range": 2, "intensity": 0.8 },
    ])
}

fn case(name: &str, strands: &[Vec<Vertex>]) -> Case {
    case_of(name, vtk(strands))
}

fn case_of(name: &str, file: Vec<u8>) -> Case {
    let scene = json!({
        "assets": { "l": { "file": "l.vtk" } },
        "materials": { "shiny": { "specular": [0.5, 0.5, 0.5], "shininess": 20 } },
        "nodes": [{ "asset": "l", "material": "shiny" }],
        "lights": lights(),
    });
    Case::new(name, &[("l.vtk", file)], &scene)
}

fn tolerance() -> Tolerance {
    // Silhouettes of tubes are curved, and every joint is an edge.
    Tolerance { color: 4, normal: 3, at_edges: 12, unexplained: 2, ..Tolerance::default() }
}

pub fn scattered(count: usize, radii: [f64; 2], seed: u64) -> Vec<Vec<Vertex>> {
    let mut numbers = SplitMix64::new(seed);
    let mut number = move || (numbers.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
    let strand = |_| {
        let mut place = DVec3::new(number(), number(), number()) * 2.0 - 1.0;
        let vertices = (0..6).map(|_| {
            place += (DVec3::new(number(), number(), number()) - 0.5) * 0.9;
            (place, radii[0] + (radii[1] - radii[0]) * number(), tint(place * 3.0))
        });
        vertices.collect()
    };
    (0..count).map(strand).collect()
}

#[test]
fn tubes_meet_rays_where_the_reference_says() {
    let case = case("tubes", &scattered(14, [0.03, 0.12], 5));
    for eye in [[0.0, 0.4, 5.0], [4.0, 1.0, -2.0], [0.3, 6.0, 0.2]] {
        let frames = case.check(&look(eye, [0.0; 3], 40.0), &tolerance());
        assert!(frames.covered() > 2000, "{}", frames.covered());
        assert!(frames.ran(Pass::ProjectLines) && frames.ran(Pass::ResolveLines));
        let segments = &frames.receipt.segments;
        assert_eq!((segments.stored, segments.tested), (70, Some(70)));
        assert!(segments.listed.unwrap() < 70, "{:?}", segments.listed);
    }
    for eye in [[0.0, 0.4, 5.0], [4.0, 1.0, -2.0]] {
        case.check(&orthographic::look(eye, [0.0; 3], 3.4), &tolerance());
    }
}

#[test]
fn large_tubes_and_tubes_around_the_eye() {
    let case = case("tubes-near", &scattered(12, [0.05, 0.3], 9));
    for (eye, target) in [
        ([0.2, 0.1, 1.4], [0.0; 3]),
        ([0.0, 0.0, 0.1], [1.0, 0.2, 0.3]),
        ([0.4, -0.3, 0.2], [-1.0, 0.5, -0.4]),
    ] {
        let frames = case.check(&look(eye, target, 70.0), &tolerance());
        assert!(frames.receipt.segments.listed.unwrap() > 10);
    }
    case.check(&orthographic::look([0.0, 0.0, 0.1], [1.0, 0.2, 0.3], 3.0), &tolerance());
}

/// Segments without length, repeated points, turns by 180°, radii larger than the segment, radii of zero, and cones.
pub fn hard_strands() -> Vec<Vec<Vertex>> {
    let at = |x: f64, y: f64, z: f64, radius: f64| {
        let place = DVec3::new(x, y, z);
        (place, radius, tint(place * 3.0))
    };
    vec![
        vec![at(-1.5, 1.0, 0.0, 0.2), at(-1.5, 1.0, 0.0, 0.2)],
        vec![
            at(-0.6, 1.0, 0.0, 0.1),
            at(-0.2, 1.0, 0.0, 0.1),
            at(-0.2, 1.0, 0.0, 0.1),
            at(0.1, 1.2, 0.0, 0.1),
        ],
        vec![at(0.5, 1.0, 0.0, 0.08), at(1.2, 1.0, 0.0, 0.08), at(0.7, 1.0, 0.0, 0.14)],
        vec![at(-1.5, 0.2, 0.0, 0.3), at(-1.45, 0.2, 0.0, 0.28)],
        vec![at(-0.8, 0.2, 0.0, 0.4), at(-0.6, 0.2, 0.0, 0.05)],
        vec![at(0.2, 0.2, 0.0, 0.0), at(1.4, 0.3, 0.0, 0.25)],
        // Along the view: towards the eye thinner, and thicker.
        vec![at(-1.2, -0.8, -1.0, 0.3), at(-1.2, -0.8, 1.0, 0.05)],
        vec![at(0.0, -0.8, -1.0, 0.05), at(0.0, -0.8, 1.0, 0.3)],
        vec![at(1.2, -0.8, -2.0, 0.15), at(1.2, -0.8, 1.0, 0.15)],
        vec![at(1.7, -0.9, 0.0, 0.0), at(1.7, 0.9, 0.0, 0.0)],
    ]
}

#[test]
fn hard_tubes() {
    let case = case("tubes-hard", &hard_strands());
    // The tip of a cone is a thin line, which is drawn by its key: the reference draws it by pixels' centres.
    let tolerance = Tolerance { stray: 4, ..tolerance() };
    for eye in [[0.0, 0.0, 6.0], [0.01, -0.79, 6.0], [5.0, 2.0, 3.0], [1.2, -0.8, 7.0]] {
        case.check(&look(eye, [0.01, -0.1, 0.0], 40.0), &tolerance);
    }
    // Exactly along a tube, with its end balls nearer and farther.
    case.check(&look([1.2, -0.8, 7.0], [1.2, -0.8, 0.0], 30.0), &tolerance);
    case.check(&look([0.0, -0.8, -7.0], [0.0, -0.8, 0.0], 30.0), &tolerance);
    case.check(&orthographic::look([0.0, 0.0, 6.0], [0.0; 3], 3.4), &tolerance);
}

#[test]
fn ribbons_are_strips_lit_from_both_sides() {
    // Arcs whose normals turn along them.
    let strand = |k: usize| {
        let at = |i: usize| {
            let t = i as f64 * 0.35 + k as f64;
            let place = DVec3::new(t.cos(), 0.4 * k as f64 - 0.9, t.sin());
            (place, 0.06 + 0.02 * (i % 5) as f64, tint(place * 3.0))
        };
        (0..9).map(at).collect()
    };
    let strands: Vec<Vec<Vertex>> = (0..5).map(strand).collect();
    let normal = |i: usize| {
        let (sin, cos) = (i as f64 * 0.23).sin_cos();
        let (p, ..) = strands[i / 9][i % 9];
        let outwards = DVec3::new(p.x, 0.0, p.z);
        outwards * cos + DVec3::Y * sin
    };
    let normals: Vec<DVec3> = (0..45).map(normal).collect();
    let scene = json!({
        "assets": { "l": { "file": "l.vtk" } },
        "materials": { "shiny": { "specular": [0.5, 0.5, 0.5], "shininess": 20 } },
        "nodes": [{ "asset": "l", "material": "shiny" }],
        "lights": lights(),
    });
    let case = Case::new("ribbons", &[("l.vtk", ribbons(&strands, &normals))], &scene);
    // Seen edge-on, a ribbon is a thin line, which is drawn by its key: the reference draws it by pixels' centres.
    let tolerance = Tolerance { psnr: 38.0, at_edges: 60, stray: 6, ..tolerance() };
    for eye in [[0.0, 0.3, 4.0], [2.5, 2.0, -2.0], [0.1, 5.0, 0.3]] {
        let frames = case.check(&look(eye, [0.0; 3], 45.0), &tolerance);
        assert!(frames.covered() > 1000, "{}", frames.covered());
    }
    // Through the camera plane.
    case.check(&look([0.0, 0.1, 0.0], [1.0, 0.0, 0.1], 80.0), &tolerance);
    case.check(&orthographic::look([0.0, 0.3, 4.0], [0.0; 3], 3.0), &tolerance);
}

#[test]
fn tubes_under_transforms_and_far_from_the_origin() {
    let file = vtk(&scattered(6, [0.04, 0.1], 21));
    let base = [412_000.0, 5_653_000.0, 110.0];
    let scene = json!({
        "assets": { "l": { "file": "l.vtk" } },
        "nodes": [{ "translate": base, "children": [
            { "asset": "l", "translate": [-1.2, 0, 0], "rotate": [20, 70, 10] },
            { "asset": "l", "translate": [1.4, 0.2, 0], "scale": 0.6 },
            { "asset": "l", "translate": [0, -1.2, 0], "scale": [1.0, -0.5, 0.7] },
        ]}],
        "lights": lights(),
    });
    let case = Case::new("tubes-placed", &[("l.vtk", file)], &scene);
    let base = DVec3::from(base);
    let view = look((base + DVec3::new(0.5, 0.6, 6.0)).into(), base.into(), 45.0);
    case.check(&view, &tolerance());
}

/// Mean linear colour of a frame less the background's.
fn mean_of(rgba: &[[u8; 4]], background: [u8; 4]) -> f64 {
    let linear = |[r, g, b, _]: [u8; 4]| {
        [r, g, b].map(|byte| linear_from_srgb(f64::from(byte) / 255.0)).iter().sum::<f64>()
    };
    rgba.iter().map(|&pixel| linear(pixel) - linear(background)).sum::<f64>() / rgba.len() as f64
}

fn brightness(case: &Case, view: &View, frames: &Frames) -> [f64; 2] {
    let exact = case.reference.frame(view, 8).to_rgba8();
    let scene = case.reference.scene();
    let [r, g, b, a] = scene.background;
    let byte =
        |v: f32| (pointillist::scene::color::srgb_from_linear(f64::from(v)) * 255.0).round() as u8;
    let background = [byte(r), byte(g), byte(b), (a * 255.0).round() as u8];
    [mean_of(&frames.color, background), mean_of(&exact, background)]
}

/// Lines of a fifth to one and a half pixels have the mean brightness of their true width, in every direction, as long segments and as many
/// short ones.
#[test]
fn thin_lines_have_the_brightness_of_their_width() {
    for (name, vertices) in [("thin-long", 2), ("thin-short", 400)] {
        for width_px in [0.2, 0.5, 0.9, 1.5] {
            // A pixel is 0.0276 units wide at a distance of 4.
            let radius = 0.5 * width_px * 2.0 * 4.0 * 20f64.to_radians().tan() / 120.0;
            let strand = |k: usize| {
                let (sin, cos) = (k as f64 * 0.21).sin_cos();
                let from = DVec3::new(cos, sin, 0.0) * 0.3;
                let way = DVec3::new(sin * 1.2 + cos * 0.4, cos * 0.9, 0.3 * sin);
                let share = |i: usize| i as f64 / (vertices - 1) as f64;
                (0..vertices).map(|i| (from + way * share(i), radius, [255; 3])).collect()
            };
            let strands: Vec<Vec<Vertex>> = (0..30).map(strand).collect();
            let case = case(&format!("{name}-{width_px}"), &strands);
            let view = look([0.0, 0.0, 4.0], [0.0; 3], 40.0);
            let frames = case.draw(&view);
            let [found, exact] = brightness(&case, &view, &frames);
            let ratio = found / exact;
            println!("{name}, {width_px} px: {ratio:.3} of the true brightness");
            assert!((0.9..1.1).contains(&ratio), "{name} {width_px}: {ratio}");
        }
    }
}

/// Draws lines at least `px` pixels wide. Returns how many pixels differ from the reference, and how many it covers.
pub fn compared(case: &Case, view: &View, px: f64) -> [usize; 2] {
    let settings = Settings { line_width_px: px.into(), ..Settings::drawn_as(Reconstruct::Points) };
    let frames = case.draw_with(view, settings);
    let scene = OracleScene { least_line_px: px, ..case.reference.scene() };
    let twin = oracle::render(&scene, view, 1);
    let colors = twin.to_rgba8();
    let differs = |i: &usize| {
        let like = |c: usize| frames.color[*i][c].abs_diff(colors[*i][c]) <= 6;
        frames.id[*i] != twin.id[*i] || !(0..4).all(like)
    };
    let differ = (0..colors.len()).filter(differs).count();
    [differ, twin.id.iter().filter(|&&id| id != 0).count()]
}

/// Lines of no width of their own are as wide as a frame asks, near and far.
#[test]
fn lines_are_no_thinner_than_asked() {
    let case = case("tubes-least", &scattered(12, [0.0, 0.02], 61));
    let views =
        [look([0.0, 0.4, 4.0], [0.0; 3], 45.0), orthographic::look([3.0, 1.0, 2.0], [0.0; 3], 3.0)];
    for view in views {
        for px in [1.0, 3.0, 12.0] {
            let [differ, covered] = compared(&case, &view, px);
            println!("{px} px: {differ} of {covered} covered pixels differ");
            // A strip of one pixel covers the pixels of its columns or rows, where a tube covers those whose rays meet it.
            let share = if px == 1.0 { 3 } else { 50 };
            assert!(covered > 700 && differ * share < covered, "{px}: {differ} of {covered}");
        }
    }
}

/// A line that bends to and fro within a pixel is as closed as a smooth one.
#[test]
fn lines_of_a_pixel_have_no_gaps_where_they_bend_within_a_pixel() {
    let mut random = SplitMix64::new(5);
    let strand = (0..3000).map(|i| {
        let place = DVec3::new(f64::from(i) / 300.0 - 5.0, random.range(-0.002, 0.002), 0.0);
        (place, 1e-4, [255; 3])
    });
    let case = case("jagged", &[strand.collect()]);
    let settings =
        Settings { line_width_px: 1.0.into(), ..Settings::drawn_as(Reconstruct::Points) };
    for eye in [[0.0, 0.013, 16.0], [2.0, -1.0, 14.0], [0.0, 0.0, 30.0]] {
        let view = look(eye, [0.0; 3], 45.0);
        let frames = case.draw_with(&view, settings);
        let width = view.width as usize;
        let covered: Vec<usize> = (0..width)
            .map(|x| frames.id.iter().skip(x).step_by(width).filter(|&&id| id != 0).count())
            .collect();
        let first = covered.iter().position(|&count| count > 0).unwrap();
        let last = covered.iter().rposition(|&count| count > 0).unwrap();
        let empty = covered[first..last].iter().filter(|&&count| count == 0).count();
        let mean = covered.iter().sum::<usize>() as f64 / (last + 1 - first) as f64;
        println!(
            "from {eye:?}: {empty} of {} columns are empty, {mean:.2} pixels each",
            last - first
        );
        assert!(last - first > 30 && empty == 0, "{empty} from {eye:?}");
        assert!(mean < 2.2, "{mean} from {eye:?}");
    }
}

/// A segment that passes beside the eye is as wide near the eye as far away, and the eye is not inside of it.
#[test]
fn least_widths_hold_where_a_line_passes_the_camera_plane() {
    let view = look([0.0; 3], [0.0, 0.0, -1.0], 60.0);
    for (name, beside, ribbon) in
        [("tube", 0.3, false), ("far tube", 40.0, false), ("ribbon", 0.3, true)]
    {
        let strand: Vec<Vertex> = [1000.0, -1000.0]
            .map(|z| (DVec3::new(beside, 0.1 * beside, z), 1e-4, [255; 3]))
            .to_vec();
        let files = match ribbon {
            true => ribbons(&[strand], &[DVec3::new(-1.0, -0.1, 0.0); 2]),
            false => vtk(&[strand]),
        };
        let case = case_of(&format!("passing-{}", name.replace(' ', "-")), files);
        for px in [1.0, 4.0] {
            let [differ, covered] = compared(&case, &view, px);
            println!("{name}, {px} px: {differ} of {covered} covered pixels differ");
            // From the vanishing point in the middle to the right border.
            let expected = px * f64::from(view.width) * 0.5;
            let share = covered as f64 / expected;
            assert!((0.75..1.3).contains(&share), "{name}, {px} px: {covered} of {expected}");
            assert!(differ * 20 < covered.max(20), "{name}, {px} px: {differ} of {covered}");
        }
    }
}

#[test]
fn a_thin_horizontal_line_is_neither_lost_nor_whole() {
    // Between the centres of two rows of pixels, where sampling at centres would show nothing.
    let view = look([0.0, 0.0, 4.0], [0.0; 3], 40.0);
    let row = 2.0 * 4.0 * 20f64.to_radians().tan() / 120.0;
    for (number, offset) in [0.0, 0.3, 0.5].into_iter().enumerate() {
        let strand = vec![
            (DVec3::new(-3.0, row * offset, 0.0), 0.15 * row, [255; 3]),
            (DVec3::new(3.0, row * offset, 0.0), 0.15 * row, [255; 3]),
        ];
        let case = case(&format!("thin-row-{number}"), &[strand]);
        let covered = case.draw(&view).covered();
        // 160 pixels of 0.3 pixels' width each.
        assert!((38..=58).contains(&covered), "{covered} at {offset}");
    }
}

#[test]
fn every_reconstruction_draws_lines_alike() {
    let case = case("tubes-all", &scattered(10, [0.002, 0.1], 33));
    let view = look([0.0, 0.4, 4.0], [0.0; 3], 45.0);
    let points = case.draw(&view);
    assert!(points.covered() > 600, "{}", points.covered());
    for reconstruct in
        [Reconstruct::Splats, Reconstruct::Fuzzy, Reconstruct::PullPush, Reconstruct::Painted]
    {
        let frames = case.draw_with(&view, Settings::drawn_as(reconstruct));
        assert!(frames.same_pixels(&points), "{reconstruct:?}");
    }
    let edl =
        Settings { edl: pointillist::plan::Edl::On, ..Settings::drawn_as(Reconstruct::Points) };
    let shaded = case.draw_wide(&view, edl);
    assert_eq!(shaded.id, points.id);
    let brighter =
        |i: &usize| (0..3).any(|c| shaded.color[*i][c] > points.color[*i][c].saturating_add(1));
    assert_eq!((0..points.id.len()).filter(brighter).count(), 0, "EDL only darkens");
}

#[test]
fn lines_stand_among_triangles_and_samples() {
    let ball = super::files::Shape::ball(24, 0.6);
    let files = [("l.vtk", vtk(&scattered(10, [0.02, 0.1], 41))), ("m.ply", ball.ply())];
    let scene = json!({
        "assets": { "l": { "file": "l.vtk" }, "m": { "file": "m.ply" } },
        "nodes": [{ "asset": "l" }, { "asset": "m" }, { "asset": "l", "translate": [0.2, 0.3, -0.6] }],
        "lights": lights(),
    });
    let case = Case::new("tubes-among", &files, &scene);
    let frames = case.draw(&look([0.5, 0.4, 4.0], [0.0; 3], 45.0));
    judge(
        "tubes-among",
        &case.reference,
        &look([0.5, 0.4, 4.0], [0.0; 3], 45.0),
        &frames,
        &tolerance(),
    );
    for id in 1..=3 {
        assert!(frames.id.contains(&id), "{id} is not seen");
    }
}
