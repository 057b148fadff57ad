//! The engine (floor 5): takes jobs and returns encoded frames with receipts. One thread owns the device.

pub mod bakes;
mod baking;
mod crowd;
mod encoders;
mod estimates;
mod framing;
mod group;
mod job;
mod kept;
mod keys;
mod library;
mod observe;
pub mod pick;
mod priming;
pub mod queue;
pub mod receipt;
mod renderer;
mod request;
mod resolve;
mod seat;
mod shared;
mod trace;
mod trees;
mod worker;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use glam::DVec3;
use serde::Serialize;

pub use bakes::BakeTicket;
pub use baking::{BakeEvent, BakeSource, BakedAsset, bake_file};
pub use encoders::EncodeHook;
pub use estimates::{EstimateState, Estimates, Latch};
pub use observe::Observer;
pub use priming::PrimeConfig;
pub use queue::{Class, Client};
pub use receipt::Receipt;
pub use renderer::Renderer;
pub use request::{FrameRequest, Pose};
pub use seat::Seat;
pub use trace::{Origin, RequestId};

use crate::assets::{AssetError, ReadOptions};
use crate::bake::cache::BakeCache;
use crate::math::Camera;
use crate::memory::{self, Admission, HostMemory, Interrupt};
use crate::plan::Reconstruct;
use crate::residency::Part;
use crate::scene::{CameraPath, SceneError, SceneLimits};

use self::shared::Shared;

/// Default of [`EngineConfig::job_share`].
pub const DEFAULT_JOB_SHARE: f64 = 0.1;

/// Number of points whose neighbours are found in a tenth of a second: below it, waiting costs less than drawing a second
/// picture.
pub const ESTIMATE_AT_ONCE: usize = 200_000;

/// Upper bound of the time step of a file system's clock.
const SETTLED_AFTER: Duration = Duration::from_secs(2);

/// Configuration of the engine.
#[derive(Clone)]
pub struct EngineConfig {
    /// Scenes and the files they name are read below this folder only.
    pub root: PathBuf,
    /// Bytes of scene data that may stay on the GPU; `None`: three quarters of what the adapter can bind, at most 4 GiB.
    pub gpu_budget_bytes: Option<u64>,
    /// Host memory for loaded scenes, loading and baking.
    pub memory: HostMemory,
    /// Jobs that may wait; more are refused with [`EngineError::Busy`].
    pub queue_capacity: usize,
    /// Largest estimated device time of waiting frames; more is refused likewise.
    pub queue_time: Duration,
    /// Minimum share of the device's time for frames of jobs ([`Client::Job`]); above 0, below 1.
    pub job_share: f64,
    /// Largest number of frames recorded into one submission.
    pub max_batch: usize,
    /// Frames of jobs that are encoded at a time. Requests and streams have a thread more each.
    pub encoder_threads: usize,
    /// For tests: is called before each frame is encoded.
    #[doc(hidden)]
    pub encode_hook: Option<EncodeHook>,
    /// Width · height of one frame.
    pub max_pixels: u64,
    /// Longest side of a frame.
    pub max_side: u32,
    /// Never use 64-bit atomics, even where the adapter has them.
    pub force_32_bit: bool,
    /// Largest number of bytes that a shader binds at once; `None`: as many as the adapter can. Less means smaller pages.
    pub max_binding_bytes: Option<u64>,
    /// For measurements: boxes of triangles with a longer side than this go to the rasteriser; `None`: the measured best.
    #[doc(hidden)]
    pub small_triangle_px: Option<u32>,
    /// For tests and measurements: draws chunks that are hidden behind others, too.
    #[doc(hidden)]
    pub draw_hidden: bool,
    /// For measurements: boxes of splats with a longer side than this go to walk_splats; `None`: the measured best.
    #[doc(hidden)]
    pub small_splat_px: Option<u32>,
    /// For tests: largest area of the boxes of a frame's large triangles, in units of 4096 pixels; `None`: about ten seconds'
    /// work.
    #[doc(hidden)]
    pub large_units_limit: Option<u32>,
    /// For measurements and tests: whether large triangles go to the rasteriser; `None`: the measured best.
    #[doc(hidden)]
    pub rasterise: Option<bool>,
    /// For tests: is called when a patch has listed the instances anew, before the scene is exchanged.
    #[doc(hidden)]
    pub patch_hook: Option<Arc<dyn Fn() + Send + Sync>>,
    /// Clouds of so many points get the normals and kernels that they lack when they are read, larger ones when a frame needs them.
    pub estimate_at_once: usize,
    /// For tests: estimates of large clouds do not begin while this is shut.
    #[doc(hidden)]
    pub estimate_latch: Option<Arc<Latch>>,
    /// For tests: files that changed more recently than this are not kept packed.
    #[doc(hidden)]
    pub settled_after: Duration,
    /// Cache of point trees and large clouds between processes; `None`: they are built and read anew.
    pub bake_cache: Option<BakeCache>,
    /// Pipelines that are built before frames need them; `None`: none.
    pub prime: Option<PrimeConfig>,
    /// Up direction of bare asset files, instead of a guess.
    pub up: Option<DVec3>,
    pub read: ReadOptions,
    pub scene: SceneLimits,
}

/// Errors in words that a user can act on. Knows nothing of HTTP.
#[derive(Debug, Clone, thiserror::Error)]
pub enum EngineError {
    #[error("there is no scene `{id}`")]
    UnknownScene { id: String },
    #[error("there is no node `{node}` in scene `{scene}`")]
    UnknownNode { scene: String, node: String },
    /// A parameter that cannot be used; `accepted` says what would be accepted.
    #[error("{parameter}: {reason}; accepted: {accepted}")]
    BadParameter { parameter: &'static str, reason: String, accepted: String },
    #[error("a scene `{id}` is already loaded")]
    SceneExists { id: String },
    #[error("the queue is full")]
    Busy { retry_after: Duration },
    /// A newer request replaced this request of a [`Seat`].
    #[error("a newer request took this one's place")]
    Overtaken,
    /// The deadline has passed, or will pass given what is queued before the frame and what such frames have cost.
    #[error("the deadline passes before the frame can be had")]
    DeadlineExceeded { retry_after: Duration },
    #[error("the GPU was lost; scenes are being rebuilt")]
    DeviceLost { retry_after: Duration },
    #[error("shutting down")]
    ShuttingDown,
    #[error("{what} needs {needed} bytes on the GPU, the budget is {budget}")]
    OutOfGpuMemory { what: String, needed: u64, budget: u64 },
    #[error("{what} take {needed} bytes, of which this adapter binds {limit} at once")]
    OverBinding { what: &'static str, needed: u64, limit: u64 },
    /// A limit of [`Limits`] was exceeded.
    #[error("{found} is more than the limit of {limit} {what}")]
    OverLimit { what: &'static str, found: u64, limit: u64 },
    /// A load was cancelled, or there is not enough host memory for it.
    #[error(transparent)]
    Interrupted(#[from] Interrupt),
    #[error("{0}")]
    Asset(Arc<AssetError>),
    #[error("{0}")]
    Scene(Arc<SceneError>),
    /// No adapter can draw; the text says what to install.
    #[error("{0}")]
    NoGpu(String),
    #[error("internal error: {0}")]
    Internal(String),
}

/// What `GET /v1/limits` lists.
#[derive(Clone, Debug, Serialize, utoipa::ToSchema)]
pub struct Limits {
    pub max_pixels: u64,
    pub max_side: u32,
    pub queue_capacity: usize,
    pub max_batch: usize,
    pub gpu_budget_bytes: u64,
    /// Host memory that loaded scenes, loading and baking may hold together, and what they hold now.
    pub host_memory_bytes: u64,
    pub host_memory_in_use_bytes: u64,
    pub max_vertices: u64,
    pub max_triangles: u64,
    pub max_texels: u64,
    pub max_decompressed_bytes: u64,
    pub max_nodes: u64,
    pub max_depth: u32,
    pub max_instances: u64,
    pub max_json_bytes: u64,
    /// Objects of a scene's JSON, whatever they are.
    pub max_json_objects: u64,
    /// Solids that one asset is made of, each counted as often as it is used.
    pub max_operands: u64,
}

/// A loaded scene as callers see it.
#[derive(Clone, Debug, Serialize, utoipa::ToSchema)]
pub struct SceneInfo {
    pub id: String,
    pub name: String,
    /// Grows with every change.
    pub revision: u64,
    /// World-space box: min and max corner, `null` when empty.
    pub bounds: Option<[[f64; 3]; 2]>,
    pub samples: u64,
    pub triangles: u64,
    pub instances: u64,
    pub assets: Vec<AssetInfo>,
    /// Bytes that the scene needs on the GPU, and whether it is there now.
    pub gpu_bytes: u64,
    pub resident: bool,
    /// Whether normals and kernels of its samples are there. Those of large clouds are estimated when a frame needs them.
    pub estimates: Estimates,
    pub cameras: Vec<NamedCamera>,
    pub paths: Vec<String>,
    /// Names of top-level nodes, as `PATCH` takes them.
    pub nodes: Vec<String>,
    pub lights: usize,
    /// Which way is up: what a pose without `up` uses.
    pub up: [f64; 3],
    /// Why that way is up: a guess names its evidence.
    pub up_because: String,
    pub warnings: Vec<String>,
}

#[derive(Clone, Debug, Serialize, utoipa::ToSchema)]
pub struct AssetInfo {
    pub name: String,
    pub format: &'static str,
    pub samples: u64,
    pub triangles: u64,
    pub has_colors: bool,
    /// Colours were not in the file and show the intensity.
    pub shows_intensity: bool,
    pub has_normals: bool,
    /// Normals were not in the file and come from the neighbourhood.
    pub normals_estimated: bool,
}

#[derive(Clone, Debug, Serialize, utoipa::ToSchema)]
pub struct NamedCamera {
    pub name: String,
    pub eye: [f64; 3],
    pub target: [f64; 3],
    pub up: [f64; 3],
    pub fov: f64,
}

impl NamedCamera {
    pub fn new(name: &str, camera: &Camera) -> Self {
        Self {
            name: name.to_owned(),
            eye: camera.eye.into(),
            target: camera.target.into(),
            up: camera.up.into(),
            fov: camera.fov_deg,
        }
    }
}

/// Source of a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Source {
    /// A scene file or an asset file.
    pub path: PathBuf,
    /// Folder to which file names in a scene are relative; `None`: the scene file's own.
    pub base: Option<PathBuf>,
    /// Up direction of a bare asset file, instead of [`EngineConfig::up`].
    pub up: Option<DVec3>,
}

impl Source {
    /// Returns the source of a file whose names are relative to its own folder.
    pub fn at(path: impl Into<PathBuf>) -> Source {
        Source { path: path.into(), base: None, up: None }
    }
}

/// Identifies a scene at one revision.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SceneMark {
    /// Unique among all scenes of a process and their revisions.
    uid: u64,
    pub revision: u64,
}

/// Changes to one top-level node; `None` leaves a property as it is.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NodePatch {
    pub world_from_node: Option<glam::DAffine3>,
    pub visible: Option<bool>,
}

/// A finished frame.
#[derive(Clone, Debug)]
pub struct EncodedFrame {
    pub bytes: Bytes,
    pub content_type: &'static str,
    pub receipt: Receipt,
}

/// Whether frames can be drawn now, and if not, why.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Readiness {
    Ready,
    Starting,
    Stalled {
        for_ms: u64,
    },
    DeviceLost,
    Draining,
    /// The render thread ended because of a defect: only a new process can draw again.
    Failed,
}

/// Counters for `/metrics`, cumulative since the start.
#[derive(Clone, Debug, Default)]
pub struct EngineStats {
    pub frames: u64,
    pub batches: u64,
    pub coalesced: u64,
    pub cancelled: u64,
    /// Jobs that a newer one replaced before they were begun.
    pub overtaken: u64,
    pub expired: u64,
    pub refused: u64,
    /// Jobs refused because the queue left no time until their deadline.
    pub hopeless: u64,
    pub failed: u64,
    pub queued: u64,
    pub device_losses: u64,
    pub evictions: u64,
    pub uploads: u64,
    /// Records of instances written to the GPU; an edit writes those that it moved, and their neighbours.
    pub instances_written: u64,
    pub gpu_bytes_resident: u64,
    pub gpu_ns: u64,
    pub encode_ns: u64,
    /// Pipelines that a frame had to build or to wait for, on the device in use.
    pub pipelines_late: u64,
    /// Pipelines that were built before frames needed them.
    pub pipelines_primed: u64,
}

/// A handle of the running engine; clones share it. When the last handle is dropped, the render thread finishes the accepted jobs
/// and ends.
#[derive(Clone)]
pub struct Engine {
    inner: Arc<Inner>,
}

struct Inner {
    shared: Arc<Shared>,
    thread: parking_lot::Mutex<Option<std::thread::JoinHandle<()>>>,
}

impl Drop for Inner {
    fn drop(&mut self) {
        self.shared.stop();
        self.shared.background.end_all();
        if let Some(thread) = self.thread.lock().take() {
            let _ = thread.join();
        }
        self.shared.finish_writing();
    }
}

/// An identifier that is being loaded; released in every case when this is dropped.
struct Reserved<'a> {
    shared: &'a Shared,
    id: &'a str,
}

impl Drop for Reserved<'_> {
    fn drop(&mut self) {
        self.shared.loading.lock().remove(self.id);
    }
}

/// A promised frame. Await it; dropping it cancels the job unless somebody else waits for the same frame
/// or it has been submitted already.
pub struct FrameTicket {
    receiver: tokio::sync::oneshot::Receiver<Result<Arc<EncodedFrame>, EngineError>>,
}

impl FrameTicket {
    /// Blocks until the frame is there; not for threads that run async tasks.
    pub fn wait(self) -> Result<Arc<EncodedFrame>, EngineError> {
        self.receiver.blocking_recv().unwrap_or(Err(EngineError::ShuttingDown))
    }
}

impl std::future::Future for FrameTicket {
    type Output = Result<Arc<EncodedFrame>, EngineError>;

    fn poll(
        mut self: std::pin::Pin<&mut Self>,
        context: &mut std::task::Context<'_>,
    ) -> std::task::Poll<Self::Output> {
        std::pin::Pin::new(&mut self.receiver)
            .poll(context)
            .map(|result| result.unwrap_or(Err(EngineError::ShuttingDown)))
    }
}

impl EngineConfig {
    /// Returns the defaults for scenes below `root`.
    pub fn new(root: impl Into<PathBuf>) -> Self {
        let cores = std::thread::available_parallelism().map_or(2, usize::from);
        Self {
            root: root.into(),
            gpu_budget_bytes: None,
            memory: HostMemory::unlimited(),
            queue_capacity: 256,
            queue_time: Duration::from_secs(30),
            job_share: DEFAULT_JOB_SHARE,
            max_batch: 16,
            encoder_threads: cores.clamp(1, 8),
            encode_hook: None,
            max_pixels: 1 << 24,
            max_side: 8192,
            force_32_bit: false,
            max_binding_bytes: None,
            small_triangle_px: None,
            draw_hidden: false,
            small_splat_px: None,
            rasterise: None,
            large_units_limit: None,
            estimate_at_once: ESTIMATE_AT_ONCE,
            patch_hook: None,
            estimate_latch: None,
            settled_after: SETTLED_AFTER,
            bake_cache: None,
            prime: None,
            read: ReadOptions::default(),
            up: None,
            scene: SceneLimits::default(),
        }
    }
}

impl Engine {
    /// Finds an adapter and starts the render thread and the encoders.
    ///
    /// # Errors
    /// No adapter, or one that lacks what the passes need; the message says what to install.
    pub fn start(config: EngineConfig) -> Result<Engine, EngineError> {
        let shared = Arc::new(Shared::new(config));
        let scenes: std::sync::Weak<Shared> = Arc::downgrade(&shared);
        shared.bakes.serve(scenes);
        let (sender, receiver) = std::sync::mpsc::sync_channel(1);
        let for_thread = shared.clone();
        let thread = std::thread::Builder::new()
            .name("render".into())
            .spawn(move || {
                let ran = catch_unwind(AssertUnwindSafe(|| {
                    worker::run(&for_thread, |opened| {
                        let _ = sender.send(opened);
                    });
                }));
                if ran.is_err() {
                    for_thread.abandon();
                }
            })
            .map_err(|error| EngineError::Internal(error.to_string()))?;
        match receiver.recv() {
            Ok(Ok(())) => {
                let (asked, (limit, _)) =
                    (shared.config.max_pixels, resolve::frame_limits(&shared));
                if asked > limit {
                    tracing::warn!(
                        asked,
                        limit,
                        "the adapter binds fewer pixels than --max-pixels"
                    );
                }
                let thread = parking_lot::Mutex::new(Some(thread));
                Ok(Engine { inner: Arc::new(Inner { shared, thread }) })
            }
            Ok(Err(error)) => Err(EngineError::NoGpu(error.to_string())),
            Err(_) => {
                Err(EngineError::Internal("the render thread ended while it opened the GPU".into()))
            }
        }
    }

    fn shared(&self) -> &Shared {
        &self.inner.shared
    }

    /// Loads a scene file or a single asset file (below the root) under `id`. Blocks: reads, bakes, checks the
    /// budget; call from a blocking thread. Fails without side effects.
    pub fn load(&self, id: &str, path: &std::path::Path) -> Result<SceneInfo, EngineError> {
        self.load_within(id, &Source::at(path), &self.admission())
    }

    /// Returns a load's admission to host memory, which is also the handle that cancels it.
    pub fn admission(&self) -> Admission {
        Admission::new(&self.shared().config.memory)
    }

    /// Loads like [`Engine::load`], until the admission is cancelled.
    ///
    /// # Errors
    /// As [`Engine::load`]; [`EngineError::Interrupted`].
    pub fn load_within(
        &self,
        id: &str,
        source: &Source,
        admission: &Admission,
    ) -> Result<SceneInfo, EngineError> {
        let shared = self.shared();
        let exists = || EngineError::SceneExists { id: id.to_owned() };
        if !shared.loading.lock().insert(id.to_owned()) {
            return Err(exists());
        }
        let _reserved = Reserved { shared, id };
        // Check again under the reservation: its previous holder may have loaded the scene.
        if shared.library.read().holds(id) {
            return Err(exists());
        }
        let loaded = self.load_reserved(id, source, admission);
        // Return the memory that reading and baking held, wherever it lies in the heap.
        memory::release_unused();
        loaded
    }

    fn load_reserved(
        &self,
        id: &str,
        source: &Source,
        admission: &Admission,
    ) -> Result<SceneInfo, EngineError> {
        let shared = self.shared();
        let began = std::time::Instant::now();
        let path = library::check_path(&source.path, &shared.config.root)?;
        let source = Source { path, ..source.clone() };
        let mut loaded = library::load(id, &source, &shared.config, &shared.cache, admission)?;
        self.check_fits(&mut loaded)?;
        admission.check()?;
        let kept = std::mem::take(&mut loaded.kept);
        let info = self.info(&loaded);
        shared.library.write().insert(loaded);
        for kept in kept {
            shared.write_apart(move || kept.write());
        }
        shared.scenes_changed();
        let (samples, triangles) = (info.samples, info.triangles);
        let elapsed_ms = began.elapsed().as_millis() as u64;
        tracing::info!(id, samples, triangles, elapsed_ms, "scene loaded");
        Ok(info)
    }

    /// Checks that a scene alone fits the GPU, at least where frames list the parts that they need. If the whole scene does not
    /// fit, the scene gets a warning.
    fn check_fits(&self, loaded: &mut library::Loaded) -> Result<(), EngineError> {
        let adapter = self.shared().adapter();
        let fits = |part| {
            let (binding, budget) = (adapter.max_binding_bytes, adapter.budget);
            crate::residency::check_fits(binding, budget, &loaded.model, part)
                .map_err(renderer::engine_error)
        };
        fits(Part::Stored)?;
        if let Err(error) = fits(Part::Whole) {
            let warning = format!("too large for full detail: {error}; lod=spt draws it");
            if !loaded.info.warnings.contains(&warning) {
                loaded.info.warnings.push(warning);
            }
        }
        Ok(())
    }

    /// Forgets a scene and frees its GPU memory.
    pub fn remove(&self, id: &str) -> Result<(), EngineError> {
        let shared = self.shared();
        let removed = shared.library.write().remove(id);
        removed.ok_or_else(|| EngineError::UnknownScene { id: id.to_owned() })?;
        shared.background.end(id);
        shared.wake_for_removal();
        shared.scenes_changed();
        tracing::info!(id, "scene deleted");
        Ok(())
    }

    /// Moves, shows or hides a top-level node. The scene gets a new revision; only transforms are uploaded.
    pub fn patch(&self, id: &str, node: &str, patch: &NodePatch) -> Result<SceneInfo, EngineError> {
        let shared = self.shared();
        // Two patches must not start from the same revision. Listing the instances again may take a while, during which frames
        // are still requested: the library is locked only for looking up and replacing.
        let _alone = shared.patching.lock();
        loop {
            let loaded = shared.library.read().get(id);
            let loaded = loaded.ok_or_else(|| EngineError::UnknownScene { id: id.to_owned() })?;
            let mut patched = loaded.patched(node, patch, &shared.config)?;
            // A node that becomes visible may draw more than fits.
            self.check_fits(&mut patched)?;
            if let Some(hook) = &shared.config.patch_hook {
                hook();
            }
            let info = self.info(&patched);
            if shared.library.write().replace(&loaded, patched) {
                shared.scenes_changed();
                tracing::info!(id, node, revision = info.revision, "scene changed");
                return Ok(info);
            }
            // The scene was removed meanwhile, and perhaps loaded again.
        }
    }

    pub fn scenes(&self) -> Vec<SceneInfo> {
        self.shared().library.read().all().iter().map(|loaded| self.info(loaded)).collect()
    }

    pub fn scene(&self, id: &str) -> Result<SceneInfo, EngineError> {
        let loaded = self.shared().library.read().get(id);
        loaded
            .map(|loaded| self.info(&loaded))
            .ok_or_else(|| EngineError::UnknownScene { id: id.to_owned() })
    }

    /// Returns a camera path that the scene names.
    pub fn camera_path(&self, id: &str, name: &str) -> Result<CameraPath, EngineError> {
        let loaded = self.shared().library.read().get(id);
        loaded.ok_or_else(|| EngineError::UnknownScene { id: id.to_owned() })?.camera_path(name)
    }

    fn info(&self, loaded: &library::Loaded) -> SceneInfo {
        let shared = self.shared();
        SceneInfo {
            resident: shared.is_resident(&loaded.info.id),
            estimates: shared.estimates(loaded),
            ..loaded.info.clone()
        }
    }

    /// Returns the strong entity tag (quoted) of the frame for `request`. Validates the request; needs no GPU work.
    pub fn etag(&self, request: &FrameRequest) -> Result<String, EngineError> {
        Ok(resolve::resolve(self.shared(), request)?.key)
    }

    /// Returns the tag as [`Engine::etag`] does; `None` for a frame that will change once normals and kernels are estimated.
    pub fn final_etag(&self, request: &FrameRequest) -> Result<Option<String>, EngineError> {
        let resolved = resolve::resolve(self.shared(), request)?;
        Ok(resolved.provisional.is_none().then_some(resolved.key))
    }

    /// Returns whether a frame for this request must wait for a bake, which [`Engine::bake`] does.
    pub fn must_bake(&self, request: &FrameRequest) -> bool {
        let loaded = self.shared().library.read().get(&request.scene);
        loaded.is_some_and(|loaded| resolve::goal(&loaded, request).is_some())
    }

    /// Builds what a request needs and is missing: the scene's point trees, or normals and kernels of large clouds. Blocks for
    /// some seconds per million samples.
    ///
    /// # Errors
    /// An unknown scene, a geometry that no tree can be built of, or a file that is not what it was.
    pub fn bake(&self, request: &FrameRequest) -> Result<(), EngineError> {
        self.begin_bake(request)?.map_or(Ok(()), BakeTicket::wait)
    }

    /// Begins a bake and returns its ticket, shared with all others who wait for the bake; `None` when everything is there. The
    /// bake is given up when nobody waits any more.
    ///
    /// # Errors
    /// An unknown scene.
    pub fn begin_bake(&self, request: &FrameRequest) -> Result<Option<BakeTicket>, EngineError> {
        let loaded = self.shared().library.read().get(&request.scene);
        let loaded =
            loaded.ok_or_else(|| EngineError::UnknownScene { id: request.scene.clone() })?;
        let goal = resolve::goal(&loaded, request);
        Ok(goal.map(|goal| self.shared().bakes.join(loaded, goal)))
    }

    /// Returns the number of running bakes of [`Engine::begin_bake`], including those that are being given up.
    pub fn bakes_running(&self) -> usize {
        self.shared().bakes.running()
    }

    /// Builds or reads the point trees of all of a scene's assets, keeps them for frames, and returns their statistics. Blocks
    /// for a few seconds per million samples that are in no cache.
    ///
    /// # Errors
    /// An unknown scene, or a geometry that no tree can be built of.
    pub fn bake_all(
        &self,
        id: &str,
        tell: impl FnMut(BakeEvent),
    ) -> Result<Vec<BakedAsset>, EngineError> {
        let loaded = self.shared().library.read().get(id);
        let loaded = loaded.ok_or_else(|| EngineError::UnknownScene { id: id.to_owned() })?;
        let loaded = self.shared().whole(&loaded)?;
        loaded.bake_each(self.shared().config.bake_cache.as_ref(), true, tell)
    }

    /// Queues a frame.
    ///
    /// # Errors
    /// Any error of the request, or [`EngineError::Busy`]; nothing is queued then.
    pub fn submit(&self, request: FrameRequest) -> Result<FrameTicket, EngineError> {
        self.submit_for(Client::Unnamed, request)
    }

    /// Queues a frame for a client, which shares the device with the others; an [`Origin`] also names the request.
    ///
    /// # Errors
    /// As [`Engine::submit`].
    pub fn submit_for(
        &self,
        origin: impl Into<Origin>,
        request: FrameRequest,
    ) -> Result<FrameTicket, EngineError> {
        self.submit_tagged(origin, request).map(|(_, ticket)| ticket)
    }

    /// Queues a frame and returns its tag (as of [`Engine::etag`]), which stays valid even if the scene changes meanwhile.
    ///
    /// # Errors
    /// As [`Engine::submit`].
    pub fn submit_tagged(
        &self,
        origin: impl Into<Origin>,
        request: FrameRequest,
    ) -> Result<(String, FrameTicket), EngineError> {
        let resolved = resolve::resolve(self.shared(), &request)?;
        let tag = resolved.key.clone();
        let (_, receiver) = self.shared().enqueue(origin.into(), resolved, request)?;
        Ok((tag, FrameTicket { receiver }))
    }

    /// Returns a place in the queue for a client that wants only the newest frame. Seats of the client `of` share the device's
    /// time.
    pub fn seat(&self, of: Client) -> Seat {
        Seat::new(self, of)
    }

    /// Sets the observer of batches and frames; only the first call succeeds. Returns whether this one did.
    pub fn observe(&self, observer: Arc<dyn Observer>) -> bool {
        self.shared().observer.set(observer).is_ok()
    }

    /// Changes whenever a scene is loaded, patched or removed.
    pub fn changes(&self) -> tokio::sync::watch::Receiver<u64> {
        self.shared().changes.subscribe()
    }

    /// Returns a mark that is unique to the scene and its revision; `None` when there is no such scene.
    pub fn scene_mark(&self, id: &str) -> Option<SceneMark> {
        let loaded = self.shared().library.read().get(id)?;
        Some(SceneMark { uid: loaded.model.uid, revision: loaded.model.revision })
    }

    /// Returns how the samples of a frame would be drawn, which a request may leave open.
    pub fn drawn_as(&self, request: &FrameRequest) -> Result<Reconstruct, EngineError> {
        Ok(resolve::resolve(self.shared(), request)?.drawing.reconstruct)
    }

    /// Returns the plan for a request.
    pub fn plan(&self, request: &FrameRequest) -> Result<crate::plan::FramePlan, EngineError> {
        Ok(resolve::resolve(self.shared(), request)?.drawing.plan)
    }

    pub fn readiness(&self) -> Readiness {
        self.shared().readiness()
    }

    pub fn stats(&self) -> EngineStats {
        self.shared().snapshot()
    }

    pub fn limits(&self) -> Limits {
        let config = &self.shared().config;
        let adapter = self.shared().adapter();
        let (max_pixels, max_side) = resolve::frame_limits(self.shared());
        Limits {
            max_pixels,
            max_side,
            queue_capacity: config.queue_capacity,
            max_batch: config.max_batch,
            gpu_budget_bytes: adapter.budget,
            host_memory_bytes: config.memory.budget(),
            host_memory_in_use_bytes: config.memory.in_use(),
            max_vertices: config.read.max_vertices,
            max_triangles: config.read.max_triangles,
            max_texels: config.read.max_texels,
            max_decompressed_bytes: config.read.max_decompressed_bytes,
            max_nodes: config.scene.max_nodes,
            max_depth: config.scene.max_depth,
            max_instances: config.scene.max_instances,
            max_json_bytes: config.scene.max_json_bytes,
            max_json_objects: config.scene.max_json_objects,
            max_operands: config.scene.max_operands,
        }
    }

    /// Returns the name of the adapter, as in receipts.
    pub fn adapter(&self) -> String {
        self.shared().adapter().name
    }

    /// Refuses new jobs and finishes the accepted ones. Blocks.
    pub fn drain(&self) {
        self.shared().stop();
        while self.shared().has_unanswered() {
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
    }

    /// Makes the render thread panic, for tests.
    #[doc(hidden)]
    pub fn break_render_thread(&self) {
        self.shared().break_render_thread();
    }

    /// Waits until pipelines have been built ahead, at most for `patience`, and returns whether they have been.
    #[doc(hidden)]
    pub fn await_primed(&self, patience: Duration) -> bool {
        self.shared().await_primed(patience)
    }

    /// Makes the driver refuse the next submission, for tests.
    #[doc(hidden)]
    pub fn spoil_next_submission(&self) {
        self.shared().spoil_next_submission();
    }

    /// Loses the device on purpose, for tests of its recovery.
    #[doc(hidden)]
    pub fn lose_device(&self) {
        self.shared().lose_device();
    }
}
