//! Metallic-roughness materials and their maps against the reference renderer.

use glam::DVec3;
use pointillist::math::View;
use pointillist::oracle::{self, OracleScene};
use pointillist::plan::{Pass, Reconstruct, Settings, Shadows};
use pointillist::scene::{Tone, ToneMap};
use serde_json::{Value, json};

use super::files::{Glb, Shape, picture};
use super::stage::{Case, Frames, look};
use super::verdict::Tolerance;

const LINEAR: u32 = 9729;

fn lights() -> Value {
    json!([{ "kind": "sun", "direction": [-0.4, -1, -0.8], "intensity": 1.2 }, { "kind": "headlight", "intensity": 0.3 },
        { "kind": "point", "position": [1.5, 1.2, 2], "range": 2, "color": "#ffcc88" },
        { "kind": "ambient", "color": "#aaccff", "intensity": 0.4 }])
}

fn scene(glb: Glb) -> (Vec<(&'static str, Vec<u8>)>, Value) {
    let scene = json!({ "assets": { "m": { "file": "m.glb" } }, "nodes": [{ "asset": "m" }], "lights": lights() });
    (vec![("m.glb", glb.finish())], scene)
}

/// Balls of all roughnesses, dielectric and metallic, in perspective and in parallel.
#[test]
fn factors_reflect_as_the_reference_has_it() {
    let mut glb = Glb::new();
    for (row, metallic) in [0.0, 0.6, 1.0].into_iter().enumerate() {
        for (column, roughness) in [0.0, 0.15, 0.4, 1.0].into_iter().enumerate() {
            let material = glb.material(json!({ "pbrMetallicRoughness": {
                "metallicFactor": metallic, "roughnessFactor": roughness, "baseColorFactor": [0.9, 0.6, 0.25, 1] } }));
            let mesh = glb.mesh(&Shape::ball(40, 0.42), Some(material));
            let place = [column as f64 - 1.5, row as f64 - 1.0, 0.0];
            glb.node(mesh, json!({ "translation": place }));
        }
    }
    let (files, scene) = scene(glb);
    let case = Case::new("physical-factors", &files, &scene);
    // Highlights of mirrors are as steep as normals of 16 bits an axis are coarse.
    let tolerance = Tolerance::default();
    case.check(&look([0.3, 0.4, 5.2], [0.0; 3], 45.0), &tolerance);
    case.check(&super::orthographic::look([0.3, 0.4, 5.2], [0.0; 3], 4.0), &tolerance);
}

/// Balls and sheets of glass before each other, a checkered wall and the background: tinted, with alpha, a map and a volume, as cut-outs, rough
/// and metallic.
fn glasses(name: &str, more: Value) -> Case {
    let mut glb = Glb::new();
    let half = picture(8, 8, |x, _| [if x < 4 { 255 } else { 60 }, 0, 0, 255]);
    let half = glb.texture(&half, json!({ "magFilter": LINEAR }));
    let leaf = picture(8, 8, |x, y| [255, 240, 180, if (x + y) % 4 == 0 { 0 } else { 200 }]);
    let leaf = glb.texture(&leaf, json!({}));
    let glass = |color: [f64; 4], share: f64, more: Value| {
        let mut glass = json!({ "doubleSided": true,
            "pbrMetallicRoughness": { "baseColorFactor": color, "metallicFactor": 0, "roughnessFactor": 0.1 },
            "extensions": { "KHR_materials_transmission": { "transmissionFactor": share } } });
        merge(&mut glass, &more);
        glass
    };
    let parts = [
        (true, glass([0.9, 0.95, 1.0, 0.4], 1.0, json!({})), [-1.4, 0.7, 0.0]),
        (
            true,
            glass(
                [0.2, 0.9, 0.3, 1.0],
                0.8,
                json!({ "pbrMetallicRoughness": { "roughnessFactor": 0.6 } }),
            ),
            [0.0, 0.7, 0.3],
        ),
        (true, glass([1.0, 0.8, 0.4, 0.5], 0.9, json!({ "alphaMode": "BLEND" })), [1.3, 0.7, 0.0]),
        (
            false,
            glass(
                [1.0, 1.0, 1.0, 1.0],
                0.9,
                json!({ "extensions": { "KHR_materials_volume": {
            "thicknessFactor": 0.5, "attenuationDistance": 0.7, "attenuationColor": [0.9, 0.3, 0.1] } } }),
            ),
            [-1.2, -0.7, 0.4],
        ),
        (
            false,
            glass(
                [0.8, 0.9, 1.0, 1.0],
                1.0,
                json!({ "extensions": {
            "KHR_materials_transmission": { "transmissionTexture": { "index": half } } } }),
            ),
            [0.0, -0.7, 0.5],
        ),
        (
            false,
            glass(
                [0.5, 1.0, 1.0, 1.0],
                0.7,
                json!({ "alphaMode": "MASK", "pbrMetallicRoughness": {
            "baseColorTexture": { "index": leaf }, "metallicFactor": 0.3 } }),
            ),
            [1.2, -0.7, 0.2],
        ),
        (
            false,
            glass([1.0, 0.5, 0.5, 1.0], 0.8, json!({ "doubleSided": false })),
            [0.3, -0.5, 0.9],
        ),
    ];
    for (is_ball, material, place) in parts {
        let material = glb.material(material);
        let sheet = Shape::quad(DVec3::new(-0.5, -0.5, 0.0), DVec3::X, DVec3::Y, 1.0);
        let shape = if is_ball { Shape::ball(40, 0.6) } else { sheet };
        let mesh = glb.mesh(&shape, Some(material));
        glb.node(mesh, json!({ "translation": place }));
    }
    let checks =
        picture(
            8,
            8,
            |x, y| if (x + y) % 2 == 0 { [240, 90, 40, 255] } else { [30, 60, 200, 255] },
        );
    let checks = glb.texture(&checks, json!({}));
    let wall = glb.material(json!({ "pbrMetallicRoughness": { "baseColorTexture": { "index": checks }, "metallicFactor": 0 } }));
    let wall = glb.mesh(
        &Shape::quad(DVec3::new(-1.5, -1.2, -1.0), DVec3::X * 2.2, DVec3::Y * 2.4, 1.0),
        Some(wall),
    );
    glb.node(wall, json!({}));
    let (files, mut scene) = scene(glb);
    merge(&mut scene, &more);
    Case::new(name, &files, &scene)
}

/// Lays the keys of one object over those of another, level by level.
fn merge(to: &mut Value, from: &Value) {
    match (to.as_object_mut(), from.as_object()) {
        (Some(to), Some(from)) => {
            for (key, value) in from {
                merge(to.entry(key).or_insert(Value::Null), value);
            }
        }
        _ => *to = from.clone(),
    }
}

#[test]
fn glass_lets_light_pass_as_the_reference_has_it() {
    let frames = glasses("glass", json!({})).check(&front(), &Tolerance::default());
    assert!(frames.ran(Pass::CompositeLayers));
    let tilted = look([1.9, 0.8, 2.6], [0.2, 0.0, 0.0], 55.0);
    glasses("glass-tilted", json!({})).check(&tilted, &Tolerance::default());
    glasses("glass-unlit", json!({ "lights": [] })).check(&front(), &Tolerance::default());
    let fog = json!({ "fog": { "color": "#8090a0", "density": 0.15 } });
    glasses("glass-fog", fog).check(&front(), &Tolerance::default());
    let parallel = super::orthographic::look([0.4, 0.6, 5.0], [0.0; 3], 3.4);
    glasses("glass-parallel", json!({})).check(&parallel, &Tolerance::default());
}

/// What lies behind is tinted, not only dimmed: green glass leaves green of white, and alpha does not count where it does not blend.
#[test]
fn glass_tints_what_lies_behind() {
    let glass = |color: [f64; 4]| {
        let mut glb = Glb::new();
        let material = glb.material(json!({ "extensions": { "KHR_materials_transmission": { "transmissionFactor": 1 } },
            "pbrMetallicRoughness": { "baseColorFactor": color, "metallicFactor": 0, "roughnessFactor": 0 } }));
        let sheet = Shape::quad(DVec3::new(-2.0, -2.0, 0.0), DVec3::X * 4.0, DVec3::Y * 4.0, 1.0);
        let mesh = glb.mesh(&sheet, Some(material));
        glb.node(mesh, json!({}));
        let scene = json!({ "assets": { "m": { "file": "m.glb" } }, "nodes": [{ "asset": "m" }],
            "lights": [], "background": "#ffffff" });
        let case = Case::new("glass-tint", &[("m.glb", glb.finish())], &scene);
        let frames = case.check(&look([0.0, 0.0, 2.0], [0.0; 3], 40.0), &Tolerance::default());
        frames.color[frames.color.len() / 2]
    };
    let [r, g, b, _] = glass([0.05, 1.0, 0.05, 0.25]);
    assert!(g >= 254 && r < 70 && b < 70, "{r} {g} {b}");
    assert_eq!(glass([0.05, 1.0, 0.05, 1.0])[..3], [r, g, b]);
}

/// Draws a sheet of a material that fills the image, from straight ahead.
fn sheet(name: &str, material: Value, more: Value) -> Frames {
    let mut glb = Glb::new();
    let material = glb.material(material);
    let sheet = Shape::quad(DVec3::new(-2.0, -2.0, 0.0), DVec3::X * 4.0, DVec3::Y * 4.0, 1.0);
    let mesh = glb.mesh(&sheet, Some(material));
    glb.node(mesh, json!({}));
    let (files, mut scene) = scene(glb);
    merge(&mut scene, &more);
    let case = Case::new(name, &files, &scene);
    case.check(&look([0.0, 0.0, 2.0], [0.0; 3], 40.0), &Tolerance::default())
}

fn middle(frames: &Frames) -> [u8; 4] {
    frames.color[(frames.height / 2 * frames.width + frames.width / 2) as usize]
}

/// Over a transparent background a highlight on glass is opaque, and the glass around it nearly clear.
#[test]
fn highlights_on_glass_show_over_a_transparent_background() {
    let glass = json!({ "extensions": { "KHR_materials_transmission": { "transmissionFactor": 1 } },
        "pbrMetallicRoughness": { "metallicFactor": 0, "roughnessFactor": 0.3 } });
    let more = json!({ "lights": [{ "kind": "headlight" }], "background": "#00000000" });
    let frames = sheet("glass-highlight", glass, more);
    let [r, g, b, alpha] = middle(&frames);
    assert!([r, g, b, alpha].iter().all(|&byte| byte > 250), "{r} {g} {b} {alpha}");
    let corner = frames.color[0];
    assert!(corner[3] < 40, "{corner:?}");
}

/// Glass that reflects nothing hides nothing, and its own light shows.
#[test]
fn glass_that_hides_nothing_gives_off_light() {
    let glass = json!({ "emissiveFactor": [0.5, 0.5, 0.5],
        "extensions": {
            "KHR_materials_transmission": { "transmissionFactor": 1 },
            "KHR_materials_specular": { "specularFactor": 0 } },
        "pbrMetallicRoughness": { "metallicFactor": 0, "roughnessFactor": 0.5 } });
    let more = json!({ "lights": [{ "kind": "ambient" }], "background": "#000000" });
    let [r, g, b, alpha] = middle(&sheet("glass-glow", glass, more));
    // 188 is the byte of 0.5.
    assert!([r, g, b].iter().all(|byte| (186..=190).contains(byte)), "{r} {g} {b}");
    assert_eq!(alpha, 255);
}

/// A node lays glass over an opaque ball, and its samples stay as they are.
#[test]
fn nodes_of_glass() {
    let ball = Shape::ball(30, 0.7);
    let scene = json!({ "assets": { "ball": { "file": "ball.ply" } },
        "materials": { "glass": { "color": "#70d0a0", "roughness": 0.05, "transmission": 0.9 }, "clay": { "roughness": 1, "transmission": 0 } },
        "nodes": [{ "asset": "ball", "material": "glass" }, { "asset": "ball", "material": "clay", "translate": [0.9, 0.2, -0.8] }],
        "lights": lights() });
    let case = Case::new("glass-node", &[("ball.ply", ball.ply())], &scene);
    let frames = case.check(&front(), &Tolerance::default());
    assert!(frames.ran(Pass::CompositeLayers));
}

/// A normal map may turn a normal away from the eye, to light from straight behind. There is no half vector then, and no highlight.
#[test]
fn light_opposite_to_the_eye_makes_no_highlight() {
    let mut glb = Glb::new();
    let away = glb.texture(&picture(2, 2, |_, _| [220, 128, 40, 255]), json!({}));
    let material = glb.material(json!({ "normalTexture": { "index": away },
        "pbrMetallicRoughness": { "metallicFactor": 0, "roughnessFactor": 0.1 } }));
    let sheet = Shape::quad(DVec3::new(-1.0, -1.0, 0.0), DVec3::X * 2.0, DVec3::Y * 2.0, 1.0);
    let mesh = glb.mesh(&sheet, Some(material));
    glb.node(mesh, json!({}));
    let (files, mut scene) = scene(glb);
    scene["lights"] = json!([{ "kind": "sun", "direction": [0, 0, 1] }]);
    let case = Case::new("physical-opposite", &files, &scene);
    let view = super::orthographic::look([0.0, 0.0, 2.0], [0.0; 3], 1.5);
    let [red, ..] = middle(&case.check(&view, &Tolerance::default()));
    assert!(red < 60, "{red}");
}

/// A node may lay an unlit or a Phong material over glass, or glass over an unlit material. No light passes then, and alpha does not blend, so that
/// nothing behind the surface shows.
#[test]
fn glass_is_opaque_under_other_materials() {
    let base = json!({ "metallicFactor": 0, "baseColorFactor": [0.2, 0.2, 0.2, 0.4] });
    let glass = json!({ "extensions": { "KHR_materials_transmission": { "transmissionFactor": 1 } },
        "pbrMetallicRoughness": base });
    let unlit =
        json!({ "extensions": { "KHR_materials_unlit": {} }, "pbrMetallicRoughness": base });
    for (name, own, over) in [
        ("glass-unlit-node", &glass, json!({ "unlit": true })),
        ("glass-phong-node", &glass, json!({ "shininess": 20 })),
        ("glass-node-unlit", &unlit, json!({ "transmission": 0.5 })),
    ] {
        let more = json!({ "materials": { "over": over }, "lights": [],
            "nodes": [{ "asset": "m", "material": "over" }], "background": "#ffffff" });
        let [red, _, _, alpha] = middle(&sheet(name, own.clone(), more));
        // 124 is the byte of 0.2; with an alpha of 0.4 it would be 214.
        assert!((122..=126).contains(&red) && alpha == 255, "{name}: {red} {alpha}");
    }
}

/// Bumps, rougher and smoother places, dark folds and glowing spots.
fn maps(glb: &mut Glb) -> Value {
    let wave = |x: u32, period: f64| (f64::from(x) * std::f64::consts::TAU / period).sin();
    let byte = |value: f64| (127.5 + 127.5 * value).round() as u8;
    let sampler = || json!({ "magFilter": LINEAR });
    let bumps = picture(32, 32, |x, y| {
        let normal =
            DVec3::new(0.6 * wave(x, 16.0), 0.4 * wave(y, 8.0), 1.0).normalize_or(DVec3::Z);
        [byte(normal.x), byte(normal.y), byte(normal.z), 255]
    });
    // Occlusion in red, roughness in green, metallic in blue.
    let shares = picture(16, 16, |x, y| {
        [
            if (x / 4 + y / 4) % 2 == 0 { 80 } else { 255 },
            (40 + 13 * x) as u8,
            if y < 8 { 0 } else { 255 },
            255,
        ]
    });
    let glow =
        picture(
            16,
            16,
            |x, y| if x % 8 < 2 && y % 8 < 2 { [255, 120, 30, 255] } else { [0, 0, 0, 255] },
        );
    let colors = picture(8, 8, |x, y| [(90 + 20 * x) as u8, (200 - 15 * y) as u8, 120, 255]);
    let bumps = glb.texture(&bumps, sampler());
    let shares = glb.texture(&shares, sampler());
    let glow = glb.texture(&glow, sampler());
    let colors = glb.texture(&colors, sampler());
    json!({ "doubleSided": true, "emissiveFactor": [1, 0.8, 0.9], "emissiveTexture": { "index": glow },
        "normalTexture": { "index": bumps, "scale": 0.8 },
        "occlusionTexture": { "index": shares, "strength": 0.7 },
        "extensions": { "KHR_materials_emissive_strength": { "emissiveStrength": 1.5 } },
        "pbrMetallicRoughness": { "baseColorTexture": { "index": colors },
            "metallicRoughnessTexture": { "index": shares }, "roughnessFactor": 0.9, "metallicFactor": 0.8 } })
}

/// A ball and a sheet seen from the front, from behind, mirrored, and with mirrored texture coordinates.
fn mapped(name: &str, more: Value) -> Case {
    let mut glb = Glb::new();
    let material = maps(&mut glb);
    let material = glb.material(material);
    let ball = glb.mesh(&Shape::ball(32, 0.6), Some(material));
    let sheet = Shape::quad(DVec3::new(-0.5, -0.5, 0.0), DVec3::X, DVec3::Y, 1.0);
    let mut turned = sheet.clone();
    for uv in &mut turned.uvs {
        uv[0] = -uv[0];
    }
    let (sheet, turned) = (glb.mesh(&sheet, Some(material)), glb.mesh(&turned, Some(material)));
    glb.node(ball, json!({ "translation": [-1.5, 0.6, 0] }));
    glb.node(ball, json!({ "translation": [0, 0.6, 0], "scale": [-1, 1, 1] }));
    glb.node(sheet, json!({ "translation": [1.4, 0.6, 0] }));
    glb.node(sheet, json!({ "translation": [-1.4, -0.7, 0], "rotation": [0, 1, 0, 0] }));
    glb.node(turned, json!({ "translation": [0, -0.7, 0] }));
    glb.node(sheet, json!({ "translation": [1.4, -0.7, 0], "scale": [1, -1.1, 1] }));
    let (files, mut scene) = scene(glb);
    for (key, value) in more.as_object().into_iter().flatten() {
        scene[key.as_str()] = value.clone();
    }
    Case::new(name, &files, &scene)
}

fn front() -> View {
    look([0.2, 0.3, 4.4], [0.0, 0.0, 0.0], 42.0)
}

#[test]
fn maps_show_what_the_reference_shows() {
    let case = mapped("physical-maps", json!({}));
    case.check(&front(), &Tolerance::default());
    case.check(&look([1.9, 0.8, 2.6], [0.2, 0.0, 0.0], 55.0), &Tolerance::default());
    case.check(&super::orthographic::look([0.4, 0.6, 5.0], [0.0; 3], 3.4), &Tolerance::default());
}

/// Surfaces that wait for another effect keep what their maps say.
#[test]
fn kept_surfaces_have_their_maps() {
    let case =
        mapped("physical-kept", json!({ "ambient_occlusion": { "radius": 1e-6, "strength": 1 } }));
    let frames = case.draw_with(&front(), Settings::default());
    assert!(frames.ran(Pass::WriteOutput) && frames.ran(Pass::AmbientOcclusion));
    let off = case.draw_with(
        &front(),
        Settings { ao: pointillist::plan::Effect::Off, ..Settings::default() },
    );
    assert!(!off.ran(Pass::WriteOutput));
    // Shares of a byte are kept of what maps say; the radius is too short to hide anything.
    let far = differing(&frames, &off, 3);
    println!("{far} of {} pixels differ by more than 3 steps", frames.covered());
    assert!(far * 500 < frames.covered(), "{far}");
    case.check(&front(), &Tolerance::default());
}

fn differing(a: &Frames, b: &Frames, steps: u8) -> usize {
    differing_bytes(&a.color, &b.color, steps)
}

fn differing_bytes(a: &[[u8; 4]], b: &[[u8; 4]], steps: u8) -> usize {
    let pairs = a.iter().zip(b);
    pairs.filter(|(a, b)| (0..3).any(|channel| a[channel].abs_diff(b[channel]) > steps)).count()
}

/// Point trees keep the triangles of such surfaces: a sample has a colour and a normal alone.
#[test]
fn point_trees_keep_their_triangles() {
    let case = mapped("physical-trees", json!({}));
    let far = look([0.5, 0.5, 40.0], [0.0; 3], 20.0);
    let trees =
        Settings { lod: pointillist::plan::Lod::Spt, ..Settings::drawn_as(Reconstruct::Points) };
    let full = Settings { lod: pointillist::plan::Lod::Full, ..trees };
    let [trees, full] = [trees, full].map(|settings| case.draw_wide(&far, settings));
    assert!(trees.covered() > 50);
    assert_eq!(differing(&trees, &full, 0), 0);
}

/// What a node lays over a material, of either model, on triangles and on samples.
#[test]
fn nodes_override_reflection() {
    let mut glb = Glb::new();
    let phong = Shape::ball(32, 0.45);
    let gold = glb.material(json!({ "pbrMetallicRoughness": {
        "metallicFactor": 1, "roughnessFactor": 0.3, "baseColorFactor": [1, 0.77, 0.34, 1] } }));
    let mesh = glb.mesh(&phong, Some(gold));
    glb.node(mesh, json!({}));
    let mut samples = Shape::cloud(4000, [-0.4; 3], [0.4; 3], 7);
    samples.normals =
        samples.positions.iter().map(|p| p.normalize_or(DVec3::Y).as_vec3()).collect();
    let files =
        [("gold.glb", glb.finish()), ("plain.ply", phong.ply()), ("samples.ply", samples.ply())];
    let materials = json!({
        "copper": { "metallic": 1, "roughness": 0.25, "color": "#d88860" },
        "smooth": { "roughness": 0.25 },
        "varnish": { "specular": "#ffffff", "shininess": 40 },
        "ember": { "color": "#301008", "emissive": "#ff5010", "emissive_strength": 0.8 } });
    let mut nodes = Vec::new();
    for (row, asset) in ["gold", "plain", "samples"].into_iter().enumerate() {
        for (column, material) in ["copper", "smooth", "varnish", "ember"].into_iter().enumerate() {
            nodes.push(json!({ "asset": asset, "material": material,
                "translate": [column as f64 - 1.5, row as f64 - 1.0, 0] }));
        }
    }
    let assets = json!({ "gold": { "file": "gold.glb" }, "plain": { "file": "plain.ply" }, "samples": { "file": "samples.ply" } });
    let scene =
        json!({ "assets": assets, "materials": materials, "nodes": nodes, "lights": lights() });
    let case = Case::new("physical-overrides", &files, &scene);
    // Highlights are steep where normals of single samples lie far apart.
    let tolerance = Tolerance { color: 5, ..Tolerance::samples() };
    case.check(&look([0.3, 0.4, 5.2], [0.0; 3], 45.0), &tolerance);
}

/// An exponent alone makes a metal reflect by Phong's model, with the specular colour of its asset.
#[test]
fn an_exponent_gives_a_metal_a_highlight() {
    let mut glb = Glb::new();
    let gold = glb.material(json!({ "pbrMetallicRoughness": {
        "metallicFactor": 1, "roughnessFactor": 0.3, "baseColorFactor": [0.6, 0.4, 0.1, 1] } }));
    let mesh = glb.mesh(&Shape::ball(40, 0.8), Some(gold));
    glb.node(mesh, json!({}));
    let (files, mut scene) = scene(glb);
    scene["materials"] = json!({ "polish": { "shininess": 20 } });
    scene["nodes"][0]["material"] = json!("polish");
    scene["lights"] = json!([{ "kind": "headlight" }]);
    let case = Case::new("physical-exponent", &files, &scene);
    let frames = case.check(&look([0.0, 0.0, 2.5], [0.0; 3], 45.0), &Tolerance::default());
    // Scattered light alone would make red 203.
    let [red, ..] = middle(&frames);
    assert!(red > 240, "{red}");
}

/// White surfaces of any material cannot be told apart under white ambient light, metals included.
#[test]
fn white_surfaces_under_white_light_are_white() {
    let ball = Shape { colors: Vec::new(), ..Shape::ball(24, 0.45) };
    let mut glb = Glb::new();
    for (column, (metallic, roughness)) in
        [(0.0, 0.1), (0.0, 1.0), (1.0, 0.1), (1.0, 1.0)].into_iter().enumerate()
    {
        let material = glb.material(json!({ "pbrMetallicRoughness": { "metallicFactor": metallic, "roughnessFactor": roughness } }));
        let mesh = glb.mesh(&ball, Some(material));
        glb.node(mesh, json!({ "translation": [column as f64 - 1.5, 0, 0] }));
    }
    let (files, mut scene) = scene(glb);
    scene["lights"] = json!([{ "kind": "ambient" }]);
    let case = Case::new("physical-furnace", &files, &scene);
    let frames = case.draw(&look([0.3, 0.4, 5.2], [0.0; 3], 45.0));
    let shown = frames.id.iter().zip(&frames.color).filter(|(id, _)| **id != 0);
    let least = shown.map(|(_, color)| color[0].min(color[1]).min(color[2])).min();
    assert!(least >= Some(254), "{least:?}");
}

/// The output of normals shows those of the maps.
#[test]
fn normals_are_those_of_the_maps() {
    let sheet = Shape::quad(DVec3::new(-1.0, -1.0, 0.0), DVec3::X * 2.0, DVec3::Y * 2.0, 1.0);
    let kinds = |name: &str, with_map: bool| {
        let mut glb = Glb::new();
        let mut material = maps(&mut glb);
        if !with_map {
            material.as_object_mut().unwrap().remove("normalTexture");
        }
        let material = glb.material(material);
        let mesh = glb.mesh(&sheet, Some(material));
        glb.node(mesh, json!({}));
        let (files, scene) = scene(glb);
        let frames = Case::new(name, &files, &scene).check(&front(), &Tolerance::default());
        let shown = frames.id.iter().zip(&frames.normal).filter(|(id, _)| **id != 0);
        shown.map(|(_, n)| [n[0], n[1], n[2]]).collect::<std::collections::BTreeSet<_>>().len()
    };
    let [mapped, flat] = [kinds("physical-bent", true), kinds("physical-flat", false)];
    assert!(flat == 1 && mapped > 100, "{flat} {mapped}");
}

/// Exposure and tone curves of everything that is lit: balls, samples as splats lit once a pixel or one by one, lines.
#[test]
fn tone_maps_are_those_of_the_reference() {
    let mut glb = Glb::new();
    for (column, roughness) in [0.2, 0.5, 1.0].into_iter().enumerate() {
        let material = glb.material(json!({ "emissiveFactor": [0.1, 0, 0.05], "pbrMetallicRoughness": {
            "metallicFactor": 0.5, "roughnessFactor": roughness, "baseColorFactor": [0.9, 0.6, 0.25, 1] } }));
        let mesh = glb.mesh(&Shape::ball(32, 0.42), Some(material));
        glb.node(mesh, json!({ "translation": [column as f64 - 1.0, 0, 0] }));
    }
    let (mut files, mut scene) = scene(glb);
    let strand: Vec<_> = (0..12)
        .map(|i| (DVec3::new(-1.4 + 0.25 * f64::from(i), 0.7, 0.0), 0.06, [220, 200, 90]))
        .collect();
    files.push(("lines.vtk", super::lines::vtk(&[strand])));
    scene["assets"]["lines"] = json!({ "file": "lines.vtk" });
    scene["nodes"].as_array_mut().unwrap().push(json!({ "asset": "lines" }));
    let case = Case::new("physical-tone", &files, &scene);
    let view = front();
    for (map, stops) in [
        (ToneMap::None, 1.0),
        (ToneMap::Neutral, 0.0),
        (ToneMap::Neutral, 2.0),
        (ToneMap::Aces, -1.0),
        (ToneMap::Aces, 3.0),
    ] {
        let settings = Settings {
            tone_map: map,
            exposure: stops.into(),
            shadows: Shadows::Off,
            ..Settings::drawn_as(Reconstruct::Points)
        };
        let frames = case.draw_with(&view, settings);
        let tone = Some(Tone { map, stops });
        let expected = oracle::render(
            &OracleScene { tone, shadows: false, ..case.reference.scene() },
            &view,
            1,
        )
        .to_rgba8();
        let far = differing_bytes(&frames.color, &expected, 3);
        println!("{map:?} {stops}: {far} of {} pixels differ", frames.covered());
        assert!(far <= 12 && frames.covered() > 2000, "{map:?} {stops}: {far}");
        let plain = case.draw_with(
            &view,
            Settings { tone_map: ToneMap::None, exposure: 0.0.into(), ..settings },
        );
        assert!(differing(&frames, &plain, 3) * 2 > frames.covered(), "{map:?} {stops}");
    }
}
