//! Shadow maps against the oracle's rays to suns and lamps.
//!
//! A map has pixels, and takes places at their middles: the edge of a shadow may lie a pixel of the map beside its true place. Away from edges, a place is
//! in the shadow or not, and both agree. How many pixels differ is therefore bounded by the length of the edges.

use glam::DVec3;
use pointillist::encode::ImageFormat;
use pointillist::engine::{FrameRequest, Pose, Receipt};
use pointillist::math::View;
use pointillist::oracle::{self, OracleScene};
use pointillist::plan::{
    Antialias, Lod, MaxError, Output, Pass, Reconstruct, Reconstruction, Settings, ShadowPx,
    Shadows,
};
use serde_json::{Value, json};

use super::files::{Glb, Shape};
use super::splats::{ball, save_both};
use super::stage::{Case, Frames, look, wide_engine};

fn suns(angle: f64) -> Value {
    json!([
        { "kind": "ambient", "intensity": 0.2 },
        { "kind": "sun", "direction": [-0.6, -1, -0.4], "intensity": 0.8, "shadows": true, "angle": angle },
    ])
}

fn floor(half: f64, height: f64) -> Shape {
    let corner = DVec3::new(-half, height, half);
    let mut floor = Shape::quad(corner, DVec3::X * 2.0 * half, DVec3::NEG_Z * 2.0 * half, 1.0);
    floor.colors = vec![[200, 200, 190, 255]; 4];
    floor.uvs.clear();
    floor
}

fn over_floor(name: &str, file: (&str, Vec<u8>), asset: Value, lights: Value) -> Case {
    let scene = json!({
        "assets": { "thing": asset, "floor": { "file": "floor.ply" } },
        "nodes": [{ "asset": "floor" }, { "name": "thing", "asset": "thing", "translate": [0, 0.2, 0] }],
        "lights": lights,
    });
    Case::new(name, &[file, ("floor.ply", floor(4.0, -1.0).ply())], &scene)
}

/// Samples as they are drawn, as splats.
fn splats() -> Settings {
    Settings::drawn_as(Reconstruct::Splats)
}

fn oracle(case: &Case, view: &View, settings: Settings) -> oracle::OracleFrame {
    let scene = case.reference.description().splats;
    let splats = Reconstruction::new(&settings, &scene).splats().copied();
    let shadows = settings.shadows == Shadows::On;
    oracle::render(&OracleScene { splats, shadows, ..case.reference.scene() }, view, 1)
}

/// Reason for a frame that draws no map although suns cast shadows.
const USED_AGAIN: &str = "the maps of an earlier frame are used again";

/// Whether the receipt's frame drew maps, with their time, or why not.
fn maps(receipt: &Receipt) -> Result<Option<u64>, String> {
    let mut passes = receipt.passes.iter();
    let line = passes.find(|pass| pass.name == Pass::ShadowMap.name()).unwrap();
    if line.ran { Ok(line.gpu_ns) } else { Err(line.why.clone().unwrap()) }
}

fn has_maps(frames: &Frames) -> bool {
    maps(&frames.receipt).map_or_else(|why| why == USED_AGAIN, |_| true)
}

/// Pixels that differ by more than a sixth of the range, and pixels of the frame that shadows change.
fn compared(case: &Case, view: &View, settings: Settings) -> ([usize; 2], Frames) {
    let frames = case.draw_with(view, settings);
    let twin = oracle(case, view, settings).to_rgba8();
    let lit = case.draw_wide(view, Settings { shadows: Shadows::Off, ..settings });
    let apart = |a: &[[u8; 4]], b: &[[u8; 4]], by: u8| {
        let differ = |(a, b): (&[u8; 4], &[u8; 4])| (0..3).any(|c| a[c].abs_diff(b[c]) > by);
        a.iter().zip(b).filter(|pair| differ(*pair)).count()
    };
    let found = [apart(&twin, &frames.color, 42), apart(&lit.color, &frames.color, 8)];
    println!(
        "{}: {} pixels differ from the oracle's, {} from those without shadows",
        case.id, found[0], found[1]
    );
    if found[0] > 0 {
        save_both(case, view, twin, frames.color.clone());
    }
    (found, frames)
}

fn check(case: &Case, view: &View, settings: Settings, most: usize) -> Frames {
    let ([differ, shaded], frames) = compared(case, view, settings);
    assert!(has_maps(&frames), "{:?}", frames.receipt.passes);
    assert!(shaded > 100, "{}: shadows change {shaded} pixels", case.id);
    assert!(differ <= most, "{}: {differ} pixels differ", case.id);
    frames
}

#[test]
fn meshes_cast_shadows_with_hard_and_soft_edges() {
    for (name, angle) in [("hard", 0.0), ("sun", 0.53), ("soft", 8.0)] {
        let file = ("ball.ply", Shape::ball(24, 0.9).ply());
        let case =
            over_floor(&format!("shadow-{name}"), file, json!({ "file": "ball.ply" }), suns(angle));
        for eye in [[0.4, 1.4, 4.6], [3.5, 2.5, -2.0]] {
            check(&case, &look(eye, [0.0, -0.4, 0.0], 55.0), splats(), 40);
        }
    }
}

/// The accepted error and the reconstruction change no shadow of a mesh in full detail, with antialiasing either.
#[test]
fn shadows_of_full_detail_have_no_accepted_error() {
    let file = ("ball.ply", Shape::ball(24, 0.9).ply());
    let case = over_floor("shadow-full", file, json!({ "file": "ball.ply" }), suns(0.53));
    let view = look([0.4, 1.4, 4.6], [0.0, -0.4, 0.0], 55.0);
    for antialias in [Antialias::Off, Antialias::Parts4] {
        let with = |reconstruct, px| {
            let max_error_px = MaxError::new(px).unwrap();
            let plain = Settings::drawn_as(reconstruct);
            case.draw_with(&view, Settings { antialias, max_error_px, ..plain })
        };
        let points = with(Reconstruct::Points, 1.0);
        assert!(has_maps(&points));
        for (reconstruct, px) in
            [(Reconstruct::Splats, 1.0), (Reconstruct::Splats, 16.0), (Reconstruct::Points, 16.0)]
        {
            let frames = with(reconstruct, px);
            let differ = frames.color.iter().zip(&points.color).filter(|(a, b)| a != b).count();
            assert_eq!(differ, 0, "{antialias:?}, {reconstruct:?}, {px} px");
        }
    }
}

#[test]
fn splats_cast_shadows_and_take_them() {
    let file = ("ball.ply", ball(4000, 5).ply());
    let case = over_floor("shadow-splats", file, json!({ "file": "ball.ply" }), suns(0.53));
    let view = look([0.4, 1.4, 4.6], [0.0, -0.4, 0.0], 55.0);
    check(&case, &view, splats(), 60);
    // Methods that light each splat by itself are no oracle's; their shadows are those of the blended surface.
    let blended = case.draw_wide(&view, splats());
    for reconstruct in
        [Reconstruct::Fuzzy, Reconstruct::Painted, Reconstruct::PullPush, Reconstruct::Points]
    {
        let frames = case.draw_wide(&view, Settings::drawn_as(reconstruct));
        assert!(has_maps(&frames));
        let floor = |frames: &Frames, i: usize| frames.id[i] == 1;
        let pairs = frames.color.iter().zip(&blended.color).enumerate();
        let floors = pairs.filter(|(i, _)| floor(&frames, *i) && floor(&blended, *i));
        let differ = floors.filter(|(_, (a, b))| a[0].abs_diff(b[0]) > 42).count();
        assert!(differ <= 40, "{reconstruct:?}: {differ} pixels of the floor differ");
    }
}

#[test]
fn point_trees_cast_the_shadows_of_the_whole() {
    let file = ("ball.ply", Shape::ball(64, 0.9).ply());
    let case = over_floor("shadow-tree", file, json!({ "file": "ball.ply" }), suns(0.53));
    let view = look([0.4, 1.4, 4.6], [0.0, -0.4, 0.0], 55.0);
    let whole = case.draw_wide(&view, splats());
    let tree = case.draw_wide(&view, Settings { lod: Lod::Spt, ..splats() });
    let differ = |a: &[u8; 4], b: &[u8; 4]| a[0].abs_diff(b[0]) > 42;
    let count = tree.color.iter().zip(&whole.color).filter(|(a, b)| differ(a, b)).count();
    assert!(count <= 80, "{count} pixels differ");
}

/// Translucent meshes let light through; holes that alpha cuts do as well.
#[test]
fn light_goes_through_glass_and_holes() {
    let quad = |height: f64| {
        Shape::quad(DVec3::new(-1.0, height, 1.0), DVec3::X * 2.0, DVec3::NEG_Z * 2.0, 1.0)
    };
    let mut glb = Glb::new();
    let checks = super::files::picture(8, 8, |x, y| {
        [255, 255, 255, if (x / 4 + y / 4) % 2 == 0 { 255 } else { 0 }]
    });
    let texture = glb.texture(&checks, json!({ "magFilter": 9728, "minFilter": 9728 }));
    let cut = glb.material(json!({ "alphaMode": "MASK", "doubleSided": true,
        "pbrMetallicRoughness": { "baseColorTexture": { "index": texture } } }));
    let glass = glb.material(json!({ "alphaMode": "BLEND", "doubleSided": true,
        "pbrMetallicRoughness": { "baseColorFactor": [0.3, 0.8, 0.5, 0.3] } }));
    let mesh = glb.mesh(&quad(0.6), Some(cut));
    glb.node(mesh, json!({}));
    let mesh = glb.mesh(&quad(0.9), Some(glass));
    glb.node(mesh, json!({}));
    let case = over_floor(
        "shadow-holes",
        ("cut.glb", glb.finish()),
        json!({ "file": "cut.glb" }),
        suns(0.0),
    );
    check(&case, &look([2.5, 3.5, 3.6], [-0.6, -1.0, -0.4], 50.0), splats(), 120);
}

#[test]
fn tubes_cast_shadows_of_their_width() {
    let grey = [190; 3];
    let strand =
        vec![(DVec3::new(-1.2, 0.1, 0.4), 0.1, grey), (DVec3::new(1.2, 0.5, -0.3), 0.05, grey)];
    let file = super::lines::vtk(&[strand]);
    let case = over_floor("shadow-tube", ("l.vtk", file), json!({ "file": "l.vtk" }), suns(0.0));
    check(&case, &look([0.4, 2.4, 4.6], [0.0, -0.6, 0.0], 50.0), splats(), 60);
}

/// Several suns have a map each, one behind the other.
#[test]
fn each_sun_casts_its_own_shadow() {
    let sun = |direction: [f64; 3], color: &str| json!({ "kind": "sun", "direction": direction, "color": color, "intensity": 0.5, "shadows": true, "angle": 0 });
    let lights = json!([
        sun([-0.6, -1.0, -0.4], "#ff4040"), { "kind": "ambient", "intensity": 0.1 },
        { "kind": "sun", "direction": [0.1, -1, 0.1], "intensity": 0.1 },
        sun([0.7, -1.0, 0.2], "#40ff40"), sun([0.0, -1.0, 0.6], "#4040ff"),
    ]);
    let file = ("ball.ply", Shape::ball(24, 0.7).ply());
    let case = over_floor("shadow-suns", file, json!({ "file": "ball.ply" }), lights);
    check(&case, &look([0.4, 2.4, 4.6], [0.0, -0.6, 0.0], 55.0), splats(), 120);
}

/// The same scene at coordinates of a survey has the same shadows, and one that is clipped away has none.
#[test]
fn places_far_from_the_origin_and_clip_boxes() {
    let far = [412_000.0, 5_652_000.0, 100.0];
    let ball = Shape::ball(24, 0.9).moved(DVec3::from(far)).ply();
    let mut ground = floor(4.0, -1.0).moved(DVec3::from(far));
    ground.uvs.clear();
    let scene = json!({
        "assets": { "ball": { "file": "ball.ply" }, "floor": { "file": "floor.ply" } },
        "nodes": [{ "asset": "floor" }, { "asset": "ball", "translate": [0, 0.2, 0] }],
        "lights": suns(0.0),
    });
    let case = Case::new("shadow-far", &[("ball.ply", ball), ("floor.ply", ground.ply())], &scene);
    let at = |place: [f64; 3]| std::array::from_fn(|i| far[i] + place[i]);
    let view = look(at([0.4, 1.4, 4.6]), at([0.0, -0.4, 0.0]), 55.0);
    check(&case, &view, splats(), 60);
    let text = format!("*,*,*,*,{},*", far[1] - 0.9);
    let clipped = Settings { clip_boxes: Some(text.parse().unwrap()), ..splats() };
    let with = case.draw_wide(&view, clipped);
    let without = case.draw_wide(&view, Settings { shadows: Shadows::Off, ..clipped });
    assert!(with.covered() > 3000);
    let differ = with.color.iter().zip(&without.color).filter(|(a, b)| a != b).count();
    assert_eq!(differ, 0, "what is clipped away casts no shadow");
}

/// Maps that are used again give the bytes of maps that are drawn; the receipt says which it was.
#[test]
fn maps_are_used_again_until_the_scene_changes() {
    let file = ("ball.ply", Shape::ball(24, 0.9).ply());
    let case = over_floor("shadow-kept", file, json!({ "file": "ball.ply" }), suns(0.53));
    let view = look([0.4, 1.4, 4.6], [0.0, -0.4, 0.0], 55.0);
    let draw = |format, shadow_px| {
        let request = FrameRequest {
            scene: case.id.clone(),
            pose: Pose::View(view),
            width: view.width,
            height: view.height,
            settings: Settings { shadow_px, ..splats() },
            output: Output::Color,
            format,
            quality: 85,
            deadline: None,
        };
        wide_engine().submit(request).unwrap().wait().unwrap()
    };
    let side = ShadowPx::Side1024;
    let (first, second) = (draw(ImageFormat::Raw, side), draw(ImageFormat::Raw, side));
    assert_eq!(first.bytes, second.bytes);
    assert!(maps(&first.receipt).unwrap().is_some_and(|ns| ns > 0));
    assert_eq!(maps(&second.receipt), Err(USED_AGAIN.to_owned()));
    let other = draw(ImageFormat::Raw, ShadowPx::Side512);
    assert!(maps(&other.receipt).is_ok(), "another size is another map");
    case.show("thing", false);
    let empty = draw(ImageFormat::Raw, side);
    assert!(maps(&empty.receipt).is_ok(), "a new revision has new maps");
    assert_ne!(first.bytes, empty.bytes);
    case.show("thing", true);
    assert_eq!(draw(ImageFormat::Raw, side).bytes, first.bytes);
}

/// Where no light casts shadows, and where they are off, frames have the passes and the bytes of a renderer without shadows.
#[test]
fn scenes_without_casting_suns_draw_no_maps() {
    let file = || ("ball.ply", Shape::ball(24, 0.9).ply());
    let mut lights = suns(0.53);
    let casting = over_floor("shadow-asked", file(), json!({ "file": "ball.ply" }), lights.clone());
    let sun = lights[1].as_object_mut().unwrap();
    sun.remove("shadows");
    sun.remove("angle");
    let plain = over_floor("shadow-unasked", file(), json!({ "file": "ball.ply" }), lights);
    let view = look([0.4, 1.4, 4.6], [0.0, -0.4, 0.0], 55.0);
    let off = Settings { shadows: Shadows::Off, ..splats() };
    let [asked, unasked] = [casting.draw_wide(&view, off), plain.draw_wide(&view, splats())];
    assert!(asked.same_pixels(&unasked));
    for (frames, expected) in [(asked, "shadows are off"), (unasked, "no light casts shadows")] {
        assert_eq!(maps(&frames.receipt), Err(expected.to_owned()));
    }
}

/// A camera that walks takes the maps of distant parts along. `draw_with` compares them with those of an engine that has not seen the first pose.
#[test]
fn maps_that_are_copied_equal_those_that_are_drawn() {
    let scene = json!({
        "assets": { "ball": { "file": "ball.ply" }, "floor": { "file": "floor.ply" } },
        "nodes": [
            { "asset": "floor" },
            { "asset": "ball", "repeat": { "grid": [12, 1, 12], "step": [6, 0, 6] }, "translate": [-33, 0, -60] },
        ],
        "lights": suns(0.53),
    });
    let files = [("ball.ply", Shape::ball(12, 0.9).ply()), ("floor.ply", floor(150.0, -1.0).ply())];
    let case = Case::new("shadow-walk", &files, &scene);
    let at = |z: f64| look([0.5, 0.8, z], [0.0, 0.2, z - 9.0], 55.0);
    let first = case.draw_wide(&at(9.0), splats());
    let second = case.draw_with(&at(8.2), splats());
    assert!(has_maps(&first) && has_maps(&second));
}

/// Thin poles on a ground a thousand times as large keep their shadows: the search for what hides the sun goes far there, and must not miss what is near.
#[test]
fn thin_poles_on_a_large_ground_cast_shadows() {
    let grey = [190; 3];
    let pole = |x: f64, radius: f64| {
        vec![(DVec3::new(x, -1.0, 0.0), radius, grey), (DVec3::new(x, 1.2, 0.0), radius, grey)]
    };
    let file = super::lines::vtk(&[pole(-0.8, 0.04), pole(0.0, 0.03), pole(0.9, 0.06)]);
    let scene = json!({
        "assets": { "poles": { "file": "l.vtk" }, "floor": { "file": "floor.ply" } },
        "nodes": [{ "asset": "floor" }, { "asset": "poles" }],
        "lights": suns(0.53),
    });
    let files = [("l.vtk", file), ("floor.ply", floor(300.0, -1.0).ply())];
    let case = Case::new("shadow-poles", &files, &scene);
    check(&case, &look([0.4, 1.6, 4.2], [-0.4, -0.8, -0.4], 50.0), splats(), 60);
}

fn lamp(position: [f64; 3], color: &str, radius: f64) -> Value {
    json!({
        "kind": "point", "position": position, "color": color, "range": 4, "intensity": 0.9,
        "shadows": true, "radius": radius,
    })
}

/// The inside of a box of six units, with balls around its middle: towards the sides, the edges and the corners of the cube that a lamp's maps are.
fn room(name: &str, origin: DVec3, lights: Value) -> Case {
    let mut walls = Shape::default();
    for axis in 0..3 {
        let (u, v, n) =
            (DVec3::AXES[(axis + 1) % 3], DVec3::AXES[(axis + 2) % 3], DVec3::AXES[axis]);
        for (u, v, n) in [(u, v, -n), (v, u, n)] {
            walls.add(&Shape::quad(origin + 3.0 * (n - u - v), 6.0 * u, 6.0 * v, 1.0));
        }
    }
    walls.uvs.clear();
    walls.colors = vec![[200, 200, 190, 255]; walls.positions.len()];
    let mut balls = Shape::default();
    for way in [
        [1.0, 0.2, 0.1],
        [-1.0, -0.1, 0.3],
        [0.1, 1.0, -0.2],
        [-0.3, -1.0, 0.1],
        [0.2, 0.1, 1.0],
        [0.1, -0.3, -1.0],
        [1.0, 1.0, 0.1],
        [-1.0, 0.0, 1.0],
        [0.2, -1.0, -1.0],
        [1.0, -1.0, 1.0],
        [-1.0, 1.0, -1.0],
    ] {
        let way = DVec3::from(way).normalize_or_zero();
        balls.add(&Shape::ball(16, 0.25).moved(origin + 1.2 * way));
    }
    let scene = json!({
        "assets": { "walls": { "file": "walls.ply" }, "balls": { "file": "balls.ply" } },
        "nodes": [{ "asset": "walls" }, { "name": "balls", "asset": "balls" }],
        "lights": lights,
    });
    Case::new(name, &[("walls.ply", walls.ply()), ("balls.ply", balls.ply())], &scene)
}

/// Shadows in all directions from a lamp, and across the edges between its maps, near the origin and at coordinates of a survey.
#[test]
fn lamps_cast_shadows_all_around() {
    let far = DVec3::new(412_000.0, 5_652_000.0, 100.0);
    for (name, origin, radius) in
        [("lamp-hard", DVec3::ZERO, 0.0), ("lamp-soft", DVec3::ZERO, 0.12), ("lamp-far", far, 0.0)]
    {
        let position = (origin + DVec3::new(0.1, -0.05, 0.08)).to_array();
        let lights =
            json!([{ "kind": "ambient", "intensity": 0.1 }, lamp(position, "#ffffff", radius)]);
        let case = room(name, origin, lights);
        let at = |place: [f64; 3]| (origin + DVec3::from(place)).to_array();
        for eye in [[2.7, 0.4, 2.6], [-2.6, 2.0, -1.2], [0.3, -2.4, 2.8]] {
            check(&case, &look(at(eye), at([0.0, 0.0, 0.0]), 90.0), splats(), 150);
        }
    }
}

/// Suns and lamps have maps of their own, and lamps those of an earlier frame wherever the camera goes.
#[test]
fn suns_and_lamps_cast_shadows_together() {
    let lights = json!([
        lamp([0.9, 1.6, 1.4], "#ff5050", 0.0),
        { "kind": "sun", "direction": [-0.6, -1, -0.4], "color": "#5050ff", "intensity": 0.5, "shadows": true, "angle": 0 },
        { "kind": "point", "position": [2, 2, 2], "range": 1, "intensity": 0.2 },
        lamp([-1.8, 0.9, 0.6], "#50ff50", 0.0),
    ]);
    let file = ("ball.ply", Shape::ball(24, 0.7).ply());
    let case = over_floor("shadow-lamps", file, json!({ "file": "ball.ply" }), lights);
    check(&case, &look([0.4, 2.4, 4.6], [0.0, -0.6, 0.0], 55.0), splats(), 120);
    let only = json!([lamp([0.9, 1.6, 1.4], "#ffffff", 0.05)]);
    let file = ("ball.ply", ball(4000, 5).ply());
    let case = over_floor("shadow-lamp-kept", file, json!({ "file": "ball.ply" }), only);
    let first = check(&case, &look([0.4, 1.4, 4.6], [0.0, -0.4, 0.0], 55.0), splats(), 60);
    assert!(maps(&first.receipt).is_ok());
    let aside = case.draw_wide(&look([-3.4, 1.4, -2.6], [0.0, -0.4, 0.0], 55.0), splats());
    assert_eq!(maps(&aside.receipt), Err(USED_AGAIN.to_owned()));
}

/// Across the shadow of a straight edge, the share of a lamp's light follows that of its disc: below the lamp, and aside of it, where its maps see the disc as an ellipse.
#[test]
fn penumbrae_of_lamps_are_as_wide_as_their_discs() {
    for aside in [0.0, 1.8] {
        let mut wall = Shape::quad(
            DVec3::new(-6.0 + 0.5 * aside, 0.0, 3.0),
            DVec3::X * 6.0,
            DVec3::NEG_Z * 6.0,
            1.0,
        );
        wall.uvs.clear();
        wall.colors = vec![[200, 200, 190, 255]; 4];
        let scene = json!({
            "assets": { "wall": { "file": "wall.ply" }, "floor": { "file": "floor.ply" } },
            "nodes": [{ "asset": "floor" }, { "asset": "wall" }],
            "lights": [lamp([0.0, 1.0, 0.0], "#ffffff", 0.15)],
        });
        let files = [("wall.ply", wall.ply()), ("floor.ply", floor(4.0, -1.0).ply())];
        let case = Case::new(&format!("lamp-edge-{aside}"), &files, &scene);
        // From below the wall, along the edge of its shadow.
        let view = look([aside, -0.3, 1.2], [aside, -1.0, 0.0], 40.0);
        let frames = case.draw_with(&view, splats());
        let twin = oracle(&case, &view, splats()).to_rgba8();
        let light = |[r, _, _, _]: [u8; 4]| (f64::from(r) / 255.0).powf(2.2);
        let (mut partly, mut sum, mut most) = (0, 0.0, 0.0f64);
        let brightest = twin.iter().copied().map(light).fold(0.0, f64::max);
        for (found, exact) in
            frames.color.iter().copied().map(light).zip(twin.iter().copied().map(light))
        {
            partly += usize::from(exact > 0.05 * brightest && exact < 0.95 * brightest);
            sum += (found - exact).powi(2);
            most = most.max((found - exact).abs());
        }
        let off = (sum / frames.color.len() as f64).sqrt() / brightest;
        println!("{aside}: {partly} pixels in part, off by {off} and {}", most / brightest);
        assert!(partly > 1000, "{partly}");
        assert!(off < 0.04 && most / brightest < 0.25, "{aside}: {off}, {}", most / brightest);
    }
}
