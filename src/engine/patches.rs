//! Changes of loaded scenes: nodes that are moved, shown or hidden.

use super::{Engine, EngineError, LoadNumber, NodePatch, SceneInfo};

impl Engine {
    /// Returns the number of the load that made a scene; `None` when there is no such scene.
    pub fn load_number(&self, id: &str) -> Option<LoadNumber> {
        Some(LoadNumber(self.state().library.read().get(id)?.order))
    }

    /// Moves, shows or hides a top-level node. The scene gets a new revision; only transforms are uploaded.
    ///
    /// # Errors
    /// An unknown scene or node; a node that becomes visible and draws more than fits.
    pub fn patch(&self, id: &str, node: &str, patch: &NodePatch) -> Result<SceneInfo, EngineError> {
        let unknown = || EngineError::UnknownScene { id: id.to_owned() };
        self.patch_load(id, self.load_number(id).ok_or_else(unknown)?, node, patch)
    }

    /// Patches like [`Engine::patch`], but only the scene of this load: a scene that was loaded under the same id since is another one.
    ///
    /// # Errors
    /// As [`Engine::patch`].
    pub fn patch_load(
        &self,
        id: &str,
        load: LoadNumber,
        node: &str,
        patch: &NodePatch,
    ) -> Result<SceneInfo, EngineError> {
        let state = self.state();
        // Two patches must not start from the same revision. Listing the instances again may take a while, during which frames
        // are still requested: the library is locked only for looking up and replacing.
        let _alone = state.patching.lock();
        loop {
            let loaded = state.loaded(id)?;
            if LoadNumber(loaded.order) != load {
                return Err(EngineError::UnknownScene { id: id.to_owned() });
            }
            let mut patched = loaded.patched(node, patch, &state.config)?;
            // A node that becomes visible may draw more than fits.
            self.check_fits(&mut patched)?;
            if let Some(hook) = &state.config.patch_hook {
                hook();
            }
            let info = self.info(&patched);
            if state.library.write().replace(&loaded, patched) {
                state.scenes_changed();
                tracing::info!(id, node, revision = info.revision, "scene changed");
                return Ok(info);
            }
            // The scene was removed meanwhile.
        }
    }
}
