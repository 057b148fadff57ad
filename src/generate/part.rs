//! `csg-part`: a machined part, made of sampled solids as in Zwicker et al. 2004, Fig. 8.
//!
//! Two bores, a rounded slot and a step are subtracted from a block. The only drawn asset of the scene is a difference, and the
//! slot is a union.

use glam::DVec3;

use super::plain::{Faces, srgb};
use super::scenes::{DAYLIGHT, Pose, around, cameras, path, poses_about};
use super::{Generated, GeneratedMesh, GeneratedScene};
use crate::math::Bounds;

/// Number of sides of a cylinder. Neighbouring sides differ by less than 4°.
const SIDES: u32 = 96;
/// Half the edges of the block, for a length of 2.
const HALF: DVec3 = DVec3::new(1.0, 0.34, 0.6);
/// Radius of the bores, and their distance from the middle along the block.
const BORE_RADIUS: f64 = 0.2;
const BORE_X: f64 = 0.68;
/// Half the slot's width, and the distance of its round ends from the middle.
const SLOT_RADIUS: f64 = 0.16;
const SLOT_X: f64 = 0.24;
/// Depth of the step in the block from its front and its top.
const STEP: f64 = 0.22;

/// The part with length `length` along x, sampled so that about `samples` remain.
pub fn machined(name: &str, length: f64, samples: u64) -> GeneratedScene {
    let unit = 0.5 * length;
    let spacing = (area() / samples as f64).sqrt() * unit;
    let half = HALF * unit;
    let (metal, cut) = (srgb(0xb4bac4), srgb(0xc98f4e));
    // Subtracted solids extend beyond the block, so that no faces coincide.
    let through = 1.4 * half.y;
    let slot_half = DVec3::new(SLOT_X * unit, through, SLOT_RADIUS * unit);
    let meshes = [
        ("block", cuboid(half, metal)),
        ("bore", cylinder(BORE_RADIUS * unit, through, cut)),
        ("slot-end", cylinder(SLOT_RADIUS * unit, through, cut)),
        ("slot-middle", cuboid(slot_half, cut)),
        ("step", cuboid(DVec3::new(1.2 * half.x, STEP * unit, STEP * unit), cut)),
    ];
    let listed: Vec<String> = meshes
        .iter()
        .map(|(asset, _)| {
            format!(
                "    \"{asset}\": {{ \"file\": \"{name}-{asset}.ply\", \"sample\": {{ \"spacing\": {spacing:.6} }} }}"
            )
        })
        .collect();
    let at = |asset: &str, [x, y, z]: [f64; 3]| {
        let [x, y, z] = [x, y, z].map(|c| (c * unit * 1e6).round() / 1e6 + 0.0);
        format!("{{ \"asset\": \"{asset}\", \"translate\": [{x}, {y}, {z}] }}")
    };
    let json = format!(
        r##"{{
  "pointillist": 1,
  "name": "{name}",
  "assets": {{
{},
    "slot": {{ "union": [
      {{ "asset": "slot-middle" }},
      {},
      {}
    ] }},
    "part": {{ "difference": [
      {{ "asset": "block" }},
      {},
      {},
      {{ "asset": "slot" }},
      {}
    ] }}
  }},
  "nodes": [ {{ "name": "part", "asset": "part" }} ],
{DAYLIGHT},
  "background": "#3a4149",
  "splats": {{ "filter": "perspective" }},
{},
{}
}}
"##,
        listed.join(",\n"),
        at("slot-end", [-SLOT_X, 0.0, 0.0]),
        at("slot-end", [SLOT_X, 0.0, 0.0]),
        at("bore", [-BORE_X, 0.0, 0.0]),
        at("bore", [BORE_X, 0.0, 0.0]),
        at("step", [0.0, HALF.y, HALF.z]),
        cameras(&poses(unit)),
        path("turn", &turn(unit))
    );
    let assets = meshes
        .into_iter()
        .map(|(asset, mesh)| (format!("{name}-{asset}.ply"), Generated::Mesh(mesh)))
        .collect();
    GeneratedScene { json, assets }
}

fn poses(unit: f64) -> [Pose; 3] {
    let pose = poses_about(DVec3::ZERO, unit);
    let block = Bounds { min: -HALF * unit, max: HALF * unit };
    [
        around("front", &block.corners(), DVec3::new(1.3, 1.8, 2.7), DVec3::Y, 38.0),
        pose("detail", [0.9, 0.95, 0.95], [0.55, 0.3, 0.05], 38.0),
        pose("above", [0.0, 3.2, 0.6], [0.0, 0.0, 0.0], 42.0),
    ]
}

fn turn(unit: f64) -> [(f64, DVec3, DVec3); 5] {
    let around = |t: f64, x: f64, z: f64| (t, DVec3::new(x, 1.7, z) * unit, DVec3::ZERO);
    [
        around(0.0, 0.0, 3.0),
        around(1.5, 3.0, 0.0),
        around(3.0, 0.0, -3.0),
        around(4.5, -3.0, 0.0),
        around(6.0, 0.0, 3.0),
    ]
}

/// Approximate area of the remaining surface, for a length of 2: walls of holes are added, their ends subtracted.
fn area() -> f64 {
    use std::f64::consts::{PI, TAU};
    let DVec3 { x, y, z } = HALF;
    let block = 8.0 * (x * y + y * z + z * x);
    let bores = 2.0 * (TAU * BORE_RADIUS * 2.0 * y - TAU * BORE_RADIUS * BORE_RADIUS);
    let slot_ends = 2.0 * (4.0 * SLOT_X * SLOT_RADIUS + PI * SLOT_RADIUS * SLOT_RADIUS);
    let slot = (4.0 * SLOT_X + TAU * SLOT_RADIUS) * 2.0 * y - slot_ends;
    block + bores + slot - 2.0 * STEP * STEP
}

fn cuboid(half: DVec3, color: [u8; 4]) -> GeneratedMesh {
    let mut faces = Faces::default();
    faces.cuboid(-half, half, color);
    faces.finish(None)
}

/// A cylinder about the y axis.
fn cylinder(radius: f64, half: f64, color: [u8; 4]) -> GeneratedMesh {
    let mut faces = Faces::default();
    faces.tube(DVec3::Y * -half, DVec3::Y * half, [radius; 2], SIDES, color);
    faces.finish(None)
}

#[cfg(test)]
mod tests {
    use super::super::{Generated, write};
    use super::*;
    use crate::scene::{self, AssetSource, SceneLimits};

    #[test]
    fn the_scene_draws_the_part_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("it.json");
        let made = machined("it", 2.4, 6_500);
        assert_eq!(made.json, machined("it", 2.4, 6_500).json);
        write(&Generated::Scene(made), &path).unwrap();
        let scene = scene::load(&path, folder.path(), &SceneLimits::default()).unwrap();
        assert_eq!(scene.operands_only(), [true, true, true, true, true, true, false]);
        assert_eq!((scene.instance_count(), scene.cameras.len(), scene.paths.len()), (1, 3, 1));
        let AssetSource::File(block) = &scene.assets[0].source else { panic!("a file") };
        let spacing = block.sample.unwrap().spacing.unwrap();
        let expected = area() * 1.2 * 1.2 / (spacing * spacing);
        assert!((6_400.0..6_600.0).contains(&expected), "{expected}");
    }
}
