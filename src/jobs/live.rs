//! The current activity of a job, shared between its runner and its watchers.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use parking_lot::{Mutex, RwLock};
use tokio::sync::watch;

use crate::film::video::Reel;

/// Period over which the rate is measured.
const WINDOW: Duration = Duration::from_secs(10);
/// Frames within this time count as having arrived together, as those of a batch do.
const TOGETHER: Duration = Duration::from_millis(50);
/// Time after the first frames before a rate is given.
const LEAST: Duration = Duration::from_secs(1);

/// Frames of a job by number.
pub use crate::film::Records as Frames;

/// Stage of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Stage {
    /// The job is not running, is getting ready, or waits for a place in the next stage.
    #[default]
    None,
    Baking,
    Frames,
    Video,
}

/// Counters that change with every frame.
#[derive(Clone, Debug, Default)]
pub struct Progress {
    pub stage: Stage,
    /// Number of finished frames, and of all frames of the job.
    pub done: u64,
    pub total: Option<u64>,
    /// Frames drawn in this run.
    pub drawn: u64,
    /// Frames coded into the video so far.
    pub coded: u64,
    /// Progress of baking, from 0 to 1.
    pub baked: f64,
    /// Condition that the stage waits for.
    pub waits_for: Option<String>,
    pace: Pace,
}

impl Progress {
    /// Returns the recent frames per second, and the remaining seconds at that rate.
    pub fn pace(&self, now: Instant) -> (Option<f64>, Option<f64>) {
        let rate = self.pace.rate(now);
        let at = if self.stage == Stage::Video { self.coded } else { self.done };
        let left = self.total.map(|total| total.saturating_sub(at));
        (rate, rate.zip(left).map(|(rate, left)| left as f64 / rate))
    }

    pub fn begin(&mut self, stage: Stage) {
        self.stage = stage;
        self.waits_for = None;
        self.pace = Pace::default();
    }

    pub fn step(&mut self, now: Instant) {
        self.pace.mark(now);
    }
}

/// Times and numbers of the last frames. Pure.
///
/// The first frames are not measured, because they wait for one-time work, above all for pipelines. Nor are the gaps between the
/// frames of one batch.
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
        // Keep two marks even if frames are rarer than the window.
        while self.marks.len() > 2
            && self.marks.front().is_some_and(|&(first, _)| now - first > WINDOW)
        {
            self.marks.pop_front();
        }
    }

    /// Returns frames per second from the oldest mark until now; `None` where that would be a guess.
    fn rate(&self, now: Instant) -> Option<f64> {
        let (first, _) = self.marks.front()?;
        let frames: u64 = self.marks.iter().skip(1).map(|(_, count)| count).sum();
        let elapsed = now.saturating_duration_since(*first);
        (frames > 0 && elapsed >= LEAST).then(|| frames as f64 / elapsed.as_secs_f64())
    }
}

/// Reason for stopping a run before its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stop {
    /// The job was cancelled or removed.
    Cancelled,
    /// The server stops.
    Paused,
    /// The quota is used up.
    Full,
}

/// Live state of one known job.
pub struct Live {
    pub progress: Mutex<Progress>,
    /// Bytes on disk.
    pub bytes: AtomicU64,
    /// Finished frames while a run draws; at other times they are read from the manifest.
    pub drawing: RwLock<Option<Frames>>,
    /// See [`Live::turns`].
    turns: AtomicU64,
    pub stop: AtomicBool,
    /// The video to make, from when all frames are there until it is made.
    pub reel: Mutex<Option<Reel>>,
    why: Mutex<Option<Stop>>,
    /// Increases with every change of the job.
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

    /// Makes a run stop; the first reason counts.
    pub fn stop(&self, why: Stop) {
        self.why.lock().get_or_insert(why);
        self.stop.store(true, Ordering::Relaxed);
        self.changed();
    }

    pub fn why(&self) -> Option<Stop> {
        *self.why.lock()
    }

    /// Clears the stop request of an earlier run.
    pub fn rearm(&self) {
        *self.why.lock() = None;
        self.stop.store(false, Ordering::Relaxed);
    }

    /// Increases whenever a run takes or leaves the job: earlier reads of the manifest may then be stale.
    pub fn turns(&self) -> u64 {
        self.turns.load(Ordering::SeqCst)
    }

    pub fn turn(&self) {
        self.turns.fetch_add(1, Ordering::SeqCst);
    }

    /// Notifies all watchers.
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
        // At four times the rate, earlier frames soon no longer count.
        for i in 0..=400 {
            progress.step(at(10_000 + i * 25));
        }
        let rate = progress.pace(at(20_000)).0.unwrap();
        assert!((39.0..=41.0).contains(&rate), "{rate}");
        // The rate of a run that stalls goes down.
        assert!(progress.pace(at(60_000)).0.unwrap() < 10.0);
        progress.begin(Stage::Video);
        assert_eq!(progress.pace(at(70_001)), (None, None));
    }

    /// The rate ignores what does not last: the wait of the first frame for pipelines, and the gaps within a batch.
    #[test]
    fn a_rate_is_told_when_it_is_one() {
        let start = Instant::now();
        let at = |ms: u64| start + Duration::from_millis(ms);
        let mut progress = Progress { total: Some(361), ..Progress::default() };
        progress.begin(Stage::Frames);
        // One frame after seven seconds, then sixteen together every 1.6 seconds: ten per second.
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
        // Frames that all arrive at once give no rate.
        progress.begin(Stage::Frames);
        (0..16).for_each(|i| progress.step(at(50_000 + i)));
        assert_eq!(progress.pace(at(50_020)).0, None);
        assert_eq!(progress.pace(at(52_000)).0, None);
        // One frame every half minute gives a rate.
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
