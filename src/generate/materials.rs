//! Balls that reflect by the two models, and a lantern with maps.
//!
//! Three rows of balls stand on a floor: enamel from smooth to rough, gold likewise, and one each of copper, varnish, ember and
//! steel, in a studio whose walls and lamps they reflect. The lantern is a hammered ball of bronze with glowing windows; its maps are those of its normals, its metal, its roughness
//! and its light.

use std::f64::consts::TAU;

use glam::{DVec3, Vec2};

use super::numeric::{sin, sin_cos, smoothstep};
use super::plain::{Faces, sphere, srgb};
use super::scenes::{cameras, path, poses_about, subject, vector};
use super::textured::lattice;
use super::{Generated, GeneratedMap, GeneratedMesh, GeneratedScene};
use crate::assets::{Encoding, Filter, Material, Mesh, Physical, Texture, Wrap};
use crate::math::Bounds;

/// Texels along each side of the lantern's maps.
const TEXELS: u32 = 128;
/// Rings of the lantern from pole to pole.
const RINGS: u32 = 24;
/// Windows around the lantern, and hammer marks around and from pole to pole.
const WINDOWS: f64 = 6.0;
const MARKS: [f64; 2] = [24.0, 12.0];

/// A map whose texels are functions of u around and v down.
fn map(name: &str, encoding: Encoding, texel: impl Fn(f64, f64) -> [f64; 3]) -> Texture {
    let rgba = (0..TEXELS * TEXELS)
        .map(|index| {
            let at = |i: u32| (f64::from(i) + 0.5) / f64::from(TEXELS);
            let [r, g, b] = texel(at(index % TEXELS), at(index / TEXELS))
                .map(|value| (value.clamp(0.0, 1.0) * 255.0).round() as u8);
            [r, g, b, 255]
        })
        .collect();
    Texture {
        name: name.to_owned(),
        width: TEXELS,
        height: TEXELS,
        rgba,
        wrap: [Wrap::Repeat; 2],
        filter: Filter::Linear,
        encoding,
    }
}

/// How much of a window there is at a place: 1 inside, 0 outside.
fn window(u: f64, v: f64) -> f64 {
    let across = 2.0 * ((u * WINDOWS).fract() - 0.5).abs();
    let up = (v - 0.5).abs() / 0.16;
    1.0 - smoothstep(0.42, 0.5, across.max(0.46 * up))
}

fn lantern() -> GeneratedMesh {
    let sectors = 2 * RINGS;
    let mut mesh = Mesh::default();
    let (mut normals, mut uvs) = (Vec::new(), Vec::new());
    for ring in 0..=RINGS {
        let v = f64::from(ring) / f64::from(RINGS);
        let (s, c) = sin_cos(0.5 * TAU * v);
        for sector in 0..=sectors {
            let u = f64::from(sector) / f64::from(sectors);
            let (turn_s, turn_c) = sin_cos(TAU * u);
            let normal = DVec3::new(s * turn_s, c, s * turn_c);
            mesh.positions.push(normal * 0.5);
            normals.push(normal.as_vec3());
            uvs.push(Vec2::new(u as f32, v as f32));
        }
    }
    mesh.triangles.extend(lattice(RINGS, sectors));
    (mesh.normals, mesh.uvs) = (Some(normals), Some(uvs));
    let normal_map = map("normals", Encoding::Linear, |u, v| {
        // Dents of the hammer, each row shifted by half a mark.
        let row = (v * MARKS[1]).floor();
        let shift = 0.5 * row.rem_euclid(2.0);
        let [x, y] = [u * MARKS[0] + shift, v * MARKS[1]].map(|at| sin(TAU * at));
        let depth = 0.35 * (1.0 - window(u, v));
        let bump = DVec3::new(-x * depth, y * depth, 1.0);
        (bump / bump.length() * 0.5 + 0.5).to_array()
    });
    let roughness = map("roughness", Encoding::Linear, |u, v| [0.35 + 0.5 * window(u, v); 3]);
    let metal = map("metal", Encoding::Linear, |u, v| [1.0 - window(u, v); 3]);
    let light = map("light", Encoding::Srgb, |u, v| {
        let glow = window(u, v);
        [glow, 0.75 * glow, 0.4 * glow]
    });
    let physical = Physical { metallic: 1.0, ..Physical::default() };
    let material = Material {
        name: "lantern".to_owned(),
        base_color: [0.55, 0.3, 0.12, 1.0],
        physical: Some(physical),
        emissive: [1.0; 3],
        double_sided: true,
        ..Material::default()
    };
    let maps = [("norm", normal_map), ("map_Pr", roughness), ("map_Pm", metal), ("map_Ke", light)];
    let maps = maps.map(|(statement, texture)| GeneratedMap { statement, texture }).into();
    GeneratedMesh { mesh, material: Some(material), texture: None, maps }
}

fn floor() -> GeneratedMesh {
    let mut faces = Faces::default();
    for (x, z) in (-4..4).flat_map(|x| (-4..4).map(move |z| (x, z))) {
        let corner = |dx: i32, dz: i32| DVec3::new(f64::from(x + dx), -0.5, f64::from(z + dz));
        let color = srgb(if (x + z) % 2 == 0 { 0x8b8f94 } else { 0x6d7176 });
        faces.polygon(&[corner(0, 0), corner(0, 1), corner(1, 1), corner(1, 0)], color);
    }
    faces.finish(None)
}

/// The materials of the scene file, as JSON.
const MATERIALS: &str = r##"  "materials": {
    "enamel-0": { "color": "#b02418", "metallic": 0, "roughness": 0.05 },
    "enamel-1": { "color": "#b02418", "metallic": 0, "roughness": 0.25 },
    "enamel-2": { "color": "#b02418", "metallic": 0, "roughness": 0.5 },
    "enamel-3": { "color": "#b02418", "metallic": 0, "roughness": 1 },
    "gold-0": { "color": "#ffd27a", "metallic": 1, "roughness": 0.1 },
    "gold-1": { "color": "#ffd27a", "metallic": 1, "roughness": 0.3 },
    "gold-2": { "color": "#ffd27a", "metallic": 1, "roughness": 0.55 },
    "gold-3": { "color": "#ffd27a", "metallic": 1, "roughness": 1 },
    "copper": { "color": "#f2a184", "metallic": 1, "roughness": 0.2 },
    "varnish": { "color": "#3a6a44", "specular": "#808080", "shininess": 60 },
    "ember": { "color": "#30120a", "emissive": "#ff5a14", "emissive_strength": 0.8 },
    "steel": { "color": "#c4c8cc", "metallic": 1, "roughness": 0.4 }
  }"##;

const LIGHTS: &str = r##"  "lights": [
    { "kind": "sun", "direction": [-0.6, -1, -0.5], "color": "#fff4e0", "intensity": 0.9, "shadows": true, "angle": 6 }
  ],
  "ambient_occlusion": { "radius": 0.3 },
  "background": "#2b3038""##;

/// Rows of balls, from the back to the front.
const ROWS: [[&str; 4]; 3] = [
    ["enamel-0", "enamel-1", "enamel-2", "enamel-3"],
    ["gold-0", "gold-1", "gold-2", "gold-3"],
    ["copper", "varnish", "ember", "steel"],
];

/// A scene of balls of many materials.
pub fn materials(name: &str) -> GeneratedScene {
    let mut nodes = vec![
        "    { \"name\": \"floor\", \"asset\": \"floor\" }".to_owned(),
        "    { \"name\": \"lantern\", \"asset\": \"lantern\", \"translate\": [0, 0.1, 2.3], \"scale\": 1.2 }"
            .to_owned(),
    ];
    for (row, z) in ROWS.iter().zip([-1.6, -0.4, 0.8]) {
        for (material, x) in row.iter().zip([-1.8, -0.6, 0.6, 1.8]) {
            let at = vector(DVec3::new(x, 0.0, z));
            nodes.push(format!(
                "    {{ \"name\": \"{material}\", \"asset\": \"ball\", \"material\": \"{material}\", \"translate\": {at} }}"
            ));
        }
    }
    let pose = poses_about(DVec3::ZERO, 1.0);
    let poses = [
        pose("front", [0.4, 3.2, 6.4], [0.0, -0.2, 0.3], 38.0),
        pose("lantern", [0.9, 0.9, 4.4], [0.0, 0.05, 2.0], 34.0),
        pose("gold", [-0.6, 1.1, 2.6], [0.0, -0.1, -0.4], 48.0),
    ];
    let keys = [0.0, 0.25, 0.5, 0.75, 1.0].map(|turn: f64| {
        let (s, c) = sin_cos(0.5 * TAU * (turn - 0.5));
        (4.0 * turn, DVec3::new(6.4 * s, 3.2, 6.4 * c), DVec3::new(0.0, -0.2, 0.2))
    });
    let assets = [("ball", sphere(1.0, 6_000)), ("floor", floor()), ("lantern", lantern())];
    let mut files: Vec<(String, Generated)> = assets
        .into_iter()
        .map(|(asset, mesh)| {
            let extension = if asset == "lantern" { "obj" } else { "ply" };
            (format!("{name}-{asset}.{extension}"), Generated::Mesh(mesh))
        })
        .collect();
    let listed: Vec<String> = files
        .iter()
        .zip(["ball", "floor", "lantern"])
        .map(|((file, _), asset)| format!("    \"{asset}\": {{ \"file\": \"{file}\" }}"))
        .collect();
    let studio = format!("{name}-studio.hdr");
    files.push((studio.clone(), Generated::Surroundings(super::studio::studio())));
    let bounds = Bounds { min: DVec3::new(-2.3, -0.5, -2.1), max: DVec3::new(2.3, 0.7, 2.9) };
    let json = format!(
        "{{\n  \"pointillist\": 1,\n  \"name\": \"{name}\",\n  \"assets\": {{\n{}\n  }},\n{MATERIALS},\n  \"nodes\": [\n{}\n  ],\n  \"environment\": {{ \"file\": \"{studio}\" }},\n{LIGHTS},\n{},\n{},\n{}\n}}\n",
        listed.join(",\n"),
        nodes.join(",\n"),
        subject(&bounds),
        cameras(&poses),
        path("swing", &keys),
    );
    GeneratedScene { json, assets: files }
}
