//! What a job is doing right now, for those who watch: shared between its runner and everybody who asks.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use parking_lot::{Mutex, RwLock};
use tokio::sync::watch;

use crate::film::video::Reel;

/// The rate is measured over the last so long.
const WINDOW: Duration = Duration::from_secs(10);
/// Frames that come within so short a time have come together, as those of a batch do.
const TOGETHER: Duration = Duration::from_millis(50);
/// From the first frames on, before there is a rate.
const LEAST: Duration = Duration::from_secs(1);

/// Frames of a job by their numbers.
pub use crate::film::Records as Frames;

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

    pub fn begin(&mut self, stage: Stage) {
        self.stage = stage;
        self.pace = Pace::default();
    }

    pub fn step(&mut self, now: Instant) {
        self.pace.mark(now);
    }
}

/// When the last few frames came, and how many each time. Pure.
///
/// The first to come are no measure: they waited for what is made once, pipelines above all. Nor is how fast those of one batch
/// follow each other.
#[derive(Clone, Debug, Default)]
struct Pace {
    marks: VecDeque<(Instant, u64)>,
}

impl Pace {
    fn mark(&mut self, now: Instant) {
        match self.marks.back_mut() {
            Some((at, count)) if now.saturating_duration_since(*at) < TOGETHER => *count += 1,
            _ => self.marks.push_back((now, 1)),
        }
        // Two of them also where frames are rarer than that.
        while self.marks.len() > 2
            && self.marks.front().is_some_and(|&(first, _)| now - first > WINDOW)
        {
            self.marks.pop_front();
        }
    }

    /// Frames a second from the oldest mark until now; `None` where that would be a guess.
    fn rate(&self, now: Instant) -> Option<f64> {
        let (first, _) = self.marks.front()?;
        let frames: u64 = self.marks.iter().skip(1).map(|(_, count)| count).sum();
        let elapsed = now.saturating_duration_since(*first);
        (frames > 0 && elapsed >= LEAST).then(|| frames as f64 / elapsed.as_secs_f64())
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
    /// Frames that are there, while a run draws; at other times the manifest has them.
    pub drawing: RwLock<Option<Frames>>,
    /// See [`Live::turns`].
    turns: AtomicU64,
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
            turns: AtomicU64::new(0),
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

    /// Grows whenever a run takes the job or leaves it: what the manifest said before may not be so any more.
    pub fn turns(&self) -> u64 {
        self.turns.load(Ordering::SeqCst)
    }

    pub fn turn(&self) {
        self.turns.fetch_add(1, Ordering::SeqCst);
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
        progress.begin(Stage::Frames);
        assert_eq!(progress.pace(at(5)).0, None);
        for i in 1..=100 {
            progress.step(at(i * 100));
        }
        progress.done = 100;
        assert_eq!(progress.pace(at(10_000)), (Some(10.0), Some(90.0)));
        // Four times as fast since: soon nothing of before counts.
        for i in 0..=400 {
            progress.step(at(10_000 + i * 25));
        }
        let rate = progress.pace(at(20_000)).0.unwrap();
        assert!((39.0..=41.0).contains(&rate), "{rate}");
        // A run that stands still slows down.
        assert!(progress.pace(at(60_000)).0.unwrap() < 10.0);
        progress.begin(Stage::Video);
        assert_eq!(progress.pace(at(70_001)), (None, None));
    }

    /// Nothing is told by what does not last: the first frame, which waits for pipelines, and how a batch comes.
    #[test]
    fn a_rate_is_told_when_it_is_one() {
        let start = Instant::now();
        let at = |ms: u64| start + Duration::from_millis(ms);
        let mut progress = Progress { total: Some(361), ..Progress::default() };
        progress.begin(Stage::Frames);
        // After seven seconds, and then sixteen together every 1.6 seconds: ten a second.
        progress.step(at(7_000));
        progress.done = 1;
        assert_eq!(progress.pace(at(7_900)), (None, None));
        assert_eq!(progress.pace(at(8_100)), (None, None));
        for batch in 1..=20 {
            let came = 7_000 + batch * 1_600;
            (0..16).for_each(|i| progress.step(at(came + i)));
            progress.done += 16;
            let (rate, eta_s) = progress.pace(at(came + 16));
            assert!((9.8..=11.5).contains(&rate.unwrap()), "{batch}: {rate:?}");
            let left_s = (361 - progress.done) as f64 / 10.0;
            assert!(
                (left_s * 0.85..=left_s * 1.03).contains(&eta_s.unwrap()),
                "{batch}: {eta_s:?}"
            );
        }
        // All at once is no rate.
        progress.begin(Stage::Frames);
        (0..16).for_each(|i| progress.step(at(50_000 + i)));
        assert_eq!(progress.pace(at(50_020)).0, None);
        assert_eq!(progress.pace(at(52_000)).0, None);
        // One in half a minute is.
        progress.begin(Stage::Frames);
        (0..3).for_each(|i| progress.step(at(60_000 + i * 30_000)));
        let rate = progress.pace(at(120_000)).0.unwrap();
        assert!((rate - 1.0 / 30.0).abs() < 1e-9, "{rate}");
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
