//! Runs one step: sends requests when they are due, for as long as the step lasts, and records how each ended.
//!
//! The schedule has a thread of its own, because a runtime's timers tick in milliseconds and wait for its tasks. At each due time
//! the thread starts a task. If the limit of requests in flight is reached, it instead counts the request as not sent, at once
//! and without delaying later ones. The step ends when its last request has ended; none lives longer than its timeout.

use std::future::Future;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use anyhow::Context;
use parking_lot::Mutex;
use tokio::runtime::Handle;
use tokio_util::task::TaskTracker;

use super::schedule::{Schedule, Spacing};
use super::tally::{Outcome, Sample, Tally};

/// A way of asking for frames, many at a time. [`super::request::RequestClient`] sends a request for each frame.
pub trait Client: Send + Sync + 'static {
    /// Asks for frame `number` of the run and reads it to its end. The future is dropped when the request's timeout is over.
    fn frame(&self, number: u64) -> impl Future<Output = Outcome> + Send;
}

/// Settings of a step.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    pub rate_per_s: f64,
    pub spacing: Spacing,
    pub seed: u64,
    /// Requests that are due during the warm-up are sent but not counted.
    pub warmup: Duration,
    pub duration: Duration,
    /// Time from when a request is due to when it is given up.
    pub timeout: Duration,
    /// Limit of requests in flight.
    pub under_way_at_most: usize,
    /// Number of the step's first request. A request's number decides its pose.
    pub first_number: u64,
}

/// Tally of a step, and the number of requests that it used up.
pub struct Finished {
    pub tally: Tally,
    pub requests: u64,
}

/// Runs a step to its end, or until `stop` is set.
///
/// # Errors
/// The thread that keeps the schedule could not be joined.
pub async fn run_step<C: Client>(
    client: Arc<C>,
    step: Step,
    stop: Arc<AtomicBool>,
) -> anyhow::Result<Finished> {
    let tally = Arc::new(Mutex::new(Tally::new(step.warmup, step.duration)));
    let tasks = TaskTracker::new();
    let pace = Pace {
        client,
        step,
        stop,
        tally: tally.clone(),
        tasks: tasks.clone(),
        runtime: Handle::current(),
    };
    let requests = tokio::task::spawn_blocking(move || pace.keep())
        .await
        .context("the thread that keeps the schedule ended early")?;
    tasks.close();
    tasks.wait().await;
    let tally = tally.lock().clone();
    Ok(Finished { tally, requests })
}

/// Keeps the schedule and starts the requests.
struct Pace<C> {
    client: Arc<C>,
    step: Step,
    stop: Arc<AtomicBool>,
    tally: Arc<Mutex<Tally>>,
    tasks: TaskTracker,
    runtime: Handle,
}

impl<C: Client> Pace<C> {
    /// Starts every request of the step, and returns how many there were.
    fn keep(self) -> u64 {
        let Step { rate_per_s, spacing, seed, warmup, duration, .. } = self.step;
        let under_way = Arc::new(AtomicUsize::new(0));
        let began = Instant::now();
        let mut number = self.step.first_number;
        for due in Schedule::new(rate_per_s, spacing, seed) {
            if due >= warmup + duration || !self.wait_until(began + due) {
                break;
            }
            // Only this thread increments the number, so it cannot exceed its limit between the check and the increment.
            if under_way.load(Ordering::Acquire) >= self.step.under_way_at_most {
                let now = began.elapsed();
                let outcome = Outcome::NotSent;
                self.tally.lock().record(Sample { due, begun: now, done: now, outcome });
            } else {
                under_way.fetch_add(1, Ordering::AcqRel);
                self.start(number, began, due, under_way.clone());
            }
            number += 1;
        }
        number - self.step.first_number
    }

    /// Returns false when the step is to stop.
    fn wait_until(&self, due: Instant) -> bool {
        const PATIENCE: Duration = Duration::from_millis(100);
        loop {
            if self.stop.load(Ordering::Relaxed) {
                return false;
            }
            match due.saturating_duration_since(Instant::now()) {
                Duration::ZERO => return true,
                left => std::thread::sleep(left.min(PATIENCE)),
            }
        }
    }

    fn start(&self, number: u64, began: Instant, due: Duration, under_way: Arc<AtomicUsize>) {
        let (client, tally) = (self.client.clone(), self.tally.clone());
        let give_up = began + due + self.step.timeout;
        self.tasks.spawn_on(
            async move {
                let begun = began.elapsed();
                let frame = client.frame(number);
                let outcome = tokio::time::timeout_at(give_up.into(), frame)
                    .await
                    .unwrap_or(Outcome::TimedOut);
                let done = began.elapsed();
                // Decrement before recording, so that a request that follows the recorded sample finds the place free.
                under_way.fetch_sub(1, Ordering::AcqRel);
                tally.lock().record(Sample { due, begun, done, outcome });
            },
            &self.runtime,
        );
    }
}

#[cfg(test)]
mod tests {
    use super::super::tally::{Answer, Point};
    use super::*;

    /// Takes `takes` for each frame, and blocks its thread for `blocks` at frame `at`.
    struct Simulated {
        takes: Duration,
        blocks: Duration,
        at: u64,
    }

    impl Client for Simulated {
        async fn frame(&self, number: u64) -> Outcome {
            if number == self.at {
                std::thread::sleep(self.blocks);
            }
            tokio::time::sleep(self.takes).await;
            Outcome::Answered(Answer {
                status: 200,
                bytes: 10,
                has_retry_after: false,
                receipt: None,
                complaint: None,
            })
        }
    }

    const STEP: Step = Step {
        rate_per_s: 200.0,
        spacing: Spacing::Constant,
        seed: 1,
        warmup: Duration::from_millis(100),
        duration: Duration::from_secs(1),
        timeout: Duration::from_secs(5),
        under_way_at_most: 1000,
        first_number: 0,
    };

    fn run(client: Simulated, step: Step) -> (Point, u64) {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let stop = Arc::new(AtomicBool::new(false));
        let finished = runtime.block_on(run_step(Arc::new(client), step, stop)).unwrap();
        (finished.tally.point(step.rate_per_s), finished.requests)
    }

    const QUICK: Simulated =
        Simulated { takes: Duration::from_millis(1), blocks: Duration::ZERO, at: u64::MAX };

    #[test]
    fn requests_are_sent_when_they_are_due() {
        let (point, requests) = run(QUICK, STEP);
        assert_eq!((requests, point.requests, point.counts.frames), (220, 200, 200));
        assert!((point.throughput_per_s - 200.0).abs() < 10.0, "{}", point.throughput_per_s);
    }

    /// A generator that is blocked for 300 ms of a second sends 30 % of its requests late, and reports it.
    #[test]
    fn a_generator_that_is_late_counts_it() {
        let client = Simulated { blocks: Duration::from_millis(300), at: 60, ..QUICK };
        let (point, _) = run(client, STEP);
        assert_eq!(point.counts.frames, 200);
        assert!(point.latency.p90_ns.unwrap() > 150_000_000, "{:?}", point.latency);
        assert!(point.begun_late_max_ns.unwrap() > 200_000_000);
    }

    #[test]
    fn what_is_over_the_limit_is_counted_and_delays_nobody() {
        // None of the first eight requests ends before the last one is due.
        let slow = Simulated { takes: Duration::from_secs(3600), ..QUICK };
        let warmup = Duration::ZERO;
        let (point, requests) = run(slow, Step { under_way_at_most: 8, warmup, ..STEP });
        assert_eq!((requests, point.requests), (200, 200));
        let Point { counts, .. } = point;
        assert_eq!((counts.timed_out, counts.not_sent), (8, 192), "{counts:?}");
    }

    #[test]
    fn requests_are_given_up_in_time() {
        let slow = Simulated { takes: Duration::from_secs(3600), ..QUICK };
        let (point, _) = run(slow, Step { timeout: Duration::from_millis(200), ..STEP });
        assert_eq!((point.counts.timed_out, point.latency.p50_ns), (200, None));
    }

    #[test]
    fn a_step_stops_when_it_is_told_to() {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let stop = Arc::new(AtomicBool::new(true));
        let finished = runtime.block_on(run_step(Arc::new(QUICK), STEP, stop)).unwrap();
        assert_eq!(finished.requests, 0);
    }
}
