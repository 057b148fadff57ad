//! Ambient occlusion against the formula in f64, for the frame's own depths, and against rays into the scene.

use glam::{DVec2, DVec3};
use pointillist::math::View;
use pointillist::oracle::color::{linear_from_srgb8, srgb8_from_linear};
use pointillist::oracle::occlusion::ambient_shares;
use pointillist::oracle::{self, OracleScene};
use pointillist::plan::{Effect, Pass, Reconstruct, Reconstruction, Settings};
use pointillist::scene::Shading;
use serde_json::{Value, json};

use super::files::Shape;
use super::orthographic;
use super::splats::{ball, save_both};
use super::stage::{Case, Frames, look};

const RADIUS: f64 = 0.8;

fn points() -> Settings {
    Settings::drawn_as(Reconstruct::Points)
}

fn off() -> Settings {
    Settings { ao: Effect::Off, ..points() }
}

fn white(mut shape: Shape) -> Shape {
    shape.colors = vec![[255; 4]; shape.positions.len()];
    shape.uvs.clear();
    shape
}

fn quad(corner: [f64; 3], u: DVec3, v: DVec3) -> Shape {
    white(Shape::quad(corner.into(), u, v, 1.0))
}

/// Under ambient light alone, white surfaces show the share of it that arrives.
fn scene(nodes: &[&str], occlusion: Value) -> Value {
    let assets: serde_json::Map<String, Value> = nodes
        .iter()
        .map(|name| ((*name).to_owned(), json!({ "file": format!("{name}.ply") })))
        .collect();
    let nodes: Vec<Value> = nodes.iter().map(|name| json!({ "asset": name })).collect();
    json!({ "assets": assets, "nodes": nodes, "lights": [{ "kind": "ambient" }], "ambient_occlusion": occlusion,
        "background": "#000000" })
}

fn case(name: &str, shapes: &[(&str, Shape)]) -> Case {
    let files: Vec<(String, Vec<u8>)> =
        shapes.iter().map(|(name, shape)| (format!("{name}.ply"), shape.ply())).collect();
    let files: Vec<(&str, Vec<u8>)> =
        files.iter().map(|(name, bytes)| (name.as_str(), bytes.clone())).collect();
    let nodes: Vec<&str> = shapes.iter().map(|(name, _)| *name).collect();
    Case::new(name, &files, &scene(&nodes, json!({ "radius": RADIUS })))
}

fn floor() -> Shape {
    quad([-5.0, 0.0, 5.0], DVec3::X * 10.0, DVec3::NEG_Z * 10.0)
}

/// A floor, a wall behind it and a wall beside it.
fn corner(name: &str) -> Case {
    let back = quad([-5.0, 0.0, -2.0], DVec3::X * 10.0, DVec3::Y * 4.0);
    let side = quad([-1.5, 0.0, 5.0], DVec3::NEG_Z * 10.0, DVec3::Y * 4.0);
    case(name, &[("floor", floor()), ("back", back), ("side", side)])
}

fn ball_on_floor(name: &str) -> Case {
    let ball = white(Shape::ball(48, 0.7).moved(DVec3::new(0.0, 0.7, 0.0)));
    case(name, &[("floor", floor()), ("ball", ball)])
}

/// Linear shares of light that a frame shows, for pixels that show something.
fn shares(frames: &Frames) -> Vec<Option<f64>> {
    let shown = frames.id.iter().zip(&frames.color);
    shown.map(|(&id, color)| (id != 0).then(|| linear_from_srgb8(color[0]))).collect()
}

/// The formula's shares for the depths of a frame, with the oracle's normals.
fn formula(case: &Case, view: &View, frames: &Frames, settings: Settings) -> Vec<f64> {
    let depth: Vec<f64> = frames.depth.iter().map(|&depth| f64::from(depth)).collect();
    let normals = oracle::render(&bare(case, settings), view, 1).normal;
    let occlusion = case.reference.description().occlusion.unwrap();
    ambient_shares(&occlusion, view, &depth, &normals)
}

/// The oracle's scene without ambient occlusion.
fn bare(case: &Case, settings: Settings) -> OracleScene<'_> {
    let splats =
        Reconstruction::new(&settings, &case.reference.description().splats).splats().copied();
    OracleScene { splats, occlusion: None, ..case.reference.scene() }
}

/// Draws a frame with every engine and returns how many bytes it is from the formula: on average, and for all but one of 200 pixels.
fn from_formula(case: &Case, view: &View, settings: Settings) -> (f64, u8) {
    let frames = case.draw_with(view, settings);
    assert!(frames.ran(Pass::AmbientOcclusion) && frames.ran(Pass::WriteOutput));
    let twin = formula(case, view, &frames, settings);
    let pairs = frames.id.iter().zip(frames.color.iter().zip(&twin));
    let shown = pairs.filter(|(id, _)| **id != 0);
    let mut differences: Vec<u8> =
        shown.map(|(_, (color, &share))| srgb8_from_linear(share).abs_diff(color[0])).collect();
    differences.sort_unstable();
    let mean =
        differences.iter().map(|&byte| f64::from(byte)).sum::<f64>() / differences.len() as f64;
    let most = differences[differences.len() * 199 / 200];
    println!("{}: {mean:.3} bytes on average, {most} at most in 199 of 200 pixels", case.id);
    (mean, most)
}

#[test]
fn frames_are_those_of_the_formula() {
    let views = [
        look([1.5, 1.6, 3.0], [0.0, 0.3, -1.5], 45.0),
        look([4.0, 6.0, 14.0], [0.0, 0.3, -1.5], 30.0),
        orthographic::look([1.5, 1.6, 3.0], [0.0, 0.3, -1.5], 3.0),
    ];
    for case in [corner("ao-corner"), ball_on_floor("ao-ball")] {
        for view in &views {
            let (mean, most) = from_formula(&case, view, points());
            assert!(mean < 0.05 && most <= 1, "{}: {mean}, {most}", case.id);
        }
    }
    let cloud = ball(6000, 3);
    let cloud = Shape { colors: vec![[255; 4]; cloud.positions.len()], ..cloud };
    let splats =
        case("ao-splats", &[("floor", floor()), ("cloud", cloud.moved(DVec3::new(0.0, 0.9, 0.0)))]);
    let (mean, most) = from_formula(
        &splats,
        &look([0.4, 1.6, 4.0], [0.0, 0.5, 0.0], 50.0),
        Settings::drawn_as(Reconstruct::Splats),
    );
    assert!(mean < 0.05 && most <= 1, "{mean}, {most}");
}

/// Root mean square and mean of the differences from rays, in linear light.
fn from_rays(case: &Case, view: &View, settings: Settings) -> [f64; 2] {
    let frames = case.draw_wide(view, settings);
    let occlusion = case.reference.description().occlusion;
    let truth = oracle::render(&OracleScene { occlusion, ..bare(case, settings) }, view, 1);
    let pairs = shares(&frames).into_iter().zip(&truth.color).zip(&truth.id);
    let differences: Vec<f64> = pairs
        .filter_map(|((share, color), &id)| share.filter(|_| id != 0).map(|share| share - color[0]))
        .collect();
    let count = differences.len() as f64;
    let rms = (differences.iter().map(|by| by * by).sum::<f64>() / count).sqrt();
    let bias = differences.iter().sum::<f64>() / count;
    save_both(case, view, truth.to_rgba8(), frames.color);
    println!("{}: {rms:.3} of the light from that of rays, {bias:+.3} on average", case.id);
    [rms, bias]
}

/// Hidden surfaces are not in the image, and twelve pixels a slice are few: the bounds are what was measured, rounded up.
#[test]
fn frames_are_near_to_rays_into_the_scene() {
    let inside = look([1.5, 1.6, 3.0], [0.0, 0.3, -1.5], 45.0);
    let corner = corner("ao-rays-corner");
    let ball = ball_on_floor("ao-rays-ball");
    let statue = case("ao-rays-statue", &[("floor", floor()), ("statue", statue())]);
    for (case, view, most, most_bias) in [
        (&corner, inside, 0.06, 0.03),
        (&corner, orthographic::look([1.5, 1.6, 3.0], [0.0, 0.3, -1.5], 3.0), 0.06, 0.03),
        (&ball, look([0.5, 1.6, 4.0], [0.0, 0.4, 0.0], 45.0), 0.06, 0.03),
        (&statue, look([1.2, 1.8, 3.6], [0.0, 0.7, 0.0], 45.0), 0.05, 0.03),
    ] {
        let [rms, bias] = from_rays(case, &view, points());
        assert!(rms < most && bias.abs() < most_bias, "{}: {rms} {bias}", case.id);
    }
}

/// Balls of several sizes that lie in each other, as a figure with folds.
fn statue() -> Shape {
    let parts = [
        ([0.0, 0.5, 0.0], 0.5),
        ([0.1, 1.2, 0.0], 0.35),
        ([0.05, 1.65, 0.05], 0.22),
        ([0.5, 1.0, 0.2], 0.18),
        ([-0.4, 0.95, 0.25], 0.18),
        ([0.0, 0.15, 0.5], 0.2),
    ];
    let mut all = Shape::default();
    for (centre, radius) in parts {
        let part = Shape::ball(28, radius).moved(centre.into());
        let first = all.positions.len() as u32;
        all.positions.extend(&part.positions);
        all.normals.extend(&part.normals);
        all.triangles
            .extend(part.triangles.iter().map(|corners| corners.map(|corner| corner + first)));
    }
    white(all)
}

/// What stands farther before a surface than the radius does not darken it, and what it hides brightens nothing: there are no halos.
#[test]
fn things_far_before_a_wall_leave_no_halo() {
    let wall = || quad([-4.0, -3.0, -2.0], DVec3::X * 8.0, DVec3::Y * 6.0);
    let post = quad([-0.2, -3.0, 0.0], DVec3::X * 0.4, DVec3::Y * 6.0);
    let case = case("ao-halo", &[("wall", wall()), ("post", post)]);
    let frames = case.draw_with(&look([0.3, 0.2, 5.0], [0.0, 0.0, -2.0], 45.0), points());
    assert!(frames.id.contains(&1) && frames.id.contains(&2));
    let dark = frames
        .id
        .iter()
        .zip(&frames.color)
        .filter(|(id, color)| **id != 0 && color[0] < 255)
        .count();
    assert_eq!(dark, 0);
}

/// A frame and the part of a larger one that shows the same: equal up to two steps of a byte away from the edges, by a radius and four pixels. Nearer, the
/// surroundings beside the frame are not seen; they count as open. The margin is a multiple of four, so that the squares of pixels are the same.
#[test]
fn edges_of_a_frame_are_brighter_at_most() {
    let case = corner("ao-edges");
    let small = look([1.5, 1.6, 3.0], [0.0, 0.3, -1.5], 45.0);
    let margin = 64;
    let large = View {
        width: small.width + 2 * margin,
        height: small.height + 2 * margin,
        principal_px: small.principal_px + DVec2::splat(f64::from(margin)),
        ..small
    };
    let [part, whole] = [small, large].map(|view| case.draw_with(&view, points()));
    let (mut inside, mut darker, mut brighter) = (0, 0, 0);
    for y in 0..small.height {
        for x in 0..small.width {
            let own = (y * small.width + x) as usize;
            let same = ((y + margin) * large.width + x + margin) as usize;
            let [a, b] = [part.color[own][0], whole.color[same][0]];
            let depth = f64::from(part.depth[own]);
            let reach = RADIUS * small.focal_px.y / depth + 4.0;
            let edge = x.min(y).min(small.width - 1 - x).min(small.height - 1 - y);
            if f64::from(edge) > reach {
                assert!(a.abs_diff(b) <= 2, "{x} {y}: {a}, {b}");
                inside += 1;
            }
            darker = darker.max(b.saturating_sub(a));
            brighter = brighter.max(a.saturating_sub(b));
        }
    }
    println!(
        "{inside} pixels inside; at the edges {darker} bytes darker, {brighter} brighter at most"
    );
    assert!(inside > 1000 && darker <= 4 && brighter <= 60, "{inside} {darker} {brighter}");
}

#[test]
fn unlit_surfaces_are_darkened_as_a_whole() {
    let shapes = [
        ("floor", floor()),
        ("ball", white(Shape::ball(48, 0.7).moved(DVec3::new(0.0, 0.7, 0.0)))),
    ];
    let files = shapes.each_ref().map(|(name, shape)| (format!("{name}.ply"), shape.ply()));
    let files: Vec<(&str, Vec<u8>)> =
        files.iter().map(|(name, bytes)| (name.as_str(), bytes.clone())).collect();
    let mut unlit = scene(&["floor", "ball"], json!({ "radius": RADIUS, "strength": 0.5 }));
    unlit["lights"] = json!([]);
    let case = Case::new("ao-unlit", &files, &unlit);
    let view = look([0.5, 1.6, 4.0], [0.0, 0.4, 0.0], 45.0);
    let frames = case.draw_with(&view, points());
    assert!(frames.ran(Pass::AmbientOcclusion));
    // Normals of depths are those of the flat triangles.
    let twin = formula(&case, &view, &frames, points());
    let pairs = frames.id.iter().zip(frames.color.iter().zip(&twin));
    let far = pairs.filter(|(id, (color, share))| {
        **id != 0 && srgb8_from_linear(**share).abs_diff(color[0]) > 12
    });
    let (far, dark) =
        (far.count(), frames.color.iter().filter(|color| (1..240).contains(&color[0])).count());
    println!("{far} pixels differ from the formula, {dark} are darkened");
    assert!(far < 200 && dark > 400, "{far} {dark}");
    assert!(twin.iter().all(|&share| share >= 0.5));
}

/// Lines thinner than a few pixels darken what is near to them and are not darkened, whether they are lit or not.
#[test]
fn thin_lines_are_not_darkened() {
    let at = |x: f64, y: f64, z: f64| (DVec3::new(x, y, z), 0.004, [200, 120, 60]);
    let strands = [
        vec![at(-1.0, 0.01, 0.5), at(1.0, 0.01, 0.5)],
        vec![at(0.0, 0.02, 1.0), at(0.3, 0.6, -1.9)],
    ];
    let files = [("floor.ply", floor().ply()), ("lines.vtk", super::lines::vtk(&strands))];
    for lights in [json!([]), json!([{ "kind": "ambient" }])] {
        let wall = json!({ "file": "floor.ply" });
        let scene = json!({ "assets": { "floor": wall, "lines": { "file": "lines.vtk" } }, "lights": lights,
            "nodes": [{ "asset": "floor" }, { "asset": "floor", "rotate": [90, 0, 0], "translate": [0, 0, -2] }, { "asset": "lines" }],
            "ambient_occlusion": { "radius": RADIUS } });
        let case =
            Case::new(&format!("ao-lines-{}", lights.as_array().unwrap().len()), &files, &scene);
        let view = look([0.5, 1.6, 4.0], [0.0, 0.1, 0.0], 30.0);
        let [on, off] = [points(), off()].map(|settings| case.draw_wide(&view, settings));
        assert!(on.ran(Pass::AmbientOcclusion) && on.color != off.color);
        let lines: Vec<usize> = (0..on.id.len()).filter(|&i| on.id[i] == 3).collect();
        assert!(lines.len() > 60, "{}", lines.len());
        assert!(lines.iter().all(|&i| on.color[i] == off.color[i]));
    }
}

/// Without ambient occlusion in the scene, with a strength of 0 and with the setting off, frames have the same passes and the same bytes.
#[test]
fn frames_without_ambient_occlusion_have_the_same_bytes() {
    let ball = white(Shape::ball(24, 0.7));
    let load = |name: &str, occlusion: Value| {
        let mut scene = scene(&["ball"], occlusion);
        scene["lights"] = json!([{ "kind": "ambient", "intensity": 0.4 }, { "kind": "headlight", "intensity": 0.5 }]);
        Case::new(name, &[("ball.ply", ball.ply())], &scene)
    };
    let view = look([0.5, 1.6, 4.0], [0.0; 3], 30.0);
    let cases = [
        load("ao-has", json!({ "radius": 1 })),
        load("ao-none", Value::Null),
        load("ao-zero", json!({ "radius": 1, "strength": 0 })),
    ];
    let [asked, none, zero] = [
        cases[0].draw_with(&view, off()),
        cases[1].draw_with(&view, points()),
        cases[2].draw_with(&view, points()),
    ];
    assert!(asked.same_pixels(&none) && none.same_pixels(&zero));
    let why = |frames: &Frames| {
        let mut passes = frames.receipt.passes.iter();
        passes.find(|pass| pass.name == Pass::AmbientOcclusion.name()).unwrap().why.clone()
    };
    assert_eq!(why(&asked).as_deref(), Some("ambient occlusion is off"));
    assert_eq!(why(&none).as_deref(), Some("the scene has no ambient occlusion"));
    assert!(!asked.ran(Pass::WriteOutput));
}

/// Ways to draw splats that give no depths, or no ambient light by itself, are drawn as they are, and the receipt says why.
#[test]
fn frames_without_depths_have_none_and_say_why() {
    let cloud = ball(2000, 3);
    let case = case("ao-depthless", &[("cloud", cloud)]);
    let view = look([0.4, 1.0, 3.0], [0.0; 3], 45.0);
    let why = |settings: Settings| {
        let frames = case.draw_wide(&view, settings);
        let without = case.draw_wide(&view, Settings { ao: Effect::Off, ..settings });
        let mut passes = frames.receipt.passes.iter();
        let line = passes.find(|pass| pass.name == Pass::AmbientOcclusion.name()).unwrap();
        assert_eq!(line.ran, frames.color != without.color);
        line.why.clone()
    };
    let depthless = "fuzzy and painted splats leave no depths for ambient occlusion";
    assert_eq!(why(Settings::drawn_as(Reconstruct::Fuzzy)).as_deref(), Some(depthless));
    assert_eq!(why(Settings::drawn_as(Reconstruct::Painted)).as_deref(), Some(depthless));
    let singly =
        Settings { shading: Some(Shading::Splat), ..Settings::drawn_as(Reconstruct::Splats) };
    assert!(why(singly).unwrap().contains("one by one"));
    assert_eq!(why(Settings::drawn_as(Reconstruct::PullPush)), None);
}
