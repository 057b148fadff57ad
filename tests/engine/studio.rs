//! An engine with its own folder, and small scenes for it.

use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use glam::DVec3;
use pointillist::encode::ImageFormat;
use pointillist::engine::{
    EncodedFrame, Engine, EngineConfig, EngineError, FrameRequest, FrameTicket, Pose, SceneInfo,
};
use pointillist::math::Camera;
use pointillist::plan::{Lod, MaxError, Output, Reconstruct, Settings};
use serde_json::{Value, json};

/// The entity tag of a frame, after the bake that it needs. Blocks.
pub fn etag(engine: &Engine, request: &FrameRequest) -> Result<String, EngineError> {
    Ok(engine.resolve_blocking(request.clone())?.etag().to_owned())
}

pub struct Studio {
    pub engine: Engine,
    folder: tempfile::TempDir,
}

impl Studio {
    pub fn new() -> Studio {
        Studio::with(|_| {})
    }

    /// An engine with the scenes of [`Studio::load_two`].
    pub fn with_two() -> Studio {
        let studio = Studio::new();
        studio.load_two();
        studio
    }

    pub fn with(adjust: impl FnOnce(&mut EngineConfig)) -> Studio {
        let folder = tempfile::tempdir().unwrap();
        let mut config = EngineConfig::new(folder.path());
        config.encoder_threads = 2;
        // However slow the machine, no frame is refused because others are estimated to take long.
        config.queue_time = Duration::from_secs(3600);
        adjust(&mut config);
        Studio { engine: Engine::start(config).unwrap(), folder }
    }

    /// An engine that reads below an existing folder.
    pub fn below(root: &Path, adjust: impl FnOnce(&mut EngineConfig)) -> Studio {
        Studio::with(|config| {
            config.root = root.to_owned();
            adjust(config);
        })
    }

    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    pub fn write(&self, name: &str, contents: impl AsRef<[u8]>) {
        std::fs::write(self.folder.path().join(name), contents).unwrap();
    }

    pub fn try_load(&self, id: &str, file: &str) -> Result<SceneInfo, EngineError> {
        self.engine.load(id, &self.folder.path().join(file))
    }

    pub fn load(&self, id: &str, file: &str) -> SceneInfo {
        self.try_load(id, file).unwrap_or_else(|error| panic!("{file}: {error}"))
    }

    /// Writes and loads a scene description.
    pub fn load_json(&self, id: &str, scene: &Value) -> SceneInfo {
        let file = format!("{id}.json");
        self.write(&file, scene.to_string());
        self.load(id, &file)
    }

    /// Loads the scene `half`: the half of the plane z = 0 at the right of x = 0, white on black, without lights.
    pub fn load_half(&self) {
        let corners = [[0.0, -9.0], [9.0, -9.0], [9.0, 9.0], [0.0, 9.0]];
        let corners = corners.map(|[x, y]| DVec3::new(x, y, 0.0));
        self.write("half.ply", mesh(&corners, &[[0, 1, 2], [0, 2, 3]]));
        self.load_json(
            "half",
            &json!({
                "assets": { "half": { "file": "half.ply" } },
                "nodes": [{ "asset": "half", "material": "white" }],
                "materials": { "white": { "color": [1, 1, 1] } },
                "lights": [],
                "background": "#000000",
            }),
        );
    }

    /// A lit scene with points and triangles, and an unlit cloud; both with a camera `front`.
    pub fn load_two(&self) {
        self.write("wall.ply", wall(40, |x, y| [(x * 6) as u8, (y * 6) as u8, 90]));
        self.write("sphere.ply", sphere(24));
        self.load_json(
            "solid",
            &json!({
                "assets": { "wall": { "file": "wall.ply" }, "sphere": { "file": "sphere.ply" } },
                "nodes": [
                    { "name": "back", "asset": "wall", "translate": [0, 0, -1], "scale": 2 },
                    { "name": "balls", "asset": "sphere", "scale": 0.4,
                      "repeat": { "grid": [3, 2, 1], "step": [0.9, 0.9, 0] }, "translate": [-0.9, -0.4, 0] },
                ],
                "lights": [{ "kind": "headlight" }, { "kind": "point", "position": [2, 3, 2], "range": 4 }],
                "cameras": { "front": { "eye": [0, 0, 4], "target": [0, 0, 0], "fov": 45 } },
            }),
        );
        self.load_json("cloud", &cloud_scene("wall.ply"));
    }

    pub fn submit(&self, request: &FrameRequest) -> FrameTicket {
        self.engine.submit(request.clone()).unwrap()
    }

    pub fn frame(&self, request: &FrameRequest) -> Arc<EncodedFrame> {
        self.submit(request).wait().unwrap_or_else(|error| panic!("{request:?}: {error}"))
    }

    pub fn bytes(&self, request: &FrameRequest) -> Vec<u8> {
        self.frame(request).bytes.to_vec()
    }

    /// Submits frames that keep the GPU busy for a while, so that later requests queue up behind them.
    pub fn keep_busy(&self, scene: &str) -> Vec<FrameTicket> {
        (0..4)
            .map(|number| {
                let mut request = front(scene, 2048, 2048 - number);
                request.output = Output::Depth;
                self.submit(&request)
            })
            .collect()
    }
}

/// An unlit scene of one cloud with a camera `front`.
pub fn cloud_scene(file: &str) -> Value {
    json!({
        "assets": { "g": { "file": file } },
        "nodes": [{ "name": "wall", "asset": "g" }],
        "lights": [],
        "cameras": { "front": { "eye": [0, 0, 3], "target": [0, 0, 0], "fov": 45 } },
    })
}

/// Raw colour from the camera `front`.
pub fn front(scene: &str, width: u32, height: u32) -> FrameRequest {
    FrameRequest {
        scene: scene.to_owned(),
        pose: Pose::Named("front".to_owned()),
        width,
        height,
        settings: Settings::drawn_as(Reconstruct::Points),
        output: Output::Color,
        format: ImageFormat::Raw,
        quality: 90,
        deadline: None,
    }
}

/// Settings for point trees with this error.
pub fn spt(px: f32, reconstruct: Reconstruct) -> Settings {
    let max_error = MaxError::new(px).unwrap();
    Settings { lod: Lod::Spt, max_error_px: max_error, reconstruct, ..Settings::default() }
}

/// A raw frame of a whole scene, as `output`.
pub fn fit(scene: &str, side: u32, output: Output) -> FrameRequest {
    FrameRequest { pose: Pose::FIT, output, ..front(scene, side, side) }
}

/// One of many different views of a scene around the origin.
pub fn orbit(scene: &str, number: u32, side: u32) -> FrameRequest {
    let angle = 0.37 * f64::from(number);
    let camera = Camera::perspective(
        DVec3::new(3.0 * angle.sin(), 0.4, 3.0 * angle.cos()),
        DVec3::ZERO,
        45.0,
    );
    FrameRequest { pose: Pose::Camera(camera), ..front(scene, side, side) }
}

pub const OUTPUTS: [Output; 4] = [Output::Color, Output::Depth, Output::Normal, Output::Id];

/// A PLY file of `side` × `side` points in the plane z = 0, two units wide, coloured by column and row.
pub fn wall(side: usize, color: impl Fn(usize, usize) -> [u8; 3]) -> String {
    let at = |i: usize| i as f64 / (side - 1) as f64 * 2.0 - 1.0;
    let points = (0..side * side).map(|i| {
        let (x, y) = (i % side, i / side);
        (DVec3::new(at(x), at(y), 0.0), color(x, y))
    });
    cloud(points)
}

/// A cloud as PLY.
pub fn cloud(points: impl Iterator<Item = (DVec3, [u8; 3])>) -> String {
    let mut body = String::new();
    let mut count = 0;
    for (p, [red, green, blue]) in points {
        writeln!(body, "{:e} {:e} {:e} {red} {green} {blue}", p.x, p.y, p.z).unwrap();
        count += 1;
    }
    format!(
        "ply\nformat ascii 1.0\nelement vertex {count}\nproperty double x\nproperty double y\nproperty double z\n\
         property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n{body}"
    )
}

/// A sample with all attributes.
#[derive(Clone, Copy, Debug)]
pub struct Disk {
    pub at: DVec3,
    pub normal: DVec3,
    pub color: [u8; 3],
    /// Radius of the disk: two standard deviations.
    pub radius: f64,
}

/// Disks as PLY.
pub fn disks(list: &[Disk]) -> String {
    let mut text = format!("ply\nformat ascii 1.0\nelement vertex {}\n", list.len());
    for (kind, names) in [
        ("double", &["x", "y", "z"][..]),
        ("float", &["nx", "ny", "nz", "radius"]),
        ("uchar", &["red", "green", "blue"]),
    ] {
        names.iter().for_each(|name| writeln!(text, "property {kind} {name}").unwrap());
    }
    text.push_str("end_header\n");
    for Disk { at, normal: n, color: [r, g, b], radius } in list {
        writeln!(
            text,
            "{:e} {:e} {:e} {:e} {:e} {:e} {radius:e} {r} {g} {b}",
            at.x, at.y, at.z, n.x, n.y, n.z
        )
        .unwrap();
    }
    text
}

/// Disks evenly distributed on the unit sphere.
pub fn disk_sphere(count: u32, radius: f64, color: impl Fn(DVec3) -> [u8; 3]) -> Vec<Disk> {
    (0..count)
        .map(|i| {
            let y = 1.0 - 2.0 * (f64::from(i) + 0.5) / f64::from(count);
            // The golden angle.
            let (sin, cos) = (2.399_963_229_728_653 * f64::from(i)).sin_cos();
            let r = (1.0 - y * y).sqrt();
            let p = DVec3::new(r * cos, y, r * sin);
            Disk { at: p, normal: p, color: color(p), radius }
        })
        .collect()
}

/// A mesh as a PLY file.
pub fn mesh(positions: &[DVec3], triangles: &[[u32; 3]]) -> String {
    let mut text = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty double x\nproperty double y\nproperty double z\n\
         element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        positions.len(),
        triangles.len()
    );
    for p in positions {
        writeln!(text, "{:e} {:e} {:e}", p.x, p.y, p.z).unwrap();
    }
    for [a, b, c] in triangles {
        writeln!(text, "3 {a} {b} {c}").unwrap();
    }
    text
}

/// The unit sphere as a PLY file: `2 · rings²` quads as pairs of triangles.
pub fn sphere(rings: u32) -> String {
    let (positions, triangles) = sphere_mesh(rings);
    mesh(&positions, &triangles)
}

pub fn sphere_mesh(rings: u32) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let columns = 2 * rings;
    let mut positions = Vec::new();
    for ring in 0..=rings {
        for column in 0..columns {
            let theta = f64::from(ring) / f64::from(rings) * std::f64::consts::PI;
            let phi = f64::from(column) / f64::from(columns) * std::f64::consts::TAU;
            positions.push(DVec3::new(
                theta.sin() * phi.sin(),
                theta.cos(),
                theta.sin() * phi.cos(),
            ));
        }
    }
    let mut triangles = Vec::new();
    for ring in 0..rings {
        for column in 0..columns {
            let at = |r: u32, c: u32| r * columns + c % columns;
            let [a, b] = [at(ring, column), at(ring, column + 1)];
            let [c, d] = [at(ring + 1, column), at(ring + 1, column + 1)];
            if ring > 0 {
                triangles.push([a, d, b]);
            }
            if ring + 1 < rings {
                triangles.push([a, c, d]);
            }
        }
    }
    (positions, triangles)
}

/// Compares images, and fails with the number and first place of differences rather than with all bytes.
pub fn same(found: &[u8], expected: &[u8], what: &str) {
    assert_eq!(found.len(), expected.len(), "{what}: sizes");
    let differing = found.iter().zip(expected).filter(|(a, b)| a != b).count();
    let first = found.iter().zip(expected).position(|(a, b)| a != b);
    assert!(differing == 0, "{what}: {differing} bytes differ, the first at {first:?}");
}

/// Depths of a raw depth image.
pub fn depths(bytes: &[u8]) -> Vec<f32> {
    bytes.chunks_exact(4).map(|word| f32::from_le_bytes(word.try_into().unwrap())).collect()
}

/// Ids of a raw id image.
pub fn ids(bytes: &[u8]) -> Vec<u32> {
    bytes.chunks_exact(4).map(|word| u32::from_le_bytes(word.try_into().unwrap())).collect()
}

/// Number of covered pixels of a raw depth image. Fails if a depth is NaN or not positive.
pub fn covered(bytes: &[u8]) -> usize {
    let depths = depths(bytes);
    assert!(depths.iter().all(|depth| !depth.is_nan() && *depth > 0.0), "depths are positive");
    depths.iter().filter(|depth| depth.is_finite()).count()
}

/// Waits for something that the render thread does asynchronously.
pub fn eventually(what: &str, mut done: impl FnMut() -> bool) {
    let until = Instant::now() + Duration::from_secs(60);
    while !done() {
        assert!(Instant::now() < until, "{what} did not happen");
        std::thread::sleep(Duration::from_millis(5));
    }
}
