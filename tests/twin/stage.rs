//! The engines under test, and their scenes.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{LazyLock, OnceLock};
use std::time::Duration;

use glam::DVec3;
use pointillist::accuracy::reference::Reference;
use pointillist::assets::ReadOptions;
use pointillist::encode::ImageFormat;
use pointillist::engine::{
    Engine, EngineConfig, FrameRequest, FrameTicket, NodePatch, Pose, Receipt,
};
use pointillist::math::{Camera, View};
use pointillist::plan::{Edl, LineWidth, Output, Pass, Reconstruct, Settings, Shadows};
use pointillist::scene::SceneLimits;
use pointillist::scene::fields::SceneField;
use serde_json::Value;

use super::verdict::{self, Tolerance};

/// The folder of scenes and of images of failures.
static FOLDER: LazyLock<PathBuf> = LazyLock::new(|| {
    // Some runners start a process for each test, so each process has its own folder.
    let runs = Path::new(env!("CARGO_TARGET_TMPDIR")).join("twin");
    std::fs::create_dir_all(&runs).unwrap();
    remove_old(&runs);
    let folder = runs.join(std::process::id().to_string());
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    let folder = folder.canonicalize().unwrap();
    // The committed scenes are copied, so that all scenes have one root.
    let from = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    for entry in std::fs::read_dir(from).unwrap() {
        let file = entry.unwrap().path();
        if file.extension().is_some_and(|kind| kind == "json") {
            let text = std::fs::read_to_string(&file).unwrap();
            let name = file.file_name().unwrap().to_str().unwrap();
            // The oracle's rays to lights would take minutes; `shadows` has scenes of its own.
            // So would its rays for ambient occlusion, which `occlusion` has scenes for.
            let mut plain: Value = serde_json::from_str(&text).unwrap();
            plain.as_object_mut().unwrap().remove("ambient_occlusion");
            for light in plain["lights"].as_array_mut().into_iter().flatten() {
                for key in ["shadows", "angle", "radius"] {
                    light.as_object_mut().unwrap().remove(key);
                }
            }
            std::fs::write(folder.join(name), plain.to_string()).unwrap();
            std::fs::write(folder.join(format!("{AS_SHIPPED}{name}")), text).unwrap();
        } else if file.is_file() {
            let to = folder.join(file.file_name().unwrap());
            if std::fs::hard_link(&file, &to).is_err() {
                std::fs::copy(&file, &to).unwrap();
            }
        }
    }
    folder
});

/// See [`Case::draw`].
const NARROW_EVERY: u32 = 3;

/// Begins the names of scene files in the folder that are as they are committed; the others have neither shadows nor ambient occlusion.
const AS_SHIPPED: &str = "shipped-";

fn engine(force_32_bit: bool, rasterise: bool) -> Engine {
    let (draw_hidden, like_a_gpu) = (rasterise, force_32_bit || rasterise);
    let rasterise = Some(rasterise);
    let config = EngineConfig::new(&*FOLDER);
    // All engines count the same splats and triangles as large, on every adapter.
    let large_px = Some(32);
    let config = EngineConfig {
        force_32_bit,
        rasterise,
        draw_hidden,
        like_a_gpu,
        small_splat_px: large_px,
        small_triangle_px: large_px,
        // On a machine that is busy with other work, frames are late and not refused.
        queue_time: Duration::from_secs(3600),
        ..config
    };
    Engine::start(config).unwrap()
}

/// The engine with 64-bit atomics.
pub fn wide_engine() -> &'static Engine {
    &WIDE
}

/// Removes folders of runs that are an hour old or more.
fn remove_old(runs: &Path) {
    const KEPT: std::time::Duration = std::time::Duration::from_secs(3600);
    for entry in std::fs::read_dir(runs).unwrap().flatten() {
        let age = entry.metadata().and_then(|found| found.modified()).map(|time| time.elapsed());
        if matches!(age, Ok(Ok(age)) if age > KEPT) {
            let _ = std::fs::remove_dir_all(entry.path());
        }
    }
}

/// The engine with 64-bit atomics, if the adapter has them.
static WIDE: LazyLock<Engine> = LazyLock::new(|| engine(false, false));
/// The engine without 64-bit atomics, which launches its passes as on a GPU.
static NARROW: LazyLock<Engine> = LazyLock::new(|| engine(true, false));
/// The engine with the adapter's rasteriser for large triangles instead of the walk in compute, which also draws hidden chunks and launches its
/// passes as on a GPU.
static RASTERISING: LazyLock<Engine> = LazyLock::new(|| engine(false, true));

/// The folder for images of failures.
pub fn folder() -> &'static Path {
    &FOLDER
}

/// A scene, loaded into the engine with 64-bit atomics and as a reference. The other engines load it for their first frame of it.
pub struct Case {
    pub id: String,
    pub reference: Reference,
    path: PathBuf,
    in_others: [OnceLock<()>; 2],
    /// Number of frames that [`Case::draw_from`] has drawn.
    drawn: AtomicU32,
}

/// The four images of a frame.
#[derive(Clone, Debug)]
pub struct Frames {
    pub width: u32,
    pub height: u32,
    pub color: Vec<[u8; 4]>,
    pub depth: Vec<f32>,
    pub normal: Vec<[u8; 4]>,
    pub id: Vec<u32>,
    /// Receipt of the colour frame, with 64-bit atomics.
    pub receipt: Receipt,
}

impl Frames {
    /// Whether all four images are equal bit by bit.
    pub fn same_pixels(&self, other: &Frames) -> bool {
        let bits = |frames: &Frames| -> Vec<u32> {
            frames.depth.iter().map(|depth| depth.to_bits()).collect()
        };
        self.color == other.color
            && bits(self) == bits(other)
            && self.normal == other.normal
            && self.id == other.id
    }

    /// Number of covered pixels.
    pub fn covered(&self) -> usize {
        self.id.iter().filter(|&&id| id != 0).count()
    }
}

impl Case {
    /// Writes `files` and the scene into a new folder and loads the scene. `name` must be unique among the tests.
    pub fn new(name: &str, files: &[(&str, Vec<u8>)], scene: &Value) -> Case {
        let folder = FOLDER.join(name);
        std::fs::create_dir_all(&folder).unwrap();
        for (file, bytes) in files {
            std::fs::write(folder.join(file), bytes).unwrap();
        }
        let path = folder.join("scene.json");
        std::fs::write(&path, serde_json::to_vec_pretty(scene).unwrap()).unwrap();
        Self::load(name, &path)
    }

    /// Loads a committed scene as users see it.
    pub fn as_shipped(name: &str) -> Case {
        Self::committed(&format!("{AS_SHIPPED}{name}"))
    }

    /// Loads a committed scene, without shadows and ambient occlusion.
    pub fn committed(name: &str) -> Case {
        static LOADED: AtomicU32 = AtomicU32::new(0);
        let number = LOADED.fetch_add(1, Ordering::Relaxed);
        Self::load(&format!("{name}-{number}"), &FOLDER.join(format!("{name}.json")))
    }

    /// Loads a file in the folder.
    pub fn load(id: &str, path: &Path) -> Case {
        WIDE.load(id, path).unwrap_or_else(|error| panic!("{id}: {error}"));
        let (read, limits) = (ReadOptions::default(), SceneLimits::default());
        let reference = Reference::load(path, &FOLDER, &read, &limits).unwrap();
        let (in_others, drawn) = Default::default();
        Case { id: id.to_owned(), reference, path: path.to_owned(), in_others, drawn }
    }

    /// The engine without 64-bit atomics, with the scene.
    fn narrow(&self) -> &'static Engine {
        self.with_scene(&NARROW, &self.in_others[0])
    }

    /// The engine with the adapter's rasteriser, with the scene.
    fn rasterising(&self) -> &'static Engine {
        self.with_scene(&RASTERISING, &self.in_others[1])
    }

    fn with_scene(&self, engine: &'static Engine, loaded: &OnceLock<()>) -> &'static Engine {
        loaded.get_or_init(|| {
            let loaded = engine.load(&self.id, &self.path);
            loaded.unwrap_or_else(|error| panic!("{}: {error}", self.id));
        });
        engine
    }

    fn engines(&self) -> [&'static Engine; 3] {
        [&WIDE, self.narrow(), self.rasterising()]
    }

    /// Shows or hides a top-level node in all engines; the reference is unchanged.
    pub fn show(&self, node: &str, visible: bool) {
        let patch = NodePatch { visible: Some(visible), ..NodePatch::default() };
        for engine in self.engines() {
            engine.patch(&self.id, node, &patch).unwrap();
        }
    }

    /// Draws the frame with 64-bit atomics. The first of every [`NARROW_EVERY`] frames of a case is also drawn without: its images must be equal bit by bit.
    /// Most of a test's time is the compilation of pipelines, and each engine has its own.
    pub fn draw(&self, view: &View) -> Frames {
        self.draw_with(view, points())
    }

    /// As [`Case::draw`], with settings.
    pub fn draw_with(&self, view: &View, settings: Settings) -> Frames {
        self.draw_from(&Pose::View(*view), (view.width, view.height), settings)
    }

    /// As [`Case::draw_with`], from any pose.
    pub fn draw_from(&self, pose: &Pose, size: (u32, u32), settings: Settings) -> Frames {
        let wide = frames_from(&WIDE, &self.id, pose, size, settings);
        if !self.drawn.fetch_add(1, Ordering::Relaxed).is_multiple_of(NARROW_EVERY) {
            return wide;
        }
        let narrow = frames_from(self.narrow(), &self.id, pose, size, settings);
        for pass in &narrow.receipt.passes {
            let second = [
                Pass::ProjectSamplesId,
                Pass::ProjectSplatsId,
                Pass::ProjectTrianglesId,
                Pass::ProjectTrianglesLayersId,
                Pass::ProjectLinesId,
            ];
            if pass.ran && second.iter().any(|second| second.name() == pass.name) {
                assert!(wide.same_pixels(&narrow), "{}: the 32-bit path differs", self.id);
                return wide;
            }
        }
        panic!("{}: the second engine has 64-bit atomics: {:?}", self.id, narrow.receipt.passes);
    }

    /// Draws the frame with 64-bit atomics alone.
    pub fn draw_wide(&self, view: &View, settings: Settings) -> Frames {
        frames(&WIDE, &self.id, view, settings)
    }

    /// The colours of the frame with 64-bit atomics.
    pub fn colors(&self, view: &View, settings: Settings) -> Vec<[u8; 4]> {
        let (pose, size) = (Pose::View(*view), (view.width, view.height));
        let frame = submit(&WIDE, &self.id, &pose, size, settings, Output::Color).wait().unwrap();
        frame.bytes.as_chunks().0.to_vec()
    }

    /// Draws the frame with every engine: with 64-bit atomics, without, and with the rasteriser and hidden chunks.
    pub fn each(&self, view: &View) -> [Frames; 3] {
        self.each_with(view, points())
    }

    /// As [`Case::each`], with settings.
    pub fn each_with(&self, view: &View, settings: Settings) -> [Frames; 3] {
        self.engines().map(|engine| frames(engine, &self.id, view, settings))
    }

    /// Draws the frame and compares it with the oracle's; fails with images.
    pub fn check(&self, view: &View, tolerance: &Tolerance) -> Frames {
        let frames = self.draw(view);
        verdict::judge(&self.id, &self.reference, view, &frames, tolerance);
        if frames.receipt.triangles.rasterised.is_some_and(|large| large > 0) {
            let rasterised = self::frames(self.rasterising(), &self.id, view, points());
            let ran = |frames: &Frames, passes: [Pass; 2]| passes.iter().any(|&p| frames.ran(p));
            assert!(ran(&rasterised, [Pass::RasteriseTriangles, Pass::RasteriseTrianglesLayers]));
            assert!(ran(&frames, [Pass::WalkTriangles, Pass::WalkTrianglesLayers]));
            let id = format!("{}-rasterised", self.id);
            verdict::judge(&id, &self.reference, view, &rasterised, tolerance);
        }
        frames
    }

    /// The scalar fields of the scene.
    pub fn fields(&self) -> Vec<SceneField> {
        WIDE.scene(&self.id).unwrap().fields
    }

    /// The view of one of the scene's cameras.
    pub fn view(&self, camera: &str, width: u32, height: u32) -> View {
        self.reference.camera(camera).unwrap().view(width, height).unwrap()
    }
}

impl Drop for Case {
    fn drop(&mut self) {
        let _ = WIDE.remove(&self.id);
        for (engine, loaded) in [&NARROW, &RASTERISING].into_iter().zip(&self.in_others) {
            if loaded.get().is_some() {
                let _ = engine.remove(&self.id);
            }
        }
    }
}

impl Frames {
    pub fn ran(&self, pass: Pass) -> bool {
        self.receipt.passes.iter().any(|line| line.name == pass.name() && line.ran)
    }
}

/// Samples as points, under suns that cast no shadows: the oracle casts them only if a test requests it.
fn points() -> Settings {
    Settings { shadows: Shadows::Off, ..Settings::drawn_as(Reconstruct::Points) }
}

/// A view of 160 × 120 with y up.
pub fn look(eye: [f64; 3], target: [f64; 3], fov_deg: f64) -> View {
    let (eye, target) = (DVec3::from(eye), DVec3::from(target));
    Camera::perspective(eye, target, fov_deg).view(160, 120).unwrap()
}

fn frames(engine: &Engine, scene: &str, view: &View, settings: Settings) -> Frames {
    frames_from(engine, scene, &Pose::View(*view), (view.width, view.height), settings)
}

fn submit(
    engine: &Engine,
    scene: &str,
    pose: &Pose,
    (width, height): (u32, u32),
    settings: Settings,
    output: Output,
) -> FrameTicket {
    // The oracle uses eye-dome lighting only if a test requests it.
    let edl = if settings.edl == Edl::Auto { Edl::Off } else { settings.edl };
    // It draws lines with their true widths, unless a test asks for others.
    let is_open = settings.line_width_px == LineWidth::default();
    let line_width_px = if is_open { 0.0.into() } else { settings.line_width_px };
    let request = FrameRequest {
        scene: scene.to_owned(),
        pose: pose.clone(),
        width,
        height,
        settings: Settings { edl, line_width_px, ..settings },
        output,
        format: ImageFormat::Raw,
        quality: 85,
        deadline: None,
    };
    engine.submit(request).unwrap()
}

fn frames_from(
    engine: &Engine,
    scene: &str,
    pose: &Pose,
    (width, height): (u32, u32),
    settings: Settings,
) -> Frames {
    // All four requests wait at the same time, so that they share a submission.
    let outputs = [Output::Color, Output::Depth, Output::Normal, Output::Id];
    let tickets =
        outputs.map(|output| submit(engine, scene, pose, (width, height), settings, output));
    let [color, depth, normal, id] = tickets.map(|ticket| ticket.wait().unwrap());
    let words = |bytes: &[u8]| -> Vec<[u8; 4]> { bytes.as_chunks().0.to_vec() };
    Frames {
        width,
        height,
        color: words(&color.bytes),
        depth: words(&depth.bytes).into_iter().map(f32::from_le_bytes).collect(),
        normal: words(&normal.bytes),
        id: words(&id.bytes).into_iter().map(u32::from_le_bytes).collect(),
        receipt: color.receipt.clone(),
    }
}
