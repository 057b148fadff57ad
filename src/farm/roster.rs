//! The workers that a server has heard of. Pure: beats and times come in.

use std::collections::{BTreeMap, HashMap};
use std::time::{Duration, Instant};

use super::messages::Beat;
use super::pacing::IDLE_AFTER;

/// Time after its last beat for which a worker counts as alive.
const SILENCE: Duration = Duration::from_secs(5);
/// Number of workers that are remembered.
const MOST: usize = 10_000;

/// All workers, by name.
#[derive(Debug, Default)]
pub struct Roster(HashMap<String, (Instant, Beat)>);

impl Roster {
    pub fn hear(&mut self, beat: Beat, now: Instant) {
        self.0.retain(|_, (at, _)| now.saturating_duration_since(*at) < SILENCE);
        if self.0.len() < MOST || self.0.contains_key(&beat.worker) {
            self.0.insert(beat.worker.clone(), (now, beat));
        }
    }

    fn alive(&self, now: Instant) -> impl Iterator<Item = &Beat> {
        let is_alive = move |at: &Instant| now.saturating_duration_since(*at) < SILENCE;
        self.0.values().filter(move |(at, _)| is_alive(at)).map(|(_, beat)| beat)
    }

    /// Returns the number of workers of a kind.
    pub fn of_kind(&self, kind: &str, now: Instant) -> u64 {
        self.alive(now).filter(|beat| beat.kind == kind).count() as u64
    }

    /// Returns the number of workers of a kind that pause because they failed at several runs.
    pub fn paused(&self, kind: &str, now: Instant) -> u64 {
        self.alive(now).filter(|beat| beat.kind == kind && beat.is_paused).count() as u64
    }

    /// Returns the number of workers of other kinds, by what distinguishes them.
    pub fn others(&self, kind: &str, identity: &str, now: Instant) -> BTreeMap<String, u64> {
        let mut others = BTreeMap::new();
        for beat in self.alive(now).filter(|beat| beat.kind != kind) {
            let what = if beat.identity == identity {
                "with another store, or one that is not mounted".to_owned()
            } else {
                format!("with {}, version {}", beat.adapter, beat.version)
            };
            *others.entry(what).or_insert(0) += 1;
        }
        others
    }

    /// Returns the runs of a film that workers have, in order.
    pub fn runs_of(&self, film: &str, now: Instant) -> Vec<u64> {
        let busy = self.alive(now).filter_map(|beat| beat.busy.as_ref());
        let mut runs: Vec<u64> = busy.filter(|(of, _)| of == film).map(|(_, run)| *run).collect();
        runs.sort_unstable();
        runs
    }

    /// Returns whether a worker of a kind has had nothing to do for a while.
    pub fn has_idle(&self, kind: &str, now: Instant) -> bool {
        let is_idle = |beat: &Beat| {
            let has_waited = beat.idle_ms >= IDLE_AFTER.as_millis() as u64;
            beat.busy.is_none() && !beat.is_paused && has_waited
        };
        self.alive(now).any(|beat| beat.kind == kind && is_idle(beat))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn silent_workers_are_forgotten_and_kinds_kept_apart() {
        let start = Instant::now();
        let at = |ms: u64| start + Duration::from_millis(ms);
        let beat = |worker: &str, kind: &str, busy: Option<u64>, idle_ms| Beat {
            worker: worker.to_owned(),
            kind: kind.to_owned(),
            identity: kind[..1].to_owned(),
            adapter: format!("adapter {kind}"),
            version: "1".to_owned(),
            busy: busy.map(|run| ("f".to_owned(), run)),
            idle_ms,
            is_paused: false,
        };
        let mut roster = Roster::default();
        roster.hear(beat("a", "x", Some(7), 0), at(0));
        roster.hear(beat("b", "x", None, 4_000), at(1_000));
        roster.hear(beat("c", "y", None, 60_000), at(1_000));
        assert_eq!((roster.of_kind("x", at(2_000)), roster.of_kind("z", at(2_000))), (2, 0));
        assert_eq!(roster.runs_of("f", at(2_000)), [7]);
        assert_eq!(roster.runs_of("g", at(2_000)), [0u64; 0]);
        assert!(!roster.has_idle("x", at(2_000)) && roster.has_idle("y", at(2_000)));
        let others = BTreeMap::from([("with adapter y, version 1".to_owned(), 1)]);
        assert_eq!(roster.others("x", "x", at(2_000)), others);
        roster.hear(beat("e", "x-elsewhere", None, 0), at(2_000));
        assert_eq!(roster.others("x", "x", at(2_000)).keys().len(), 2);
        assert!(roster.others("x", "x", at(2_000)).keys().any(|what| what.contains("store")));
        roster.hear(beat("b", "x", None, 5_000), at(2_000));
        assert!(roster.has_idle("x", at(2_000)));
        // A worker that pauses takes no run, so it is no sign of lost runs.
        roster.hear(Beat { is_paused: true, ..beat("b", "x", None, 6_000) }, at(2_000));
        assert_eq!((roster.has_idle("x", at(2_000)), roster.paused("x", at(2_000))), (false, 1));
        assert_eq!((roster.of_kind("x", at(5_500)), roster.runs_of("f", at(5_500))), (1, vec![]));
        roster.hear(beat("d", "x", None, 0), at(60_000));
        assert_eq!(roster.0.len(), 1);
    }
}
