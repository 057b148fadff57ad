//! Decides how frames are shared out and when they are given up. Pure: counts and times come in, decisions come out.

use std::time::{Duration, Instant};

/// Desired time of a run. Shorter runs pay more for the way to the broker, longer ones keep others waiting at the end of a film.
pub const RUN_TIME: Duration = Duration::from_secs(2);
/// Frames of the first runs, before any frame was measured.
const FIRST_FRAMES: u64 = 4;
/// Largest number of frames of a run, which bounds its message.
const MOST_FRAMES: u64 = 256;
/// Runs that are queued at a time for each worker. With less than two, workers would wait for the server.
const RUNS_PER_WORKER: u64 = 3;
const FEWEST_RUNS: u64 = 4;
/// Number of times that a frame is begun before it is set aside.
pub const MOST_TRIES: u64 = 3;
/// Number of different workers that fail at a frame before it is set aside, where there are so many.
pub const FAILED_WORKERS: usize = 2;
/// Number of consecutive runs at which a worker fails before it pauses.
const FAILURES: u32 = 3;
/// First and longest pause of a worker that fails. Each pause is twice as long as the one before.
const FIRST_PAUSE: Duration = Duration::from_secs(5);
const MOST_PAUSE: Duration = Duration::from_secs(60);
/// Number of times that a run of several frames is begun before each of its frames becomes a run.
const TRIES_TOGETHER: u64 = 1;
/// A run that no worker has named for this time, while some worker has nothing to do, is lost. The broker delivers a killed
/// worker's run again much earlier ([`ACK_WAIT`]).
pub const LOST_AFTER: Duration = Duration::from_secs(20);
/// Time after which a film says that it waits for such a run. The broker has delivered a killed worker's run again by then.
pub const MISSED_AFTER: Duration = Duration::from_secs(8);
/// Time for which a worker must have waited for work to count as idle.
pub const IDLE_AFTER: Duration = Duration::from_secs(5);
/// Time after which the broker delivers a run again whose worker is silent.
pub const ACK_WAIT: Duration = Duration::from_secs(5);

/// Interval of a worker's beats.
pub const BEAT: Duration = Duration::from_secs(1);
/// Interval at which a worker that draws a run tells the broker so.
pub const PROGRESS: Duration = Duration::from_nanos(ACK_WAIT.as_nanos() as u64 / 3);
/// Time for which the broker keeps a worker's pull.
pub const PULL: Duration = Duration::from_secs(4);
/// Operations of the store that a worker has under way at a time.
pub const STORES: usize = 8;
/// Drawn frames that wait in a worker to be stored.
pub const UNSTORED: usize = 4;
/// Interval at which a server looks at a film when no note comes.
pub const TICK: Duration = Duration::from_millis(250);
/// Time without notes after which a server lists a film in the store.
const LIST_AFTER: Duration = Duration::from_secs(2);
/// Number of times that the interval of listings is doubled while nothing is new.
const MOST_DOUBLINGS: u32 = 4;
/// Frames that a server reads from the store at a time for a film.
pub const READS: usize = 8;
/// Notes of a film that a server takes at a time.
pub const MOST_NOTES: usize = 64;

/// Returns the number of frames of the next run, given that `remaining` frames are in no run yet. `frame` is the measured time of a frame.
/// Towards the end of a film, runs become shorter, so that all workers end at about the same time.
pub fn run_length(remaining: u64, frame: Option<Duration>, workers: u64) -> u64 {
    let by_time = frame.map_or(FIRST_FRAMES, |frame| {
        let frames = RUN_TIME.as_secs_f64() / frame.as_secs_f64().max(1e-9);
        (frames as u64).clamp(1, MOST_FRAMES)
    });
    let fair = remaining.div_ceil(2 * workers.max(1));
    by_time.min(fair).max(1).min(remaining)
}

/// Returns the number of workers that one of `films` films may keep busy. The queue is in order of arrival: if each film queued runs for all
/// workers, the first run of a new film would wait for those of all others.
pub fn share_of_workers(workers: u64, films: u64) -> u64 {
    workers.div_ceil(films.max(1))
}

/// Returns the number of runs that are queued or drawn at a time.
pub fn most_runs(workers: u64) -> u64 {
    (workers * RUNS_PER_WORKER).max(FEWEST_RUNS)
}

/// Returns the mean time of a frame after another measurement. Newer ones count more, because frames of a film change slowly.
pub fn mean_time(before: Option<Duration>, drawn: u64, elapsed: Duration) -> Option<Duration> {
    let frames = u32::try_from(drawn).ok().filter(|frames| *frames > 0);
    let Some(now) = frames.map(|frames| elapsed / frames) else { return before };
    Some(before.map_or(now, |before| (before + now) / 2))
}

/// A worker's decision about a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    Draw,
    /// Make each frame a run, to find the one that cannot be drawn.
    Split,
    SetAside,
}

/// Decides about a run of `frames` frames that was begun `begun` times before. In `deaths` of these tries, the worker ended.
pub fn judge(begun: u64, deaths: u64, frames: usize) -> Verdict {
    match frames {
        0 | 1 if deaths >= MOST_TRIES => Verdict::SetAside,
        0 | 1 => Verdict::Draw,
        _ if begun >= TRIES_TOGETHER => Verdict::Split,
        _ => Verdict::Draw,
    }
}

/// Returns whether frames of a run that was begun `begun` times before may be in the store, so that a worker asks for each before it
/// draws. A fresh run of several frames seldom has any: the server has looked before. Runs of one frame may come from a run that was split.
pub fn may_be_stored(begun: u64, frames: usize) -> bool {
    begun > 0 || frames <= 1
}

/// Decides when a server lists a film in the store, in case notes were lost. Each listing costs requests for all frames of the film, so
/// listings become rarer while no note comes and no worker begins or ends a run.
#[derive(Debug, Default)]
pub struct Listings {
    latest: Option<Instant>,
    /// When the latest note came.
    news: Option<Instant>,
    /// Listings since something was new.
    quiet: u32,
    /// Runs that workers have.
    runs: Vec<u64>,
}

impl Listings {
    /// Records that a note came.
    pub fn hear(&mut self, now: Instant) {
        self.news = Some(now);
        self.quiet = 0;
    }

    /// Records which runs workers have, in order. The notes of a run that has ended may be lost.
    pub fn see(&mut self, runs: &[u64]) {
        if self.runs != runs {
            self.runs = runs.to_vec();
            self.quiet = 0;
        }
    }

    /// Records a listing.
    pub fn listed(&mut self, now: Instant) {
        self.latest = Some(now);
        self.quiet = (self.quiet + 1).min(MOST_DOUBLINGS);
    }

    /// Returns whether the film is to be listed. The first listing is due at once.
    pub fn is_due(&self, now: Instant) -> bool {
        let has_passed = |at: Option<Instant>, time: Duration| {
            at.is_none_or(|at| now.saturating_duration_since(at) >= time)
        };
        self.latest.is_none()
            || has_passed(self.news, LIST_AFTER)
                && has_passed(self.latest, LIST_AFTER * (1 << self.quiet))
    }
}

/// Consecutive runs at which a worker failed for reasons of its own, such as a full disk.
#[derive(Debug, Default)]
pub struct Streak {
    failures: u32,
    /// The latest run failed, and no pause has followed yet.
    is_fresh: bool,
}

impl Streak {
    /// Counts a run that failed.
    pub fn fail(&mut self) {
        self.failures = self.failures.saturating_add(1);
        self.is_fresh = true;
    }

    /// Ends the streak: the worker has drawn frames.
    pub fn end(&mut self) {
        *self = Streak::default();
    }

    /// Returns the number of failures, and the pause that is due before the worker pulls again. The pause is due once for each failure.
    pub fn pause(&mut self) -> Option<(u32, Duration)> {
        let doubled = self.failures.checked_sub(FAILURES).filter(|_| self.is_fresh)?;
        self.is_fresh = false;
        Some((self.failures, (FIRST_PAUSE * (1 << doubled.min(8))).min(MOST_PAUSE)))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn runs_take_about_two_seconds_and_shrink_at_the_end() {
        let ms = |ms| Some(Duration::from_millis(ms));
        assert_eq!(run_length(300, None, 3), 4);
        assert_eq!(run_length(300, ms(100), 3), 20);
        assert_eq!(run_length(300, ms(1), 1), 150);
        assert_eq!(run_length(10_000, ms(1), 1), 256);
        assert_eq!(run_length(300, ms(60_000), 3), 1);
        assert_eq!(run_length(12, ms(100), 3), 2);
        assert_eq!(run_length(1, ms(100), 3), 1);
        assert_eq!((most_runs(0), most_runs(3)), (4, 9));
    }

    #[test]
    fn frames_are_tried_together_once_and_alone_three_times() {
        assert_eq!(judge(0, 0, 20), Verdict::Draw);
        assert_eq!((judge(1, 0, 20), judge(1, 1, 20)), (Verdict::Split, Verdict::Split));
        let alone = [0, 1, 2, 3, 4].map(|deaths| judge(4, deaths, 1));
        let [draw, aside] = [Verdict::Draw, Verdict::SetAside];
        assert_eq!(alone, [draw, draw, draw, aside, aside]);
        let looked = [(0, 20), (0, 1), (1, 20)].map(|(begun, frames)| may_be_stored(begun, frames));
        assert_eq!(looked, [false, true, true]);
    }

    #[test]
    fn a_worker_that_fails_at_run_after_run_pauses_longer_each_time() {
        let mut streak = Streak::default();
        let fail = |streak: &mut Streak| {
            streak.fail();
            streak.pause().map(|(_, pause)| pause.as_secs())
        };
        let pauses: Vec<_> = (0..9).map(|_| fail(&mut streak)).collect();
        let due = [5, 10, 20, 40, 60, 60, 60].map(Some);
        assert_eq!(pauses, [&[None, None][..], &due].concat());
        // A run that is passed on causes no pause, and ends no streak.
        assert_eq!(streak.pause(), None);
        assert_eq!(fail(&mut streak), Some(60));
        streak.end();
        assert_eq!([(); 3].map(|()| fail(&mut streak)), [None, None, Some(5)]);
    }

    #[test]
    fn a_quiet_film_is_listed_less_and_less_often() {
        let start = Instant::now();
        let listed = |listings: &mut Listings, seconds: std::ops::Range<u64>| {
            let mut at = Vec::new();
            for second in seconds {
                let now = start + Duration::from_secs(second);
                if listings.is_due(now) {
                    listings.listed(now);
                    at.push(second);
                }
            }
            at
        };
        let mut listings = Listings::default();
        assert_eq!(listed(&mut listings, 0..130), [0, 4, 12, 28, 60, 92, 124]);
        listings.hear(start + Duration::from_secs(130));
        assert_eq!(listed(&mut listings, 130..140), [132, 136]);
        // The last note of a film may be lost, but its worker is seen to be idle.
        listings.see(&[7]);
        listings.see(&[]);
        assert_eq!(listed(&mut listings, 140..146), [140, 144]);
        listings.see(&[]);
        assert_eq!(listed(&mut listings, 146..152), [0u64; 0]);
    }

    proptest! {
        #[test]
        fn every_film_is_shared_out(
            frames in 1u64..5000,
            frame_us in prop::option::of(0u64..10_000_000),
            workers in 0u64..40,
        ) {
            let (mut left, mut runs) = (frames, 0);
            while left > 0 {
                let length = run_length(left, frame_us.map(Duration::from_micros), workers);
                prop_assert!((1..=left.min(MOST_FRAMES)).contains(&length));
                left -= length;
                runs += 1;
            }
            prop_assert!(runs <= frames);
        }

        #[test]
        fn means_lie_between_measurements(times in prop::collection::vec((1u64..100, 1u64..1_000_000), 1..30)) {
            let each = |(frames, us): (u64, u64)| Duration::from_micros(us) / frames as u32;
            let mean = times.iter().fold(None, |mean, &(frames, us)| {
                mean_time(mean, frames, Duration::from_micros(us))
            });
            let (least, most) = (times.iter().map(|t| each(*t)).min(), times.iter().map(|t| each(*t)).max());
            prop_assert!(least <= mean && mean <= most);
            prop_assert_eq!(mean_time(mean, 0, Duration::from_secs(9)), mean);
        }
    }
}
