//! Materials, overrides, vertex colours, textures and cut-outs.

use std::fmt::Write;

use glam::DVec3;
use serde_json::{Value, json};

use super::files::{Glb, Shape, picture};
use super::stage::{Case, look};
use super::verdict::Tolerance;

/// A wall that leans back, 4 wide and 3 high, of `cells` × `cells` quads.
fn wall(cells: u32, repeats: f32) -> Shape {
    let mut shape = Shape::default();
    let (u, v) = (DVec3::new(4.0, 0.0, 0.0), DVec3::new(0.0, 3.0, -1.5));
    let (du, dv) = (u / f64::from(cells), v / f64::from(cells));
    for i in 0..cells * cells {
        let (x, y) = (i % cells, i / cells);
        let corner = u * -0.5 - v * 0.5 + du * f64::from(x) + dv * f64::from(y);
        let mut cell = Shape::quad(corner, du, dv, 1.0);
        for uv in &mut cell.uvs {
            // Quads run from 0 to 1 with v downwards.
            let across = (x as f32 + uv[0]) / cells as f32;
            let down = 1.0 - (y as f32 + 1.0 - uv[1]) / cells as f32;
            *uv = [(across - 0.3) * repeats, (down - 0.4) * repeats];
        }
        shape.add(&cell);
    }
    shape
}

fn ramp(width: u32, height: u32) -> Vec<u8> {
    picture(width, height, |x, y| {
        let checker = if (x / 2 + y / 2) % 2 == 0 { 60 } else { 0 };
        [(255 * x / width) as u8, (255 * y / height) as u8, 90 + checker, 255]
    })
}

fn textured(name: &str, shape: &Shape, png: &[u8], sampler: Value, material: Value) -> Case {
    let mut glb = Glb::new();
    let texture = glb.texture(png, sampler);
    let mut material = material;
    material["pbrMetallicRoughness"]["baseColorTexture"] = json!({ "index": texture });
    let material = glb.material(material);
    let mesh = glb.mesh(shape, Some(material));
    glb.node(mesh, json!({}));
    let scene = json!({ "assets": { "m": { "file": "m.glb" } }, "nodes": [{ "asset": "m" }] });
    Case::new(name, &[("m.glb", glb.finish())], &scene)
}

const REPEAT: u32 = 10497;
const MIRROR: u32 = 33648;
const CLAMP: u32 = 33071;
const NEAREST: u32 = 9728;
const LINEAR: u32 = 9729;

/// All ways to wrap on each axis, with both filters, for small and large triangles.
#[test]
fn textures_wrap_and_filter() {
    let view = look([0.6, 0.3, 3.4], [0.1, 0.0, 0.0], 50.0);
    let png = ramp(24, 20);
    for (wrap_s, wrap_t) in [(REPEAT, CLAMP), (MIRROR, REPEAT), (CLAMP, MIRROR)] {
        for filter in [NEAREST, LINEAR] {
            for cells in [1, 12] {
                let name = format!("wrap {wrap_s} {wrap_t} {filter} {cells}");
                let sampler = json!({ "wrapS": wrap_s, "wrapT": wrap_t, "magFilter": filter });
                let case = textured(&name, &wall(cells, 3.4), &png, sampler, json!({}));
                case.check(&view, &Tolerance::default());
            }
        }
    }
}

/// Red grows from left to right, and no vertex has blue, which the texture has everywhere.
#[test]
fn vertex_colors_tint_textures() {
    let shape = wall(6, 1.0);
    let mut text = "mtllib m.mtl\nusemtl t\n".to_owned();
    for (p, [s, t]) in shape.positions.iter().zip(&shape.uvs) {
        let red = (p.x + 2.0) / 5.0;
        writeln!(text, "v {} {} {} {red} 0.8 0\nvt {s} {t}", p.x, p.y, p.z).unwrap();
    }
    for triangle in &shape.triangles {
        let [a, b, c] = triangle.map(|corner| corner + 1);
        writeln!(text, "f {a}/{a} {b}/{b} {c}/{c}").unwrap();
    }
    let files = [
        ("m.obj", text.into_bytes()),
        ("m.mtl", b"newmtl t\nKd 1 1 1\nmap_Kd t.png\n".to_vec()),
        ("t.png", ramp(24, 20)),
    ];
    let scene = json!({ "assets": { "m": { "file": "m.obj" } }, "nodes": [{ "asset": "m" }],
        "lights": [] });
    let case = Case::new("vertex-colors-texture", &files, &scene);
    let view = look([0.6, 0.3, 3.4], [0.1, 0.0, 0.0], 50.0);
    let frames = case.check(&view, &Tolerance::default());
    let shown = frames.id.iter().zip(&frames.color).filter(|(id, _)| **id != 0);
    let [most_red, _, most_blue, _] =
        shown.fold([0; 4], |most: [u8; 4], (_, own)| std::array::from_fn(|i| most[i].max(own[i])));
    assert!(most_red > 60 && most_blue == 0, "{most_red} {most_blue}");
}

/// From strong magnification to a pixel that covers many texels; odd sizes; grazing views.
#[test]
fn textures_at_every_level() {
    for (name, size, repeats) in [
        ("magnified", [3, 2], 0.7),
        ("one to one", [64, 64], 2.0),
        ("minified", [255, 130], 9.0),
        ("far below", [64, 32], 300.0),
    ] {
        let png = ramp(size[0], size[1]);
        let case =
            textured(name, &wall(3, repeats), &png, json!({ "magFilter": LINEAR }), json!({}));
        case.check(&look([0.6, 0.3, 3.4], [0.1, 0.0, 0.0], 50.0), &Tolerance::default());
        case.check(&look([1.9, -1.0, 1.2], [-0.4, 0.2, -0.2], 60.0), &Tolerance::default());
    }
}

fn dots() -> Vec<u8> {
    picture(32, 32, |x, y| {
        let (dx, dy) = (f64::from(x % 16) - 7.5, f64::from(y % 16) - 7.5);
        let alpha = (255.0 - 24.0 * (dx * dx + dy * dy).sqrt()).clamp(0.0, 255.0);
        [200, (x * 8) as u8, (y * 8) as u8, alpha as u8]
    })
}

/// Cut-outs show what is behind them, for small and large triangles.
#[test]
fn alpha_cuts_holes() {
    for (name, cells, cutoff) in
        [("cut-small", 12, 0.5), ("cut-large", 1, 0.5), ("cut-high", 3, 0.83)]
    {
        let mut glb = Glb::new();
        let texture = glb.texture(&dots(), json!({ "magFilter": LINEAR }));
        let cut = glb.material(json!({ "alphaMode": "MASK", "alphaCutoff": cutoff, "doubleSided": true,
            "pbrMetallicRoughness": { "baseColorTexture": { "index": texture }, "baseColorFactor": [1, 0.9, 1, 0.95] } }));
        let solid = glb
            .material(json!({ "pbrMetallicRoughness": { "baseColorFactor": [0.2, 0.5, 0.3, 1] } }));
        let front = glb.mesh(&wall(cells, 4.0), Some(cut));
        let back = glb.mesh(&Shape::ball(16, 0.7), Some(solid));
        glb.node(front, json!({}));
        glb.node(back, json!({ "translation": [0, 0, -2] }));
        let scene = json!({ "assets": { "m": { "file": "m.glb" } }, "nodes": [{ "asset": "m" }] });
        let case = Case::new(name, &[("m.glb", glb.finish())], &scene);
        let frames = case.check(&look([0.4, 0.2, 3.6], [0.0; 3], 50.0), &Tolerance::default());
        assert!(frames.id.contains(&1) && frames.id.contains(&2) && frames.id.contains(&0));
    }
}

/// The alpha of an overriding colour moves no hole of a cut-out.
#[test]
fn an_overriding_colour_leaves_a_cut_out_its_holes() {
    let mut glb = Glb::new();
    let texture = glb.texture(&dots(), json!({ "magFilter": LINEAR }));
    let cut = glb.material(json!({ "alphaMode": "MASK", "alphaCutoff": 0.4, "doubleSided": true,
        "pbrMetallicRoughness": { "baseColorTexture": { "index": texture }, "baseColorFactor": [1, 1, 1, 0.5] } }));
    let mesh = glb.mesh(&wall(6, 3.0), Some(cut));
    glb.node(mesh, json!({}));
    let files = [("m.glb", glb.finish())];
    let covered = ["#ffffff", "#ffffff99", "#ffffff20"].map(|color| {
        let scene = json!({ "assets": { "m": { "file": "m.glb" } }, "materials": { "over": { "color": color } },
            "nodes": [{ "asset": "m", "material": "over" }] });
        let case = Case::new(&format!("over {color}"), &files, &scene);
        case.check(&look([0.4, 0.2, 3.6], [0.0; 3], 50.0), &Tolerance::default()).covered()
    });
    assert!(covered[0] > 0 && covered == [covered[0]; 3], "{covered:?}");
}

/// Closed shapes with and without back faces, mirrored and overridden.
#[test]
fn sides() {
    let mut glb = Glb::new();
    let one =
        glb.material(json!({ "pbrMetallicRoughness": { "baseColorFactor": [0.8, 0.3, 0.2, 1] } }));
    let two = glb.material(json!({ "doubleSided": true, "pbrMetallicRoughness": { "baseColorFactor": [0.2, 0.4, 0.8, 1] } }));
    let mut bowl = Shape::ball(20, 0.6);
    bowl.triangles.retain(|t| t.iter().all(|&corner| bowl.positions[corner as usize].y < 0.2));
    for (material, x) in [(one, -0.7), (two, 0.7)] {
        let mesh = glb.mesh(&bowl, Some(material));
        glb.node(mesh, json!({ "translation": [x, 0, 0] }));
    }
    // A wall seen from behind, large enough for the rasteriser.
    let back = Shape::quad(DVec3::new(2.0, -2.0, -1.5), DVec3::X * -4.0, DVec3::Y * 4.0, 1.0);
    let mesh = glb.mesh(&back, Some(one));
    glb.node(mesh, json!({}));
    let file = [("m.glb", glb.finish())];
    for (name, node) in [
        ("sides", json!({ "asset": "m" })),
        ("sides-mirrored", json!({ "asset": "m", "scale": [1, 1, -1] })),
        ("sides-all", json!({ "asset": "m", "material": "both" })),
        ("sides-none", json!({ "asset": "m", "material": "front", "scale": [-1, 1, 1] })),
    ] {
        let scene = json!({ "assets": { "m": { "file": "m.glb" } }, "nodes": [node],
            "materials": { "both": { "double_sided": true }, "front": { "double_sided": false } } });
        let case = Case::new(name, &file, &scene);
        for eye in [[0.0, 1.6, 2.6], [0.2, -1.2, -3.0], [0.3, 0.4, 0.0]] {
            case.check(&look(eye, [0.0, 0.0, 0.2], 60.0), &Tolerance::default());
        }
    }
}

/// All properties of a material override those of meshes and samples.
#[test]
fn overrides() {
    let lights = json!([{ "kind": "sun", "direction": [-0.3, -1, -0.8], "intensity": 0.8 },
        { "kind": "ambient", "intensity": 0.2 }]);
    let files = [
        ("ball.ply", Shape::ball(24, 0.5).ply()),
        ("cloud.ply", {
            let mut cloud = Shape::ball(40, 0.5);
            cloud.triangles.clear();
            cloud.uvs.clear();
            cloud.ply()
        }),
    ];
    let materials = json!({
        "none": {}, "color": { "color": "#3070d0" }, "shiny": { "specular": "#ffffff", "shininess": 40 },
        "unlit": { "unlit": true }, "all": { "color": [0.9, 0.6, 0.1], "specular": "#808080", "shininess": 5, "unlit": false },
    });
    let mut nodes = vec![];
    for (k, material) in ["none", "color", "shiny", "unlit", "all"].iter().enumerate() {
        for (y, asset) in [(-0.6, "ball"), (0.6, "cloud")] {
            let at = [1.15 * k as f64 - 2.3, y, 0.0];
            nodes.push(json!({ "asset": asset, "material": material, "translate": at }));
        }
    }
    let scene = json!({ "assets": { "ball": { "file": "ball.ply" }, "cloud": { "file": "cloud.ply" } },
        "materials": materials, "nodes": nodes, "lights": lights });
    let case = Case::new("overrides", &files, &scene);
    case.check(&look([0.0, 0.3, 6.0], [0.0; 3], 40.0), &Tolerance::samples());
}
