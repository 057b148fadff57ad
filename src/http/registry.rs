//! Scenes that are loading, or whose load failed while nobody waited.
//!
//! ```text
//! reserve ──► loading ──► (engine knows it)          finish
//!                │
//!                └──────► failed, until DELETE,       fail
//!                         until it is loaded again,
//!                         or, without files, until the id is used again
//! ```
//!
//! A load can be cancelled: it ends at its next step, and its reservation ends with it.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Instant;

use parking_lot::Mutex;

use serde::Serialize;
use tokio::sync::Notify;
use utoipa::ToSchema;

use super::problem::{Kind, Problem, ProblemDocument};
use crate::engine::{SceneInfo, Source};
use crate::memory::Admission;

/// Largest number of remembered failures without files; the oldest is forgotten first.
const MAX_FAILED: usize = 64;

#[derive(Clone, Debug)]
pub enum Entry {
    Loading {
        since: Instant,
        admission: Admission,
    },
    Failed {
        at: Instant,
        problem: Problem,
        /// Files that can be loaded again; `None` where none were kept.
        source: Option<Source>,
    },
}

/// A scene and its state.
#[derive(Serialize, ToSchema)]
#[serde(tag = "state", rename_all = "snake_case")]
pub enum SceneState {
    /// The scene is loaded, and frames can be requested.
    Ready(Box<SceneInfo>),
    Loading {
        id: String,
        loading_ms: u64,
    },
    Failed {
        id: String,
        #[schema(value_type = ProblemDocument)]
        problem: Problem,
    },
}

impl SceneState {
    pub fn of(id: String, entry: Entry) -> Self {
        match entry {
            Entry::Loading { since, .. } => {
                let loading_ms = u64::try_from(since.elapsed().as_millis()).unwrap_or(u64::MAX);
                SceneState::Loading { id, loading_ms }
            }
            Entry::Failed { problem, .. } => SceneState::Failed { id, problem },
        }
    }
}

#[derive(Clone, Default)]
pub struct Registry {
    entries: Arc<Mutex<HashMap<String, Entry>>>,
    /// Notified whenever a reservation ends.
    ended: Arc<Notify>,
}

/// A reserved id; freed when this is dropped, finished, or failed.
pub struct Reservation {
    registry: Registry,
    id: String,
    admission: Admission,
    settled: bool,
}

impl Registry {
    /// Reserves `id` for a load, unless the id is loading, is loaded (`is_loaded`), or has failed and can be loaded again.
    pub fn reserve(
        &self,
        id: &str,
        admission: Admission,
        is_loaded: impl FnOnce(&str) -> bool,
    ) -> Result<Reservation, Problem> {
        let mut entries = self.entries.lock();
        let is_free = matches!(entries.get(id), None | Some(Entry::Failed { source: None, .. }));
        // Check under the lock: a load that has just finished is in the engine before it leaves the registry.
        if !is_free || is_loaded(id) {
            return Err(Problem::new(Kind::SceneExists, format!("a scene `{id}` exists"))
                .at("id")
                .accepted("an unused id, or DELETE the scene first"));
        }
        let loading = Entry::Loading { since: Instant::now(), admission: admission.clone() };
        entries.insert(id.to_owned(), loading);
        Ok(Reservation { registry: self.clone(), id: id.to_owned(), admission, settled: false })
    }

    /// Reserves the id of a failed load that can be repeated.
    pub fn retry(&self, id: &str, admission: Admission) -> Option<(Reservation, Source)> {
        let mut entries = self.entries.lock();
        let entry = entries.get_mut(id)?;
        let Entry::Failed { source: Some(source), .. } = entry else { return None };
        let source = source.clone();
        *entry = Entry::Loading { since: Instant::now(), admission: admission.clone() };
        let (registry, id) = (self.clone(), id.to_owned());
        Some((Reservation { registry, id, admission, settled: false }, source))
    }

    pub fn get(&self, id: &str) -> Option<Entry> {
        self.entries.lock().get(id).cloned()
    }

    /// Lists all entries by id.
    pub fn list(&self) -> Vec<(String, Entry)> {
        let mut list: Vec<_> =
            self.entries.lock().iter().map(|(id, entry)| (id.clone(), entry.clone())).collect();
        list.sort_by(|a, b| a.0.cmp(&b.0));
        list
    }

    /// Cancels the load of `id`, which ends at its next step. Returns false where nothing is loading.
    pub fn cancel(&self, id: &str) -> bool {
        match self.entries.lock().get(id) {
            Some(Entry::Loading { admission, .. }) => {
                admission.cancel();
                true
            }
            _ => false,
        }
    }

    /// Waits until `id` is no longer loading.
    pub async fn ended(&self, id: &str) {
        loop {
            let ended = self.ended.notified();
            if !matches!(self.get(id), Some(Entry::Loading { .. })) {
                return;
            }
            ended.await;
        }
    }

    /// Forgets a failure. Returns false when there is none.
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

    /// Returns the load's admission, which reserves its memory and can cancel it.
    pub fn admission(&self) -> &Admission {
        &self.admission
    }

    /// Ends the reservation of a scene that the engine now has.
    pub fn finish(self) {}

    /// Keeps `problem` for later requests, and `source` for a retry.
    pub fn fail(mut self, problem: Problem, source: Option<Source>) {
        self.settled = true;
        let mut entries = self.registry.entries.lock();
        entries.insert(self.id.clone(), Entry::Failed { at: Instant::now(), problem, source });
        let failed = |entry: &Entry| match entry {
            Entry::Failed { at, source: None, .. } => Some(*at),
            // Failures with files stay listed as long as the files exist.
            _ => None,
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
        self.registry.ended.notify_waiters();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn problem() -> Problem {
        Problem::new(Kind::AssetRefused, "no")
    }

    fn reserve(registry: &Registry, id: &str) -> Result<Reservation, Problem> {
        registry.reserve(id, Admission::default(), |_| false)
    }

    #[test]
    fn a_load_that_is_cancelled_frees_its_id() {
        let registry = Registry::default();
        assert!(!registry.cancel("a"));
        let loading = reserve(&registry, "a").unwrap();
        assert!(registry.cancel("a") && loading.admission().is_cancelled());
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        let waiting = registry.clone();
        runtime.block_on(async {
            let ended = tokio::spawn(async move { waiting.ended("a").await });
            tokio::task::yield_now().await;
            assert!(!ended.is_finished());
            drop(loading);
            ended.await.unwrap();
        });
        assert!(registry.get("a").is_none());
        runtime.block_on(registry.ended("a"));
    }

    #[test]
    fn an_id_is_taken_once() {
        let registry = Registry::default();
        let first = reserve(&registry, "a").unwrap();
        assert_eq!(reserve(&registry, "a").err().unwrap().status(), 409);
        assert!(matches!(registry.get("a"), Some(Entry::Loading { .. })));
        assert!(!registry.forget("a"));
        first.finish();
        assert!(registry.get("a").is_none());
        assert_eq!(
            registry.reserve("a", Admission::default(), |_| true).err().unwrap().status(),
            409
        );
    }

    #[test]
    fn failures_stay_until_the_id_is_used_again() {
        let registry = Registry::default();
        reserve(&registry, "a").unwrap().fail(problem(), None);
        assert!(matches!(registry.get("a"), Some(Entry::Failed { .. })));
        drop(reserve(&registry, "a").unwrap());
        assert!(registry.get("a").is_none());
        reserve(&registry, "a").unwrap().fail(problem(), None);
        assert!(registry.forget("a") && !registry.forget("a"));
    }

    #[test]
    fn failures_do_not_pile_up() {
        let registry = Registry::default();
        for i in 0..2 * MAX_FAILED {
            reserve(&registry, &format!("s{i}")).unwrap().fail(problem(), None);
        }
        assert_eq!(registry.list().len(), MAX_FAILED);
        assert!(registry.get("s0").is_none());
        // Failures that can be loaded again are kept.
        let source = Some(Source::at("a.ply"));
        reserve(&registry, "kept").unwrap().fail(problem(), source);
        for i in 0..2 * MAX_FAILED {
            reserve(&registry, &format!("t{i}")).unwrap().fail(problem(), None);
        }
        assert!(registry.get("kept").is_some());
        assert_eq!(reserve(&registry, "kept").err().unwrap().status(), 409);
        let (again, source) = registry.retry("kept", Admission::default()).unwrap();
        assert_eq!((again.id(), source), ("kept", Source::at("a.ply")));
        assert!(registry.retry("kept", Admission::default()).is_none());
    }
}
