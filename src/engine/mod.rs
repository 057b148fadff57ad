//! The engine (floor 5): takes requests and returns encoded frames with receipts. One thread owns the device.
//!
//! # Order of locks
//!
//! A thread that holds a lock takes only locks further down this list. Locks of one line are never held together.
//!
//! | lock | guards | held during |
//! |---|---|---|
//! | `EngineState::patching` | the next revision of any scene | a patch, with its list of instances |
//! | [`MadeOnce`](crate::residency::once::MadeOnce) of a scene, then of an asset | the making of trees or estimates | a bake; others wait with a time limit and ask whether they are still wanted |
//! | `EngineState::library` | the map of scenes | a lookup or an exchange |
//! | `Background::running` | estimates that no frame waits for | a lookup |
//! | `Planners::known`, then the pace of a scene's measurements | measured frames | a look-up or a change |
//! | `BakeService::state` | waiting and running bakes | a lookup |
//! | `EngineState::schedule` | queue, costs, unanswered frames | a decision of the queue |
//! | `EncodeBacklog::state` | frames that wait for an encoder | a decision of the queue |
//! | a frame's own locks, `EngineState::{loading, adapter, resident, cache}`, `Background::writers` | one value each | a read or a write |
//!
//! Nobody draws, encodes, bakes, reads a file or answers a caller under a lock, but under the first two.

mod asset_cache;
mod asset_keys;
mod background_estimates;
mod bake_files;
pub mod bake_service;
mod charges;
mod choices;
mod cloud_cache;
mod config;
mod encode_backlog;
mod encoders;
mod entity_tag;
mod error;
mod estimates;
mod exposures;
mod finish;
mod frame_job;
mod framing;
mod group;
mod info;
mod instance_trees;
mod landing;
mod latest_slot;
mod library;
mod load;
mod loaded;
mod observe;
mod patches;
pub mod pick;
mod planner;
mod point_tree_cache;
mod point_trees;
mod priming;
pub mod queue;
pub mod receipt;
mod render_thread;
mod renderer;
mod request;
mod resolve;
mod resolved;
mod scene_files;
mod sizes;
mod state;
mod stats;
mod ticket;
mod trace;
mod uid;
mod viewpoint;
mod watch;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Duration;

pub use bake_files::{BakeEvent, BakedAsset, bake_file};
pub use bake_service::{BakeTicket, Latch};
pub use config::{DEFAULT_JOB_SHARE, ESTIMATE_AT_ONCE, EngineConfig, LevelsHook};
pub use encoders::EncodeHook;
pub use error::EngineError;
pub use info::{
    AssetInfo, EstimateState, Estimates, Limits, LoadNumber, NamedCamera, NodePatch, SceneInfo,
    SceneMark, Source,
};
pub use latest_slot::LatestSlot;
pub use observe::Observer;
pub use planner::{MovingFrame, PlannedFrame};
pub use point_tree_cache::BakeSource;
pub use priming::PrimeConfig;
pub use queue::{Class, Client};
pub use receipt::Receipt;
pub use renderer::Renderer;
pub use request::{FrameRequest, Pose};
pub use resolve::{Resolution, UnbakedFrame};
pub use resolved::ResolvedFrame;
pub use scene_files::SceneFiles;
pub use stats::{EngineStats, Readiness};
pub use ticket::{EncodedFrame, FrameTicket};
pub use trace::{Origin, RequestId};

use crate::bake::uncovered::uncovered_share;
use crate::memory::{self, Admission};
use crate::plan::planner::Moving;
use crate::residency::{Part, model::AssetModel};
use crate::scene::CameraPath;

use self::bake_service::Goal;
use self::state::EngineState;

/// A handle of the running engine; clones share it. When the last handle is dropped, the render thread finishes the accepted jobs
/// and ends.
#[derive(Clone)]
pub struct Engine {
    inner: Arc<Inner>,
}

struct Inner {
    state: Arc<EngineState>,
    thread: parking_lot::Mutex<Option<std::thread::JoinHandle<()>>>,
}

impl Drop for Inner {
    fn drop(&mut self) {
        self.state.stop();
        self.state.background.end_all();
        if let Some(thread) = self.thread.lock().take() {
            let _ = thread.join();
        }
        self.state.finish_writing();
    }
}

/// An identifier that is being loaded; released in every case when this is dropped.
struct Reserved<'a> {
    state: &'a EngineState,
    id: &'a str,
}

impl Drop for Reserved<'_> {
    fn drop(&mut self) {
        self.state.loading.lock().remove(self.id);
    }
}

impl Engine {
    /// Finds an adapter and starts the render thread and the encoders.
    ///
    /// # Errors
    /// No adapter, or one that lacks what the passes need; the message says what to install.
    pub fn start(config: EngineConfig) -> Result<Engine, EngineError> {
        let state = Arc::new(EngineState::new(config));
        let scenes: std::sync::Weak<EngineState> = Arc::downgrade(&state);
        state.bake_service.serve(scenes);
        let (sender, receiver) = std::sync::mpsc::sync_channel(1);
        let for_thread = state.clone();
        let thread = std::thread::Builder::new()
            .name("render".into())
            .spawn(move || {
                let ran = catch_unwind(AssertUnwindSafe(|| {
                    render_thread::run(&for_thread, |opened| {
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
                let (asked, (limit, _)) = (state.config.max_pixels, sizes::frame_limits(&state));
                if asked > limit {
                    tracing::warn!(
                        asked,
                        limit,
                        "the adapter binds fewer pixels than --max-pixels"
                    );
                }
                let thread = parking_lot::Mutex::new(Some(thread));
                Ok(Engine { inner: Arc::new(Inner { state, thread }) })
            }
            Ok(Err(error)) => Err(EngineError::NoGpu(error.to_string())),
            Err(_) => {
                Err(EngineError::Internal("the render thread ended while it opened the GPU".into()))
            }
        }
    }

    fn state(&self) -> &EngineState {
        &self.inner.state
    }

    /// Loads a scene file or a single asset file (below the root) under `id`. Blocks: reads, bakes, checks the
    /// budget; call from a blocking thread. Fails without side effects.
    pub fn load(&self, id: &str, path: &std::path::Path) -> Result<SceneInfo, EngineError> {
        self.load_within(id, &Source::at(path), &self.admission())
    }

    /// Returns a load's admission to host memory, which is also the handle that cancels it.
    pub fn admission(&self) -> Admission {
        Admission::new(&self.state().config.memory)
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
        let state = self.state();
        let exists = || EngineError::SceneExists { id: id.to_owned() };
        if !state.loading.lock().insert(id.to_owned()) {
            return Err(exists());
        }
        let _reserved = Reserved { state, id };
        // Check again under the reservation: its previous holder may have loaded the scene.
        if state.library.read().holds(id) {
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
        let state = self.state();
        let began = std::time::Instant::now();
        let path = load::check_path(&source.path, &state.config.root)?;
        let source = Source { path, ..source.clone() };
        let mut loaded = load::load(id, &source, &state.config, &state.cache, admission)?;
        self.check_fits(&mut loaded)?;
        admission.check()?;
        let unwritten = std::mem::take(&mut loaded.unwritten);
        let info = self.info(&loaded);
        state.library.write().insert(loaded);
        for cloud in unwritten {
            state.write_apart(move || cloud.write());
        }
        state.scenes_changed();
        let (samples, triangles, segments) = (info.samples, info.triangles, info.segments);
        let elapsed_ms = began.elapsed().as_millis() as u64;
        tracing::info!(id, samples, triangles, segments, elapsed_ms, "scene loaded");
        Ok(info)
    }

    /// Checks that a scene alone fits the GPU, at least where frames list the parts that they need. If the whole scene does not
    /// fit, the scene gets a warning.
    fn check_fits(&self, loaded: &mut loaded::Loaded) -> Result<(), EngineError> {
        let adapter = self.state().adapter();
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
        let state = self.state();
        let removed = state.library.write().remove(id);
        let unknown = EngineError::UnknownScene { id: id.to_owned() };
        let removed = removed.ok_or_else(|| unknown.clone())?;
        state.background.end(id);
        state.bake_service.cancel(removed.load(), &unknown);
        state.wake_for_removal();
        state.scenes_changed();
        tracing::info!(id, "scene deleted");
        Ok(())
    }

    pub fn scenes(&self) -> Vec<SceneInfo> {
        self.state().library.read().all().iter().map(|loaded| self.info(loaded)).collect()
    }

    pub fn scene(&self, id: &str) -> Result<SceneInfo, EngineError> {
        Ok(self.info(&*self.state().loaded(id)?))
    }

    /// Returns a camera path that the scene names.
    pub fn camera_path(&self, id: &str, name: &str) -> Result<CameraPath, EngineError> {
        self.state().loaded(id)?.camera_path(name)
    }

    fn info(&self, loaded: &loaded::Loaded) -> SceneInfo {
        let state = self.state();
        SceneInfo {
            resident: state.is_resident(&loaded.info.id),
            estimates: state.estimates(loaded),
            ..loaded.info.clone()
        }
    }

    /// Resolves a request: checks it and decides how it is drawn, once for all that follows. Needs no GPU work and never bakes.
    ///
    /// # Errors
    /// Any error of the request.
    pub fn resolve(&self, request: FrameRequest) -> Result<Resolution, EngineError> {
        self.resolve_planned(request, None)
    }

    /// Does the work of [`Engine::resolve`]. `planned` says how [`Engine::plan_moving`] chose the settings.
    ///
    /// # Errors
    /// Any error of the request.
    pub fn resolve_planned(
        &self,
        request: FrameRequest,
        planned: Option<PlannedFrame>,
    ) -> Result<Resolution, EngineError> {
        resolve::resolve(&self.inner.state, request, planned)
    }

    /// Chooses settings and size for a frame of a moving pose from the measurements of its scene. The request has the size of the still frame and a goal. With
    /// `at_once`, only from what needs no bake. `None` if the scene was not measured, or no measured settings go with those that are given.
    ///
    /// # Errors
    /// Any error of the request.
    pub fn plan_moving(
        &self,
        request: &FrameRequest,
        moving: &Moving<'_>,
        at_once: bool,
    ) -> Result<Option<MovingFrame>, EngineError> {
        resolve::moving(self.state(), request, moving, at_once)
    }

    /// Resolves a request after the bake that it needs, if any. Blocks; async code has [`Engine::resolve`].
    ///
    /// # Errors
    /// Any error of the request, or of the bake.
    pub fn resolve_blocking(
        &self,
        request: FrameRequest,
    ) -> Result<Arc<ResolvedFrame>, EngineError> {
        match self.resolve(request)? {
            Resolution::Ready(frame) => Ok(frame),
            Resolution::NeedsBake(unbaked) => unbaked.bake_blocking(),
        }
    }

    /// Finds what is wrong with a request, without deciding how the frame is drawn.
    ///
    /// # Errors
    /// Those of [`Engine::resolve`].
    pub fn check(&self, request: &FrameRequest) -> Result<(), EngineError> {
        resolve::lacking(self.state(), request).map(drop)
    }

    /// Returns whether a frame for this request must wait for a bake, which [`Engine::bake`] does. A request that is refused need not.
    pub fn must_bake(&self, request: &FrameRequest) -> bool {
        matches!(resolve::lacking(self.state(), request), Ok(Some(_)))
    }

    /// Builds what a request needs and is missing: the scene's point trees, or normals and kernels of large clouds. Blocks for
    /// some seconds per million samples.
    ///
    /// # Errors
    /// Any error of the request; a geometry that no tree can be built of, or a file that is not what it was.
    pub fn bake(&self, request: &FrameRequest) -> Result<(), EngineError> {
        self.begin_bake(request)?.map_or(Ok(()), BakeTicket::wait)
    }

    /// Begins a bake and returns its ticket, shared with all others who wait for the bake; `None` when everything is there. The
    /// bake is given up when nobody waits any more, and when the scene is deleted.
    ///
    /// # Errors
    /// Any error of the request.
    pub fn begin_bake(&self, request: &FrameRequest) -> Result<Option<BakeTicket>, EngineError> {
        match self.resolve(request.clone())? {
            Resolution::Ready(_) => Ok(None),
            Resolution::NeedsBake(unbaked) => unbaked.begin().map(Some),
        }
    }

    /// Returns the number of running bakes of [`Engine::begin_bake`], including those that are being given up.
    pub fn bakes_running(&self) -> usize {
        self.state().bake_service.running()
    }

    /// Returns the number of tickets of bakes that have not ended. For tests.
    #[doc(hidden)]
    pub fn bake_waiters(&self) -> usize {
        self.state().bake_service.waiters()
    }

    /// Estimates for each asset, in the order of [`SceneInfo::assets`], the share of the sampled surface that splats leave uncovered: the mean
    /// over its geometries, weighted by their samples. `None` where [`uncovered_share`] tells none, and while kernels are not estimated.
    ///
    /// # Errors
    /// An unknown scene.
    pub fn uncovered_shares(&self, id: &str) -> Result<Vec<Option<f64>>, EngineError> {
        let loaded = self.state().loaded(id)?;
        let of_asset = |asset: &Arc<AssetModel>| {
            let known = || asset.packed.geometries.iter().filter(|_| asset.deferred.is_none());
            let shares = known().filter_map(|geometry| {
                let samples = geometry.samples()?;
                Some((uncovered_share(samples)?, samples.positions.len() as f64))
            });
            let (sum, count) = shares
                .fold((0.0, 0.0), |(sum, all), (share, count)| (sum + share * count, all + count));
            (count > 0.0).then(|| sum / count)
        };
        Ok(loaded.model.assets.iter().map(of_asset).collect())
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
        let mut loaded = self.state().loaded(id)?;
        if !loaded.is_whole() {
            loaded = self.state().begin_bake(&loaded, Goal::Estimates)?.wait_for_scene()?;
        }
        loaded.bake_each(self.state().config.bake_cache.as_ref(), true, tell)
    }

    /// Queues a frame. Blocks as [`Engine::resolve_blocking`] does; async code has [`Engine::queue`].
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
        self.queue(origin, self.resolve_blocking(request)?)
    }

    /// Queues a resolved frame. It shows the scene as it was resolved, even if the scene changes meanwhile.
    ///
    /// # Errors
    /// [`EngineError::Busy`] and other refusals of the queue; nothing is queued then.
    pub fn queue(
        &self,
        origin: impl Into<Origin>,
        frame: Arc<ResolvedFrame>,
    ) -> Result<FrameTicket, EngineError> {
        let (_, receiver) = self.state().enqueue(origin.into(), frame)?;
        Ok(FrameTicket { receiver })
    }

    /// Returns a place in the queue for a client that wants only the newest frame. Slots of the client `of` share the device's
    /// time.
    pub fn latest_slot(&self, of: Client) -> LatestSlot {
        LatestSlot::new(self, of)
    }

    /// Changes whenever a scene is loaded, patched or removed.
    pub fn changes(&self) -> tokio::sync::watch::Receiver<u64> {
        self.state().changes.subscribe()
    }

    /// Returns a mark that is unique to the scene and its revision; `None` when there is no such scene.
    pub fn scene_mark(&self, id: &str) -> Option<SceneMark> {
        let loaded = self.state().library.read().get(id)?;
        Some(SceneMark { uid: loaded.model.uid, revision: loaded.model.revision })
    }

    pub fn readiness(&self) -> Readiness {
        self.state().readiness()
    }

    pub fn stats(&self) -> EngineStats {
        self.state().snapshot()
    }

    pub fn limits(&self) -> Limits {
        let config = &self.state().config;
        let adapter = self.state().adapter();
        let (max_pixels, max_side) = sizes::frame_limits(self.state());
        Limits {
            max_pixels,
            max_exposed_pixels: sizes::exposures_limit(self.state()),
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
        self.state().adapter().name
    }

    /// Refuses new jobs and finishes the accepted ones. Blocks.
    pub fn drain(&self) {
        self.state().stop();
        while self.state().has_unanswered() {
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
    }

    /// Makes the render thread panic, for tests.
    #[doc(hidden)]
    pub fn break_render_thread(&self) {
        self.state().break_render_thread();
    }

    /// Waits until pipelines have been built ahead, at most for `patience`, and returns whether they have been.
    #[doc(hidden)]
    pub fn await_primed(&self, patience: Duration) -> bool {
        self.state().await_primed(patience)
    }

    /// Makes the driver refuse the next submission, for tests.
    #[doc(hidden)]
    pub fn spoil_next_submission(&self) {
        self.state().spoil_next_submission();
    }

    /// Loses the device on purpose, for tests of its recovery.
    #[doc(hidden)]
    pub fn lose_device(&self) {
        self.state().lose_device();
    }
}
