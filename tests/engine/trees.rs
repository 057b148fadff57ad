//! Level of detail: frames of point trees are within the promised error of full detail, without holes, and deterministic.

use std::path::Path;

use glam::DVec3;
use pointillist::accuracy::metrics::farthest_px;
use pointillist::assets::{Geometry, Progress, ReadOptions, read};
use pointillist::bake::pack::{octahedral_decode, pack_samples, unpack_samples};
use pointillist::bake::prepare::{AssetTraits, prepare_geometry};
use pointillist::bake::tree::{SIDEWAYS, Seen, UNTILTED, build_tree, is_drawn};
use pointillist::engine::{FrameRequest, NodePatch, Pose};
use pointillist::generate::{Kind, Parameters, generate, write};
use pointillist::math::Camera;
use pointillist::plan::{ErrorMode, Output, Reconstruct, Settings, Shadows};
use serde_json::{Value, json};

use super::studio::{
    Disk, OUTPUTS, Studio, covered, depths, disk_sphere, disks, fit, front, ids, mesh, same,
    sphere, sphere_mesh, spt,
};

const WAYS: [Reconstruct; 2] = [Reconstruct::Points, Reconstruct::Splats];

fn split(px: f32) -> Settings {
    Settings { error_mode: ErrorMode::Split, ..spt(px, Reconstruct::Splats) }
}

fn full(reconstruct: Reconstruct) -> Settings {
    Settings { reconstruct, ..Settings::default() }
}

/// A view from `distance` away from the origin.
fn seen(scene: &str, number: u32, distance: f64, side: u32) -> FrameRequest {
    let (turn, lift) = (1.1 * f64::from(number), (0.7 * f64::from(number)).sin());
    let eye = DVec3::new(turn.sin(), lift, turn.cos()).normalize_or(DVec3::Z) * distance;
    let camera = Camera::perspective(eye, DVec3::ZERO, 40.0);
    let request = front(scene, side, side);
    FrameRequest { pose: Pose::Camera(camera), output: Output::Depth, ..request }
}

/// Writes a sculpture of points or triangles as `statue.ply`.
fn sculpture(studio: &Studio, kind: Kind, size: u64) {
    let parameters = Parameters { seed: 3, ..Parameters::of_size(kind, size) };
    let generated = generate(kind, &parameters, &Progress::none()).unwrap();
    write(&generated, &studio.folder().join("statue.ply")).unwrap();
}

fn one(file: &str) -> Value {
    json!({ "assets": { "g": { "file": file } }, "nodes": [{ "name": "one", "asset": "g" }] })
}

/// The covered pixels of a frame.
fn mask(studio: &Studio, request: &FrameRequest) -> Vec<bool> {
    depths(&studio.bytes(request)).iter().map(|depth| depth.is_finite()).collect()
}

/// Number of missing pixels within surfaces: `whole` shows them and all their neighbours as one surface.
fn holes(whole: &[f32], found: &[bool], side: i64, margin: i64) -> usize {
    // Depths on a surface change per pixel by no more than the width of a few pixels.
    let pixel = 2.0 * 20f32.to_radians().tan() / side as f32;
    let at = |x: i64, y: i64| {
        let inside = (0..side).contains(&x) && (0..side).contains(&y);
        if inside { whole[(y * side + x) as usize] } else { f32::INFINITY }
    };
    let window = || (-margin..=margin).flat_map(|y| (-margin..=margin).map(move |x| (x, y)));
    let is_inner = |x: i64, y: i64| {
        let depth = at(x, y);
        let slope = 3.0 * margin as f32 * pixel * depth;
        depth.is_finite() && window().all(|(dx, dy)| (at(x + dx, y + dy) - depth).abs() <= slope)
    };
    (0..side * side)
        .filter(|pixel| is_inner(pixel % side, pixel / side) && !found[*pixel as usize])
        .count()
}

/// Compares silhouettes at `px` with those at full detail: their distances in both directions are at most the promised error
/// (plus a pixel for the pixel grid), and there are no holes.
fn check_silhouettes(studio: &Studio, scene: &str, poses: u32, distance: f64) {
    const SIDE: i64 = 220;
    for pose in 0..poses {
        // Distances from so near that some is behind the eye to far away.
        let distance = distance * [0.45, 1.0, 2.5, 7.0, 30.0][pose as usize % 5];
        for reconstruct in WAYS {
            let request = seen(scene, pose, distance, SIDE as u32);
            let settings = full(reconstruct);
            let deep = depths(&studio.bytes(&FrameRequest { settings, ..request.clone() }));
            let whole: Vec<bool> = deep.iter().map(|depth| depth.is_finite()).collect();
            let modes = match reconstruct {
                Reconstruct::Points => &[ErrorMode::Unified][..],
                _ => &[ErrorMode::Unified, ErrorMode::Split],
            };
            for (px, &error_mode) in
                [0.5, 2.0, 6.0].into_iter().flat_map(|px| modes.iter().map(move |mode| (px, mode)))
            {
                let settings = Settings { error_mode, ..spt(px, reconstruct) };
                let found = mask(studio, &FrameRequest { settings, ..request.clone() });
                // From afar a sparse tree that is a single node is drawn only in some cases.
                if px >= 2.0 && pose % 5 == 4 && !found.contains(&true) {
                    continue;
                }
                let what =
                    format!("{scene}, pose {pose}, {reconstruct:?}, {error_mode:?}, {px} px");
                // The bound at the end of a surface, which may be seen at an angle.
                let sideways = if error_mode == ErrorMode::Split { 1.0 / SIDEWAYS } else { 1.0 };
                // Points may leave holes in both frames. Splats fill the pixel of their centre.
                let limit = f64::from(px * sideways)
                    + if reconstruct == Reconstruct::Splats { 1.5 } else { 2.5 };
                let excess = |a, b| farthest_px(a, b, SIDE as u32, SIDE as u32).unwrap();
                let beyond = excess(&found, &whole);
                assert!(beyond <= limit, "{what}: {beyond} px beyond");
                let short = excess(&whole, &found);
                // Instances that cover little of a pixel are left out by chance. The next one is a step of the crowd away.
                let step = if scene == "crowd" && px >= 2.0 && pose % 5 >= 2 { 3.0 } else { 0.0 };
                assert!(short <= limit + step, "{what}: {short} px short");
                if reconstruct == Reconstruct::Splats && step == 0.0 {
                    let holes = holes(&deep, &found, SIDE, px.ceil() as i64 + 2);
                    // Between dots with gaps a pixel may show the background.
                    let most = if scene == "lattice" && px >= 2.0 { 4 } else { 0 };
                    assert!(holes <= most, "{what}: {holes} holes");
                }
            }
        }
    }
}

#[test]
fn silhouettes_of_points_are_as_near_as_promised() {
    let studio = Studio::new();
    sculpture(&studio, Kind::Statue, 60_000);
    studio.load_json("statue", &one("statue.ply"));
    check_silhouettes(&studio, "statue", 5, 4.0);
}

#[test]
fn silhouettes_of_meshes_are_as_near_as_promised() {
    let studio = Studio::new();
    sculpture(&studio, Kind::Relief, 8000);
    studio.load_json("statue", &one("statue.ply"));
    check_silhouettes(&studio, "statue", 5, 4.0);
}

/// Leaves for which a disk is a bad approximation: in a line along their normals, in plates one above the other, in dots with
/// gaps; and a ball beside one that is inside out.
#[test]
fn silhouettes_of_odd_shapes_are_as_near_as_promised() {
    let studio = Studio::new();
    let disk = |at: [f64; 3], normal, radius| Disk {
        at: DVec3::from(at),
        normal,
        color: [200, 90, 40],
        radius,
    };
    let at = |i: u32, count: u32| 2.0 * f64::from(i) / f64::from(count) - 1.0;
    let column: Vec<Disk> =
        (0..2000).map(|i| disk([0.0, at(i, 2000), 0.0], DVec3::Y, 0.002)).collect();
    let shelf: Vec<Disk> =
        (0..64).map(|i| disk([0.1 * at(i % 4, 4), at(i / 4, 16), 0.1], DVec3::Y, 0.03)).collect();
    let lattice: Vec<Disk> = (0..48 * 48)
        .map(|i| disk([at(i % 48, 48), at(i / 48, 48), 0.0], DVec3::Z, 0.006))
        .collect();
    let (mut positions, mut triangles) = sphere_mesh(12);
    let count = positions.len() as u32;
    positions.iter_mut().for_each(|p| *p = *p * 0.45 - DVec3::X * 0.5);
    positions.extend(positions.clone().into_iter().map(|p| p + DVec3::X));
    triangles.extend(triangles.clone().into_iter().map(|[a, b, c]| [a, c, b].map(|v| v + count)));
    let turned = mesh(&positions, &triangles);
    let files = [
        ("column", disks(&column)),
        ("shelf", disks(&shelf)),
        ("lattice", disks(&lattice)),
        ("turned", turned),
    ];
    for (name, text) in files {
        let file = format!("{name}.ply");
        studio.write(&file, text);
        studio.load_json(name, &one(&file));
        check_silhouettes(&studio, name, 5, 3.0);
    }
}

#[test]
fn silhouettes_of_a_crowd_are_as_near_as_promised() {
    let studio = Studio::new();
    let ball = disk_sphere(700, 0.12, |p| [(p.x * 100.0 + 128.0) as u8, 90, 40]);
    studio.write("ball.ply", disks(&ball));
    studio.write("sphere.ply", sphere(8));
    let scene = json!({
        "assets": { "ball": { "file": "ball.ply" }, "mesh": { "file": "sphere.ply" } },
        "nodes": [
            { "asset": "ball", "scale": 0.1, "repeat": { "grid": [9, 7, 9], "step": [0.3, 0.3, 0.3] } },
            { "asset": "mesh", "scale": 0.05, "repeat": { "grid": [8, 8, 8], "step": [0.3, 0.25, 0.3] } },
        ],
    });
    studio.load_json("crowd", &scene);
    check_silhouettes(&studio, "crowd", 5, 5.0);
}

/// The bounds hold under scaling and mirroring, and far from the origin.
#[test]
fn silhouettes_hold_at_any_scale() {
    let studio = Studio::new();
    let ball = disk_sphere(3000, 0.06, |_| [200, 200, 200]);
    studio.write("ball.ply", disks(&ball));
    for (name, scale, at) in [
        ("small", json!(1e-5), [0.0; 3]),
        ("large", json!(3e5), [0.0; 3]),
        ("mirrored", json!([-1.0, 2.0, 0.5]), [0.0; 3]),
        ("far", json!(1.0), [3.1e6, -5.2e6, 4e5]),
    ] {
        let node = json!({ "asset": "g", "scale": scale, "translate": at });
        studio.load_json(
            name,
            &json!({ "assets": { "g": { "file": "ball.ply" } }, "nodes": [node] }),
        );
        let size = scale.as_f64().unwrap_or(1.5);
        for (number, reconstruct) in WAYS.into_iter().enumerate() {
            let mut request = seen(name, number as u32, 5.0 * size, 160);
            if let Pose::Camera(camera) = &mut request.pose {
                camera.eye += DVec3::from(at);
                camera.target += DVec3::from(at);
            }
            let whole =
                mask(&studio, &FrameRequest { settings: full(reconstruct), ..request.clone() });
            let found = mask(&studio, &FrameRequest { settings: spt(2.0, reconstruct), ..request });
            assert!(whole.iter().filter(|seen| **seen).count() > 500, "{name}");
            let excess = |a, b| farthest_px(a, b, 160, 160).unwrap();
            assert!(excess(&found, &whole) <= 4.5, "{name}, {reconstruct:?}");
            assert!(excess(&whole, &found) <= 4.5, "{name}, {reconstruct:?}");
        }
    }
}

#[test]
fn less_is_drawn_the_more_may_be_wrong_and_full_detail_where_nothing_may() {
    let studio = Studio::new();
    sculpture(&studio, Kind::Statue, 40_000);
    studio.load_json("statue", &one("statue.ply"));
    for reconstruct in WAYS {
        let request = fit("statue", 300, Output::Color);
        let at = |settings| studio.frame(&FrameRequest { settings, ..request.clone() });
        let mut last = u64::MAX;
        for px in [0.05, 0.5, 2.0, 8.0, 64.0] {
            let frame = at(spt(px as f32, reconstruct));
            let samples = &frame.receipt.samples;
            let (tested, accepted) = (samples.tested.unwrap(), samples.accepted.unwrap());
            assert!(accepted <= last && accepted <= tested, "{px} px: {samples:?}");
            assert_eq!(frame.receipt.accepted_px, Some(px));
            last = accepted;
        }
        // Points are discs, whose nodes are half as large.
        let most = if reconstruct == Reconstruct::Points { 400 } else { 150 };
        assert!(last < most, "{last} nodes at 64 px");
        // All leaves and nothing else: these are the same samples in another order.
        let (fine, whole) = (at(spt(0.05, reconstruct)), at(full(reconstruct)));
        assert!(fine.receipt.samples.accepted.unwrap() >= 39_000);
        let off = fine.bytes.iter().zip(whole.bytes.iter()).map(|(a, b)| a.abs_diff(*b));
        let square: f64 = off.map(|d| f64::from(d) * f64::from(d)).sum();
        let psnr = 10.0 * (65025.0 * whole.bytes.len() as f64 / square.max(1e-9)).log10();
        assert!(psnr > 45.0, "{reconstruct:?}: {psnr} dB");
        assert_eq!(whole.receipt.samples.accepted, None);
    }
}

/// With a split error, nodes are selected by the angle at which they are seen: fewer are drawn, within the same error.
#[test]
fn a_split_error_draws_less_of_a_sculpture() {
    let studio = Studio::new();
    sculpture(&studio, Kind::Statue, 60_000);
    studio.load_json("statue", &one("statue.ply"));
    let (mut unified, mut fewer) = (0, 0);
    for pose in 0..6 {
        let distance = 5.0 * 1.6f64.powi(pose);
        let request = seen("statue", pose as u32, distance, 240);
        let at = |settings| studio.frame(&FrameRequest { settings, ..request.clone() });
        let accepted = |settings| at(settings).receipt.samples.accepted.unwrap();
        let (a, b) = (accepted(spt(1.0, Reconstruct::Splats)), accepted(split(1.0)));
        assert!(b as f64 <= 1.01 * a as f64, "pose {pose}: {b} of {a}");
        (unified, fewer) = (unified + a, fewer + b);
    }
    assert!((fewer as f64) < 0.96 * unified as f64, "{fewer} of {unified}");
    let request = fit("statue", 300, Output::Color);
    let at = |settings| studio.bytes(&FrameRequest { settings, ..request.clone() });
    assert!(at(split(4.0)) != at(split(8.0)));
    assert!(at(split(4.0)) != at(spt(4.0, Reconstruct::Splats)));
    let used =
        &studio.frame(&FrameRequest { settings: split(4.0), ..request }).receipt.settings.clone();
    assert_eq!(used.applied.error_mode, Some(ErrorMode::Split));
}

/// Shadow maps are kept from frame to frame, and one tag is of one picture.
#[test]
fn a_frame_of_a_split_error_leaves_no_shadows_to_one_of_a_unified_error() {
    let studio = || {
        let studio = Studio::new();
        sculpture(&studio, Kind::Statue, 60_000);
        let lights = json!([{ "kind": "sun", "direction": [-1, -0.6, -0.3], "shadows": true }]);
        let mut scene = one("statue.ply");
        scene["lights"] = lights;
        studio.load_json("statue", &scene);
        studio
    };
    let request = fit("statue", 200, Output::Color);
    let with = |settings| FrameRequest { settings, ..request.clone() };
    let unified = with(spt(8.0, Reconstruct::Splats));
    let used = studio();
    let before = used.frame(&with(split(8.0)));
    assert!(before.receipt.passes.iter().any(|pass| pass.name == "shadow_map" && pass.ran));
    let fresh = studio().bytes(&unified);
    same(&used.bytes(&unified), &fresh, "unified after split");
    let without = Settings { shadows: Shadows::Off, ..unified.settings };
    assert!(used.bytes(&with(without)) != fresh, "there are shadows");
}

/// Times of such frames do not depend on earlier ones.
#[test]
fn a_frame_draws_its_shadow_maps_itself_where_it_is_told_to() {
    let studio = Studio::new();
    studio.write("ball.ply", sphere(20));
    let mut scene = one("ball.ply");
    scene["lights"] = json!([{ "kind": "sun", "direction": [-1, -0.6, -0.3], "shadows": true }]);
    studio.load_json("ball", &scene);
    let plain = fit("ball", 64, Output::Color);
    let own = Settings { draws_maps: true, ..plain.settings };
    let own = FrameRequest { settings: own, ..plain.clone() };
    let draws_maps = |request: &FrameRequest| {
        let frame = studio.frame(request);
        same(&frame.bytes, &studio.bytes(&plain), "with maps of its own");
        frame.receipt.passes.iter().any(|pass| pass.name == "shadow_map" && pass.ran)
    };
    assert!(draws_maps(&plain) && !draws_maps(&plain));
    assert!(draws_maps(&own) && draws_maps(&own) && !draws_maps(&plain));
}

/// Number of nodes of a cloud's tree that `bake::tree` would draw as splats, with all of it in view.
fn drawn_by_twin(path: &Path, request: &FrameRequest, camera: &Camera) -> u64 {
    let mut asset = read(path, &ReadOptions::default()).unwrap();
    let mut geometry = asset.geometries.remove(0);
    let admission = pointillist::memory::Admission::default();
    prepare_geometry(&mut geometry, &mut AssetTraits::default(), &admission).unwrap();
    let Geometry::Points(cloud) = geometry else { panic!("no cloud") };
    let packed = build_tree(&unpack_samples(&pack_samples(&cloud).unwrap()), None).unwrap();
    let view = camera.view(request.width, request.height).unwrap();
    let lod = request.settings.max_error_px.px() / view.focal_px.max_element() as f32;
    let mut count = 0;
    for chunk in &packed.chunks {
        for at in (chunk.first..chunk.first + chunk.count).map(|at| at as usize) {
            let place = packed.grid.position(chunk.cell(packed.positions[at]));
            let way = view.view_from_world * (place - view.eye);
            let normal = octahedral_decode(packed.attributes[at][1]).as_dvec3();
            let angle = normal.dot(place - view.eye) / way.length();
            let split = request.settings.error_mode == ErrorMode::Split && normal != DVec3::ZERO;
            let cosine = if split { angle.abs().min(1.0) as f32 } else { UNTILTED };
            let seen = Seen { z: -way.z as f32, far: way.length() as f32, cosine };
            let base = chunk.range.base * packed.grid.step as f32;
            count += u64::from(is_drawn(packed.nodes[at], 0, base, lod, seen));
        }
    }
    count
}

#[test]
fn the_gpu_draws_the_nodes_that_its_twin_draws() {
    let studio = Studio::new();
    let ball = disk_sphere(9000, 0.02, |p| [(p.x * 90.0 + 128.0) as u8, 90, 40]);
    studio.write("ball.ply", disks(&ball));
    studio.load_json("ball", &one("ball.ply"));
    for (pose, distance) in [3.5, 7.0, 20.0, 90.0].into_iter().enumerate() {
        for settings in [spt(1.0, Reconstruct::Splats), split(1.0), split(3.0)] {
            let request = FrameRequest { settings, ..seen("ball", pose as u32, distance, 240) };
            let Pose::Camera(camera) = &request.pose else { panic!("no camera") };
            let twin = drawn_by_twin(&studio.folder().join("ball.ply"), &request, camera);
            let found = studio.frame(&request).receipt.samples.accepted.unwrap();
            // For some nodes the shader's rounding decides.
            let few = 2 + twin / 500;
            assert!(found.abs_diff(twin) <= few, "from {distance}: {found}, twin {twin}");
        }
    }
}

/// Instances of a sculpture from near to far: between a merged tree above them and their own trees there are no gaps.
#[test]
fn a_split_error_leaves_no_holes_in_crowds() {
    let studio = Studio::new();
    studio.write("sphere.ply", sphere(10));
    let repeat = json!({ "grid": [7, 7, 1], "step": [0.28, 0.28, 0.1] });
    let nodes = json!([
        { "asset": "g", "scale": 0.2, "repeat": repeat },
        { "asset": "g", "scale": [0.9, 0.5, 0.1], "translate": [0.8, 0.8, -0.5] },
    ]);
    let assets = json!({ "g": { "file": "sphere.ply" } });
    studio.load_json("wall", &json!({ "assets": assets, "nodes": nodes }));
    for distance in [3.0, 12.0, 40.0] {
        let request = seen("wall", 0, distance, 200);
        let whole = FrameRequest { settings: full(Reconstruct::Splats), ..request.clone() };
        let deep = depths(&studio.bytes(&whole));
        for px in [1.0, 3.0] {
            let found = mask(&studio, &FrameRequest { settings: split(px), ..request.clone() });
            let holes = holes(&deep, &found, 200, px.ceil() as i64 + 2);
            assert_eq!(holes, 0, "from {distance}, {px} px");
        }
    }
}

#[test]
fn every_output_repeats_to_the_bit_with_and_without_wide_atomics() {
    for force_32_bit in [false, true] {
        let studio = Studio::with(|config| config.force_32_bit = force_32_bit);
        studio.load_two();
        for scene in ["solid", "cloud"] {
            for output in OUTPUTS {
                for reconstruct in WAYS {
                    let settings = spt(1.5, reconstruct);
                    let request = FrameRequest { output, settings, ..front(scene, 120, 90) };
                    let first = studio.bytes(&request);
                    studio.frame(&FrameRequest { output, ..front(scene, 60, 60) });
                    same(
                        &studio.bytes(&request),
                        &first,
                        &format!("{scene} {output:?} {reconstruct:?}"),
                    );
                    if output == Output::Id {
                        assert!(ids(&first).iter().any(|&id| id != 0));
                    }
                }
            }
        }
    }
}

/// Repeated nodes are drawn as if they were written out.
#[test]
fn copies_are_as_if_written_out() {
    let studio = Studio::new();
    studio.write("sphere.ply", sphere(12));
    let copies: Vec<Value> = (0..25)
        .map(|i| {
            let (x, z) = (f64::from(i % 5) - 2.0, f64::from(i / 5) - 2.0);
            json!({ "asset": "g", "scale": 0.3, "translate": [x, 0, z] })
        })
        .collect();
    let assets = json!({ "g": { "file": "sphere.ply" } });
    let repeat = json!({ "grid": [5, 1, 5], "step": [1, 0, 1] });
    let nodes = json!([{ "asset": "g", "scale": 0.3, "repeat": repeat }]);
    studio.load_json("repeated", &json!({ "assets": assets, "nodes": nodes }));
    studio.load_json("written", &json!({ "assets": assets, "nodes": copies }));
    for (distance, px) in [(4.0, 1.0), (40.0, 1.0), (40.0, 8.0)] {
        let settings = spt(px, Reconstruct::Splats);
        let of = |scene| {
            let request = seen(scene, 3, distance, 150);
            studio.bytes(&FrameRequest { settings, output: Output::Color, ..request })
        };
        same(&of("repeated"), &of("written"), &format!("from {distance}"));
    }
}

#[test]
fn a_moved_node_is_as_if_it_had_always_been_there() {
    let studio = Studio::new();
    studio.write("sphere.ply", sphere(12));
    let scene = |at: [f64; 3]| {
        let repeat = json!({ "grid": [6, 1, 6], "step": [1, 0, 1] });
        json!({
            "assets": { "g": { "file": "sphere.ply" } },
            "nodes": [
                { "asset": "g", "scale": 0.3, "repeat": repeat },
                { "name": "one", "asset": "g", "translate": at },
            ],
        })
    };
    studio.load_json("moved", &scene([0.0, 2.0, 0.0]));
    studio.load_json("still", &scene([1.0, 1.5, -2.0]));
    let request = |scene| FrameRequest {
        settings: spt(1.0, Reconstruct::Splats),
        output: Output::Color,
        ..seen(scene, 2, 14.0, 200)
    };
    let before = studio.bytes(&request("moved"));
    let patch = NodePatch {
        world_from_node: Some(glam::DAffine3::from_translation(DVec3::new(1.0, 1.5, -2.0))),
        ..NodePatch::default()
    };
    studio.engine.patch("moved", "one", &patch).unwrap();
    let after = studio.bytes(&request("moved"));
    assert!(before != after);
    same(&after, &studio.bytes(&request("still")), "after the move");
}

/// There are more chunks than the list initially has room for: the frame is drawn again completely.
#[test]
fn a_list_that_is_too_short_grows() {
    let studio = Studio::new();
    let ball = disk_sphere(40, 0.5, |_| [250, 120, 10]);
    studio.write("ball.ply", disks(&ball));
    let repeat = json!({ "grid": [200, 1, 200], "step": [0.02, 0, 0.02] });
    let node = json!({ "asset": "g", "scale": 0.008, "repeat": repeat });
    let scene = json!({ "assets": { "g": { "file": "ball.ply" } }, "nodes": [node] });
    studio.load_json("many", &scene);
    let settings = spt(0.05, Reconstruct::Points);
    let camera = Camera::perspective(DVec3::new(0.1, 8.0, 0.1), DVec3::ZERO, 60.0);
    let request = FrameRequest { settings, pose: Pose::Camera(camera), ..front("many", 256, 256) };
    let frame = studio.frame(&request);
    assert_eq!(frame.receipt.instances.drawn, Some(40_000), "{:?}", frame.receipt.instances);
    // From afar a few nodes represent everything.
    let camera = Camera::perspective(DVec3::new(0.1, 4000.0, 0.1), DVec3::ZERO, 60.0);
    let settings = spt(1.0, Reconstruct::Points);
    let request = FrameRequest { settings, pose: Pose::Camera(camera), ..front("many", 256, 256) };
    let frame = studio.frame(&request);
    assert!(frame.receipt.samples.tested.unwrap() < 500, "{:?}", frame.receipt.samples);
    assert_eq!(frame.receipt.instances.drawn, Some(1), "the tree over the instances alone");
}

#[test]
fn odd_geometries_have_trees() {
    let studio = Studio::new();
    let header = "ply\nformat ascii 1.0\nelement vertex";
    let fields = "property double x\nproperty double y\nproperty double z\nend_header\n";
    studio.write("lone.ply", format!("{header} 1\n{fields}0 0 0\n"));
    studio.write("same.ply", format!("{header} 40\n{fields}{}", "1 2 3\n".repeat(40)));
    studio.write("flat.ply", super::studio::mesh(&[DVec3::ZERO, DVec3::X, DVec3::X], &[[0, 1, 2]]));
    studio.write("none.ply", format!("{header} 0\n{fields}"));
    for name in ["lone", "same", "flat", "none"] {
        let Ok(info) = studio.try_load(name, &format!("{name}.ply")) else { continue };
        for reconstruct in WAYS {
            let settings = spt(1.0, reconstruct);
            let frame = studio.frame(&FrameRequest { settings, ..fit(name, 64, Output::Depth) });
            let drawn = covered(&frame.bytes);
            assert!(drawn > 0 || info.samples == 0, "{name}, {reconstruct:?}");
        }
    }
}

/// A field of balls of at most a pixel each, lit from the side of the eye, is about as bright as the same balls at eight times
/// the size. If the undersides of the smallest disks were in front of everything else, the field would be black.
#[test]
fn what_is_smaller_than_a_pixel_is_as_bright_as_it_is() {
    let studio = Studio::new();
    studio.write("sphere.ply", sphere(24));
    let field = json!({
        "assets": { "ball": { "file": "sphere.ply" } },
        "nodes": [{ "asset": "ball", "repeat": { "grid": [30, 1, 30], "step": [5, 0, 5] }, "translate": [-75, 0, -75] }],
        "lights": [{ "kind": "sun", "direction": [-1, -2, -1] }],
    });
    studio.load_json("field", &field);
    let eye = DVec3::new(300.0, 160.0, 300.0);
    let camera = Camera::perspective(eye, DVec3::ZERO, 30.0);
    let brightness = |settings: Settings, side: u32| {
        let request =
            FrameRequest { pose: Pose::Camera(camera), settings, ..front("field", side, side) };
        let bytes = studio.bytes(&request);
        let shown = bytes.chunks_exact(4).filter(|pixel| pixel[..3] != bytes[..3]);
        let greens: Vec<f64> = shown.map(|pixel| f64::from(pixel[1])).collect();
        assert!(greens.len() > 1000, "{}", greens.len());
        greens.iter().sum::<f64>() / greens.len() as f64
    };
    let truth = brightness(full(Reconstruct::Points), 1600);
    for px in [0.5, 0.1] {
        let found = brightness(spt(px, Reconstruct::Splats), 200);
        assert!((0.7..1.4).contains(&(found / truth)), "{px} px: {found} of {truth}");
    }
}
