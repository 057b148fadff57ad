//! Scenes that are on their way: loading, or failed while nobody was waiting.
//!
//! ```text
//! reserve ──► loading ──► (engine knows it)          finish
//!                │
//!                └──────► failed, until DELETE,       fail
//!                         or until the id is used again
//! ```

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Instant;

use parking_lot::Mutex;

use super::problem::{Kind, Problem};

/// Failures that are remembered; the oldest is forgotten first.
const MAX_FAILED: usize = 64;

#[derive(Clone, Debug)]
pub enum Entry {
    Loading { since: Instant },
    Failed { at: Instant, problem: Problem },
}

#[derive(Clone, Default)]
pub struct Registry {
    entries: Arc<Mutex<HashMap<String, Entry>>>,
}

/// An id that is taken until this is dropped, finished, or failed.
pub struct Reservation {
    registry: Registry,
    id: String,
    settled: bool,
}

impl Registry {
    /// Takes `id`, unless it is loading now or `is_loaded`.
    pub fn reserve(
        &self,
        id: &str,
        is_loaded: impl FnOnce(&str) -> bool,
    ) -> Result<Reservation, Problem> {
        let mut entries = self.entries.lock();
        let loading = matches!(entries.get(id), Some(Entry::Loading { .. }));
        // Asked under the lock: a load that has just finished is in the engine before it leaves here.
        if loading || is_loaded(id) {
            return Err(Problem::new(Kind::SceneExists, format!("a scene `{id}` exists"))
                .at("id")
                .accepted("an id that is free, or DELETE the scene first"));
        }
        entries.insert(id.to_owned(), Entry::Loading { since: Instant::now() });
        Ok(Reservation { registry: self.clone(), id: id.to_owned(), settled: false })
    }

    pub fn get(&self, id: &str) -> Option<Entry> {
        self.entries.lock().get(id).cloned()
    }

    /// Everything on its way, by id.
    pub fn list(&self) -> Vec<(String, Entry)> {
        let mut list: Vec<_> =
            self.entries.lock().iter().map(|(id, entry)| (id.clone(), entry.clone())).collect();
        list.sort_by(|a, b| a.0.cmp(&b.0));
        list
    }

    /// Forgets a failure. False when there is none.
    pub fn forget(&self, id: &str) -> bool {
        let mut entries = self.entries.lock();
        match entries.get(id) {
            Some(Entry::Failed { .. }) => entries.remove(id).is_some(),
            _ => false,
        }
    }
}

impl Reservation {
    pub fn id(&self) -> &str {
        &self.id
    }

    /// The engine has the scene now.
    pub fn finish(self) {}

    /// Keeps `problem` for whoever asks.
    pub fn fail(mut self, problem: Problem) {
        self.settled = true;
        let mut entries = self.registry.entries.lock();
        entries.insert(self.id.clone(), Entry::Failed { at: Instant::now(), problem });
        let failed = |entry: &Entry| match entry {
            Entry::Failed { at, .. } => Some(*at),
            Entry::Loading { .. } => None,
        };
        if entries.values().filter_map(failed).count() > MAX_FAILED {
            let oldest =
                entries.iter().filter_map(|(id, entry)| Some((failed(entry)?, id.clone()))).min();
            if let Some((_, id)) = oldest {
                entries.remove(&id);
            }
        }
    }
}

impl Drop for Reservation {
    fn drop(&mut self) {
        if !self.settled {
            self.registry.entries.lock().remove(&self.id);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn problem() -> Problem {
        Problem::new(Kind::AssetRefused, "no")
    }

    #[test]
    fn an_id_is_taken_once() {
        let registry = Registry::default();
        let first = registry.reserve("a", |_| false).unwrap();
        assert_eq!(registry.reserve("a", |_| false).err().unwrap().status(), 409);
        assert!(matches!(registry.get("a"), Some(Entry::Loading { .. })));
        assert!(!registry.forget("a"));
        first.finish();
        assert!(registry.get("a").is_none());
        assert_eq!(registry.reserve("a", |_| true).err().unwrap().status(), 409);
    }

    #[test]
    fn failures_stay_until_the_id_is_used_again() {
        let registry = Registry::default();
        registry.reserve("a", |_| false).unwrap().fail(problem());
        assert!(matches!(registry.get("a"), Some(Entry::Failed { .. })));
        drop(registry.reserve("a", |_| false).unwrap());
        assert!(registry.get("a").is_none());
        registry.reserve("a", |_| false).unwrap().fail(problem());
        assert!(registry.forget("a") && !registry.forget("a"));
    }

    #[test]
    fn failures_do_not_pile_up() {
        let registry = Registry::default();
        for i in 0..2 * MAX_FAILED {
            registry.reserve(&format!("s{i}"), |_| false).unwrap().fail(problem());
        }
        assert_eq!(registry.list().len(), MAX_FAILED);
        assert!(registry.get("s0").is_none());
    }
}
