//! All loaded scenes by identifier.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::loaded::Loaded;

/// All loaded scenes, and the assets that they share.
#[derive(Default)]
pub struct Library {
    scenes: BTreeMap<String, Arc<Loaded>>,
}

impl Library {
    pub fn get(&self, id: &str) -> Option<Arc<Loaded>> {
        self.scenes.get(id).cloned()
    }

    pub fn holds(&self, id: &str) -> bool {
        self.scenes.contains_key(id)
    }

    /// Returns all scenes in the order in which they were loaded.
    pub fn all(&self) -> Vec<Arc<Loaded>> {
        let mut scenes: Vec<Arc<Loaded>> = self.scenes.values().cloned().collect();
        scenes.sort_by_key(|loaded| loaded.order);
        scenes
    }

    pub fn insert(&mut self, loaded: Loaded) {
        self.scenes.insert(loaded.model.id.clone(), Arc::new(loaded));
    }

    /// Replaces `old` by `new` if `old` is still there, and returns whether it was.
    pub fn replace(&mut self, old: &Arc<Loaded>, new: Loaded) -> bool {
        match self.scenes.get_mut(&old.model.id) {
            Some(held) if Arc::ptr_eq(held, old) => {
                *held = Arc::new(new);
                true
            }
            _ => false,
        }
    }

    pub fn remove(&mut self, id: &str) -> Option<Arc<Loaded>> {
        self.scenes.remove(id)
    }
}
