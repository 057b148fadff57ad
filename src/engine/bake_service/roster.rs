//! State of waiting and running bakes. Pure.
//!
//! ```text
//! join ──► waits ──next──► runs ──finished──► (answered)
//!            │               │
//!            └──the last one leaves──► gone, or told to stop: a stopping bake is nobody's, and counts until it has ended
//! ```

use std::collections::BTreeMap;

/// Unique number of a bake.
pub type BakeId = u64;

#[derive(Clone, Copy, Debug, PartialEq)]
struct Entry {
    /// Key of the baked data.
    key: u64,
    waiting: usize,
    runs: bool,
}

/// Result of [`Roster::join`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Joined {
    /// A new bake, which has not begun.
    New(BakeId),
    /// A bake that others wait for already.
    Shared(BakeId),
}

/// Result of [`Roster::leave`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Left {
    /// Others still wait, or the bake has ended.
    Nothing,
    /// The bake had not begun and is removed.
    Forgotten,
    /// The bake runs and must stop.
    Stopping,
}

/// All bakes.
#[derive(Clone, Debug)]
pub struct Roster {
    /// Largest number of concurrent bakes.
    most: usize,
    /// Wanted bakes in the order of arrival.
    wanted: BTreeMap<BakeId, Entry>,
    /// Number of bakes that were told to stop and have not ended yet.
    stopping: usize,
    next_id: BakeId,
}

impl Roster {
    pub fn new(most: usize) -> Roster {
        Roster { most, wanted: BTreeMap::new(), stopping: 0, next_id: 0 }
    }

    /// Adds a waiter for the bake of `key`.
    pub fn join(&mut self, key: u64) -> Joined {
        if let Some((id, entry)) = self.wanted.iter_mut().find(|(_, entry)| entry.key == key) {
            entry.waiting += 1;
            return Joined::Shared(*id);
        }
        let id = self.next_id;
        self.next_id += 1;
        self.wanted.insert(id, Entry { key, waiting: 1, runs: false });
        Joined::New(id)
    }

    /// Removes a waiter.
    pub fn leave(&mut self, id: BakeId) -> Left {
        let Some(entry) = self.wanted.get_mut(&id) else { return Left::Nothing };
        entry.waiting -= 1;
        if entry.waiting > 0 {
            return Left::Nothing;
        }
        let runs = entry.runs;
        self.wanted.remove(&id);
        self.stopping += usize::from(runs);
        if runs { Left::Stopping } else { Left::Forgotten }
    }

    /// Removes a bake with all its waiters.
    pub fn cancel(&mut self, id: BakeId) {
        let runs = self.wanted.remove(&id).is_some_and(|entry| entry.runs);
        self.stopping += usize::from(runs);
    }

    pub fn running(&self) -> usize {
        self.stopping + self.wanted.values().filter(|entry| entry.runs).count()
    }

    /// Returns the next bake to begin, if there is room for one.
    pub fn next(&mut self) -> Option<BakeId> {
        if self.running() >= self.most {
            return None;
        }
        let (id, entry) = self.wanted.iter_mut().find(|(_, entry)| !entry.runs)?;
        entry.runs = true;
        Some(*id)
    }

    /// Records that a running bake has ended. Returns true if somebody waits for its result.
    pub fn finished(&mut self, id: BakeId) -> bool {
        let is_wanted = self.wanted.remove(&id).is_some();
        if !is_wanted {
            self.stopping = self.stopping.saturating_sub(1);
        }
        is_wanted
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_bake_that_nobody_wants_stops_and_is_not_joined() {
        let mut roster = Roster::new(1);
        let Joined::New(first) = roster.join(7) else { panic!() };
        assert_eq!((roster.join(7), roster.next()), (Joined::Shared(first), Some(first)));
        let Joined::New(behind) = roster.join(8) else { panic!() };
        assert_eq!(roster.next(), None, "one at a time");
        assert_eq!((roster.leave(first), roster.leave(first)), (Left::Nothing, Left::Stopping));
        let Joined::New(again) = roster.join(7) else { panic!() };
        assert_eq!(roster.next(), None, "it has not ended yet");
        assert!(!roster.finished(first));
        assert_eq!((roster.leave(behind), roster.next()), (Left::Forgotten, Some(again)));
        assert!(roster.finished(again));
        assert_eq!((roster.leave(again), roster.running()), (Left::Nothing, 0));
    }

    proptest! {
        /// In every order of events: the limit holds, each bake begins at most once and is wanted when it begins, no waiter is
        /// forgotten, and no two wanted bakes have the same key.
        #[test]
        fn rosters_stay_in_order(most in 1usize..4, steps in prop::collection::vec((0u8..5, 0usize..8), 1..100)) {
            let mut roster = Roster::new(most);
            let (mut waiting, mut begun, mut under_way) = (BTreeMap::<BakeId, (u64, usize)>::new(), Vec::new(), Vec::new());
            for (what, which) in steps {
                match what {
                    0 => match roster.join(which as u64) {
                        Joined::New(id) => prop_assert!(waiting.insert(id, (which as u64, 1)).is_none()),
                        Joined::Shared(id) => {
                            let entry = waiting.get_mut(&id).unwrap();
                            prop_assert_eq!(entry.0, which as u64);
                            entry.1 += 1;
                        }
                    },
                    1 => if let Some(id) = roster.next() {
                        prop_assert!(!begun.contains(&id) && waiting.contains_key(&id));
                        begun.push(id);
                        under_way.push(id);
                    },
                    2 => if let Some(&id) = waiting.keys().nth(which) {
                        let entry = waiting.get_mut(&id).unwrap();
                        entry.1 -= 1;
                        let expected = match (entry.1, under_way.contains(&id)) {
                            (0, true) => Left::Stopping,
                            (0, false) => Left::Forgotten,
                            _ => Left::Nothing,
                        };
                        if entry.1 == 0 { waiting.remove(&id); }
                        prop_assert_eq!(roster.leave(id), expected);
                    },
                    3 => if let Some(&id) = waiting.keys().nth(which) {
                        waiting.remove(&id);
                        roster.cancel(id);
                        prop_assert_eq!(roster.leave(id), Left::Nothing);
                    },
                    _ => if !under_way.is_empty() {
                        let id = under_way.remove(which % under_way.len());
                        prop_assert_eq!(roster.finished(id), waiting.remove(&id).is_some());
                    },
                }
                prop_assert_eq!(roster.running(), under_way.len());
                prop_assert!(under_way.len() <= most);
                let mut keys: Vec<u64> = waiting.values().map(|(key, _)| *key).collect();
                keys.sort_unstable();
                prop_assert!(keys.windows(2).all(|pair| pair[0] != pair[1]));
            }
            // All wanted bakes begin in the end.
            for id in under_way { roster.finished(id); waiting.remove(&id); }
            while let Some(id) = roster.next() {
                prop_assert!(waiting.remove(&id).is_some());
                roster.finished(id);
            }
            prop_assert!(waiting.is_empty());
        }
    }
}
