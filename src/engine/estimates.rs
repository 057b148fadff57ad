//! Scenes of large clouds, which are drawn as points before normals and kernels of their samples are estimated.
//!
//! ```text
//! load ──► points alone ──a frame that needs more──► estimated by the bakes ([`super::bake_service`]) ──► whole, at the same revision
//! ```
//! A frame that leaves it open how samples are drawn does not wait: it gets points, its receipt says so, and the estimate
//! runs on in the background until it has ended or the scene is deleted.

use std::collections::HashMap;
use std::sync::Arc;
use std::thread::JoinHandle;

use parking_lot::Mutex;
use serde::Serialize;

use super::EngineError;
use super::bake_service::{Abandoned, BakeTicket, Goal, Scenes, Watch};
use super::cloud_cache::keep_whole;
use super::library::Loaded;
use super::state::EngineState;
use crate::memory::Interrupt;
use crate::plan::{Lod, Output, Reconstruct};

/// Whether the samples of a scene have their normals and kernels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum EstimateState {
    /// All samples have normals and kernels.
    Complete,
    /// Not yet: no frame has needed them.
    Deferred,
    Running,
    /// They cannot be estimated; `reason` says why.
    Failed,
}

/// How far the estimate of a scene's normals and kernels is.
#[derive(Clone, Debug, PartialEq, Serialize, utoipa::ToSchema)]
pub struct Estimates {
    pub state: EstimateState,
    /// Part that is done, of 1.
    pub done: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
}

/// Estimates that frames do not wait for, by scene.
#[derive(Default)]
pub struct Background {
    running: Mutex<HashMap<String, Running>>,
    /// What is being written to the cache.
    writers: Mutex<Vec<JoinHandle<()>>>,
}

struct Running {
    /// [`Loaded::load`] of the scene.
    load: u64,
    ticket: BakeTicket,
    failed: Option<EngineError>,
}

impl Running {
    fn look(&mut self) {
        if let Some(Err(error)) = self.ticket.outcome() {
            tracing::warn!(%error, "normals and kernels cannot be estimated");
            self.failed = Some(error);
        }
    }
}

impl Background {
    /// Ends what runs for a scene that is gone or whole.
    pub fn end(&self, scene: &str) {
        let ended = self.running.lock().remove(scene);
        // Its ticket takes a lock of its own.
        drop(ended);
    }

    pub fn end_all(&self) {
        let ended = std::mem::take(&mut *self.running.lock());
        drop(ended);
    }
}

impl Loaded {
    /// Whether a frame needs normals or kernels that are not there.
    pub fn lacks(&self, reconstruct: Reconstruct, lod: Lod, output: Output) -> bool {
        if self.is_whole() {
            return false;
        }
        let lit = output == Output::Color && self.facts.lights > 0;
        lod == Lod::Spt
            || reconstruct != Reconstruct::Points
            || (self.lacks_normals() && (output == Output::Normal || lit))
    }
}

impl EngineState {
    /// Has the samples of a scene estimated in the background; how much is done, of 1, or why it cannot be.
    pub fn estimate_in_background(&self, scene: &Arc<Loaded>) -> Result<f64, EngineError> {
        let (id, load) = (&scene.model.id, scene.load());
        // Taken before the list of estimates, here and wherever both are.
        let library = self.library.read();
        // A frame may outlive its scene, whose id another scene may have by now.
        if library.get(id).is_none_or(|held| held.load() != load) {
            return Ok(0.0);
        }
        let mut running = self.background.running.lock();
        let before = running.remove(id);
        let before = before.filter(|entry| entry.load == load && !self.may_pass_now(entry));
        let entry = running.entry(id.clone()).or_insert_with(|| {
            before.unwrap_or_else(|| Running {
                load,
                ticket: self.bake_service.join(scene.clone(), Goal::Estimates),
                failed: None,
            })
        });
        entry.look();
        match &entry.failed {
            Some(error) => Err(error.clone()),
            None => Ok(entry.ticket.progress()),
        }
    }

    /// Whether an estimate failed for lack of memory that is there by now.
    fn may_pass_now(&self, entry: &Running) -> bool {
        match &entry.failed {
            Some(EngineError::Interrupted(Interrupt::OutOfMemory(error))) => {
                self.config.memory.has_room(error.needed)
            }
            _ => false,
        }
    }

    /// How far the estimate of a scene is.
    pub fn estimates(&self, scene: &Loaded) -> Estimates {
        let told = |state, done| Estimates { state, done, reason: None };
        if scene.is_whole() {
            return told(EstimateState::Complete, 1.0);
        }
        let mut running = self.background.running.lock();
        let own = running.get_mut(&scene.model.id).filter(|entry| entry.load == scene.load());
        let Some(entry) = own else {
            return match self.bake_service.estimating(scene) {
                Some(done) => told(EstimateState::Running, done),
                None => told(EstimateState::Deferred, 0.0),
            };
        };
        entry.look();
        match &entry.failed {
            Some(error) => Estimates {
                reason: Some(error.to_string()),
                ..told(EstimateState::Failed, entry.ticket.progress())
            },
            None => told(EstimateState::Running, entry.ticket.progress()),
        }
    }

    /// Begins a bake of a loaded scene, or joins it if it runs already.
    ///
    /// # Errors
    /// [`EngineError::UnknownScene`] if the scene was deleted.
    pub fn begin_bake(&self, scene: &Arc<Loaded>, goal: Goal) -> Result<BakeTicket, EngineError> {
        let id = &scene.model.id;
        // Held while the bake is joined, so that a deletion either comes first or finds the bake and cancels it.
        let library = self.library.read();
        if library.get(id).is_none_or(|held| held.load() != scene.load()) {
            return Err(EngineError::UnknownScene { id: id.clone() });
        }
        Ok(self.bake_service.join(scene.clone(), goal))
    }

    /// Has something written on a thread of its own, which [`EngineState::finish_writing`] waits for.
    pub fn write_apart(&self, write: impl FnOnce() + Send + 'static) {
        let mut writers = self.background.writers.lock();
        writers.retain(|writer| !writer.is_finished());
        match std::thread::Builder::new().name("keep".into()).spawn(write) {
            Ok(writer) => writers.push(writer),
            Err(error) => tracing::warn!(%error, "a large cloud cannot be kept"),
        }
    }

    pub fn finish_writing(&self) {
        let writers = std::mem::take(&mut *self.background.writers.lock());
        for writer in writers {
            // The panic hook has logged the cause.
            let _ = writer.join();
        }
    }

    /// Puts whole scenes in place of all that can be.
    fn exchange_whole(&self) {
        self.cache.complete();
        let scenes = self.library.read().all();
        for mut held in scenes {
            while let Some(whole) = held.completed(&self.config).unwrap_or_else(|error| {
                tracing::warn!(scene = held.model.id, %error, "a scene stays without estimates");
                None
            }) {
                if self.library.write().replace(&held, whole) {
                    self.background.end(&held.model.id);
                    self.scenes_changed();
                    break;
                }
                // Patched meanwhile, or removed.
                let Some(now) = self.library.read().get(&held.model.id) else { break };
                held = now;
            }
        }
    }
}

impl Scenes for EngineState {
    fn make_whole(
        &self,
        scene: &Arc<Loaded>,
        watch: &Watch<'_>,
    ) -> Result<Result<Arc<Loaded>, EngineError>, Abandoned> {
        if scene.is_whole() {
            return Ok(Ok(scene.clone()));
        }
        if let Err(error) = scene.estimate(&self.config, watch)? {
            return Ok(Err(error));
        }
        self.exchange_whole();
        if let Some(cache) = &self.config.bake_cache {
            for (digest, whole) in scene.estimated() {
                let cache = cache.clone();
                self.write_apart(move || keep_whole(&cache, &digest, &whole));
            }
        }
        // Its revision may be another by now, and it may be gone, but for those who wait.
        let held = self.library.read().get(&scene.model.id);
        if let Some(held) = held.filter(|held| held.is_whole()) {
            return Ok(Ok(held));
        }
        Ok(match scene.completed(&self.config) {
            Ok(Some(whole)) => Ok(Arc::new(whole)),
            Ok(None) => Ok(scene.clone()),
            Err(error) => Err(error),
        })
    }
}
