//! The effects that the bench draws, each with a small scene, off and on.

use std::f64::consts::{PI, TAU};

use glam::DVec3;
use pointillist::math::{Camera, Lens};
use pointillist::plan::{
    Antialias, BlurSamples, Edl, EdlStrength, Effect, Reconstruct, Settings, Shadows,
};
use pointillist::scene::ToneMap;
use serde_json::{Value, json};

use super::shapes::{Glb, Shape, picture};

/// A scene file and the files that it names.
#[derive(Clone)]
pub struct Scene {
    pub files: Vec<(&'static str, Vec<u8>)>,
    pub description: Value,
}

/// A scene and the settings that it is drawn with.
pub struct Side {
    pub scene: Scene,
    pub settings: Settings,
}

/// An effect, off and on.
pub struct Case {
    pub name: &'static str,
    /// The setting, or the field of a scene or file, that switches the effect.
    pub switch: &'static str,
    pub off: Side,
    pub on: Side,
    camera: Camera,
    /// Way of the camera while the shutter is open.
    moves_by: DVec3,
    /// The least PSNR against the reference in decibels, where it is less than [`super::LEAST_DB`], and why.
    pub allowed: Option<(f64, &'static str)>,
}

impl Case {
    fn new(
        [name, switch]: [&'static str; 2],
        camera: Camera,
        off: (Scene, Settings),
        on: (Scene, Settings),
    ) -> Case {
        let [off, on] = [off, on].map(|(scene, settings)| Side { scene, settings });
        Case { name, switch, off, on, camera, moves_by: DVec3::ZERO, allowed: None }
    }

    /// An effect of a setting.
    fn of_setting(
        names: [&'static str; 2],
        camera: Camera,
        scene: Scene,
        [off, on]: [Settings; 2],
    ) -> Case {
        Case::new(names, camera, (scene.clone(), off), (scene, on))
    }

    /// An effect of a scene.
    fn of_scene(names: [&'static str; 2], camera: Camera, [off, on]: [Scene; 2]) -> Case {
        Case::new(names, camera, (off, plain()), (on, plain()))
    }

    fn allowing(self, least_db: f64, reason: &'static str) -> Case {
        Case { allowed: Some((least_db, reason)), ..self }
    }

    /// The camera at a share of the time for which the shutter is open.
    pub fn camera_at(&self, time: f64) -> Camera {
        let way = self.moves_by * (time - 0.5);
        Camera { eye: self.camera.eye + way, target: self.camera.target + way, ..self.camera }
    }
}

/// Settings without effects of their own.
fn plain() -> Settings {
    Settings { edl: Edl::Off, ..Settings::drawn_as(Reconstruct::Points) }
}

fn look(eye: [f64; 3], target: [f64; 3], fov_deg: f64) -> Camera {
    let (eye, target) = (DVec3::from(eye), DVec3::from(target));
    Camera { eye, target, up: DVec3::Y, lens: Lens::Perspective { fov_deg } }
}

/// All effects, in the order of the sheets.
///
/// # Errors
/// An environment that cannot be encoded.
pub fn all() -> anyhow::Result<Vec<Case>> {
    let mut cases = shadows();
    cases.extend(cameras());
    cases.extend(surroundings()?);
    cases.extend(surfaces());
    Ok(cases)
}

fn shadows() -> Vec<Case> {
    let above = look([0.4, 1.4, 4.6], [0.0, -0.4, 0.0], 55.0);
    let off = Settings { shadows: Shadows::Off, ..plain() };
    let sun = |angle: f64| {
        over_floor(json!([
            { "kind": "ambient", "intensity": 0.2 },
            { "kind": "sun", "direction": [-0.6, -1, -0.4], "intensity": 0.8, "shadows": true, "angle": angle },
        ]))
    };
    let lamp = over_floor(json!([
        { "kind": "ambient", "intensity": 0.2 },
        { "kind": "point", "position": [0.9, 1.6, 1.4], "range": 4, "intensity": 0.9, "shadows": true, "radius": 0 },
    ]));
    let edge = "A shadow map has pixels: the edge of a shadow lies up to one pixel of the map beside the true edge, and is three of them wide.";
    let corner = Shape::quad(DVec3::new(-5.0, -1.0, -1.2), DVec3::X * 10.0, DVec3::Y * 4.0, 1.0);
    let mut folds = over_floor(
        json!([{ "kind": "ambient", "intensity": 0.9 }, { "kind": "headlight", "intensity": 0.1 }]),
    );
    folds.files.push(("wall.ply", white(corner).ply()));
    merge(
        &mut folds.description,
        &json!({ "assets": { "wall": { "file": "wall.ply" } }, "ambient_occlusion": { "radius": 0.8 },
            "nodes": [{ "asset": "floor" }, { "asset": "ball", "translate": [0, -0.1, 0] }, { "asset": "wall" }] }),
    );
    vec![
        Case::of_setting(
            ["shadow of the sun", "`shadows` of a sun; `shadows=on`"],
            above,
            sun(0.0),
            [off, plain()],
        )
        .allowing(36.0, edge),
        Case::of_setting(
            ["shadow of a lamp", "`shadows` of a point light; `shadows=on`"],
            look([0.4, 2.4, 4.6], [0.0, -0.6, 0.0], 55.0),
            lamp,
            [off, plain()],
        )
        .allowing(39.0, edge),
        Case::of_scene(
            ["soft shadow", "`angle` of a sun, `radius` of a point light"],
            above,
            [sun(0.0), sun(16.0)],
        ),
        Case::of_setting(
            ["ambient occlusion", "`ambient_occlusion` of a scene; `ao=on`"],
            above,
            folds,
            [Settings { ao: Effect::Off, ..plain() }, plain()],
        )
        .allowing(32.0, "The renderer knows the depths of the image alone, and the reference sends rays into the scene: what the image hides darkens nothing."),
    ]
}

fn cameras() -> Vec<Case> {
    let along = look([0.4, 0.6, 6.5], [0.0, 0.0, -1.0], 55.0);
    let fog = json!({ "fog": { "color": "#c0d0e8", "density": 0.12 } });
    let exposures = Settings { blur_samples: BlurSamples::Exposures16, ..plain() };
    let scene = || avenue(&json!({}));
    let bright = json!({ "lights": [{ "kind": "ambient", "intensity": 0.5 },
        { "kind": "sun", "direction": [0.3, -1, -0.6], "intensity": 2.2 }] });
    let moving = Case::of_setting(
        ["motion blur", "`shutter=0.5` of a moving camera"],
        along,
        scene(),
        [plain(), Settings { shutter: 0.5.into(), ..exposures }],
    );
    let with = |antialias| Settings { antialias, ..plain() };
    vec![
        Case::of_setting(
            ["fog", "`fog` of a scene; `fog=on`"],
            along,
            avenue(&fog),
            [Settings { fog: Effect::Off, ..plain() }, plain()],
        ),
        Case::of_setting(
            ["depth of field", "`aperture=0.4`"],
            along,
            scene(),
            [plain(), Settings { aperture: 0.4.into(), ..exposures }],
        ),
        Case { moves_by: DVec3::X * 0.5, ..moving },
        Case::of_setting(
            ["antialiasing, 4 parts", "`antialias=4x`"],
            along,
            scene(),
            [plain(), with(Antialias::Parts4)],
        ),
        Case::of_setting(
            ["antialiasing, 16 parts", "`antialias=16x`"],
            along,
            scene(),
            [plain(), with(Antialias::Parts16)],
        ),
        Case::of_setting(
            ["exposure and tone map", "`exposure=0.5`, `tone_map=neutral`"],
            along,
            avenue(&bright),
            [plain(), Settings { tone_map: ToneMap::Neutral, exposure: 0.5.into(), ..plain() }],
        ),
        Case::of_setting(
            ["image of a stereo pair", "`eye_offset=0.3`"],
            along,
            scene(),
            [plain(), plain().shifted(0.3)],
        ),
        Case::of_setting(
            ["eye-dome lighting", "`edl=on`"],
            along,
            avenue(&json!({ "lights": [] })),
            [plain(), Settings { edl: Edl::On, edl_strength: EdlStrength::from(0.5), ..plain() }],
        ),
    ]
}

fn surroundings() -> anyhow::Result<Vec<Case>> {
    let front = look([0.3, 0.2, 4.2], [0.0; 3], 42.0);
    let sky = sky()?;
    let scene = |background: bool| {
        let mut glb = Glb::new();
        for (row, metallic) in [0.0, 1.0].into_iter().enumerate() {
            for (column, roughness) in [0.12, 0.35, 1.0].into_iter().enumerate() {
                let material = glb.material(json!({ "pbrMetallicRoughness": {
                    "metallicFactor": metallic, "roughnessFactor": roughness, "baseColorFactor": [0.9, 0.7, 0.4, 1] } }));
                let ball = glb.mesh(&Shape::ball(40, 0.45), Some(material));
                glb.node(
                    ball,
                    json!({ "translation": [column as f64 - 1.0, row as f64 - 0.5, 0] }),
                );
            }
        }
        Scene {
            files: vec![("m.glb", glb.finish()), ("sky.hdr", sky.clone())],
            description: json!({ "assets": { "m": { "file": "m.glb" } }, "nodes": [{ "asset": "m" }],
                "background": "#304050", "environment": { "file": "sky.hdr", "background": background } }),
        }
    };
    Ok(vec![
        Case::of_scene(
            ["environment as background", "`background` of an `environment`"],
            front,
            [scene(false), scene(true)],
        ),
        Case::of_setting(
            ["image-based light", "`environment` of a scene; `environment=on`"],
            front,
            scene(false),
            [Settings { environment: Effect::Off, ..plain() }, plain()],
        ),
    ])
}

fn surfaces() -> Vec<Case> {
    let front = look([0.2, 0.3, 3.4], [0.0; 3], 42.0);
    let of = |more: Value| surface(false, |_| more);
    let behind = |more: Value| surface(true, |_| more);
    let maps = [bumps as fn(&mut Glb) -> Value, glow, folds];
    let [bumps, glow, folds] = maps.map(|make| [of(json!({})), surface(false, make)]);
    let bowl = |is_double: bool| {
        let mut bowl = Shape::ball(24, 0.9);
        bowl.triangles.retain(|t| t.iter().all(|&corner| bowl.positions[corner as usize].y < 0.2));
        let mut glb = Glb::new();
        let material = glb.material(merged(&clay(), &json!({ "doubleSided": is_double })));
        let mesh = glb.mesh(&bowl, Some(material));
        glb.node(mesh, json!({}));
        of_glb(glb)
    };
    let mut metal = of_ball();
    merge(
        &mut metal.description,
        &json!({ "materials": { "metal": { "metallic": 1, "roughness": 0.3 } },
            "nodes": [{ "asset": "ball", "material": "metal" }] }),
    );
    let cut = Settings { clip_boxes: "*,*,*,0.3,0.2,0.55".parse().ok(), ..plain() };
    vec![
        Case::of_scene(
            ["metallic-roughness", "`metallic`, `roughness` of a material; glTF's factors"],
            front,
            [of_ball(), metal],
        ),
        Case::of_scene(["normal map", "`normalTexture` of glTF"], front, bumps),
        Case::of_scene(["emission", "`emissive` of a material; glTF's texture"], front, glow),
        Case::of_scene(["occlusion texture", "`occlusionTexture` of glTF"], front, folds),
        Case::of_scene(
            ["transmission", "`transmission` of a material; `KHR_materials_transmission`"],
            front,
            [
                behind(json!({})),
                behind(
                    json!({ "extensions": { "KHR_materials_transmission": { "transmissionFactor": 0.9 } } }),
                ),
            ],
        ),
        Case::of_scene(
            ["translucent surface", "alpha of a colour; glTF's `BLEND`"],
            front,
            [
                behind(json!({})),
                behind(
                    json!({ "alphaMode": "BLEND", "pbrMetallicRoughness": { "baseColorFactor": [0.8, 0.6, 0.4, 0.4] } }),
                ),
            ],
        ),
        Case::of_scene(
            ["unlit", "`unlit` of a material; `KHR_materials_unlit`"],
            front,
            [of(json!({})), of(json!({ "extensions": { "KHR_materials_unlit": {} } }))],
        ),
        Case::of_scene(
            ["two-sided surface", "`double_sided` of a material; glTF's `doubleSided`"],
            look([0.0, 1.8, 2.6], [0.0, -0.2, 0.0], 42.0),
            [bowl(false), bowl(true)],
        ),
        Case::of_scene(
            ["vertex colours × texture", "colours of vertices beside `map_Kd`"],
            look([0.5, 0.3, 4.4], [0.0; 3], 45.0),
            [tinted(false), tinted(true)],
        ),
        Case::of_setting(
            ["clip boxes", "`clip_boxes=*,*,*,0.3,0.2,0.55`"],
            look([0.9, 1.2, 3.0], [0.0; 3], 45.0),
            of_ball(),
            [plain(), cut],
        ),
    ]
}

fn white(shape: Shape) -> Shape {
    Shape { colors: vec![[200, 200, 190, 255]; shape.positions.len()], uvs: Vec::new(), ..shape }
}

/// A square in the plane y = -1.
fn floor(half: f64) -> Shape {
    let corner = DVec3::new(-half, -1.0, half);
    white(Shape::quad(corner, DVec3::X * 2.0 * half, DVec3::NEG_Z * 2.0 * half, 1.0))
}

fn over_floor(lights: Value) -> Scene {
    Scene {
        files: vec![("floor.ply", floor(4.0).ply()), ("ball.ply", Shape::ball(24, 0.9).ply())],
        description: json!({
            "assets": { "floor": { "file": "floor.ply" }, "ball": { "file": "ball.ply" } },
            "nodes": [{ "asset": "floor" }, { "asset": "ball", "translate": [0, 0.2, 0] }],
            "lights": lights, "background": "#304050",
        }),
    }
}

/// Two rows of balls into the distance, in a scene with these keys.
fn avenue(more: &Value) -> Scene {
    let mut scene = over_floor(json!([{ "kind": "ambient", "intensity": 0.3 },
        { "kind": "sun", "direction": [0.3, -1, -0.6], "intensity": 0.8 }]));
    scene.files[0].1 = floor(40.0).ply();
    scene.description["nodes"][1] = json!({ "asset": "ball", "translate": [-1.2, 0, -13],
        "repeat": { "grid": [2, 1, 5], "step": [2.4, 0, 3] } });
    merge(&mut scene.description, more);
    scene
}

/// A ball that reflects by Phong's model.
fn of_ball() -> Scene {
    let mut scene = over_floor(json!([{ "kind": "ambient", "intensity": 0.3 },
        { "kind": "sun", "direction": [1, -1, -0.5], "intensity": 0.8 }]));
    scene.description["assets"] = json!({ "ball": { "file": "ball.ply" } });
    scene.description["nodes"] = json!([{ "asset": "ball" }]);
    scene
}

/// A blue sky over a brown ground, with a warm lamp four times as bright as white.
fn sky() -> anyhow::Result<Vec<u8>> {
    let (width, height) = (128u32, 64u32);
    let pixel = |i: u32| {
        let turn = TAU * ((f64::from(i % width) + 0.5) / f64::from(width) - 0.5);
        let down = PI * (f64::from(i / width) + 0.5) / f64::from(height);
        let way = DVec3::new(down.sin() * turn.sin(), down.cos(), -down.sin() * turn.cos());
        let up = 0.5 + 0.5 * way.y;
        let lamp = 4.0 * (-(way - DVec3::new(0.64, 0.48, 0.6)).length_squared() / 0.06).exp();
        let [ground, sky] = [[0.25, 0.2, 0.12], [0.15, 0.35, 0.8]].map(DVec3::from);
        let light = ground.lerp(sky, up) + lamp * DVec3::new(1.0, 0.8, 0.5);
        image::Rgb(light.as_vec3().to_array())
    };
    let pixels: Vec<image::Rgb<f32>> = (0..width * height).map(pixel).collect();
    let mut bytes = Vec::new();
    let encoder = image::codecs::hdr::HdrEncoder::new(&mut bytes);
    encoder.encode(&pixels, width as usize, height as usize)?;
    Ok(bytes)
}

/// The material that effects of surfaces change.
fn clay() -> Value {
    json!({ "doubleSided": true, "pbrMetallicRoughness": {
        "baseColorFactor": [0.8, 0.6, 0.4, 1], "metallicFactor": 0, "roughnessFactor": 0.6 } })
}

/// A ball and a sheet of clay with what `change` makes of it, before a checkered wall or the background.
fn surface(has_wall: bool, change: impl FnOnce(&mut Glb) -> Value) -> Scene {
    let mut glb = Glb::new();
    let changes = change(&mut glb);
    let material = glb.material(merged(&clay(), &changes));
    let ball = glb.mesh(&Shape::ball(40, 0.62), Some(material));
    let sheet = Shape::quad(DVec3::new(0.1, -0.6, 0.0), DVec3::X * 1.2, DVec3::Y * 1.2, 1.0);
    let sheet = glb.mesh(&sheet, Some(material));
    glb.node(ball, json!({ "translation": [-0.7, 0, 0] }));
    glb.node(sheet, json!({}));
    if has_wall {
        let even = |x: u32, y: u32| (x + y).is_multiple_of(2);
        let checks =
            picture(8, 8, |x, y| if even(x, y) { [240, 90, 40, 255] } else { [30, 60, 200, 255] });
        let checks = glb.texture(&checks, json!({}));
        let wall = glb.material(json!({ "pbrMetallicRoughness": { "baseColorTexture": { "index": checks }, "metallicFactor": 0 } }));
        let shape = Shape::quad(DVec3::new(-1.2, -0.9, -1.0), DVec3::X * 2.4, DVec3::Y * 1.8, 1.0);
        let wall = glb.mesh(&shape, Some(wall));
        glb.node(wall, json!({}));
    }
    of_glb(glb)
}

fn of_glb(glb: Glb) -> Scene {
    let lights = json!([{ "kind": "sun", "direction": [-0.4, -1, -0.8], "intensity": 1.1 },
        { "kind": "headlight", "intensity": 0.3 }, { "kind": "ambient", "color": "#aaccff", "intensity": 0.4 }]);
    Scene {
        files: vec![("m.glb", glb.finish())],
        description: json!({ "assets": { "m": { "file": "m.glb" } }, "nodes": [{ "asset": "m" }],
            "lights": lights, "background": "#304050" }),
    }
}

/// Adds a texture that is interpolated between its texels.
fn smooth(glb: &mut Glb, side: u32, texel: impl Fn(u32, u32) -> [u8; 4]) -> usize {
    glb.texture(&picture(side, side, texel), json!({ "magFilter": 9729 }))
}

fn bumps(glb: &mut Glb) -> Value {
    let wave = |x: u32, period: f64| (f64::from(x) * TAU / period).sin();
    let bumps = smooth(glb, 32, |x, y| {
        let normal =
            DVec3::new(0.6 * wave(x, 16.0), 0.4 * wave(y, 8.0), 1.0).normalize_or(DVec3::Z);
        let [r, g, b] = normal.to_array().map(|value| (127.5 + 127.5 * value).round() as u8);
        [r, g, b, 255]
    });
    json!({ "normalTexture": { "index": bumps, "scale": 0.8 } })
}

fn glow(glb: &mut Glb) -> Value {
    let glow =
        smooth(
            glb,
            16,
            |x, y| {
                if x % 8 < 3 && y % 8 < 3 { [255, 120, 30, 255] } else { [0, 0, 0, 255] }
            },
        );
    json!({ "emissiveFactor": [1, 0.8, 0.9], "emissiveTexture": { "index": glow },
        "extensions": { "KHR_materials_emissive_strength": { "emissiveStrength": 1.5 } } })
}

fn folds(glb: &mut Glb) -> Value {
    let folds = smooth(glb, 16, |x, y| {
        let open = if (x / 4 + y / 4).is_multiple_of(2) { 40 } else { 255 };
        [open, 255, 0, 255]
    });
    json!({ "occlusionTexture": { "index": folds } })
}

/// A textured sheet whose corners have colours, or not.
fn tinted(has_colors: bool) -> Scene {
    const TINTS: [[f64; 3]; 4] = [[1.0, 0.3, 0.3], [0.3, 1.0, 0.3], [0.3, 0.3, 1.0], [1.0; 3]];
    let sheet = Shape::quad(DVec3::new(-2.0, -1.5, 0.0), DVec3::X * 4.0, DVec3::Y * 3.0, 1.0);
    let mut text = "mtllib m.mtl\nusemtl t\n".to_owned();
    for ((place, [s, t]), [r, g, b]) in sheet.positions.iter().zip(&sheet.uvs).zip(TINTS) {
        let tint = if has_colors { format!(" {r} {g} {b}") } else { String::new() };
        text += &format!("v {} {} {}{tint}\nvt {s} {t}\n", place.x, place.y, place.z);
    }
    text += "f 1/1 2/2 3/3\nf 1/1 3/3 4/4\n";
    let ramp = picture(24, 24, |x, y| {
        let check = if (x / 3 + y / 3).is_multiple_of(2) { 110 } else { 0 };
        [(100 + 6 * x) as u8, (100 + 6 * y) as u8, 130 + check, 255]
    });
    Scene {
        files: vec![
            ("m.obj", text.into_bytes()),
            ("m.mtl", b"newmtl t\nKd 1 1 1\nmap_Kd t.png\n".to_vec()),
            ("t.png", ramp),
        ],
        description: json!({ "assets": { "m": { "file": "m.obj" } }, "nodes": [{ "asset": "m" }],
            "lights": [], "background": "#304050" }),
    }
}

fn merged(base: &Value, more: &Value) -> Value {
    let mut all = base.clone();
    merge(&mut all, more);
    all
}

/// Lays the keys of one object over those of another, level by level.
fn merge(to: &mut Value, from: &Value) {
    match (to, from) {
        (Value::Object(to), Value::Object(from)) => {
            for (key, value) in from {
                merge(to.entry(key).or_insert(Value::Null), value);
            }
        }
        (to, from) => *to = from.clone(),
    }
}
