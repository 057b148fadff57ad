//! What a job is doing right now, for those who watch: shared between its runner and everybody who asks.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use parking_lot::{Mutex, RwLock};
use tokio::sync::watch;

use crate::film::Record as FrameRecord;
use crate::film::video::Reel;

/// The rate is measured over the last so long.
const WINDOW: Duration = Duration::from_secs(20);
/// And over so many frames at most.
const MOST_MARKS: usize = 256;

/// Frames of a job by their numbers.
pub type Frames = BTreeMap<u64, FrameRecord>;

/// What a run is at.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Stage {
    /// Not running, getting ready, or waiting for a place in the next stage.
    #[default]
    None,
    Baking,
    Frames,
    Video,
}

/// Numbers that change with every frame.
#[derive(Clone, Debug, Default)]
pub struct Progress {
    pub stage: Stage,
    /// Frames of the job that are there, and that are wanted.
    pub done: u64,
    pub total: Option<u64>,
    /// Drawn in this run.
    pub drawn: u64,
    /// Frames that are in the video so far.
    pub coded: u64,
    /// How much of what the frames need is baked, of 1.
    pub baked: f64,
    pace: Pace,
}

impl Progress {
    /// Frames a second of late, and the seconds that what is left takes at that rate.
    pub fn pace(&self, now: Instant) -> (Option<f64>, Option<f64>) {
        let rate = self.pace.rate(now);
        let at = if self.stage == Stage::Video { self.coded } else { self.done };
        let left = self.total.map(|total| total.saturating_sub(at));
        (rate, rate.zip(left).map(|(rate, left)| left as f64 / rate))
    }

    pub fn begin(&mut self, stage: Stage, now: Instant) {
        self.stage = stage;
        self.pace = Pace::default();
        self.pace.mark(now);
    }

    pub fn step(&mut self, now: Instant) {
        self.pace.mark(now);
    }
}

/// When the last few frames came. Pure.
#[derive(Clone, Debug, Default)]
struct Pace {
    marks: VecDeque<Instant>,
}

impl Pace {
    fn mark(&mut self, now: Instant) {
        self.marks.push_back(now);
        while self.marks.len() > MOST_MARKS
            || self.marks.front().is_some_and(|&first| now - first > WINDOW)
        {
            self.marks.pop_front();
        }
    }

    /// Frames a second from the oldest mark until now; `None` before there are two.
    fn rate(&self, now: Instant) -> Option<f64> {
        let first = self.marks.front()?;
        let steps = self.marks.len() - 1;
        let elapsed_s = now.saturating_duration_since(*first).as_secs_f64();
        (steps > 0 && elapsed_s > 0.0).then(|| steps as f64 / elapsed_s)
    }
}

/// Why a run is to stop before its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stop {
    /// Cancelled or removed.
    Cancelled,
    /// The daemon ends.
    Paused,
    /// The quota is used up.
    Full,
}

/// One job's, for as long as it is known.
pub struct Live {
    pub progress: Mutex<Progress>,
    /// Bytes on the disk.
    pub bytes: AtomicU64,
    /// Frames that are there, while a run lasts; at other times the manifest has them.
    pub drawing: RwLock<Option<Frames>>,
    pub stop: AtomicBool,
    /// What is to be made of the frames, from when they are all there until it is made.
    pub reel: Mutex<Option<Reel>>,
    why: Mutex<Option<Stop>>,
    /// Grows whenever anything of the job changes.
    version: watch::Sender<u64>,
}

impl Live {
    pub fn new(bytes: u64) -> Arc<Live> {
        Arc::new(Live {
            progress: Mutex::default(),
            bytes: AtomicU64::new(bytes),
            drawing: RwLock::new(None),
            stop: AtomicBool::new(false),
            reel: Mutex::new(None),
            why: Mutex::new(None),
            version: watch::Sender::new(0),
        })
    }

    /// Has a run stop; the first reason counts.
    pub fn stop(&self, why: Stop) {
        self.why.lock().get_or_insert(why);
        self.stop.store(true, Ordering::Relaxed);
        self.changed();
    }

    pub fn why(&self) -> Option<Stop> {
        *self.why.lock()
    }

    /// Forgets what an earlier run was told.
    pub fn rearm(&self) {
        *self.why.lock() = None;
        self.stop.store(false, Ordering::Relaxed);
    }

    /// Tells everybody who watches.
    pub fn changed(&self) {
        self.version.send_modify(|version| *version += 1);
    }

    pub fn watch(&self) -> watch::Receiver<u64> {
        self.version.subscribe()
    }

    pub fn bytes(&self) -> u64 {
        self.bytes.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_those_of_late() {
        let start = Instant::now();
        let at = |ms: u64| start + Duration::from_millis(ms);
        let mut progress = Progress { total: Some(1000), ..Progress::default() };
        assert_eq!(progress.pace(start), (None, None));
        progress.begin(Stage::Frames, start);
        assert_eq!(progress.pace(at(5)).0, None);
        for i in 1..=100 {
            progress.step(at(i * 100));
        }
        progress.done = 100;
        assert_eq!(progress.pace(at(10_000)), (Some(10.0), Some(90.0)));
        // Four times as fast since: soon nothing of before counts.
        for i in 0..400 {
            progress.step(at(10_000 + i * 25));
        }
        let rate = progress.pace(at(19_975)).0.unwrap();
        assert!((39.0..=41.0).contains(&rate), "{rate}");
        // A run that stands still slows down.
        assert!(progress.pace(at(60_000)).0.unwrap() < 10.0);
        progress.begin(Stage::Video, at(70_000));
        assert_eq!(progress.pace(at(70_001)), (None, None));
    }

    #[test]
    fn the_first_reason_to_stop_counts() {
        let live = Live::new(0);
        let before = *live.watch().borrow();
        live.stop(Stop::Full);
        live.stop(Stop::Paused);
        assert_eq!(live.why(), Some(Stop::Full));
        assert!(live.stop.load(Ordering::Relaxed) && *live.watch().borrow() > before);
        live.rearm();
        assert_eq!((live.why(), live.stop.load(Ordering::Relaxed)), (None, false));
    }
}
