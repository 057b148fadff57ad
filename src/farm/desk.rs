//! The frames of one film from the daemon's point of view. Pure: it decides what to queue and knows what is outstanding.
//!
//! ```text
//!            next                    arrived, given up
//! waiting ──────────► in a run ──────────────────────► gone
//!    ▲                    │
//!    └────────lost────────┘
//! ```

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use super::messages::Run;
use super::pacing::{LOST_AFTER, mean_time, most_runs, run_length};
use crate::film::Wanted;

/// Frames that are queued or drawn.
#[derive(Debug)]
struct Sent {
    /// Tags of the frames that have not arrived, by number.
    frames: BTreeMap<u64, String>,
    /// When the run was queued, or when it last seemed to be drawn.
    seen: Instant,
}

/// All frames that have not arrived.
#[derive(Debug)]
pub struct Desk {
    film: String,
    /// Tags of the frames that are in no run, by number.
    waiting: BTreeMap<u64, String>,
    sent: BTreeMap<u64, Sent>,
    next_run: u64,
    frame_time: Option<Duration>,
}

impl Desk {
    pub fn new(film: &str, frames: Vec<Wanted>) -> Desk {
        Desk {
            film: film.to_owned(),
            waiting: frames.into_iter().map(|frame| (frame.number, frame.tag)).collect(),
            sent: BTreeMap::new(),
            next_run: 0,
            frame_time: None,
        }
    }

    /// Returns whether no frame is outstanding.
    pub fn is_clear(&self) -> bool {
        self.waiting.is_empty() && self.sent.is_empty()
    }

    /// Returns the next run to queue, if there are frames for one and few enough are queued.
    pub fn next(&mut self, workers: u64, now: Instant) -> Option<Run> {
        if self.sent.len() as u64 >= most_runs(workers) || self.waiting.is_empty() {
            return None;
        }
        let length = run_length(self.waiting.len() as u64, self.frame_time, workers);
        let tags: BTreeMap<u64, String> =
            (0..length).map_while(|_| self.waiting.pop_first()).collect();
        let id = self.next_run;
        self.next_run += 1;
        let wanted = |(number, tag): (&u64, &String)| Wanted { number: *number, tag: tag.clone() };
        let frames = tags.iter().map(wanted).collect();
        self.sent.insert(id, Sent { frames: tags, seen: now });
        Some(Run { film: self.film.clone(), id, frames })
    }

    /// Returns the tag of a frame that has not arrived.
    pub fn tag(&self, frame: u64) -> Option<String> {
        let sent = self.sent.values().find_map(|sent| sent.frames.get(&frame));
        sent.or_else(|| self.waiting.get(&frame)).cloned()
    }

    /// Returns the outstanding frames with these tags.
    pub fn numbers(&self, tags: &[String]) -> Vec<u64> {
        let mut known: BTreeMap<&str, Vec<u64>> = BTreeMap::new();
        let sent = self.sent.values().flat_map(|sent| &sent.frames);
        for (number, tag) in sent.chain(&self.waiting) {
            known.entry(tag).or_default().push(*number);
        }
        tags.iter().flat_map(|tag| known.remove(tag.as_str()).unwrap_or_default()).collect()
    }

    /// Records that a frame has arrived or is given up. Returns false for a frame that was not outstanding.
    pub fn close(&mut self, frame: u64) -> bool {
        let mut is_known = self.waiting.remove(&frame).is_some();
        self.sent.retain(|_, sent| {
            is_known |= sent.frames.remove(&frame).is_some();
            !sent.frames.is_empty()
        });
        is_known
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

    /// Takes back the frames of runs that the broker seems to have lost: none was seen for long although a worker is idle. Returns
    /// the number of such runs.
    pub fn take_back(&mut self, has_idle: bool, now: Instant) -> usize {
        if !has_idle {
            return 0;
        }
        let is_lost = |sent: &Sent| now.saturating_duration_since(sent.seen) >= LOST_AFTER;
        let lost: Vec<u64> =
            self.sent.iter().filter(|(_, sent)| is_lost(sent)).map(|(run, _)| *run).collect();
        for run in &lost {
            let frames = self.sent.remove(run).map(|sent| sent.frames).unwrap_or_default();
            self.waiting.extend(frames);
        }
        lost.len()
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
        let mut desk = Desk::new("f", frames(8));
        let first = desk.next(1, start).unwrap();
        assert_eq!((first.id, first.frames.len()), (0, 4));
        let second = desk.next(1, start).unwrap();
        assert!(desk.close(0) && !desk.close(0));
        desk.seen(&[second.id], late);
        assert_eq!((desk.take_back(false, late), desk.take_back(true, late)), (0, 1));
        let third = desk.next(1, late).unwrap();
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

    proptest! {
        #[test]
        fn every_frame_arrives_once_whatever_is_lost(
            count in 1u64..60,
            steps in prop::collection::vec((0u8..4, 0usize..60), 0..200),
        ) {
            let mut now = Instant::now();
            let mut desk = Desk::new("f", frames(count));
            let (mut queued, mut arrived): (Vec<u64>, Vec<u64>) = (Vec::new(), Vec::new());
            let rest = (0..2 * count as usize).map(|i| ((i % 2) as u8, 0));
            for (what, which) in steps.into_iter().chain(rest) {
                match what {
                    0 => while let Some(run) = desk.next(2, now) {
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
