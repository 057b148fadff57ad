//! The frames of one film from the server's point of view. Pure: it decides what to queue and knows what is outstanding.
//!
//! ```text
//!            next                    arrived, given up
//! waiting ──────────► in a run ──────────────────────► gone
//!    ▲                    │
//!    └────────lost────────┘
//! ```

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

use super::messages::Run;
use super::pacing::{LOST_AFTER, MISSED_AFTER, mean_time, most_runs, run_length, share_of_workers};
use crate::film::Wanted;

/// A frame that has not arrived.
#[derive(Debug)]
struct Outstanding {
    tag: String,
    /// The run that it is in; `None`: it waits.
    run: Option<u64>,
}

/// A run that is queued or drawn.
#[derive(Debug)]
struct Sent {
    /// Frames of the run that have not arrived.
    frames: BTreeSet<u64>,
    /// When the run was queued, or when it last seemed to be drawn.
    seen: Instant,
}

/// All frames that have not arrived. A frame's run is found without a search, because with a thousand workers there are thousands of runs.
#[derive(Debug)]
pub struct Desk {
    film: String,
    /// Identifier of this desk in its runs.
    generation: String,
    frames: BTreeMap<u64, Outstanding>,
    /// Frames that are in no run.
    waiting: BTreeSet<u64>,
    sent: BTreeMap<u64, Sent>,
    next_run: u64,
    frame_time: Option<Duration>,
}

impl Desk {
    pub fn new(film: &str, generation: String, frames: Vec<Wanted>) -> Desk {
        let outstanding = |Wanted { number, tag }| (number, Outstanding { tag, run: None });
        Desk {
            film: film.to_owned(),
            generation,
            waiting: frames.iter().map(|frame| frame.number).collect(),
            frames: frames.into_iter().map(outstanding).collect(),
            sent: BTreeMap::new(),
            next_run: 0,
            frame_time: None,
        }
    }

    /// Returns whether no frame is outstanding.
    pub fn is_clear(&self) -> bool {
        self.frames.is_empty()
    }

    /// Returns the next run to queue, if there are frames for one and few enough are queued. The film shares `workers` with all `films`
    /// that the server draws now, itself included.
    pub fn next(&mut self, workers: u64, films: u64, now: Instant) -> Option<Run> {
        let workers = share_of_workers(workers, films);
        if self.sent.len() as u64 >= most_runs(workers) || self.waiting.is_empty() {
            return None;
        }
        let length = run_length(self.waiting.len() as u64, self.frame_time, workers);
        let id = self.next_run;
        self.next_run += 1;
        let numbers: BTreeSet<u64> = (0..length).map_while(|_| self.waiting.pop_first()).collect();
        let mut frames = Vec::with_capacity(numbers.len());
        for &number in &numbers {
            if let Some(frame) = self.frames.get_mut(&number) {
                frame.run = Some(id);
                frames.push(Wanted { number, tag: frame.tag.clone() });
            }
        }
        self.sent.insert(id, Sent { frames: numbers, seen: now });
        let (film, generation) = (self.film.clone(), self.generation.clone());
        Some(Run { film, generation, id, frames })
    }

    /// Returns the tag of a frame that has not arrived.
    pub fn tag(&self, frame: u64) -> Option<String> {
        self.frames.get(&frame).map(|frame| frame.tag.clone())
    }

    /// Returns the outstanding frames with these tags.
    pub fn numbers(&self, tags: &[String]) -> Vec<u64> {
        let mut known: BTreeMap<&str, Vec<u64>> = BTreeMap::new();
        for (number, frame) in &self.frames {
            known.entry(&frame.tag).or_default().push(*number);
        }
        tags.iter().flat_map(|tag| known.remove(tag.as_str()).unwrap_or_default()).collect()
    }

    /// Records that a frame has arrived or is given up. Returns false for a frame that was not outstanding.
    pub fn close(&mut self, frame: u64) -> bool {
        let Some(Outstanding { run, .. }) = self.frames.remove(&frame) else { return false };
        self.waiting.remove(&frame);
        if let Some((run, sent)) = run.and_then(|run| Some((run, self.sent.get_mut(&run)?))) {
            sent.frames.remove(&frame);
            if sent.frames.is_empty() {
                self.sent.remove(&run);
            }
        }
        true
    }

    /// Records a sign that runs are being drawn.
    pub fn seen(&mut self, runs: &[u64], now: Instant) {
        for run in runs {
            if let Some(sent) = self.sent.get_mut(run) {
                sent.seen = now;
            }
        }
    }

    /// Records the time that a worker needed for some frames.
    pub fn measured(&mut self, drawn: u64, elapsed: Duration) {
        self.frame_time = mean_time(self.frame_time, drawn, elapsed);
    }

    /// Returns the number of frames of a run that have not arrived.
    pub fn left_of(&self, run: u64) -> u64 {
        self.sent.get(&run).map_or(0, |sent| sent.frames.len() as u64)
    }

    /// Returns the runs that no worker has named for a time although a worker is idle.
    fn unseen(&self, time: Duration, has_idle: bool, now: Instant) -> Vec<u64> {
        let is_unseen = |sent: &Sent| has_idle && now.saturating_duration_since(sent.seen) >= time;
        self.sent.iter().filter(|(_, sent)| is_unseen(sent)).map(|(run, _)| *run).collect()
    }

    /// Returns the number of runs that [`Desk::take_back`] takes back if they stay unseen.
    pub fn missed(&self, has_idle: bool, now: Instant) -> usize {
        self.unseen(MISSED_AFTER, has_idle, now).len()
    }

    /// Takes back the frames of runs that the broker seems to have lost: none was seen for long although a worker is idle. Returns
    /// the number of such frames.
    pub fn take_back(&mut self, has_idle: bool, now: Instant) -> u64 {
        let mut lost = 0;
        for run in self.unseen(LOST_AFTER, has_idle, now) {
            let numbers = self.sent.remove(&run).map(|sent| sent.frames).unwrap_or_default();
            lost += numbers.len() as u64;
            for number in numbers {
                if let Some(frame) = self.frames.get_mut(&number) {
                    frame.run = None;
                    self.waiting.insert(number);
                }
            }
        }
        lost
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn frames(count: u64) -> Vec<Wanted> {
        // Frames of a still camera have the same tag.
        (0..count).map(|number| Wanted { number, tag: format!("t{}", number / 2) }).collect()
    }

    #[test]
    fn runs_that_nobody_has_are_queued_again_when_a_worker_is_idle() {
        let start = Instant::now();
        let late = start + LOST_AFTER;
        let mut desk = Desk::new("f", "g".to_owned(), frames(8));
        let first = desk.next(1, 1, start).unwrap();
        assert_eq!((first.id, first.frames.len()), (0, 4));
        let second = desk.next(1, 1, start).unwrap();
        assert!(desk.close(0) && !desk.close(0));
        assert_eq!([first.id, second.id, 9].map(|run| desk.left_of(run)), [3, 2, 0]);
        let missed = [(true, start), (false, start + MISSED_AFTER), (true, start + MISSED_AFTER)];
        assert_eq!(missed.map(|(has_idle, now)| desk.missed(has_idle, now)), [0, 0, 2]);
        desk.seen(&[second.id], late);
        assert_eq!(desk.missed(true, late), 1);
        assert_eq!((desk.take_back(false, late), desk.take_back(true, late)), (0, 3));
        let third = desk.next(1, 1, late).unwrap();
        assert!(third.id > second.id);
        let again: Vec<u64> = third.frames.iter().map(|frame| frame.number).collect();
        assert!(
            again
                .iter()
                .all(|number| *number != 0 && !second.frames.iter().any(|f| f.number == *number))
        );
        assert_eq!(desk.tag(7).unwrap(), "t3");
        assert_eq!(desk.numbers(&["t3".to_owned(), "t9".to_owned()]), [6, 7]);
    }

    #[test]
    fn films_share_the_workers() {
        let runs = |workers, films| {
            let mut desk = Desk::new("f", "g".to_owned(), frames(100_000));
            std::iter::from_fn(|| desk.next(workers, films, Instant::now())).count()
        };
        // Three runs for each worker of the film's share, so that the first run of another film does not wait for all of theirs.
        assert_eq!((runs(1000, 1), runs(1000, 10), runs(1000, 5000)), (3000, 300, 4));
        assert_eq!((runs(3, 2), runs(0, 3)), (6, 4));
    }

    proptest! {
        #[test]
        fn every_frame_arrives_once_whatever_is_lost(
            count in 1u64..60,
            steps in prop::collection::vec((0u8..4, 0usize..60), 0..200),
        ) {
            let mut now = Instant::now();
            let mut desk = Desk::new("f", "g".to_owned(), frames(count));
            let (mut queued, mut arrived): (Vec<u64>, Vec<u64>) = (Vec::new(), Vec::new());
            let rest = (0..2 * count as usize).map(|i| ((i % 2) as u8, 0));
            for (what, which) in steps.into_iter().chain(rest) {
                match what {
                    0 => while let Some(run) = desk.next(2, 1, now) {
                        queued.extend(run.frames.iter().map(|frame| frame.number));
                    },
                    1 if !queued.is_empty() => {
                        let frame = queued.swap_remove(which % queued.len());
                        let is_new = !arrived.contains(&frame);
                        prop_assert_eq!(desk.tag(frame).is_some(), is_new);
                        prop_assert_eq!(desk.close(frame), is_new);
                        arrived.extend(is_new.then_some(frame));
                    }
                    2 => {
                        now += LOST_AFTER;
                        desk.take_back(true, now);
                    }
                    _ => desk.measured(1 + which as u64, Duration::from_millis(40)),
                }
                prop_assert_eq!(desk.is_clear(), arrived.len() as u64 == count);
            }
            // Everything that was queued has been answered meanwhile, or is still outstanding.
            let left = (0..count).filter(|frame| desk.tag(*frame).is_some()).count();
            prop_assert_eq!(left + arrived.len(), count as usize);
        }
    }
}
