//! Scenes of large clouds, which are drawn as points before normals and kernels of their samples are estimated.
//!
//! ```text
//! load ──► points alone ──a frame that needs more──► estimated by the bakes ([`super::bake_service`]) ──► whole, at the same revision
//! ```
//! A frame that leaves it open how samples are drawn does not wait: it gets points, its receipt says so, and the estimate
//! runs on in the background until it has ended or the scene is deleted.

use std::sync::Arc;

use super::asset_keys::AssetKeys;
use super::background_estimates::Running;
use super::bake_service::{BakeTicket, Goal, Scenes};
use super::cloud_cache::keep_whole;
use super::error::asset_error;
use super::load::{Stop, whole_asset};
use super::loaded::{Loaded, Parts, build};
use super::state::EngineState;
use super::watch::{Abandoned, Watch};
use super::{EngineConfig, EngineError, EstimateState, Estimates};
use crate::assets::AssetError;
use crate::memory::{Admission, Interrupt};
use crate::plan::{Output, Settings, Shadows};
use crate::residency::model::AssetModel;

impl Loaded {
    /// Reads the files of assets that lack normals or kernels again and estimates these. [`Loaded::completed`] then returns the
    /// scene with them.
    pub fn estimate(
        &self,
        config: &EngineConfig,
        watch: &Watch<'_>,
    ) -> Result<Result<(), EngineError>, Abandoned> {
        let lacking = || {
            let assets = self.model.assets.iter().enumerate();
            assets.filter_map(|(index, asset)| Some((index, asset, asset.deferred.as_ref()?)))
        };
        let size = |asset: &AssetModel| asset.counts().samples as f64;
        let total = lacking().map(|(_, asset, _)| size(asset)).sum::<f64>().max(1.0);
        let mut done = 0.0;
        for (index, asset, deferred) in lacking() {
            let part = size(asset) / total;
            let watch = watch.part(done, part);
            let made = deferred
                .whole
                .get_or_try(|| Ok(watch.check()?), || self.whole_asset(index, config, &watch));
            match made {
                Ok(_) => {}
                Err(Stop::Failed(error)) => return Ok(Err(error)),
                Err(Stop::Abandoned) => return Err(Abandoned),
            }
            done += part;
        }
        Ok(Ok(()))
    }

    /// Returns the scene with everything that its samples lack. Blocks.
    pub fn into_whole(self, config: &EngineConfig) -> Result<Loaded, EngineError> {
        match self.estimate(config, &Watch::NONE) {
            Ok(estimated) => estimated?,
            Err(Abandoned) => return Err(Stop::Abandoned.error()),
        }
        Ok(self.completed(config)?.unwrap_or(self))
    }

    /// Returns the assets with estimates, each with the hash of its content.
    pub fn estimated(&self) -> Vec<([u8; 32], Arc<AssetModel>)> {
        let whole = |asset: &Arc<AssetModel>| asset.deferred.as_ref()?.whole.get().cloned();
        let assets = self.model.assets.iter().zip(&self.keys);
        // The cache finds assets by the content of one file.
        let alone = assets.filter(|(_, key)| key.alone);
        alone.filter_map(|(asset, key)| Some((key.digest, whole(asset)?))).collect()
    }

    fn whole_asset(
        &self,
        index: usize,
        config: &EngineConfig,
        watch: &Watch<'_>,
    ) -> Result<Arc<AssetModel>, Stop> {
        let (began, key) = (std::time::Instant::now(), self.keys[index]);
        let admission = Admission::new(&config.memory);
        let found =
            AssetKeys::within(&admission).of(&self.description, index).map_err(Stop::Failed)?;
        if found.digest != key.digest {
            return Err(Stop::Failed(asset_error(AssetError::Malformed {
                file: self.description.assets[index].label(),
                place: "file".to_owned(),
                reason: "has changed since the scene was loaded, so that its normals and kernels \
                    cannot be estimated; delete the scene and load it again"
                    .to_owned(),
            })));
        }
        let asset = (index, key);
        let whole = whole_asset(&self.path, &self.description, asset, config, watch, &admission)?;
        let elapsed_ms = began.elapsed().as_millis() as u64;
        let samples = whole.counts().samples;
        tracing::info!(asset = whole.name, samples, elapsed_ms, "normals and kernels estimated");
        Ok(whole)
    }

    /// Returns the scene with incomplete assets replaced by whole ones, at the same revision; `None` while these are not there,
    /// or where nothing was lacking.
    pub fn completed(&self, config: &EngineConfig) -> Result<Option<Loaded>, EngineError> {
        let whole = |asset: &Arc<AssetModel>| match &asset.deferred {
            Some(deferred) => deferred.whole.get().cloned(),
            None => Some(asset.clone()),
        };
        let assets: Option<Vec<_>> = self.model.assets.iter().map(whole).collect();
        let Some(assets) = assets.filter(|_| !self.is_whole()) else { return Ok(None) };
        let parts = Parts { assets, ..self.parts() };
        let whole = build(parts, config, None, &Admission::new(&config.memory))?;
        Ok(Some(Loaded { order: self.order, ..whole }))
    }

    /// Whether a frame needs normals or kernels that are not there.
    pub fn lacks(&self, settings: &Settings, output: Output) -> bool {
        if self.is_whole() {
            return false;
        }
        let is_color = output == Output::Color;
        let lit = is_color && self.facts.lights > 0;
        // Suns see splats, however the frame draws samples.
        let casts = is_color && self.facts.casting_lights > 0 && settings.shadows == Shadows::On;
        settings.draws_trees()
            || !settings.draws_points()
            || casts
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
