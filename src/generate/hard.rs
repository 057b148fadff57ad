//! `hard`: small scenes of splats and lines, each a corner case that renderers often miss.
//!
//! There is one function per case. `scenes/README.md` says what each may break, and `tests/engine/splats_hard.rs` draws all of
//! them. Samples that differ only in a tilt or a length are copies of one disk, so that the exact number is in the scene file,
//! not rounded to the f32 of a PLY. Ellipses come from scales that differ by axis.

use glam::{DVec3, Vec3};
use serde_json::{Map, Value, json};

use super::plain::{Faces, srgb};
use super::{Generated, GeneratedMesh, GeneratedScene};
use crate::assets::{Mesh, PointCloud, Polylines};
use crate::scene::random::SplitMix64;

/// A colour whose linear channels are 0 and 1, which weighted sums keep exactly.
const PURE: [u8; 3] = [255, 0, 255];
/// A colour that rounding may change.
const MIXED: [u8; 3] = [200, 120, 40];

/// A scene under construction.
struct Case {
    name: &'static str,
    assets: Vec<(&'static str, Generated, Value)>,
    nodes: Vec<Value>,
    lit: bool,
    splats: Value,
    cameras: Vec<(String, Value)>,
}

impl Case {
    fn new(name: &'static str) -> Case {
        let splats = json!({});
        Case { name, assets: vec![], nodes: vec![], lit: true, splats, cameras: vec![] }
    }

    fn unlit(mut self) -> Case {
        self.lit = false;
        self
    }

    fn asset(mut self, name: &'static str, made: Generated) -> Case {
        self.assets.push((name, made, json!({})));
        self
    }

    /// Adds a mesh that is drawn as samples at this spacing.
    fn sampled(mut self, name: &'static str, mesh: GeneratedMesh, spacing: f64) -> Case {
        let how = json!({ "sample": { "spacing": spacing } });
        self.assets.push((name, Generated::Mesh(mesh), how));
        self
    }

    fn node(mut self, node: Value) -> Case {
        self.nodes.push(node);
        self
    }

    fn camera(self, name: &str, eye: [f64; 3], target: [f64; 3]) -> Case {
        self.wide(name, eye, target, 45.0)
    }

    fn wide(mut self, name: &str, eye: [f64; 3], target: [f64; 3], fov: f64) -> Case {
        self.cameras.push((name.to_owned(), json!({ "eye": eye, "target": target, "fov": fov })));
        self
    }

    /// Finishes the scene, with solids made of its sampled meshes.
    fn finish(self, solids: &[(&str, Value)]) -> (String, GeneratedScene) {
        let file = |asset: &str, made: &Generated| {
            let extension = if matches!(made, Generated::Lines(_)) { "vtk" } else { "ply" };
            format!("{}-{asset}.{extension}", self.name)
        };
        let mut listed = Map::new();
        for (asset, made, how) in &self.assets {
            let mut entry = how.clone();
            entry["file"] = json!(file(asset, made));
            listed.insert((*asset).to_owned(), entry);
        }
        for (asset, solid) in solids {
            listed.insert((*asset).to_owned(), solid.clone());
        }
        let lights = if self.lit {
            json!([{ "kind": "headlight", "intensity": 0.8 }, { "kind": "ambient", "intensity": 0.2 }])
        } else {
            json!([])
        };
        let lines = [
            ("name", json!(self.name)),
            ("assets", Value::Object(listed)),
            ("nodes", Value::Array(self.nodes)),
            ("lights", lights),
            ("background", json!("#102030")),
            ("splats", self.splats),
            ("cameras", Value::Object(self.cameras.into_iter().collect())),
        ];
        let lines: Vec<String> =
            lines.iter().map(|(key, value)| format!("  \"{key}\": {}", spread(value))).collect();
        let json = format!("{{\n  \"pointillist\": 1,\n{}\n}}\n", lines.join(",\n"));
        let assets = self.assets.into_iter().map(|(asset, made, _)| (file(asset, &made), made));
        (self.name.to_owned(), GeneratedScene { json, assets: assets.collect() })
    }
}

/// Formats JSON with a line for each entry.
fn spread(value: &Value) -> String {
    let (open, lines, close): (_, Vec<String>, _) = match value {
        Value::Object(map) if map.values().any(Value::is_object) => {
            let line = |(key, value): (&String, &Value)| format!("    \"{key}\": {value}");
            ('{', map.iter().map(line).collect(), '}')
        }
        Value::Array(list) if list.len() > 1 => {
            ('[', list.iter().map(|value| format!("    {value}")).collect(), ']')
        }
        plain => return plain.to_string(),
    };
    format!("{open}\n{}\n  {close}", lines.join(",\n"))
}

/// Samples with their attributes.
#[derive(Default)]
struct Disks {
    positions: Vec<DVec3>,
    normals: Vec<Vec3>,
    colors: Vec<[u8; 4]>,
    radii: Vec<f32>,
}

impl Disks {
    fn add(&mut self, position: DVec3, normal: DVec3, [r, g, b]: [u8; 3], radius: f64) {
        self.positions.push(position);
        self.normals.push(normal.as_vec3());
        self.colors.push([r, g, b, 255]);
        self.radii.push(radius as f32);
    }

    fn finish(self) -> Generated {
        Generated::Points(PointCloud {
            positions: self.positions,
            normals: Some(self.normals),
            colors: Some(self.colors),
            radii: Some(self.radii),
            ..PointCloud::default()
        })
    }

    /// Positions and colours only; everything else is estimated from neighbours.
    fn bare(self) -> Generated {
        Generated::Points(PointCloud {
            positions: self.positions,
            colors: Some(self.colors),
            ..PointCloud::default()
        })
    }
}

fn disk(normal: DVec3, radius: f64) -> Generated {
    let mut disks = Disks::default();
    disks.add(DVec3::ZERO, normal, PURE, radius);
    disks.finish()
}

/// `side` × `side` disks perpendicular to `normal`, `step` apart. `at` maps two coordinates to a position.
fn sheet(
    side: u32,
    step: f64,
    normal: DVec3,
    radius: f64,
    color: [u8; 3],
    at: impl Fn(f64, f64) -> DVec3,
) -> Generated {
    let mut disks = Disks::default();
    for i in 0..side * side {
        let along = |k: u32| (f64::from(k) - f64::from(side / 2)) * step;
        disks.add(at(along(i % side), along(i / side)), normal, color, radius);
    }
    disks.finish()
}

/// Disks on a sphere of radius 1 about the origin.
fn ball(count: u32, radius: f64, colors: impl Fn(DVec3) -> [u8; 3], outwards: f64) -> Generated {
    let mut disks = Disks::default();
    for i in 0..count {
        // A spiral by the golden angle, which keeps neighbours apart.
        let y = 1.0 - 2.0 * (f64::from(i) + 0.5) / f64::from(count);
        let (sin, cos) = super::numeric::sin_cos(2.399_963_229_728_653 * f64::from(i));
        let r = (1.0 - y * y).sqrt();
        let p = DVec3::new(r * cos, y, r * sin);
        disks.add(p, p * outwards, colors(p), radius);
    }
    disks.finish()
}

fn striped(p: DVec3) -> [u8; 3] {
    let byte = |v: f64| (60.0 + 90.0 * (1.0 + v)) as u8;
    [byte(p.x), byte(p.y), byte(p.z)]
}

/// All cases with their names.
pub fn corpus() -> Vec<(String, GeneratedScene)> {
    vec![
        edge_on(),
        around_the_eye(),
        axes(),
        without_normals(),
        survey("survey", DVec3::new(1e7, -1e7, 100.0)),
        survey("survey-home", DVec3::ZERO),
        layers(),
        behind(),
        fields_of_view(),
        transforms(),
        few(),
        turned_away(),
        clips(),
        lines(),
    ]
}

/// Disks that are seen at 10⁻¹ … 10⁻¹² rad, and one exactly edge-on.
fn edge_on() -> (String, GeneratedScene) {
    let mut case = Case::new("edge-on").unlit().asset("disk", disk(DVec3::Y, 0.3));
    for power in 0..13 {
        let x = f64::from(power - 6) * 0.5;
        let tilt = if power == 0 { 0.0 } else { 10f64.powi(-power) };
        // Rotated about the x axis. For these angles sine and cosine are exact to the last digit.
        let (sin, cos) = super::numeric::sin_cos(tilt);
        case = case.node(json!({
            "asset": "disk",
            "matrix": [1, 0, 0, 0, 0, cos, sin, 0, 0, -sin, cos, 0, x, 0, 0, 1],
        }));
    }
    case.camera("front", [0.0, 0.0, 6.0], [0.0, 0.0, 0.0])
        .camera("close", [0.0, 0.0, 0.4], [0.0, 0.0, 0.0])
        .camera("end", [9.0, 0.0, 0.0], [0.0, 0.0, 0.0])
        .camera("tilted", [0.0, 1e-6, 6.0], [0.0, 0.0, 0.0])
        .finish(&[])
}

/// Ground around an eye in it, on it, and slightly above it.
fn around_the_eye() -> (String, GeneratedScene) {
    let ground = sheet(17, 0.25, DVec3::Y, 0.3, PURE, |x, z| DVec3::new(x, 0.0, z));
    Case::new("around-the-eye")
        .unlit()
        .asset("ground", ground)
        .node(json!({ "asset": "ground" }))
        .camera("on-a-sample", [0.0, 0.0, 0.0], [0.0, 0.0, -1.0])
        .camera("on-a-sample-down", [0.0, 0.0, 0.0], [0.0, -1.0, 0.0])
        .camera("on-a-sample-askew", [0.0, 0.0, 0.0], [0.3, -0.5, -1.0])
        .camera("a-hair-above", [0.03, 1e-9, 0.01], [0.03, 1e-9, -1.0])
        .camera("down-from-a-hair", [0.0, 1e-12, 0.0], [0.0, -1.0, 0.0])
        .camera("within", [0.1, 0.05, 0.1], [0.1, 0.0, -1.0])
        .camera("camera-plane", [0.125, 0.5, 1e-12], [0.125, 0.4, -1.0])
        .camera("below", [0.1, -0.02, 0.1], [0.1, 0.0, -1.0])
        .finish(&[])
}

/// Radii of 10⁻¹² to 10¹², and ellipses with a ratio of 10⁶.
fn axes() -> (String, GeneratedScene) {
    let mut lengths = Disks::default();
    for (i, power) in [-12, -9, -6, -3, -1].into_iter().enumerate() {
        let x = f64::from(i as u32) * 0.4 - 0.8;
        lengths.add(DVec3::new(x, 0.0, 0.0), DVec3::Z, PURE, 10f64.powi(power));
    }
    let mut large = Disks::default();
    for (z, radius) in [(-1.0, 1e3), (-2.0, 1e6), (-3.0, 1e12)] {
        large.add(DVec3::new(0.0, 0.0, z), DVec3::new(0.0, 0.3, 1.0), PURE, radius);
    }
    let lone = disk(DVec3::new(0.0, 0.1, 1.0), 1e12);
    Case::new("axes")
        .unlit()
        .asset("lengths", lengths.finish())
        .asset("large", large.finish())
        .asset("lone", lone)
        .asset("disk", disk(DVec3::Z, 0.2))
        .node(json!({ "asset": "lengths" }))
        .node(json!({ "asset": "large", "translate": [0, 0, -1] }))
        .node(json!({ "asset": "lone", "translate": [0, 0, -9] }))
        .node(json!({ "asset": "disk", "translate": [0, 0.6, 0], "scale": [1e3, 1e-3, 1] }))
        .node(json!({ "asset": "disk", "translate": [0, -0.6, 0], "rotate": [0, 0, 30], "scale": [1e-3, 1e3, 1] }))
        .node(json!({ "asset": "disk", "translate": [0, -0.3, 0], "rotate": [0, 90, 0], "scale": [1e3, 1e-3, 1] }))
        .camera("front", [0.0, 0.0, 3.0], [0.0, 0.0, 0.0])
        .camera("along", [3.0, 0.1, 0.3], [0.0, 0.0, 0.0])
        .camera("near", [0.4, 0.0, 1e-3], [0.4, 0.0, 0.0])
        .camera("far", [0.0, 0.0, 1e7], [0.0, 0.0, 0.0])
        .finish(&[])
}

/// Every second sample has no normal. The points of a lone pair have none that could be estimated either.
fn without_normals() -> (String, GeneratedScene) {
    let mut disks = Disks::default();
    for i in 0..100u32 {
        let p = DVec3::new(f64::from(i % 10) * 0.2 - 0.9, f64::from(i / 10) * 0.2 - 0.9, 0.0);
        let normal = if i % 2 == 0 { DVec3::ZERO } else { DVec3::Z };
        disks.add(p, normal, PURE, 0.2);
    }
    let mut pair = Disks::default();
    for _ in 0..2 {
        pair.add(DVec3::new(0.0, 0.0, 0.5), DVec3::ZERO, PURE, 0.2);
    }
    Case::new("without-normals")
        .asset("some", disks.finish())
        .asset("pair", pair.finish())
        .node(json!({ "asset": "some" }))
        .node(json!({ "asset": "pair" }))
        .node(json!({ "asset": "pair", "translate": [0.5, 0, 0], "scale": [1e-3, 1, 1e3] }))
        .camera("front", [0.0, 0.0, 3.0], [0.0, 0.0, 0.0])
        .camera("on-it", [0.0, 0.0, 0.5], [0.0, 0.0, 0.0])
        .camera("beside-it", [0.0, 1e-6, 0.5], [0.0, 0.0, 0.5])
        .camera("edge", [3.0, 0.0, 0.0], [0.0, 0.0, 0.0])
        .finish(&[])
}

/// Millimetre detail far from the origin. Coordinates are multiples of 2⁻¹⁰, which are exact at any distance.
fn survey(name: &'static str, corner: DVec3) -> (String, GeneratedScene) {
    const MM: f64 = 1.0 / 1024.0;
    let mut random = SplitMix64::new(7);
    let mut disks = Disks::default();
    for i in 0..24 * 24u32 {
        let height = MM * random.index(24) as f64;
        let [x, z] = [i % 24, i / 24].map(|k| (f64::from(k) - 12.0) * 32.0 * MM);
        let shade = random.index(4) as u8 * 60;
        let lean = DVec3::new(random.range(-0.1, 0.1), 1.0, random.range(-0.1, 0.1));
        disks.add(corner + DVec3::new(x, height, z), lean, [255 - shade, 90, shade], 36.0 * MM);
    }
    let at = |p: [f64; 3]| (corner + DVec3::from_array(p)).to_array();
    Case::new(name)
        .unlit()
        .asset("ground", disks.finish())
        .node(json!({ "asset": "ground" }))
        .camera("above", at([0.0, 1.0, 0.5]), at([0.0, 0.0, 0.0]))
        .camera("above-panned", at([MM, 1.0, 0.5]), at([MM, 0.0, 0.0]))
        .camera("grazing", at([0.0, 0.125, 0.75]), at([0.0, 0.0, 0.0]))
        .camera("grazing-panned", at([0.0, 0.125, 0.75 + MM]), at([0.0, 0.0, MM]))
        .finish(&[])
}

/// Two sheets at a distance of a millionth of the distance to the eye. The red one is nearer.
fn layers() -> (String, GeneratedScene) {
    let sheet = |color| sheet(15, 0.125, DVec3::Z, 0.15, color, |x, y| DVec3::new(x, y, 0.0));
    Case::new("layers")
        .unlit()
        .asset("near", sheet([255, 0, 0]))
        .asset("far", sheet([0, 255, 0]))
        .node(json!({ "asset": "far", "translate": [0, 0, -4e-6] }))
        .node(json!({ "asset": "near" }))
        .camera("front", [0.0, 0.0, 4.0], [0.0, 0.0, 0.0])
        .camera("slant", [1.5, 1.0, 3.5], [0.0, 0.0, 0.0])
        .finish(&[])
}

/// Everything is behind the eye.
fn behind() -> (String, GeneratedScene) {
    Case::new("behind")
        .asset("ball", ball(300, 0.2, |_| PURE, 1.0))
        .node(json!({ "asset": "ball" }))
        .camera("just", [0.0, 0.0, -1.5], [0.0, 0.0, -3.0])
        .camera("far", [0.0, 0.0, -1e6], [0.0, 0.0, -2e6])
        .wide("wide", [0.0, 0.0, -1.5], [0.0, 0.0, -3.0], 179.0)
        .finish(&[])
}

fn fields_of_view() -> (String, GeneratedScene) {
    Case::new("fields-of-view")
        .asset("ball", ball(600, 0.12, striped, 1.0))
        .node(json!({ "asset": "ball" }))
        .wide("narrow", [0.0, 0.0, 9e3], [0.0, 0.0, 0.0], 0.01)
        .wide("narrow-near", [0.0, 0.0, 3.0], [0.0, 0.0, 0.0], 0.01)
        .wide("wide", [0.0, 0.0, 1.2], [0.0, 0.0, 0.0], 179.0)
        .wide("wide-within", [0.0, 0.0, 0.0], [0.2, 0.1, -1.0], 179.0)
        .finish(&[])
}

/// Mirrored, sheared, nearly singular, tiny and huge instances.
fn transforms() -> (String, GeneratedScene) {
    let matrix = |columns: [[f64; 3]; 3], x: f64| {
        let [a, b, c] = columns;
        json!({
            "asset": "ball",
            "matrix": [a[0], a[1], a[2], 0, b[0], b[1], b[2], 0, c[0], c[1], c[2], 0, x, 0, 0, 1],
        })
    };
    Case::new("transforms")
        .asset("ball", ball(300, 0.18, striped, 1.0))
        .node(json!({ "asset": "ball", "scale": 0.4 }))
        .node(matrix([[-0.4, 0.0, 0.0], [0.0, 0.4, 0.0], [0.0, 0.0, 0.4]], -1.0))
        .node(matrix([[0.4, 0.0, 0.0], [0.4, 0.4, 0.0], [0.0, 0.3, 0.4]], 1.0))
        // Nearly a plane, a line and a point: the limits of what scene files may have.
        .node(matrix([[0.4, 0.0, 0.0], [0.0, 0.4, 0.0], [0.4, 0.4, 1e-9]], -2.0))
        .node(matrix([[0.4, 0.2, 0.1], [0.4, 0.2001, 0.1], [0.4, 0.2, 0.1001]], 2.0))
        .node(matrix([[2e-9, 0.0, 0.0], [0.0, 2e-9, 0.0], [0.0, 0.0, 2e-9]], 2.5))
        .node(json!({ "asset": "ball", "translate": [0, 1, 0], "scale": 1e-8 }))
        .node(json!({ "asset": "ball", "translate": [0, 0, 2e8], "scale": 1e8 }))
        .camera("front", [0.0, 0.0, 5.0], [0.0, 0.0, 0.0])
        .camera("tiny", [0.0, 1.0, 4e-8], [0.0, 1.0, 0.0])
        .camera("huge", [0.0, 0.0, 7e8], [0.0, 0.0, 2e8])
        .camera("within-huge", [0.0, 0.0, 2e8], [1.0, 0.0, 2e8])
        .finish(&[])
}

/// A single sample, five hundred equal samples, a line, a plane: positions and colours only.
fn few() -> (String, GeneratedScene) {
    let cloud = |count: u32, at: &dyn Fn(f64) -> DVec3| {
        let mut disks = Disks::default();
        for i in 0..count {
            disks.add(at(f64::from(i)), DVec3::ZERO, PURE, 1.0);
        }
        disks.bare()
    };
    Case::new("few")
        .asset("one", cloud(1, &|_| DVec3::ZERO))
        .asset("same", cloud(500, &|_| DVec3::splat(0.125)))
        .asset("line", cloud(40, &|i| DVec3::new(i * 0.025, i * 0.0125, 0.0)))
        .asset(
            "plane",
            cloud(144, &|i| DVec3::new((i % 12.0) * 0.08, (i / 12.0).floor() * 0.08, 0.0)),
        )
        .node(json!({ "asset": "one", "translate": [-1.5, 0, 0] }))
        .node(json!({ "asset": "same", "translate": [-0.5, 0, 0] }))
        .node(json!({ "asset": "line" }))
        .node(json!({ "asset": "plane", "translate": [1.2, 0, 0] }))
        .camera("front", [0.0, 0.3, 4.0], [0.0, 0.3, 0.0])
        .camera("one", [-1.5, 0.0, 1.0], [-1.5, 0.0, 0.0])
        .camera("same", [-0.375, 0.125, 0.125], [0.0, 0.0, 0.0])
        .camera("in-plane", [0.5, 0.44, 0.0], [1.2, 0.44, 0.0])
        .finish(&[])
}

/// Normals that point inwards: from outside all samples face away.
fn turned_away() -> (String, GeneratedScene) {
    Case::new("turned-away")
        .asset("ball", ball(400, 0.15, |_| MIXED, -1.0))
        .node(json!({ "asset": "ball" }))
        .camera("outside", [0.0, 0.0, 3.0], [0.0, 0.0, 0.0])
        .camera("inside", [0.0, 0.0, 0.0], [0.0, 0.5, -1.0])
        .finish(&[])
}

/// Clip lines that are parallel, coincide, pass through the centre, or leave nothing: slivers and blades thinner than the sample
/// spacing, walls of nearly equal solids, solids that touch.
fn clips() -> (String, GeneratedScene) {
    let cuboid = |half: DVec3| {
        let mut faces = Faces::default();
        faces.cuboid(-half, half, srgb(0xff00ff));
        faces.finish(None)
    };
    let mut slivers = Mesh::default();
    for i in 0..8u32 {
        let width = 10f64.powi(-(i as i32));
        let y = f64::from(i) * 0.2;
        let first = slivers.positions.len() as u32;
        slivers.positions.extend([
            DVec3::new(-0.5, y, 0.0),
            DVec3::new(0.5, y, 0.0),
            DVec3::new(0.5, y + 0.1 * width, 0.0),
        ]);
        slivers.triangles.push([first, first + 1, first + 2]);
    }
    slivers.normals = Some(vec![Vec3::Z; slivers.positions.len()]);
    slivers.colors = Some(vec![srgb(0xff00ff); slivers.positions.len()]);
    let slivers = GeneratedMesh { mesh: slivers, ..GeneratedMesh::default() };
    let solids = [
        (
            "shell",
            json!({ "difference": [{ "asset": "box" }, { "asset": "box", "scale": 0.999 }, { "asset": "lid" }] }),
        ),
        (
            "blade",
            json!({ "intersection": [{ "asset": "box" }, { "asset": "box", "translate": [0.7999, 0, 0] }] }),
        ),
        (
            "touching",
            json!({ "union": [{ "asset": "box" }, { "asset": "box", "translate": [0.8, 0, 0] }] }),
        ),
        (
            "again",
            json!({ "union": [{ "asset": "box" }, { "asset": "box", "rotate": [0, 45, 0] }] }),
        ),
    ];
    Case::new("clips")
        .sampled("slivers", slivers, 0.08)
        .sampled("box", cuboid(DVec3::splat(0.4)), 0.1)
        .sampled("lid", cuboid(DVec3::new(1.0, 1.0, 0.39)), 0.1)
        .sampled("plate", cuboid(DVec3::new(0.4, 0.4, 1e-4)), 0.1)
        .node(json!({ "asset": "slivers", "translate": [-2, -0.8, 0] }))
        .node(json!({ "asset": "shell", "translate": [-0.8, 0.6, 0] }))
        .node(json!({ "asset": "blade", "translate": [-0.4, -0.6, 0] }))
        .node(json!({ "asset": "touching", "translate": [0.8, 0.6, 0] }))
        .node(json!({ "asset": "again", "translate": [2.2, 0, 0] }))
        .node(json!({ "asset": "plate", "translate": [0.8, -0.6, 0], "rotate": [0, 80, 0] }))
        .camera("front", [0.0, 0.0, 4.5], [0.0, 0.0, 0.0])
        .camera("edge", [6.0, 0.2, 0.0], [0.0, 0.0, 0.0])
        .camera("inside", [2.2, 0.0, 0.0], [2.2, 0.0, -1.0])
        .finish(&solids)
}

/// Tubes without length, with repeated points and turns by 180°, with radii of 0 and radii larger than their length, cones, tubes seen from
/// their end, tubes around the eye, and a hair that runs through the camera plane.
fn lines() -> (String, GeneratedScene) {
    let (wide, thin) = (0.2, 1e-6);
    let strands: [&[([f64; 3], f64)]; 13] = [
        &[([-1.5, 1.0, 0.0], wide), ([-1.5, 1.0, 0.0], wide)],
        &[
            ([-0.6, 1.0, 0.0], 0.1),
            ([-0.2, 1.0, 0.0], 0.1),
            ([-0.2, 1.0, 0.0], 0.1),
            ([0.1, 1.2, 0.0], 0.1),
        ],
        &[([0.5, 1.0, 0.0], 0.08), ([1.2, 1.0, 0.0], 0.08), ([0.7, 1.0, 0.0], 0.14)],
        &[([-1.5, 0.2, 0.0], 0.3), ([-1.45, 0.2, 0.0], 0.28)],
        &[([-0.8, 0.2, 0.0], 0.4), ([-0.6, 0.2, 0.0], 0.05)],
        &[([0.2, 0.2, 0.0], 0.0), ([1.4, 0.3, 0.0], 0.25)],
        &[([1.7, -0.9, 0.0], 0.0), ([1.7, 0.9, 0.0], 0.0)],
        // Along the view: straight, and thinner towards the eye and away from it.
        &[([1.2, -0.8, -2.0], wide), ([1.2, -0.8, 1.0], wide)],
        &[([-1.2, -0.8, -1.0], 0.3), ([-1.2, -0.8, 1.0], 0.05)],
        &[([0.0, -0.8, -1.0], 0.05), ([0.0, -0.8, 1.0], 0.3)],
        // Through the eye of `within`, and past it.
        &[([0.0, 0.0, 9.0], wide), ([0.0, 0.0, 11.0], wide)],
        &[([-1e4, 0.25, 10.5], thin), ([1e4, 0.25, 8.5], thin)],
        // As long as the scene is far away.
        &[([-1e6, 3.0, -1e6], 50.0), ([1e6, 3.0, -1e6], 50.0)],
    ];
    let mut lines = Polylines { strands: vec![0], ..Polylines::default() };
    let mut radii = Vec::new();
    for strand in strands {
        for &(place, radius) in strand {
            lines.positions.push(DVec3::from_array(place));
            radii.push(radius as f32);
        }
        lines.strands.push(lines.positions.len() as u32);
    }
    lines.colors = Some(vec![srgb(0xff00ff); radii.len()]);
    lines.radii = Some(radii);
    Case::new("lines")
        .asset("tubes", Generated::Lines(lines))
        .node(json!({ "asset": "tubes" }))
        .node(json!({ "asset": "tubes", "translate": [0, 0, -3], "rotate": [0, 180, 0] }))
        .node(json!({ "asset": "tubes", "translate": [0, 0, -6], "scale": [1, 1e-4, 1] }))
        .camera("front", [0.0, 0.0, 6.0], [0.01, -0.1, 0.0])
        .camera("end-on", [1.2, -0.8, 7.0], [1.2, -0.8, 0.0])
        .camera("within", [0.0, 0.0, 10.0], [0.1, 0.05, 0.0])
        .camera("far", [0.0, 0.0, 3e4], [0.0, 0.0, 0.0])
        .wide("narrow", [0.0, 0.0, 6.0], [-1.5, 1.0, 0.0], 0.01)
        .wide("wide", [0.3, 0.1, 0.5], [0.0, 0.0, 0.0], 170.0)
        .finish(&[])
}
