//! Scene files in, scenes and refusals out.

mod properties;
mod solids;

use std::path::PathBuf;

use glam::DVec3;

use super::*;

/// A folder with the empty files `a.ply`, `b.ply` and `sub/c.ply`.
pub(super) struct Folder {
    _keep: tempfile::TempDir,
    pub root: PathBuf,
}

impl Folder {
    pub fn new() -> Folder {
        let keep = tempfile::tempdir().unwrap();
        let root = keep.path().canonicalize().unwrap();
        std::fs::create_dir(root.join("sub")).unwrap();
        for file in ["a.ply", "b.ply", "sub/c.ply"] {
            std::fs::write(root.join(file), "").unwrap();
        }
        Folder { _keep: keep, root }
    }

    pub fn parse(&self, text: &str) -> Result<Scene, SceneError> {
        parse(text, "test.json", &self.root, &self.root, &SceneLimits::default())
    }

    /// Path and reason of a refusal.
    fn refused(&self, text: &str) -> (String, String) {
        match self.parse(text) {
            Err(SceneError::Invalid { file, path, reason }) => {
                assert_eq!(file, "test.json");
                (path, reason)
            }
            other => panic!("expected a refusal of {text}, got {other:?}"),
        }
    }

    /// Asserts that `nodes` (JSON) is refused at `path` with `words` in the reason.
    fn assert_refused(&self, text: &str, path: &str, words: &str) {
        let (found_path, reason) = self.refused(text);
        assert_eq!(found_path, path, "{text}: {reason}");
        assert!(reason.contains(words), "{text}: {reason}");
    }
}

fn file_of(scene: &Scene, asset: usize) -> PathBuf {
    match &scene.assets[asset].source {
        AssetSource::File(file) => file.path.clone(),
        AssetSource::Solid(_) => panic!("asset {asset} is no file"),
    }
}

fn with_nodes(nodes: &str) -> String {
    format!(r#"{{"assets": {{"a": {{"file": "a.ply"}}}}, "nodes": {nodes}}}"#)
}

#[test]
fn the_smallest_scene() {
    let scene = Folder::new().parse(&with_nodes(r#"[{"asset": "a"}]"#)).unwrap();
    assert_eq!(scene.lights, Light::default_pair());
    assert_eq!(scene.up, DVec3::Y);
    assert_eq!(scene.instances().len(), 1);
    assert_eq!(scene.name, "test.json");
    let grey = color::linear_from_srgb(f64::from(0x24) / 255.0) as f32;
    assert_eq!(scene.background[1], grey);
    let bare = Scene::from_asset("a", file_of(&scene, 0));
    assert_eq!(bare.instances(), scene.instances());
    assert_eq!((bare.background, bare.lights), (scene.background, scene.lights));
}

#[test]
fn everything_at_once() {
    let text = r##"{ "pointillist": 1, "name": "plaza", "up": "z", "background": "#00000000",
        "assets": { "b": { "file": "./sub/../b.ply" }, "a": { "file": "sub/c.ply" } },
        "prototypes": { "pair": { "children": [
            { "asset": "a" }, { "asset": "b", "translate": [0, 0, 2], "scale": 0.5, "material": "red" } ] } },
        "materials": { "red": { "color": [1, 0, 0], "specular": "#fff", "shininess": 20, "unlit": true } },
        "nodes": [ { "name": "n", "prototype": "pair", "rotate": [0, 0, 90], "translate": [10, 0, 0],
                     "repeat": { "grid": [2, 1, 1], "step": [4, 0, 0] } },
                   { "name": "off", "asset": "a", "visible": false } ],
        "lights": [ { "kind": "sun", "direction": [0, 0, -2], "color": "#fff", "intensity": 2, "shadows": true, "angle": 2 },
                    { "kind": "point", "position": [1, 2, 3], "range": 5 }, { "kind": "ambient" } ],
        "cameras": { "z": { "eye": [0, 1, 3], "target": [0, 0, 0] }, "a": { "eye": [1, 1, 3], "target": [0, 0, 0], "fov": 60, "up": "x" } },
        "paths": { "fly": { "keys": [ { "t": 0, "eye": [0, 1, 9], "target": [0, 0, 0] }, { "t": 4, "eye": [9, 1, 0], "target": [0, 0, 0] } ] } } }"##;
    let folder = Folder::new();
    let scene = folder.parse(text).unwrap();
    assert_eq!(file_of(&scene, 1), folder.root.join("sub/c.ply"));
    assert_eq!(scene.cameras.iter().map(|c| c.0.as_str()).collect::<Vec<_>>(), ["z", "a"]);
    assert_eq!((scene.cameras[0].1.up, scene.cameras[0].1.lens.fov_deg()), (DVec3::Z, Some(40.0)));
    assert_eq!((scene.cameras[1].1.up, scene.cameras[1].1.lens.fov_deg()), (DVec3::X, Some(60.0)));
    let fly = &scene.paths[0].1;
    assert_eq!((fly.keys[1].t, fly.fps, fly.interpolation), (4.0, 30.0, Interpolation::CatmullRom));
    assert_eq!((fly.keys[0].ease, fly.keys[0].camera.up), (Ease::Smooth, DVec3::Z));
    assert_eq!(scene.background, [0.0; 4]);
    assert_eq!(
        scene.lights[0],
        Light::Sun { direction: DVec3::NEG_Z, color: [2.0; 3], shadows: Some(2.0) }
    );
    let found = scene.instances();
    assert_eq!(found.len(), 4);
    assert_eq!(scene.instance_count(), 4);
    assert_eq!(found.iter().map(|i| i.asset).collect::<Vec<_>>(), [1, 0, 1, 0]);
    assert_eq!(found[3].material, Some(0));
    assert_eq!(found[3].world_from_asset.transform_point3(DVec3::X), DVec3::new(12.0, 0.5, 2.0));
    assert_eq!(found[0].world_from_asset.translation, DVec3::new(8.0, 0.0, 0.0));
}

#[test]
fn euler_angles_turn_about_x_then_y_then_z() {
    let scene = Folder::new()
        .parse(&with_nodes(r#"[{"asset": "a", "rotate": [90, 90, 0]}, {"asset": "a", "quaternion": [0, 0, 2, 2]}]"#))
        .unwrap();
    let found = scene.instances();
    // Y → Z by the turn about x, Z → X by the turn about y.
    assert_eq!(found[0].world_from_asset.transform_vector3(DVec3::Y), DVec3::X);
    let turned = found[1].world_from_asset.transform_vector3(DVec3::X);
    assert!((turned - DVec3::Y).length() < 1e-15);
}

#[test]
fn matrices_are_column_major() {
    let text = r#"[{"asset": "a", "matrix": [0,2,0,0, -2,0,0,0, 0,0,2,0, 5,6,7,1]}]"#;
    let scene = Folder::new().parse(&with_nodes(text)).unwrap();
    let map = scene.instances()[0].world_from_asset;
    assert_eq!(map.transform_point3(DVec3::X), DVec3::new(5.0, 8.0, 7.0));
}

#[test]
fn scatter_is_seeded_bounded_and_keeps_its_place() {
    let node = r#"[{"asset": "a", "translate": [100, 0, 0], "repeat":
        {"scatter": 500, "half_extent": [10, 0, 5], "scale": [0.5, 2], "turn": true, "seed": 3}}]"#;
    let folder = Folder::new();
    let first = folder.parse(&with_nodes(node)).unwrap().instances();
    assert_eq!(first, folder.parse(&with_nodes(node)).unwrap().instances());
    let other = folder.parse(&with_nodes(&node.replace("\"seed\": 3", "\"seed\": 4"))).unwrap();
    assert_ne!(first, other.instances());
    let mut mean = DVec3::ZERO;
    for instance in &first {
        let p = instance.world_from_asset.translation - DVec3::new(100.0, 0.0, 0.0);
        assert!(p.x.abs() <= 10.0 && p.y == 0.0 && p.z.abs() <= 5.0);
        let scale = instance.world_from_asset.matrix3.determinant().cbrt();
        assert!((0.5..=2.0).contains(&scale));
        mean += p / 500.0;
    }
    assert!(mean.length() < 1.0, "{mean}");
}

/// The numbers that a given seed gives are part of the format.
#[test]
fn scatter_never_changes() {
    let node = r#"[{"asset": "a", "repeat": {"scatter": 2, "half_extent": [1, 1, 1], "seed": 1}}]"#;
    let found = Folder::new().parse(&with_nodes(node)).unwrap().instances();
    let mut random = random::SplitMix64::new(1);
    for instance in found {
        let expected = DVec3::from_array([(); 3].map(|()| random.range(-1.0, 1.0)));
        assert_eq!(instance.world_from_asset.translation, expected);
        random.unit();
        random.unit();
    }
}

#[test]
fn refusals_name_the_place() {
    let f = Folder::new();
    let nodes = |n: &str, path: &str, words: &str| f.assert_refused(&with_nodes(n), path, words);
    nodes(
        r#"[{}, {"children": [{"asset": "a", "repeat": {"grid": [1, 0, 1], "step": [1, 1, 1]}}]}]"#,
        "nodes[1].children[0].repeat.grid[1]",
        "must be at least 1",
    );
    nodes(r#"[{"asset": "b"}]"#, "nodes[0].asset", "there is no asset `b`; did you mean `a`?");
    nodes(r#"[{"prototype": "b"}]"#, "nodes[0].prototype", "the scene names no prototype");
    nodes(r#"[{"asset": "a", "prototype": "b"}]"#, "nodes[0]", "only one");
    nodes(r#"[{"asset": "a", "translate": [0, 1]}]"#, "nodes[0].translate", "found 2 elements");
    nodes(r#"[{"translate": [0, 1, 1e13]}]"#, "nodes[0].translate[2]", "lies outside");
    nodes(r#"[{"translate": [0, 1, 1e999]}]"#, "nodes[0].translate[2]", "out of range");
    nodes(r#"[{"translate": [0, 1, "2"]}]"#, "nodes[0].translate[2]", "expected a number");
    nodes(r#"[{"scale": 0}]"#, "nodes[0].scale", "flattens");
    nodes(r#"[{"scale": [1, 1, 0]}]"#, "nodes[0].scale[2]", "flattens");
    nodes(r#"[{"scale": [1, 1, 1, 1]}]"#, "nodes[0].scale", "expected a number or three");
    nodes(r#"[{"quaternion": [0, 0, 0, 0]}]"#, "nodes[0].quaternion", "zero");
    nodes(
        r#"[{"quaternion": [0, 0, 0, 1], "rotate": [0, 0, 0]}]"#,
        "nodes[0].quaternion",
        "beside",
    );
    nodes(
        r#"[{"matrix": [1,0,0,1, 0,1,0,0, 0,0,1,0, 0,0,0,1]}]"#,
        "nodes[0].matrix[3]",
        "last row",
    );
    nodes(r#"[{"matrix": [1,0,0,0, 0,1,0,0, 1,1,0,0, 0,0,0,1]}]"#, "nodes[0].matrix", "flattens");
    nodes(
        r#"[{"matrix": [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1], "scale": 2}]"#,
        "nodes[0].scale",
        "beside `matrix`",
    );
    nodes(r#"[{"repeat": {}}]"#, "nodes[0].repeat", "needs `grid`");
    nodes(r#"[{"repeat": {"grid": [1,1,1]}}]"#, "nodes[0].repeat", "needs `step`");
    nodes(
        r#"[{"repeat": {"grid": [1,1,1], "step": [1,1,1], "seed": 1}}]"#,
        "nodes[0].repeat.seed",
        "beside `grid`",
    );
    nodes(
        r#"[{"repeat": {"scatter": 1, "half_extent": [1,1,-1]}}]"#,
        "nodes[0].repeat.half_extent[2]",
        "outside",
    );
    nodes(
        r#"[{"name": "x"}, {"name": "y"}, {"name": "x"}]"#,
        "nodes[2].name",
        "nodes[0] is already called `x`",
    );
}

#[test]
fn refusals_beyond_nodes() {
    let f = Folder::new();
    let top = |more: &str, path: &str, words: &str| {
        let text = format!(r#"{{"assets": {{"a": {{"file": "a.ply"}}}}, "nodes": [], {more}}}"#);
        f.assert_refused(&text, path, words);
    };
    top(r#""pointillist": 2"#, "pointillist", "version 2");
    top(r#""up": "w""#, "up", "`w` is no axis");
    top(r#""up": [0, 0, 0]"#, "up", "zero");
    top(r#""background": "blue""#, "background", "#rrggbb");
    top(r#""subject": [[0, 0, 0], [1, -1, 1]]"#, "subject", "must not exceed");
    top(r#""subject": [[1, 1, 1], [1, 1, 1]]"#, "subject", "must differ");
    top(r#""subject": [[0, 0, 0], [1, 1, 1e300]]"#, "subject[1][2]", "outside");
    top(r#""background": [1, 2, 0]"#, "background[1]", "outside 0..=1");
    let fog = |rest: &str| format!(r##""fog": {{"color": "#fff"{rest}}}"##);
    top(&fog(""), "fog", "missing field `density`");
    top(&fog(r#", "density": -0.1"#), "fog.density", "outside 0..=1000000000");
    top(&fog(r#", "density": 1e-13"#), "fog.density", "outside 0.000000000001..=1000000000");
    top(&fog(r#", "density": 1, "height": 2"#), "fog.height", "`base_height`");
    top(&fog(r#", "density": 1, "scale_height": 0"#), "fog.scale_height", "0 lies outside");
    top(&fog(r#", "density": 1, "base_height": 2"#), "fog.base_height", "`scale_height`");
    top(r#""fog": {"color": "red", "density": 1}"#, "fog.color", "#rrggbb");
    let occlusion = |rest: &str| format!(r#""ambient_occlusion": {{{rest}}}"#);
    top(&occlusion(""), "ambient_occlusion", "missing field `radius`");
    top(&occlusion(r#""radius": 0"#), "ambient_occlusion.radius", "0 lies outside");
    top(&occlusion(r#""radius": 1, "strength": 2"#), "ambient_occlusion.strength", "outside 0..=1");
    top(r#""lights": [{"kind": "sun"}]"#, "lights[0]", "needs `direction`");
    top(
        r#""lights": [{"kind": "sum", "direction": [0,0,1]}]"#,
        "lights[0].kind",
        "did you mean `sun`?",
    );
    top(r#""lights": [{"kind": "ambient", "shadows": true}]"#, "lights[0].shadows", "only suns");
    let sun = |rest: &str| format!(r#"{{"kind": "sun", "direction": [0, -1, 0]{rest}}}"#);
    let lights = |suns: &[String]| format!(r#""lights": [{}]"#, suns.join(", "));
    top(&lights(&[sun(r#", "angle": 1"#)]), "lights[0].angle", "softens shadows");
    top(&lights(&[sun(r#", "shadows": true, "angle": 21"#)]), "lights[0].angle", "outside 0..=20");
    let lamp =
        |rest: &str| format!(r#"{{"kind": "point", "position": [0, 0, 0], "range": 1{rest}}}"#);
    top(&lights(&[lamp(r#", "radius": 1"#)]), "lights[0].radius", "softens shadows");
    top(&lights(&[lamp(r#", "shadows": true, "angle": 1"#)]), "lights[0].angle", "only a sun");
    top(&lights(&[sun(r#", "shadows": true, "radius": 1"#)]), "lights[0].radius", "a point light");
    top(&lights(&[lamp(r#", "shadows": true, "radius": -1"#)]), "lights[0].radius", "outside");
    let casting = vec![sun(r#", "shadows": true"#); 5];
    top(&lights(&casting), "lights", "5 lights cast shadows, 4 are possible");
    top(r#""lights": [{"kind": "ambient", "range": 1}]"#, "lights[0].range", "a point light");
    top(
        r#""lights": [{"kind": "point", "position": [0,0,0], "range": 0}]"#,
        "lights[0].range",
        "outside",
    );
    top(r#""lights": [{"kind": "ambient", "intensity": -1}]"#, "lights[0].intensity", "outside");
    top(r#""materials": {"m": {"shininess": 0}}"#, "materials.m.shininess", "outside");
    top(r#""materials": {"m": {"metallic": 1.5}}"#, "materials.m.metallic", "outside");
    top(r#""materials": {"m": {"roughness": -0.1}}"#, "materials.m.roughness", "outside");
    let both = r#""materials": {"m": {"metallic": 1, "shininess": 20}}"#;
    top(both, "materials.m.shininess", "different models");
    let alone = r#""materials": {"m": {"emissive_strength": 2}}"#;
    top(alone, "materials.m.emissive_strength", "emissive");
    top(r#""cameras": {"c": {"eye": [0,0,0], "target": [0,0,0]}}"#, "cameras.c.target", "differ");
    top(
        r#""cameras": {"c": {"eye": [0,0,0], "target": [0,0,1], "fov": 180}}"#,
        "cameras.c.fov",
        "180",
    );
    top(r#""cameras": {"c": {"eye": [0,0,0]}}"#, "cameras.c", "missing field `target`");
    top(r#""paths": {"p": {"keys": []}}"#, "paths.p.keys", "at least one");
    top(
        r#""paths": {"p": {"keys": [{"t": 1, "eye": [0,0,0], "target": [0,0,1]}, {"t": 1, "eye": [0,0,0], "target": [0,0,1]}]}}"#,
        "paths.p.keys[1].t",
        "later",
    );
}

#[test]
fn paths_in_files_of_their_own() {
    let text = r#"{ "fps": 12, "interpolation": "linear", "keys": [
        { "t": 0, "eye": [0, 0, 5], "target": [0, 0, 0] },
        { "t": 1, "eye": [5, 0, 0], "target": [0, 0, 0], "ease": "in_out", "up": [0, 1, 0], "fov": 60 } ] }"#;
    let path = parse_path(text, "cam.json", DVec3::Z).unwrap();
    assert_eq!((path.fps, path.interpolation), (12.0, Interpolation::Linear));
    assert_eq!((path.keys[0].ease, path.keys[1].ease), (Ease::Linear, Ease::InOut));
    let cameras = [path.keys[0].camera, path.keys[1].camera];
    assert_eq!((cameras[0].up, cameras[0].lens.fov_deg()), (DVec3::Z, Some(40.0)));
    assert_eq!((cameras[1].up, cameras[1].lens.fov_deg()), (DVec3::Y, Some(60.0)));
    for (from, to, expected) in [
        ("linear", "bezier", "cam.json: interpolation: unknown value `bezier`"),
        ("in_out", "inout", "cam.json: keys[1].ease: unknown value `inout` at line 3 column"),
        ("in_out", "inout", "did you mean `in_out`?"),
        ("fov", "fow", "did you mean `fov`?"),
        ("60 }", "60, \"ortho_height\": 2 }", "either `fov` or `ortho_height`"),
        ("\"fov\": 60", "\"ortho_height\": 2", "all keys of a path need one projection"),
        ("\"t\": 1", "\"t\": -1", "cam.json: keys[1].t: -1 s must be later"),
        ("[5, 0, 0]", "[0, 0, 0]", "cam.json: keys[1].target: must differ from eye"),
    ] {
        let refused = parse_path(&text.replace(from, to), "cam.json", DVec3::Z).unwrap_err();
        assert!(refused.to_string().contains(expected), "{refused}");
    }
    let f = Folder::new();
    let file = f.root.join("cam.json");
    std::fs::write(&file, text).unwrap();
    let limits = SceneLimits::default();
    assert_eq!(load_path(&file, DVec3::Z, &limits).unwrap(), path);
    let small = SceneLimits { max_json_bytes: 10, ..limits };
    assert!(matches!(load_path(&file, DVec3::Z, &small), Err(SceneError::TooLarge { .. })));
    let schema = path_json_schema();
    assert_eq!(schema["required"], serde_json::json!(["keys"]));
    assert_eq!(schema["additionalProperties"], false);
}

#[test]
fn unknown_and_repeated_keys() {
    let f = Folder::new();
    let (path, reason) = f.refused(r#"{"assets": {}, "nodes": [{"colour": 1, "rotat": [0,0,0]}]}"#);
    assert!(path.starts_with("nodes[0]"), "{path}");
    assert!(reason.contains("unknown key `colour`") && reason.contains("known are"), "{reason}");
    let (_, reason) = f.refused(r#"{"assets": {}, "nodes": [{"rotat": [0,0,0]}]}"#);
    assert!(reason.contains("did you mean `rotate`?") && reason.contains("line 1"), "{reason}");
    let (_, reason) = f.refused(r#"{"asets": {}, "nodes": []}"#);
    assert!(reason.contains("did you mean `assets`?"), "{reason}");
    let (_, reason) = f.refused(r#"{"assets": {}, "nodes": [], "`, expected `x` or `y": 1}"#);
    assert!(reason.contains("unknown key"), "{reason}");
    let twice = r#"{"assets": {"a": {"file": "a.ply"}, "a": {"file": "b.ply"}}, "nodes": []}"#;
    let (path, reason) = f.refused(twice);
    assert!(path.starts_with("assets") && reason.contains("duplicate key `a`"), "{path} {reason}");
    let (path, reason) = f.refused(r#"{"assets": {}, "nodes": [{"scale": 1, "scale": 2}]}"#);
    assert!(path.starts_with("nodes[0]") && reason.contains("duplicate field `scale`"), "{reason}");
    let (_, reason) = f.refused(r#"{"assets": {}, "nodes": []} x"#);
    assert!(reason.contains("trailing"), "{reason}");
    f.assert_refused("", "$", "EOF");
    f.assert_refused("[1, 2]", "$", "expected an object");
    f.assert_refused(r#"{"assets": {"a": ["a.ply"]}, "nodes": []}"#, "assets.a", "an object");
    f.assert_refused(r#"{"assets": {}, "nodes": [["name"]]}"#, "nodes[0]", "expected an object");
}

#[test]
fn files_stay_inside_the_root() {
    let f = Folder::new();
    let file = |name: &str, words: &str| {
        let json = serde_json::Value::String(name.to_owned());
        let text = format!(r#"{{"assets": {{"m": {{"file": {json}}}}}, "nodes": []}}"#);
        f.assert_refused(&text, "assets.m.file", words);
        f.refused(&text).1
    };
    assert!(!file("missing.ply", "there is no file `missing.ply`").contains("tmp"));
    file("../a.ply", "leads out");
    file("sub/../../etc/passwd", "leads out");
    file("/etc/passwd", "absolute");
    file("http://example.org/a.ply", "address");
    file("", "must name a file");
    file("a\0.ply", "NUL");
    file("sub", "not a file");
    let outside = tempfile::NamedTempFile::new().unwrap();
    std::os::unix::fs::symlink(outside.path(), f.root.join("link.ply")).unwrap();
    file("link.ply", "leads out");
    std::os::unix::fs::symlink("a.ply", f.root.join("inside.ply")).unwrap();
    let ok = r#"{"assets": {"m": {"file": "inside.ply"}}, "nodes": []}"#;
    assert_eq!(file_of(&f.parse(ok).unwrap(), 0), f.root.join("a.ply"));
    // From a scene in a sub-folder, the way up is open as far as the root.
    let up = r#"{"assets": {"m": {"file": "../a.ply"}}, "nodes": []}"#;
    let limits = SceneLimits::default();
    assert!(parse(up, "s", &f.root.join("sub"), &f.root, &limits).is_ok());
    assert!(parse(up, "s", &f.root.join("sub"), &f.root.join("sub"), &limits).is_err());
}

#[test]
fn loading_from_disk() {
    let f = Folder::new();
    let limits = SceneLimits::default();
    let path = f.root.join("sub/one.json");
    std::fs::write(&path, "\u{feff}{\"assets\": {\"c\": {\"file\": \"c.ply\"}}, \"nodes\": []}")
        .unwrap();
    assert_eq!(load(&path, &f.root, &limits).unwrap().name, "one");
    let small = SceneLimits { max_json_bytes: 10, ..limits.clone() };
    assert!(matches!(load(&path, &f.root, &small), Err(SceneError::TooLarge { .. })));
    let missing = load(&f.root.join("none.json"), &f.root, &limits).unwrap_err();
    assert!(missing.to_string().contains("none.json"), "{missing}");
    std::fs::write(f.root.join("bad.json"), b"{\xff}").unwrap();
    let bad = load(&f.root.join("bad.json"), &f.root, &limits).unwrap_err();
    assert!(bad.to_string().contains("not UTF-8 text: byte 1"), "{bad}");
    let outside = load(&path, &f.root.join("sub"), &limits);
    assert!(outside.is_ok());
    let other = Folder::new();
    let refused = load(&path, &other.root, &limits).unwrap_err();
    assert!(refused.to_string().contains("outside the scene root"), "{refused}");
}

#[test]
fn the_schema_describes_the_format() {
    let schema = json_schema();
    assert_eq!(schema["additionalProperties"], serde_json::Value::Bool(false));
    let required: Vec<_> = schema["required"].as_array().unwrap().iter().collect();
    assert_eq!(required.len(), 2, "{required:?}");
    for key in
        ["assets", "nodes", "prototypes", "materials", "lights", "cameras", "paths", "up", "splats"]
    {
        assert!(schema["properties"][key].is_object(), "{key}");
    }
    assert!(schema["$defs"]["NodeWire"]["properties"]["quaternion"].is_object());
}

/// A chain of `length` prototypes, each drawing the next twice, the last an asset.
fn doubling_chain(length: usize) -> String {
    let mut prototypes = vec![r#""p0": {"children": [{"asset": "a"}]}"#.to_owned()];
    for i in 1..length {
        let below = format!(r#"{{"prototype": "p{}"}}"#, i - 1);
        prototypes.push(format!(r#""p{i}": {{"children": [{below}, {below}]}}"#));
    }
    format!(
        r#"{{"assets": {{"a": {{"file": "a.ply"}}}}, "prototypes": {{{}}}, "nodes": [{{"prototype": "p{}"}}]}}"#,
        prototypes.join(", "),
        length - 1
    )
}

#[test]
fn limits_are_counted_without_unfolding() {
    let f = Folder::new();
    assert_eq!(f.parse(&doubling_chain(11)).unwrap().instances().len(), 1024);
    match f.parse(&doubling_chain(63)) {
        Err(SceneError::TooLarge { what: "instances", found, .. }) => assert_eq!(found, 1 << 62),
        other => panic!("{other:?}"),
    }
    match f.parse(&doubling_chain(64)) {
        Err(SceneError::TooLarge { what: "depth of nodes", found: 65, limit: 64, .. }) => {}
        other => panic!("{other:?}"),
    }
    let grid = r#"[{"asset": "a", "repeat": {"grid": [4000000000, 4000000000, 4000000000], "step": [0, 0, 0]}}]"#;
    match f.parse(&with_nodes(grid)) {
        Err(SceneError::TooLarge { what: "instances", found: u64::MAX, .. }) => {}
        other => panic!("{other:?}"),
    }
    let few = SceneLimits { max_nodes: 2, ..SceneLimits::default() };
    let three = parse(&with_nodes("[{}, {\"children\": [{}]}]"), "t", &f.root, &f.root, &few);
    assert!(matches!(three, Err(SceneError::TooLarge { what: "nodes", found: 3, limit: 2, .. })));
}

/// Subtrees that draw nothing cost nothing, however often they are repeated.
#[test]
fn empty_repeats_are_free() {
    let text = r#"[{"repeat": {"grid": [4000000000, 4000000000, 1], "step": [0, 0, 0]}, "children": [{}]},
        {"repeat": {"grid": [4000000000, 1, 1], "step": [0, 0, 0]}, "children": []}, {"asset": "a"}]"#;
    assert_eq!(Folder::new().parse(&with_nodes(text)).unwrap().instances().len(), 1);
    // An exponential tree of prototypes whose leaves draw nothing.
    let text = doubling_chain(60).replace(r#"{"asset": "a"}"#, "{}");
    assert_eq!(Folder::new().parse(&text).unwrap().instances().len(), 0);
}

#[test]
fn deep_chains_are_fine_deeper_ones_are_refused() {
    let f = Folder::new();
    let chain = |length: usize| {
        let mut prototypes =
            vec![r#""p0": {"children": [{"asset": "a", "translate": [1, 0, 0]}]}"#.to_owned()];
        for i in 1..length {
            prototypes.push(format!(
                r#""p{i}": {{"children": [{{"prototype": "p{}", "translate": [1, 0, 0]}}]}}"#,
                i - 1
            ));
        }
        format!(
            r#"{{"assets": {{"a": {{"file": "a.ply"}}}}, "prototypes": {{{}}}, "nodes": [{{"prototype": "p{}"}}]}}"#,
            prototypes.join(", "),
            length - 1
        )
    };
    let deep = f.parse(&chain(63)).unwrap().instances();
    assert_eq!(deep[0].world_from_asset.translation, DVec3::new(63.0, 0.0, 0.0));
    let found = f.parse(&chain(20_000)).unwrap_err();
    assert!(
        matches!(found, SceneError::TooLarge { what: "depth of nodes", found: 20_001, .. }),
        "{found}"
    );
    let nested = |levels: usize| {
        with_nodes(&format!("{}{}{}", "[{\"children\":".repeat(levels), "[]", "}]".repeat(levels)))
    };
    assert!(f.parse(&nested(60)).is_ok());
    let (_, reason) = f.refused(&nested(100_000));
    assert!(reason.contains("prototypes"), "{reason}");
}

#[test]
fn cycles_are_printed() {
    let f = Folder::new();
    let text = r#"{"assets": {}, "nodes": [], "prototypes": {
        "lone": {"children": []}, "x": {"children": [{"prototype": "a"}]},
        "a": {"children": [{"prototype": "lone"}, {"children": [{"prototype": "b"}]}]},
        "b": {"children": [{"prototype": "c"}]}, "c": {"children": [{"prototype": "a"}]}}}"#;
    f.assert_refused(text, "prototypes.a", "contains itself: a → b → c → a");
    let own =
        r#"{"assets": {}, "nodes": [], "prototypes": {"a": {"children": [{"prototype": "a"}]}}}"#;
    f.assert_refused(own, "prototypes.a", "a → a");
}

#[test]
fn invisible_nodes_count_for_limits_alone() {
    let text =
        r#"[{"asset": "a", "visible": false, "children": [{"asset": "a"}]}, {"asset": "a"}]"#;
    let scene = Folder::new().parse(&with_nodes(text)).unwrap();
    assert_eq!(scene.instances().len(), 1);
    assert_eq!(scene.instances()[0].node, 1);
    let f = Folder::new();
    let few = SceneLimits { max_instances: 2, ..SceneLimits::default() };
    assert!(parse(&with_nodes(text), "t", &f.root, &f.root, &few).is_err());
    assert!(file_of(&scene, 0).is_absolute());
}

#[test]
fn limits_are_enforced_before_anything_is_made_of_a_text() {
    let folder = Folder::new();
    // Wrong in every node: a parser would say so first.
    let nodes = format!("[{}{{}}]", r#"{"x": 1},"#.repeat(100_000));
    match folder.parse(&with_nodes(&nodes)) {
        Err(SceneError::TooLarge { what: "nodes", found: 100_001, limit: 100_000, .. }) => {}
        other => panic!("{other:?}"),
    }
    let name = "n".repeat(100_000);
    let long = folder.parse(&with_nodes(&format!(r#"[{{"name": "{name}"}}]"#)));
    assert!(matches!(long, Err(SceneError::TooLarge { found: 100_000, .. })), "{long:?}");
    let operands = format!("[{}]", vec![r#"{"asset": "a"}"#; 1_000_001].join(","));
    let text = format!(r#"{{"assets": {{"a": {{"union": {operands}}}}}, "nodes": []}}"#);
    let many = folder.parse(&text);
    assert!(matches!(many, Err(SceneError::TooLarge { what: "objects in JSON", .. })), "{many:?}");
}

#[test]
fn a_scene_file_is_parsed_within_a_budget() {
    use crate::memory::{Admission, HostMemory, Interrupt};
    let folder = Folder::new();
    let path = folder.root.join("s.json");
    let nodes = vec![r#"{"asset": "a"}"#; 10_000].join(",");
    std::fs::write(&path, with_nodes(&format!("[{nodes}]"))).unwrap();
    let load = |budget| {
        let admission = Admission::new(&HostMemory::new(budget));
        let limits = SceneLimits::default();
        let scene = load_within(&path, None, &folder.root, &limits, &admission);
        (scene, admission.held())
    };
    let (refused, _) = load(1 << 20);
    let is_refused = matches!(refused, Err(SceneError::Interrupted(Interrupt::OutOfMemory(_))));
    assert!(is_refused, "{refused:?}");
    let (scene, held) = load(64 << 20);
    assert_eq!(scene.unwrap().nodes.len(), 10_000);
    // The text and what was parsed are gone; the nodes stay.
    let nodes = 10_000 * size_of::<Node>() as u64;
    assert!((nodes..2 * nodes).contains(&held), "{held} of {nodes}");
    // Files are found from the base, wherever the scene lies.
    let below = folder.root.join("sub/s.json");
    std::fs::rename(&path, &below).unwrap();
    let (base, limits) = (Some(folder.root.as_path()), SceneLimits::default());
    let admission = Admission::default();
    assert!(load_within(&below, None, &folder.root, &limits, &admission).is_err());
    assert!(load_within(&below, base, &folder.root, &limits, &admission).is_ok());
}
