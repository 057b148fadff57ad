//! The tries of a run: which workers began it, and how often each of them failed at it. Pure.
//!
//! A *failure* is a try that its worker reports. A *death* is a try whose worker ended while it drew the run.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::pacing::{FAILED_WORKERS, MOST_TRIES};

/// Tries by worker. A worker's name is unique to its process.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Tries(BTreeMap<String, Counts>);

/// Tries of one worker.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
struct Counts {
    begun: u64,
    failed: u64,
}

impl Tries {
    /// Returns how often the run was begun.
    pub fn begun(&self) -> u64 {
        self.0.values().fold(0, |sum, counts| sum.saturating_add(counts.begun))
    }

    /// Returns how often a worker ended while it drew the run.
    pub fn deaths(&self) -> u64 {
        let deaths = |counts: &Counts| counts.begun.saturating_sub(counts.failed);
        self.0.values().fold(0, |sum, counts| sum.saturating_add(deaths(counts)))
    }

    /// Returns the number of workers that failed at the run.
    fn failed_workers(&self) -> usize {
        self.0.values().filter(|counts| counts.failed > 0).count()
    }

    /// Counts a try. The worker is alive, so none of its earlier tries was a death.
    pub fn begin(&mut self, worker: &str) {
        let counts = self.0.entry(worker.to_owned()).or_default();
        counts.failed = counts.begun;
        counts.begun = counts.begun.saturating_add(1);
    }

    /// Records that the worker's latest try failed.
    pub fn fail(&mut self, worker: &str) {
        let counts = self.0.entry(worker.to_owned()).or_default();
        counts.begun = counts.begun.max(1);
        counts.failed = counts.begun;
    }

    /// Forgets the worker's latest try.
    pub fn take_back(&mut self, worker: &str) {
        if let Some(counts) = self.0.get_mut(worker) {
            counts.begun = counts.begun.saturating_sub(1);
            counts.failed = counts.failed.min(counts.begun);
        }
        self.0.retain(|_, counts| counts.begun > 0);
    }

    /// Returns whether a frame at which a worker has just failed is given up. One sick worker gives up no frame that another worker may
    /// be able to draw. `is_alone` says that there is no other worker.
    pub fn is_hopeless(&self, is_alone: bool) -> bool {
        self.begun() >= MOST_TRIES && (is_alone || self.failed_workers() >= FAILED_WORKERS)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_worker_gives_up_no_frame_beside_others() {
        let mut tries = Tries::default();
        for number in 1..=20 {
            tries.begin("sick");
            tries.fail("sick");
            assert_eq!((tries.begun(), tries.deaths()), (number, 0));
            assert_eq!((tries.is_hopeless(false), tries.is_hopeless(true)), (false, number >= 3));
        }
        tries.begin("other");
        // The other worker draws the frame and has not failed yet.
        assert_eq!((tries.deaths(), tries.is_hopeless(false)), (1, false));
        tries.fail("other");
        assert_eq!((tries.deaths(), tries.is_hopeless(false)), (0, true));
        let text = serde_json::to_string(&tries).unwrap();
        assert_eq!(serde_json::from_str::<Tries>(&text).unwrap(), tries);
    }

    #[test]
    fn two_workers_have_three_tries() {
        let mut tries = Tries::default();
        for (worker, is_hopeless) in [("a", false), ("b", false), ("a", true)] {
            tries.begin(worker);
            tries.fail(worker);
            assert_eq!(tries.is_hopeless(false), is_hopeless);
        }
    }

    #[test]
    fn deaths_are_tries_that_no_worker_ended() {
        let mut tries = Tries::default();
        for worker in ["a", "b"] {
            tries.begin(worker);
        }
        assert_eq!((tries.begun(), tries.deaths()), (2, 2));
        // This worker is alive after all, and could not record its failure.
        tries.begin("a");
        assert_eq!((tries.begun(), tries.deaths()), (3, 2));
        tries.take_back("a");
        assert_eq!((tries.begun(), tries.deaths()), (2, 1));
        tries.take_back("b");
        tries.take_back("c");
        tries.take_back("a");
        assert_eq!(tries, Tries::default());
    }
}
