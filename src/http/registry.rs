//! Scenes that are loading or being removed, or whose load failed while nobody waited.
//!
//! ```text
//! reserve ──► loading ──► (engine knows it)          finish
//!                │
//!                └──────► failed, until DELETE,       fail
//!                         until it is loaded again,
//!                         or, without files, until the id is used again
//! claim ────► being removed ──► (free)               finish
//!                │
//!                └──────► as before                   dropped
//! ```
//!
//! A load can be cancelled: it ends at its next step, and its reservation ends with it. An id that is being removed counts as loading:
//! no upload gets the id before the files of the scene are gone.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Instant;

use parking_lot::Mutex;

use serde::Serialize;
use tokio::sync::watch;
use utoipa::ToSchema;

use super::problem::{Kind, Problem, ProblemDocument};
use crate::engine::{LoadNumber, SceneInfo, Source};
use crate::memory::Admission;

/// Largest number of remembered failures without files; the oldest is forgotten first.
const MAX_FAILED: usize = 64;

#[derive(Clone, Debug)]
pub enum Entry {
    Loading {
        since: Instant,
        admission: Admission,
        load: Load,
    },
    Failed {
        at: Instant,
        problem: Problem,
        /// Files that can be loaded again; `None` where none were kept.
        source: Option<Source>,
        load: Load,
    },
    /// A removal deletes the files of the id, and then its scene.
    Removing {
        load: Load,
    },
}

/// One load, or one removal, of an id.
#[derive(Clone, Debug)]
pub struct Load(watch::Receiver<Option<Ended>>);

/// How a load or a removal left its id.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// The engine has the scene.
    Loaded(LoadNumber),
    /// The failure is kept.
    Failed,
    /// There is no scene.
    Gone,
}

impl Load {
    /// Waits for the end of this load, and not for others of the same id.
    pub async fn ended(mut self) -> Ended {
        let ended = self.0.wait_for(Option::is_some).await;
        ended.ok().and_then(|ended| *ended).unwrap_or(Ended::Gone)
    }

    fn is(&self, other: &Load) -> bool {
        self.0.same_channel(&other.0)
    }
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
    /// Returns the state of a scene that the engine does not have; `None` if it is being removed.
    pub fn of(id: String, entry: Entry) -> Option<Self> {
        match entry {
            Entry::Loading { since, .. } => {
                let loading_ms = u64::try_from(since.elapsed().as_millis()).unwrap_or(u64::MAX);
                Some(SceneState::Loading { id, loading_ms })
            }
            Entry::Failed { problem, .. } => Some(SceneState::Failed { id, problem }),
            Entry::Removing { .. } => None,
        }
    }
}

#[derive(Clone, Default)]
pub struct Registry {
    entries: Arc<Mutex<HashMap<String, Entry>>>,
}

/// A reserved id; freed when this is dropped, finished, or failed.
pub struct Reservation {
    registry: Registry,
    id: String,
    admission: Admission,
    load: Load,
    ended: watch::Sender<Option<Ended>>,
    /// What the id is left with when this is dropped.
    outcome: Ended,
    /// Entry of the id when this is dropped.
    after: Option<Entry>,
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
        Ok(self.hold_loading(&mut entries, id, admission))
    }

    /// Reserves the id of a failed load that can be repeated.
    pub fn retry(&self, id: &str, admission: Admission) -> Option<(Reservation, Source)> {
        let mut entries = self.entries.lock();
        let Entry::Failed { source: Some(source), .. } = entries.get(id)? else { return None };
        let source = source.clone();
        Some((self.hold_loading(&mut entries, id, admission), source))
    }

    /// Reserves an id whose scene is to be removed. `loaded` returns the scene's number if the engine has it. Unless the reservation
    /// is finished, everything stays as it was. Returns `None` while the id is loading or being removed.
    pub fn claim(
        &self,
        id: &str,
        loaded: impl FnOnce(&str) -> Option<LoadNumber>,
    ) -> Option<Reservation> {
        let mut entries = self.entries.lock();
        let before = match entries.get(id) {
            Some(Entry::Loading { .. } | Entry::Removing { .. }) => return None,
            before => before.cloned(),
        };
        let outcome = match before {
            Some(_) => Ended::Failed,
            None => loaded(id).map_or(Ended::Gone, Ended::Loaded),
        };
        let removing = |load| Entry::Removing { load };
        let mut claim = self.hold(&mut entries, id, Admission::default(), outcome, removing);
        claim.after = before;
        Some(claim)
    }

    /// Claims the failure of this load, if it is still there.
    pub fn claim_failure(&self, id: &str, load: &Load) -> Option<Reservation> {
        let claim = self.claim(id, |_| None)?;
        claim.is_failure_of(load).then_some(claim)
    }

    fn hold_loading(
        &self,
        entries: &mut HashMap<String, Entry>,
        id: &str,
        admission: Admission,
    ) -> Reservation {
        let loads = admission.clone();
        let entry = |load| Entry::Loading { since: Instant::now(), admission: loads, load };
        self.hold(entries, id, admission, Ended::Gone, entry)
    }

    fn hold(
        &self,
        entries: &mut HashMap<String, Entry>,
        id: &str,
        admission: Admission,
        outcome: Ended,
        entry: impl FnOnce(Load) -> Entry,
    ) -> Reservation {
        let (ended, receiver) = watch::channel(None);
        let load = Load(receiver);
        entries.insert(id.to_owned(), entry(load.clone()));
        let (registry, id) = (self.clone(), id.to_owned());
        Reservation { registry, id, admission, load, ended, outcome, after: None }
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

    /// Cancels the load of `id`, which ends at its next step, and returns it. Returns a removal as it is. Returns `None` where
    /// neither is in progress.
    pub fn cancel(&self, id: &str) -> Option<Load> {
        match self.entries.lock().get(id) {
            Some(Entry::Loading { admission, load, .. }) => {
                admission.cancel();
                Some(load.clone())
            }
            Some(Entry::Removing { load, .. }) => Some(load.clone()),
            Some(Entry::Failed { .. }) | None => None,
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

    /// Returns the load that this reservation is for.
    pub fn load(&self) -> Load {
        self.load.clone()
    }

    /// Returns what the claimed id has.
    pub fn found(&self) -> Ended {
        self.outcome
    }

    /// Returns whether the claimed id has the failure of this load.
    pub fn is_failure_of(&self, other: &Load) -> bool {
        matches!(&self.after, Some(Entry::Failed { load, .. }) if load.is(other))
    }

    /// Ends the reservation of a scene that the engine now has, or of one that is removed.
    pub fn finish(mut self, ended: Ended) {
        (self.outcome, self.after) = (ended, None);
    }

    /// Keeps `problem` for later requests, and `source` for a retry.
    pub fn fail(mut self, problem: Problem, source: Option<Source>) {
        self.outcome = Ended::Failed;
        self.after =
            Some(Entry::Failed { at: Instant::now(), problem, source, load: self.load.clone() });
    }
}

impl Drop for Reservation {
    fn drop(&mut self) {
        let mut entries = self.registry.entries.lock();
        match self.after.take() {
            Some(entry) => {
                entries.insert(self.id.clone(), entry);
                forget_oldest(&mut entries);
            }
            None => drop(entries.remove(&self.id)),
        }
        drop(entries);
        self.ended.send_replace(Some(self.outcome));
    }
}

/// Forgets the oldest failure without files, if there are too many.
fn forget_oldest(entries: &mut HashMap<String, Entry>) {
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

#[cfg(test)]
mod tests {
    use futures::FutureExt;

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
        assert!(registry.cancel("a").is_none());
        let loading = reserve(&registry, "a").unwrap();
        let mut ended = registry.cancel("a").unwrap().ended().boxed();
        assert!(loading.admission().is_cancelled());
        assert!((&mut ended).now_or_never().is_none());
        drop(loading);
        assert!(registry.get("a").is_none());
        // Who waits for a load does not wait for the next one with the id.
        let next = reserve(&registry, "a").unwrap();
        assert_eq!(ended.now_or_never(), Some(Ended::Gone));
        assert!(!next.admission().is_cancelled());
        let load = next.load();
        next.fail(problem(), None);
        assert_eq!(load.ended().now_or_never(), Some(Ended::Failed));
    }

    #[test]
    fn an_id_is_taken_once() {
        let registry = Registry::default();
        let first = reserve(&registry, "a").unwrap();
        assert_eq!(reserve(&registry, "a").err().unwrap().status(), 409);
        assert!(matches!(registry.get("a"), Some(Entry::Loading { .. })));
        assert!(registry.claim("a", |_| None).is_none());
        first.finish(Ended::Gone);
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
    }

    #[test]
    fn nobody_gets_an_id_before_its_scene_is_removed() {
        let registry = Registry::default();
        let first = reserve(&registry, "a").unwrap();
        let load = first.load();
        first.fail(problem(), None);
        let claim = registry.claim_failure("a", &load).unwrap();
        assert_eq!(reserve(&registry, "a").err().unwrap().status(), 409);
        assert!(registry.claim("a", |_| None).is_none());
        let removing = registry.get("a").unwrap();
        assert!(matches!(removing, Entry::Removing { .. }));
        assert!(SceneState::of("a".to_owned(), removing).is_none());
        // A removal that fails leaves everything as it was.
        let removal = registry.cancel("a").unwrap();
        drop(claim);
        assert_eq!(removal.ended().now_or_never(), Some(Ended::Failed));
        let claim = registry.claim("a", |_| None).unwrap();
        assert_eq!(claim.found(), Ended::Failed);
        claim.finish(Ended::Gone);
        // The failure of another load with the id is not this one's.
        reserve(&registry, "a").unwrap().fail(problem(), None);
        assert!(registry.claim_failure("a", &load).is_none());
        assert!(matches!(registry.get("a"), Some(Entry::Failed { .. })));
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
