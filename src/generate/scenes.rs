//! Whole scenes: a JSON file with lights, cameras and a path, and its assets.
//!
//! `generate KIND -o NAME.json` puts an asset of any kind into its own scene. `plaza` is always a scene: forty by forty
//! assemblies of a statue, trees, benches and a lamp, instanced through four levels of prototypes. A file of two kilobytes draws
//! twenty thousand instances.

use glam::DVec3;

use super::trees::Plant;
use super::{Generated, GeneratedMesh, GeneratedScene, plain, relief, textured};
use crate::assets::Progress;
use crate::math::framing::{Look, Shown, frame};
use crate::math::{Bounds, Camera};

/// A pose in a scene file.
pub(super) struct Pose {
    pub name: &'static str,
    pub eye: DVec3,
    pub target: DVec3,
    pub fov: f64,
}

/// Makes poses from a name, eye, target and field of view, where places count in units of a length about a middle.
pub(super) fn poses_about(
    middle: DVec3,
    unit: f64,
) -> impl Fn(&'static str, [f64; 3], [f64; 3], f64) -> Pose {
    let place = move |at: [f64; 3]| middle + DVec3::from_array(at) * unit;
    move |name, eye, target, fov| Pose { name, eye: place(eye), target: place(target), fov }
}

/// Formats coordinates for a file, rounded to millimetres.
pub(super) fn vector(v: DVec3) -> String {
    let round = |c: f64| (c * 1000.0).round() / 1000.0 + 0.0;
    format!("[{}, {}, {}]", round(v.x), round(v.y), round(v.z))
}

/// The box that a frame without a pose shows.
pub(super) fn subject(bounds: &Bounds) -> String {
    format!("  \"subject\": [{}, {}]", vector(bounds.min), vector(bounds.max))
}

pub(super) fn cameras(poses: &[Pose]) -> String {
    let lines: Vec<String> = poses
        .iter()
        .map(|pose| {
            let (eye, target) = (vector(pose.eye), vector(pose.target));
            format!(
                "    \"{}\": {{ \"eye\": {eye}, \"target\": {target}, \"fov\": {} }}",
                pose.name, pose.fov
            )
        })
        .collect();
    format!("  \"cameras\": {{\n{}\n  }}", lines.join(",\n"))
}

/// A path through `keys` (seconds, eye, target).
pub(super) fn path(name: &str, keys: &[(f64, DVec3, DVec3)]) -> String {
    let lines: Vec<String> = keys
        .iter()
        .map(|(t, eye, target)| {
            let (eye, target) = (vector(*eye), vector(*target));
            format!("      {{ \"t\": {t}, \"eye\": {eye}, \"target\": {target} }}")
        })
        .collect();
    format!(
        "  \"paths\": {{ \"{name}\": {{ \"fps\": 30, \"keys\": [\n{}\n  ] }} }}",
        lines.join(",\n")
    )
}

/// Light for scenes that stand on a ground.
pub(super) const SUNSHINE: &str = r##"  "lights": [
    { "kind": "sun", "direction": [-0.5, -1, -0.7], "color": "#fff2dd", "intensity": 0.85, "shadows": true },
    { "kind": "headlight", "intensity": 0.15 },
    { "kind": "ambient", "color": "#dce6f5", "intensity": 0.25 }
  ]"##;

/// Light for a single solid.
pub(super) const DAYLIGHT: &str = r##"  "lights": [
    { "kind": "sun", "direction": [-0.5, -1, -0.7], "color": "#fff2dd", "intensity": 0.85 },
    { "kind": "headlight", "intensity": 0.15 },
    { "kind": "ambient", "color": "#dce6f5", "intensity": 0.25 }
  ]"##;

/// Largest number of points to which a camera is fitted.
const MOST_FRAMED: usize = 200_000;

/// A camera that shows all points in a square frame, and therefore in every other frame.
pub(super) fn around(
    name: &'static str,
    points: &[DVec3],
    backward: DVec3,
    up: DVec3,
    fov: f64,
) -> Pose {
    let backward = backward / backward.length();
    let look = Look { backward, up, shown: Shown::Perspective(fov), aspect: 1.0, reach: 0.0 };
    let Camera { eye, target, .. } = frame(points, &look);
    Pose { name, eye, target, fov }
}

/// The scan of a town: unlit points in their own colours.
pub fn town(name: &str, scan: Generated, size_m: f64) -> GeneratedScene {
    let asset = format!("{name}-scan.laz");
    let middle = super::town::ORIGIN_M;
    let s = size_m;
    let town: Vec<DVec3> = match &scan {
        Generated::Points(cloud) => {
            let every = cloud.positions.len().div_ceil(MOST_FRAMED).max(1);
            cloud.positions.iter().step_by(every).copied().collect()
        }
        _ => Vec::new(),
    };
    let pose = poses_about(middle, s);
    let poses = [
        around("overview", &town, DVec3::new(-0.55, -1.0, 0.8), DVec3::Z, 42.0),
        pose("square", [-0.3, -0.42, 0.14], [0.03, 0.05, 0.06], 50.0),
        pose("street", [-0.5, -0.32, 0.06], [0.1, -0.2, 0.03], 55.0),
        around("above", &town, DVec3::new(0.0, -0.05, 1.2), DVec3::Z, 50.0),
    ];
    let key = |t: f64, x: f64, y: f64| {
        (t, middle + DVec3::new(x, y, 0.45) * s, middle + DVec3::new(0.0, 0.0, 0.05) * s)
    };
    let keys =
        [key(0.0, -0.62, -0.8), key(2.0, 0.62, -0.8), key(4.0, 0.8, 0.6), key(6.0, -0.6, 0.8)];
    let json = format!(
        "{{\n  \"pointillist\": 1,\n  \"name\": \"{name}\",\n  \"up\": \"z\",\n  \"assets\": {{ \"scan\": {{ \"file\": \"{asset}\" }} }},\n  \"nodes\": [ {{ \"name\": \"scan\", \"asset\": \"scan\" }} ],\n  \"lights\": [],\n  \"background\": \"#c9d8e6\",\n{},\n{}\n}}\n",
        cameras(&poses),
        path("orbit", &keys)
    );
    GeneratedScene { json, assets: vec![(asset, scan)] }
}

fn bounds_of(asset: &Generated) -> Bounds {
    match asset {
        Generated::Points(cloud) => Bounds::of(cloud.positions.iter().copied()),
        Generated::Mesh(mesh) => Bounds::of(mesh.mesh.positions.iter().copied()),
        Generated::Lines(lines) => {
            Bounds::of(lines.positions.iter().copied()).grown(lines.widest())
        }
        Generated::Plant(plant) => {
            let parts =
                [&plant.trunk.mesh.positions, &plant.branches.positions, &plant.leaves.positions];
            Bounds::of(parts.into_iter().flatten().copied())
        }
        Generated::Scene(_) | Generated::Scenes(_) | Generated::Surroundings(_) => Bounds::EMPTY,
    }
}

/// A scene of one solid with lights and cameras around it.
pub fn solid(name: &str, asset: Generated) -> GeneratedScene {
    let bounds = bounds_of(&asset);
    let textured = matches!(&asset, Generated::Mesh(GeneratedMesh { texture: Some(_), .. }));
    let parts = match asset {
        Generated::Plant(plant) => parts(name, name, *plant),
        Generated::Lines(_) => vec![(name.to_owned(), format!("{name}-lines.vtk"), asset)],
        _ if textured => vec![(name.to_owned(), format!("{name}-mesh.obj"), asset)],
        _ => vec![(name.to_owned(), format!("{name}-asset.ply"), asset)],
    };
    let listed: Vec<String> = parts
        .iter()
        .map(|(part, file, _)| format!("\"{part}\": {{ \"file\": \"{file}\" }}"))
        .collect();
    let nodes: Vec<String> = parts
        .iter()
        .map(|(part, ..)| format!("{{ \"name\": \"{part}\", \"asset\": \"{part}\" }}"))
        .collect();
    let (middle, reach) = (bounds.centre(), bounds.extent().max_element().max(1e-6));
    let pose = poses_about(middle, reach);
    let poses = [
        pose("front", [0.25, 0.25, 1.75], [0.0, 0.0, 0.0], 38.0),
        pose("detail", [0.35, 0.35, 0.65], [0.02, 0.12, 0.05], 40.0),
        pose("above", [0.5, 1.5, 0.7], [0.0, 0.0, 0.0], 38.0),
    ];
    let around = |t: f64, x: f64, z: f64| (t, middle + DVec3::new(x, 0.3, z) * reach, middle);
    let keys = [
        around(0.0, 0.0, 1.75),
        around(1.5, 1.75, 0.0),
        around(3.0, 0.0, -1.75),
        around(4.5, -1.75, 0.0),
        around(6.0, 0.0, 1.75),
    ];
    let json = format!(
        "{{\n  \"pointillist\": 1,\n  \"name\": \"{name}\",\n  \"assets\": {{ {} }},\n  \"nodes\": [ {} ],\n{DAYLIGHT},\n  \"background\": \"#3a4149\",\n{},\n{}\n}}\n",
        listed.join(", "),
        nodes.join(", "),
        cameras(&poses),
        path("turn", &keys)
    );
    GeneratedScene { json, assets: parts.into_iter().map(|(_, file, part)| (file, part)).collect() }
}

/// Name in the scene, file and asset of each part of a tree of lines.
fn parts(name: &str, tree: &str, plant: Plant) -> Vec<(String, String, Generated)> {
    vec![
        (format!("{tree}-trunk"), format!("{name}-trunk.ply"), Generated::Mesh(plant.trunk)),
        (
            format!("{tree}-branches"),
            format!("{name}-branches.vtk"),
            Generated::Lines(plant.branches),
        ),
        (format!("{tree}-leaves"), format!("{name}-leaves.vtk"), Generated::Lines(plant.leaves)),
    ]
}

/// An amphora on a checkered floor.
pub fn amphora(name: &str, amphora: Generated, height: f64) -> GeneratedScene {
    let (mesh, floor) = (format!("{name}-amphora.obj"), format!("{name}-floor.obj"));
    let h = height;
    let pose = poses_about(DVec3::ZERO, h);
    let poses = [
        pose("front", [0.5, 0.9, 2.1], [0.0, 0.47, 0.0], 38.0),
        pose("detail", [0.3, 0.75, 0.75], [0.0, 0.58, 0.0], 40.0),
        pose("grazing", [1.5, 0.18, 3.2], [0.0, 0.35, 0.0], 45.0),
    ];
    let middle = DVec3::new(0.0, 0.5, 0.0) * h;
    let around = |t: f64, x: f64, z: f64| (t, DVec3::new(x, 0.9, z) * h, middle);
    let keys = [
        around(0.0, 0.0, 2.1),
        around(1.5, 2.1, 0.0),
        around(3.0, 0.0, -2.1),
        around(4.5, -2.1, 0.0),
        around(6.0, 0.0, 2.1),
    ];
    let json = format!(
        "{{\n  \"pointillist\": 1,\n  \"name\": \"{name}\",\n  \"assets\": {{\n    \"amphora\": {{ \"file\": \"{mesh}\" }},\n    \"floor\": {{ \"file\": \"{floor}\" }}\n  }},\n  \"nodes\": [\n    {{ \"name\": \"amphora\", \"asset\": \"amphora\" }},\n    {{ \"name\": \"floor\", \"asset\": \"floor\" }}\n  ],\n{SUNSHINE},\n  \"ambient_occlusion\": {{ \"radius\": {} }},\n  \"background\": \"#aebccb\",\n{},\n{},\n{}\n}}\n",
        0.25 * h,
        subject(&bounds_of(&amphora)),
        cameras(&poses),
        path("turn", &keys)
    );
    let floor_mesh = Generated::Mesh(textured::checker_mesh(6.4 * h));
    GeneratedScene { json, assets: vec![(mesh, amphora), (floor, floor_mesh)] }
}

/// The trees of a grove: place, turn in degrees and scale, for trees of height 1.
const GROVE: [([f64; 2], u32, f64); 10] = [
    ([-1.3, -0.7], 0, 1.0),
    ([-0.62, -0.9], 40, 0.88),
    ([0.08, -0.75], 200, 1.08),
    ([0.8, -0.95], 310, 0.95),
    ([1.45, -0.65], 95, 1.05),
    ([-0.98, 0.15], 250, 0.92),
    ([-0.3, 0.05], 150, 1.1),
    ([0.46, 0.2], 20, 0.9),
    ([1.12, 0.1], 280, 1.0),
    ([0.05, 0.95], 120, 0.8),
];

/// Ten copies of a tree on level ground.
pub fn grove(name: &str, tree: Generated, height: f64) -> GeneratedScene {
    let h = height;
    let mut parts = match tree {
        Generated::Plant(plant) => parts(name, "tree", *plant),
        mesh => vec![("tree".to_owned(), format!("{name}-tree.ply"), mesh)],
    };
    let children: Vec<String> =
        parts.iter().map(|(part, ..)| format!("      {{ \"asset\": \"{part}\" }}")).collect();
    let mut ground = plain::Faces::default();
    let corner = |x: f64, z: f64| DVec3::new(x, 0.0, z) * (4.0 * h);
    ground.polygon(
        &[corner(-1.0, -1.0), corner(-1.0, 1.0), corner(1.0, 1.0), corner(1.0, -1.0)],
        plain::srgb(0x7f8a5a),
    );
    let ground = Generated::Mesh(ground.finish(None));
    parts.push(("ground".to_owned(), format!("{name}-ground.ply"), ground));
    let listed: Vec<String> = parts
        .iter()
        .map(|(part, file, _)| format!("    \"{part}\": {{ \"file\": \"{file}\" }}"))
        .collect();
    let nodes: Vec<String> = GROVE
        .iter()
        .enumerate()
        .map(|(number, ([x, z], turn, scale))| {
            let place = vector(DVec3::new(*x, 0.0, *z) * h);
            format!(
                "    {{ \"name\": \"tree-{number}\", \"prototype\": \"tree\", \"translate\": {place}, \"rotate\": [0, {turn}, 0], \"scale\": {scale} }}"
            )
        })
        .collect();
    let pose = poses_about(DVec3::ZERO, h);
    let poses = [
        pose("overview", [0.6, 1.0, 4.6], [0.05, 0.42, 0.0], 40.0),
        pose("near", [-0.1, 0.45, 2.1], [0.05, 0.42, 0.0], 50.0),
        pose("detail", [0.15, 0.55, 1.75], [0.05, 0.45, 0.95], 40.0),
        pose("far", [2.0, 2.5, 14.0], [0.05, 0.4, 0.0], 40.0),
    ];
    let key =
        |t: f64, x: f64, z: f64| (t, DVec3::new(x, 0.8, z) * h, DVec3::new(0.05, 0.4, 0.0) * h);
    let keys = [key(0.0, 0.0, 4.5), key(2.0, 4.0, 2.0), key(4.0, 3.0, -3.5), key(6.0, -2.5, -4.0)];
    let shown = Bounds { min: DVec3::new(-1.8, 0.0, -1.4), max: DVec3::new(1.9, 1.05, 1.4) };
    let shown = Bounds { min: shown.min * h, max: shown.max * h };
    let json = format!(
        r##"{{
  "pointillist": 1,
  "name": "{name}",
  "assets": {{
{}
  }},
  "prototypes": {{
    "tree": {{ "children": [
{}
    ] }}
  }},
  "nodes": [
    {{ "name": "ground", "asset": "ground" }},
{}
  ],
{DAYLIGHT},
  "background": "#b9cbdd",
{},
{},
{}
}}
"##,
        listed.join(",\n"),
        children.join(",\n"),
        nodes.join(",\n"),
        subject(&shown),
        cameras(&poses),
        path("around", &keys)
    );
    GeneratedScene { json, assets: parts.into_iter().map(|(_, file, part)| (file, part)).collect() }
}

/// Distance between assemblies in metres.
const PITCH_M: f64 = 8.0;
/// Half the width of the part that the default view shows, around the middle of an assembly.
const SUBJECT_M: f64 = 4.0;
const SUBJECT_HEIGHT_M: f64 = 12.0;

/// A scene of `count` by `count` assemblies.
pub fn plaza(name: &str, count: u64, seed: u64, progress: &Progress) -> GeneratedScene {
    let statue = relief::ReliefParameters { height: 2.0, count: 5_000, seed };
    let statue = relief::relief(&statue, progress);
    let assets: Vec<(&str, GeneratedMesh)> = vec![
        ("statue", statue),
        ("tree", plain::tree(4.2, 900, seed)),
        ("bench", plain::bench()),
        ("lamp", plain::lamp()),
        ("tile", plain::tile(PITCH_M)),
    ];
    let half = 0.5 * PITCH_M * count as f64;
    let extent = DVec3::new(half, 0.0, half);
    let square = Bounds { min: -extent, max: extent + DVec3::Y * 5.0 };
    let poses = [
        Pose {
            name: "assembly",
            eye: DVec3::new(5.2, 1.9, 9.4),
            target: DVec3::new(3.9, 1.3, 4.0),
            fov: 38.0,
        },
        Pose {
            name: "walk",
            eye: DVec3::new(4.5, 2.2, 0.35 * half + 2.5),
            target: DVec3::new(3.9, 1.5, -0.2 * half),
            fov: 50.0,
        },
        around("overview", &square.corners(), DVec3::new(0.5, 0.4, 1.0), DVec3::Y, 40.0),
    ];
    // An aisle between two rows of trees, above the statues in it.
    let aisle = |y: f64, z: f64| DVec3::new(0.5 * PITCH_M, y, z * half);
    let keys = [
        (0.0, DVec3::new(0.55, 0.42, 1.25) * half, DVec3::ZERO),
        (3.0, aisle(6.0, 0.5), aisle(1.0, 0.0)),
        (6.0, aisle(2.9, -0.3), aisle(1.6, -0.6)),
    ];
    // The default view shows one assembly and the sky above it, so that it extends from there to the horizon.
    let centre = DVec3::new(0.5, 0.0, 0.5) * PITCH_M;
    let reach = DVec3::new(SUBJECT_M, 0.0, SUBJECT_M);
    let shown = Bounds { min: centre - reach, max: centre + reach + DVec3::Y * SUBJECT_HEIGHT_M };
    let listed: Vec<String> = assets
        .iter()
        .map(|(asset, _)| format!("    \"{asset}\": {{ \"file\": \"{name}-{asset}.ply\" }}"))
        .collect();
    let json = format!(
        r##"{{
  "pointillist": 1,
  "name": "{name}",
  "assets": {{
{}
  }},
  "prototypes": {{
    "corner": {{ "children": [
      {{ "asset": "tree", "translate": [2.7, 0, 2.7] }},
      {{ "asset": "bench", "translate": [0, 0, 2.9], "rotate": [0, 180, 0] }}
    ] }},
    "assembly": {{ "children": [
      {{ "asset": "tile" }},
      {{ "asset": "statue", "translate": [0, 0.3, 0] }},
      {{ "prototype": "corner" }},
      {{ "prototype": "corner", "rotate": [0, 90, 0] }},
      {{ "prototype": "corner", "rotate": [0, 180, 0] }},
      {{ "prototype": "corner", "rotate": [0, 270, 0] }},
      {{ "asset": "lamp", "translate": [-1.4, 0, 3.2] }}
    ] }},
    "row": {{ "children": [
      {{ "prototype": "assembly", "repeat": {{ "grid": [{count}, 1, 1], "step": [{PITCH_M}, 0, 0] }} }}
    ] }}
  }},
  "nodes": [
    {{ "name": "square", "prototype": "row", "repeat": {{ "grid": [1, 1, {count}], "step": [0, 0, {PITCH_M}] }} }}
  ],
{SUNSHINE},
  "fog": {{ "color": "#cfdbe6", "density": 0.005, "scale_height": 12 }},
  "background": "#b9cbdd",
{},
{},
{}
}}
"##,
        listed.join(",\n"),
        subject(&shown),
        cameras(&poses),
        path("approach", &keys)
    );
    let assets = assets
        .into_iter()
        .map(|(asset, mesh)| (format!("{name}-{asset}.ply"), Generated::Mesh(mesh)))
        .collect();
    GeneratedScene { json, assets }
}
