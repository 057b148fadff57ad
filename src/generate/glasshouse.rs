//! A greenhouse: translucent panes in a frame of bars, plants behind them, and balls of coloured glass on a bench.

use glam::DVec3;

use super::plain::{Faces, sphere, srgb, tree};
use super::scenes::{SUNSHINE, cameras, path, poses_about, subject, vector};
use super::{Generated, GeneratedMesh, GeneratedScene};
use crate::assets::{Material, Physical};
use crate::math::Bounds;

/// Length of the house; its other lengths are shares of it.
pub const LENGTH: f64 = 6.0;
/// Half the width, the height of the walls and that of the ridge, for a length of 1.
const HALF: f64 = 0.3;
const WALL: f64 = 0.35;
const RIDGE: f64 = 0.52;
/// Panes along a side, and from the ground to the eaves, the eaves to the ridge, or across a gable's half.
const ALONG: u32 = 6;
const UP: u32 = 2;
/// Where the lamp hangs, for a length of 1.
const LAMP: DVec3 = DVec3::new(0.0, 0.4, 0.1);
/// Half the thickness of a bar.
const BAR: f64 = 0.006;

/// sRGB and alpha of the panes.
const PANE: [u8; 4] = [196, 226, 214, 56];

/// The corners of a wall's or a roof's outline, in order; its first edge is the lower one.
type Outline = [DVec3; 4];

fn outlines() -> [Outline; 6] {
    let at = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
    let side = |x: f64| [at(x, 0.0, 0.5), at(x, 0.0, -0.5), at(x, WALL, -0.5), at(x, WALL, 0.5)];
    let roof =
        |x: f64| [at(x, WALL, 0.5), at(x, WALL, -0.5), at(0.0, RIDGE, -0.5), at(0.0, RIDGE, 0.5)];
    let gable =
        |z: f64| [at(-HALF, 0.0, z), at(HALF, 0.0, z), at(HALF, WALL, z), at(-HALF, WALL, z)];
    [side(-HALF), side(HALF), roof(-HALF), roof(HALF), gable(-0.5), gable(0.5)]
}

/// The place in an outline at a share of its width and its height.
fn place([a, b, c, d]: Outline, across: f64, up: f64) -> DVec3 {
    let (low, high) = (a + (b - a) * across, d + (c - d) * across);
    low + (high - low) * up
}

/// Panes and the bars between them.
fn house(length: f64) -> [GeneratedMesh; 2] {
    let (mut panes, mut bars) = (Faces::default(), Faces::default());
    let mut bar = |from: DVec3, to: DVec3| {
        bars.tube(from * length, to * length, [BAR * length; 2], 4, srgb(0xe8ece8));
    };
    for outline in outlines() {
        let across = |i: u32| f64::from(i) / f64::from(ALONG);
        let up = |j: u32| f64::from(j) / f64::from(UP);
        for i in 0..ALONG {
            for j in 0..UP {
                let corners = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
                    .map(|(i, j)| place(outline, across(i), up(j)) * length);
                panes.polygon(&corners, PANE);
            }
        }
        for i in 0..=ALONG {
            bar(place(outline, across(i), 0.0), place(outline, across(i), 1.0));
        }
        for j in 0..=UP {
            bar(place(outline, 0.0, up(j)), place(outline, 1.0, up(j)));
        }
    }
    for z in [-0.5, 0.5] {
        let [left, right] = [-HALF, HALF].map(|x| DVec3::new(x, WALL, z) * length);
        panes.polygon(&[left, right, DVec3::new(0.0, RIDGE, z) * length], PANE);
    }
    [panes, bars].map(|faces| faces.finish(None))
}

/// A ball of glass of diameter 1.
fn ball(name: &str, [r, g, b]: [f32; 3]) -> GeneratedMesh {
    let physical = Physical { roughness: 0.05, transmission: 1.0, ..Physical::default() };
    let material = Material {
        name: name.to_owned(),
        base_color: [r, g, b, 1.0],
        physical: Some(physical),
        ..Material::default()
    };
    GeneratedMesh { material: Some(material), ..sphere(1.0, 1_200) }
}

/// The ground, and the bench that balls lie on.
fn ground(length: f64) -> GeneratedMesh {
    let mut faces = Faces::default();
    let corner = |x: f64, z: f64| DVec3::new(x, -0.002, z) * (2.5 * length);
    let corners = [corner(-1.0, -1.0), corner(-1.0, 1.0), corner(1.0, 1.0), corner(1.0, -1.0)];
    faces.polygon(&corners, srgb(0x76805a));
    let low = DVec3::new(0.05, 0.0, 0.1) * length;
    faces.cuboid(low, DVec3::new(0.2, 0.12, 0.42) * length, srgb(0x8a6a48));
    faces.finish(None)
}

/// Plants: place, turn in degrees and scale, for a house of length 1.
const PLANTS: [([f64; 2], u32, f64); 7] = [
    ([-0.16, -0.36], 0, 1.0),
    ([-0.17, -0.12], 70, 0.85),
    ([-0.15, 0.12], 140, 1.05),
    ([-0.17, 0.36], 210, 0.9),
    ([0.15, -0.38], 300, 1.0),
    ([0.14, -0.12], 30, 0.95),
    ([0.62, -0.5], 100, 1.5),
];

/// Balls: asset, place and diameter. Some lie within others, and two meet.
const BALLS: [(&str, [f64; 3], f64); 6] = [
    ("amber", [0.12, 0.16, 0.36], 0.08),
    ("blue", [0.12, 0.17, 0.25], 0.1),
    ("ruby", [0.12, 0.17, 0.25], 0.05),
    ("ruby", [0.11, 0.155, 0.15], 0.07),
    ("amber", [0.14, 0.155, 0.19], 0.07),
    ("blue", [0.1, 0.145, 0.41], 0.05),
];

/// The time of day of a greenhouse.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hour {
    Noon,
    /// A lamp hangs below the ridge.
    Night,
}

/// The lights and the background, as JSON.
fn lights(hour: Hour, length: f64) -> String {
    match hour {
        Hour::Noon => format!("{SUNSHINE},\n  \"background\": \"#b9cbdd\""),
        Hour::Night => format!(
            r##"  "lights": [
    {{ "kind": "point", "position": {}, "range": {}, "color": "#ffd9a0", "intensity": 3, "shadows": true, "radius": {} }},
    {{ "kind": "ambient", "color": "#8ea4d0", "intensity": 0.06 }}
  ],
  "background": "#0b1020""##,
            vector(LAMP * length),
            0.25 * length,
            0.01 * length
        ),
    }
}

/// A scene of a greenhouse of a length.
pub fn glasshouse(name: &str, length: f64, seed: u64, hour: Hour) -> GeneratedScene {
    let [panes, bars] = house(length);
    let assets = [
        ("panes", panes),
        ("bars", bars),
        ("plant", tree(0.3 * length, 900, seed)),
        ("ground", ground(length)),
        ("amber", ball("amber", [0.98, 0.78, 0.35])),
        ("blue", ball("blue", [0.45, 0.65, 0.96])),
        ("ruby", ball("ruby", [0.93, 0.25, 0.33])),
    ];
    let mut nodes: Vec<String> = ["ground", "bars", "panes"]
        .map(|asset| format!("    {{ \"name\": \"{asset}\", \"asset\": \"{asset}\" }}"))
        .into();
    nodes.extend(PLANTS.iter().zip(0..).map(|(([x, z], turn, scale), number)| {
        let at = vector(DVec3::new(*x, 0.0, *z) * length);
        format!(
            "    {{ \"name\": \"plant-{number}\", \"asset\": \"plant\", \"translate\": {at}, \"rotate\": [0, {turn}, 0], \"scale\": {scale} }}"
        )
    }));
    nodes.extend(BALLS.iter().zip(0..).map(|((asset, at, diameter), number)| {
        let at = vector(DVec3::from_array(*at) * length);
        let scale = (diameter * length * 1000.0).round() / 1000.0;
        format!(
            "    {{ \"name\": \"ball-{number}\", \"asset\": \"{asset}\", \"translate\": {at}, \"scale\": {scale} }}"
        )
    }));
    let pose = poses_about(DVec3::ZERO, length);
    let poses = [
        pose("corner", [0.95, 0.5, 1.25], [0.0, 0.22, 0.0], 40.0),
        pose("bench", [0.52, 0.3, 0.5], [0.1, 0.15, 0.26], 40.0),
        pose("inside", [-0.02, 0.25, 0.47], [0.0, 0.2, -0.3], 65.0),
        pose("through", [0.0, 0.25, 1.6], [0.0, 0.22, 0.0], 32.0),
    ];
    let target = DVec3::new(0.0, 0.2, 0.0) * length;
    let key = |t: f64, x: f64, z: f64| (t, DVec3::new(x, 0.35, z) * length, target);
    let keys = [key(0.0, 0.0, 1.6), key(2.0, 1.3, 0.6), key(4.0, 0.8, -1.1), key(6.0, -1.2, -0.4)];
    // PLY files have no materials.
    let file = |asset: &str, mesh: &GeneratedMesh| {
        format!("{name}-{asset}.{}", if mesh.material.is_some() { "obj" } else { "ply" })
    };
    let listed: Vec<String> = assets
        .iter()
        .map(|(asset, mesh)| format!("    \"{asset}\": {{ \"file\": \"{}\" }}", file(asset, mesh)))
        .collect();
    let shown = Bounds {
        min: DVec3::new(-HALF, 0.0, -0.5) * length,
        max: DVec3::new(HALF, RIDGE, 0.5) * length,
    };
    let json = format!(
        "{{\n  \"pointillist\": 1,\n  \"name\": \"{name}\",\n  \"assets\": {{\n{}\n  }},\n  \"nodes\": [\n{}\n  ],\n{},\n{},\n{},\n{}\n}}\n",
        listed.join(",\n"),
        nodes.join(",\n"),
        lights(hour, length),
        subject(&shown),
        cameras(&poses),
        path("around", &keys)
    );
    let assets = assets
        .into_iter()
        .map(|(asset, mesh)| (file(asset, &mesh), Generated::Mesh(mesh)))
        .collect();
    GeneratedScene { json, assets }
}
