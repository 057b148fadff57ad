//! Picks name the element that a frame shows, and its position.

use glam::{DMat3, DVec3};
use pointillist::engine::pick::{HitKind, Pick, request_of};
use pointillist::engine::{Client, EngineError, FrameRequest, Pose};
use pointillist::math::{Camera, Projection};
use pointillist::plan::{Lod, Output, Pass, Reconstruct, Settings};
use serde_json::json;

use super::studio::{Studio, cloud, cloud_scene, front, sphere, spt, wall};

fn picks(studio: &Studio, request: &FrameRequest, pixels: &[[u32; 2]]) -> Vec<Pick> {
    let frame = studio.engine.resolve_blocking(request_of(request.clone())).unwrap();
    let picked = studio.engine.pick(Client::Unnamed, &frame, pixels.to_vec());
    let (ticket, picker) = picked.unwrap();
    let frame = ticket.wait().unwrap();
    let ran = |pass: &str| frame.receipt.passes.iter().any(|p| p.ran && p.name == pass);
    assert!(ran(Pass::Identify.name()), "{:?}", frame.receipt.passes);
    picker.read(&frame).unwrap()
}

fn every_pixel(request: &FrameRequest) -> Vec<[u32; 2]> {
    (0..request.height).flat_map(|y| (0..request.width).map(move |x| [x, y])).collect()
}

fn words(studio: &Studio, request: &FrameRequest, output: Output) -> Vec<[u8; 4]> {
    let bytes = studio.bytes(&FrameRequest { output, ..request.clone() });
    bytes.chunks_exact(4).map(|bytes| bytes.try_into().unwrap()).collect()
}

#[test]
fn picks_of_every_pixel_agree_with_the_pictures() {
    for force_32_bit in [false, true] {
        let studio = Studio::with(|config| config.force_32_bit = force_32_bit);
        studio.load_two();
        let settings = [
            Settings::drawn_as(Reconstruct::Points),
            Settings::drawn_as(Reconstruct::Splats),
            spt(1.0, Reconstruct::Points),
            spt(2.0, Reconstruct::Splats),
        ];
        for (scene, settings) in
            ["solid", "cloud"].into_iter().flat_map(|s| settings.map(|w| (s, w)))
        {
            let request = FrameRequest { settings, ..front(scene, 60, 50) };
            let picks = picks(&studio, &request, &every_pixel(&request));
            let ids = words(&studio, &request, Output::Id).into_iter().map(u32::from_le_bytes);
            let depths =
                words(&studio, &request, Output::Depth).into_iter().map(f32::from_le_bytes);
            // A point in a splat's plane may be as far from the sample as the splat extends.
            let slack = if settings.reconstruct == Reconstruct::Points { 1e-5 } else { 0.2 };
            let mut hits = 0;
            for ((pick, id), depth) in picks.iter().zip(ids).zip(depths) {
                let at = format!("{scene} {settings:?} {pick:?} {id} {depth}");
                let Some(hit) = &pick.hit else {
                    assert!(id == 0 && depth.is_infinite(), "{at}");
                    continue;
                };
                hits += 1;
                assert_eq!(hit.instance.as_ref().map_or(0, |instance| instance.id), id, "{at}");
                assert!((hit.depth - f64::from(depth)).abs() < slack * hit.depth, "{at}");
                assert!(hit.distance >= hit.depth - 1e-12, "{at}");
                let is_tree = settings.lod == pointillist::plan::Lod::Spt;
                assert_eq!(hit.kind == HitKind::Node, is_tree && hit.kind != HitKind::Triangle);
            }
            assert!(hits > 300, "{hits} pixels of {scene} show something");
        }
    }
}

#[test]
fn picks_return_the_scalar_fields_of_a_sample() {
    let studio = Studio::new();
    let mut text = "ply\nformat ascii 1.0\nelement vertex 900\nproperty double x\nproperty double y\nproperty double z\n\
        property uchar classification\nproperty int number\nproperty float warmth\nend_header\n"
        .to_owned();
    let at = |i: usize| (i as f64 - 14.5) / 15.0;
    for i in 0..900 {
        let warmth = if i % 2 == 0 { "nan".to_owned() } else { format!("{}", i as f64 / 8.0) };
        text += &format!("{} {} 0 {} {} {warmth}\n", at(i % 30), at(i / 30), i % 5, 100_000 + i);
    }
    studio.write("wall.ply", text);
    studio.load_json("wall", &cloud_scene("wall.ply"));
    for lod in [Lod::Full, Lod::Spt] {
        let mut request = front("wall", 64, 60);
        request.settings.lod = lod;
        let mut hits = 0;
        for hit in
            picks(&studio, &request, &every_pixel(&request)).into_iter().filter_map(|p| p.hit)
        {
            let index = |v: f64| (v * 15.0 + 14.5).round() as usize;
            let i = index(hit.position[0]) + 30 * index(hit.position[1]);
            if lod == Lod::Spt && hit.fields["number"] != (100_000 + i) as f64 {
                // The node stands for several samples.
                continue;
            }
            assert_eq!(hit.fields["number"], (100_000 + i) as f64);
            assert_eq!(hit.fields.get("classification"), Some(&((i % 5) as f64)));
            let expected = (i % 2 == 1).then_some(i as f64 / 8.0);
            let found = hit.fields.get("warmth").copied();
            assert_eq!(found.is_some(), expected.is_some());
            assert!((found.unwrap_or(0.0) - expected.unwrap_or(0.0)).abs() < 1e-3);
            hits += 1;
        }
        assert!(hits > 500, "{lod:?}: {hits}");
    }
}

#[test]
fn picks_of_a_survey_are_exact() {
    let studio = Studio::new();
    // Millimetre detail at UTM coordinates.
    let base = DVec3::new(500_123.456, 5_400_789.012, 234.567);
    let places: Vec<DVec3> = (0..40 * 40)
        .map(|i| {
            let (x, y) = (f64::from(i % 40), f64::from(i / 40));
            base + DVec3::new(x * 0.101, y * 0.103, f64::from(i * 7 % 5) * 0.001)
        })
        .collect();
    studio.write("ground.ply", cloud(places.iter().map(|&at| (at, [200, 100, 50]))));
    studio.load("ground", "ground.ply");
    let middle = base + DVec3::new(2.0, 2.0, 0.0);
    let camera = Camera::perspective(middle + DVec3::new(0.3, -0.4, 6.0), middle, 40.0);
    let request = FrameRequest { pose: Pose::Camera(camera), ..front("ground", 64, 60) };
    let mut hits = 0;
    for hit in picks(&studio, &request, &every_pixel(&request)).into_iter().filter_map(|p| p.hit) {
        let found = DVec3::from(hit.position);
        let away = |at: &&DVec3| at.distance(found);
        let nearest = places.iter().min_by(|a, b| away(a).total_cmp(&away(b))).unwrap();
        assert!(away(&nearest) < hit.resolution, "{found} {nearest} {}", hit.resolution);
        let rounded = (found * 1000.0).round() / 1000.0;
        assert!(rounded.distance(*nearest) < 2e-9, "{rounded} is not {nearest}");
        assert!((hit.distance - found.distance(camera.eye)).abs() < 1e-9);
        assert_eq!(hit.color, [200, 100, 50]);
        hits += 1;
    }
    assert!(hits > 1000, "{hits}");
}

#[test]
fn a_pick_of_a_triangle_lies_on_its_ray_and_its_plane() {
    let studio = Studio::new();
    let base = DVec3::new(431_000.25, 5_812_000.5, 90.0);
    studio.write(
        "square.ply",
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty double x\nproperty double y\n\
         property double z\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n\
         -1 -1 0\n1 -1 0\n1 1 0\n-1 1 0\n3 0 1 2\n3 0 2 3\n",
    );
    studio.load_json(
        "tilted",
        &json!({
            "assets": { "square": { "file": "square.ply" } },
            "materials": { "clay": { "color": "#804020" } },
            "nodes": [{ "name": "roof", "asset": "square", "material": "clay", "rotate": [30, 0, 0],
                        "translate": base.to_array() }],
        }),
    );
    let camera = Camera::perspective(base + DVec3::new(0.2, 0.1, 3.0), base, 40.0);
    let request = FrameRequest { pose: Pose::Camera(camera), ..front("tilted", 64, 48) };
    let view = camera.view(64, 48).unwrap();
    let normal = DMat3::from_rotation_x(30f64.to_radians()) * DVec3::Z;
    let flat = Settings { projection: Some(Projection::Orthographic), ..request.settings };
    let flat = FrameRequest { settings: flat, ..request.clone() };
    let flat_view = camera.with_projection(Projection::Orthographic).view(64, 48).unwrap();
    let places = [[32, 24], [20, 30], [40, 12]];
    let all = [(&request, view), (&flat, flat_view)];
    let all = all.map(|(request, view)| {
        picks(&studio, request, &places).into_iter().map(move |pick| (pick, view))
    });
    for (pick, view) in all.into_iter().flatten() {
        let hit = pick.hit.unwrap();
        assert!((hit.depth + view.to_view(hit.position.into()).z).abs() < 1e-9);
        let position = DVec3::from(hit.position);
        let pixel = glam::DVec2::new(f64::from(pick.x) + 0.5, f64::from(pick.y) + 0.5);
        let seen = view.project(view.to_view(position)).unwrap();
        assert!((seen - pixel).length() < 1e-5, "{seen} {pixel}");
        assert!((position - base).dot(normal).abs() < 1e-8, "{position}");
        assert!(DVec3::from(hit.normal.unwrap()).distance(normal) < 1e-4, "{:?}", hit.normal);
        assert_eq!((hit.kind, hit.color), (HitKind::Triangle, [0x80, 0x40, 0x20]));
        assert_eq!(hit.instance.unwrap().path[0].name, "roof");
    }
}

#[test]
fn a_pick_names_the_nodes_above_an_instance() {
    let studio = Studio::new();
    studio.write("sphere.ply", sphere(12));
    studio.write("wall.ply", wall(9, |_, _| [9, 9, 9]));
    studio.load_json("row", &json!({
        "assets": { "ball": { "file": "sphere.ply" }, "wall": { "file": "wall.ply" } },
        "prototypes": { "stand": { "children": [
            { "name": "foot", "asset": "wall", "translate": [0, 0, -50] },
            { "name": "head", "asset": "ball", "scale": 0.4 } ] } },
        "nodes": [
            { "asset": "wall", "translate": [0, 0, -60] },
            { "name": "stands", "prototype": "stand", "repeat": { "grid": [3, 1, 1], "step": [1, 0, 0] } },
        ],
        "cameras": { "front": { "eye": [0, 0, 6], "target": [0, 0, 0], "fov": 40 } },
    }));
    let request = front("row", 90, 60);
    let found = picks(&studio, &request, &[[45, 30], [59, 30], [0, 0]]);
    let instance = |pick: &Pick| pick.hit.clone().unwrap().instance.unwrap();
    let names: Vec<_> =
        instance(&found[0]).path.iter().map(|n| (n.name.clone(), n.index, n.copy)).collect();
    assert_eq!(names, [("stands".to_owned(), 1, 1), ("head".to_owned(), 1, 0)]);
    assert_eq!((instance(&found[0]).asset.as_str(), instance(&found[1]).path[0].copy), ("ball", 2));
    assert_eq!(found[2].hit, None, "the corner shows the background");
}

#[test]
fn pixels_outside_the_frame_are_refused() {
    let studio = Studio::with_two();
    let request = request_of(front("cloud", 60, 50));
    let frame = studio.engine.resolve_blocking(request).unwrap();
    let refused = |pixels: Vec<[u32; 2]>| match studio.engine.pick(Client::Unnamed, &frame, pixels)
    {
        Err(EngineError::BadParameter { parameter, accepted, .. }) => (parameter, accepted),
        Err(other) => panic!("{other}"),
        Ok(_) => panic!("not refused"),
    };
    assert_eq!(refused(vec![[60, 0]]), ("x", "0 to 59".to_owned()));
    assert_eq!(refused(vec![[59, 50]]), ("y", "0 to 49".to_owned()));
    assert_eq!(refused(vec![[59, 49], [0, 50]]), ("pixels", "y of 0 to 49".to_owned()));
    assert_eq!(refused(vec![]).0, "pixels");
    assert_eq!(refused(vec![[0, 0]; 4097]).0, "pixels");
}

#[test]
fn a_node_over_several_instances_is_no_instance() {
    let studio = Studio::new();
    studio.write("sphere.ply", sphere(12));
    studio.load_json(
        "field",
        &json!({
            "assets": { "ball": { "file": "sphere.ply" } },
            "nodes": [{ "asset": "ball", "scale": 0.4,
                        "repeat": { "grid": [40, 40, 1], "step": [1, 1, 0] } }],
            "cameras": { "front": { "eye": [0, 0, 900], "target": [0, 0, 0], "fov": 40 } },
        }),
    );
    let request =
        FrameRequest { settings: spt(8.0, Reconstruct::Points), ..front("field", 60, 60) };
    let picks = picks(&studio, &request, &every_pixel(&request));
    let ids = words(&studio, &request, Output::Id).into_iter().map(u32::from_le_bytes);
    let (mut over, mut hits) = (0, 0);
    for (pick, id) in picks.iter().zip(ids) {
        let Some(hit) = &pick.hit else { continue };
        hits += 1;
        assert_eq!(hit.instance.as_ref().map_or(0, |instance| instance.id), id, "{hit:?}");
        over += usize::from(hit.instance.is_none());
        let at = DVec3::from(hit.position);
        assert!(at.abs().cmple(DVec3::new(21.0, 21.0, 1.0)).all(), "{hit:?}");
        assert_eq!(hit.kind, HitKind::Node);
    }
    assert!(hits > 0 && over > 0, "{over} of {hits} pixels show nodes over instances");
}
