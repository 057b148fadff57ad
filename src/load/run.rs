//! A whole run: steps at given rates or a search for the knee, and the report.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use serde::Serialize;

use super::drive::{Client, Finished, Step, run_step};
use super::following::StreamPoint;
use super::knee::{Demands, Search, SearchSettings, Verdict, judge};
use super::report::{JudgedPoint, Knee};
use super::schedule::Spacing;
use super::tally::{Point, Tally};
use crate::scene::random::SplitMix64;

/// The rates at which requests are sent.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Rates {
    /// These rates per second, in this order.
    Given(Vec<f64>),
    /// Raise the rate until the server no longer keeps up.
    Saturate(SearchSettings),
}

/// Settings that all steps share.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RunSettings {
    pub rates: Rates,
    pub spacing: Spacing,
    pub seed: u64,
    pub warmup_s: f64,
    pub duration_s: f64,
    pub timeout_s: f64,
    pub connections_at_most: usize,
    pub demands: Demands,
    /// Number of streams beside the requests, and poses per second that each of them sends.
    pub streams: usize,
    pub poses_per_s: f64,
}

/// Progress of a run.
pub enum Event<'a> {
    /// A step begins; it sends requests for this time.
    Began {
        rate_per_s: f64,
        sends_for: Duration,
    },
    Ended(&'a JudgedPoint),
}

/// Results of the steps that ended.
pub struct Outcomes {
    pub points: Vec<JudgedPoint>,
    pub knee: Option<Knee>,
    pub interrupted: bool,
    pub adapter: Option<String>,
    pub settings: serde_json::Value,
}

/// Runs until all rates are done, the knee is found, or `stop` is set. A step that `stop` interrupts is left out. `streams` runs
/// the streams beside the requests of a step.
///
/// # Errors
/// As [`run_step`].
pub async fn run<C: Client>(
    client: Arc<C>,
    streams: impl AsyncFn(Step) -> Option<StreamPoint>,
    settings: &RunSettings,
    stop: Arc<AtomicBool>,
    mut tell: impl FnMut(Event<'_>),
) -> anyhow::Result<Outcomes> {
    let mut rates = Ahead::new(&settings.rates);
    let mut outcomes = Outcomes {
        points: Vec::new(),
        knee: None,
        interrupted: false,
        adapter: None,
        settings: serde_json::Value::Null,
    };
    let mut first_number = 0;
    while let Some(rate_per_s) = rates.next_rate() {
        let step = step(settings, rate_per_s, outcomes.points.len(), first_number);
        tell(Event::Began { rate_per_s, sends_for: step.warmup + step.duration });
        let (finished, beside) =
            tokio::join!(run_step(client.clone(), step, stop.clone()), streams(step));
        let Finished { tally, requests } = finished?;
        if stop.load(Ordering::Relaxed) {
            outcomes.interrupted = true;
            break;
        }
        first_number += requests;
        let point = judged(&tally, rate_per_s, beside, &settings.demands);
        if outcomes.adapter.is_none() {
            (outcomes.adapter, outcomes.settings) = tally.first_receipt();
        }
        rates.tell(rate_per_s, point.verdict);
        tell(Event::Ended(&point));
        outcomes.points.push(point);
    }
    outcomes.knee = rates.knee(&outcomes.points);
    Ok(outcomes)
}

fn step(settings: &RunSettings, rate_per_s: f64, index: usize, first_number: u64) -> Step {
    Step {
        rate_per_s,
        spacing: settings.spacing,
        // Each step has its own arrival times, independent of where the run enters the path.
        seed: SplitMix64::stream(settings.seed, index as u64).next_u64(),
        warmup: Duration::from_secs_f64(settings.warmup_s),
        duration: Duration::from_secs_f64(settings.duration_s),
        timeout: Duration::from_secs_f64(settings.timeout_s),
        under_way_at_most: settings.connections_at_most,
        first_number,
    }
}

fn judged(
    tally: &Tally,
    rate_per_s: f64,
    streams: Option<StreamPoint>,
    demands: &Demands,
) -> JudgedPoint {
    let point = Point { streams, ..tally.point(rate_per_s) };
    JudgedPoint { verdict: judge(&point, demands), point }
}

/// Rates that are still to come.
enum Ahead {
    Given(std::vec::IntoIter<f64>),
    Search(Search),
}

impl Ahead {
    fn new(rates: &Rates) -> Self {
        match rates {
            Rates::Given(rates) => Ahead::Given(rates.clone().into_iter()),
            Rates::Saturate(settings) => Ahead::Search(Search::new(*settings)),
        }
    }

    fn next_rate(&mut self) -> Option<f64> {
        match self {
            Ahead::Given(rates) => rates.next(),
            Ahead::Search(search) => search.next_rate(),
        }
    }

    fn tell(&mut self, rate_per_s: f64, verdict: Verdict) {
        if let Ahead::Search(search) = self {
            // If by chance no request was due at a low rate, this is no reason to lower the rate.
            search.tell(rate_per_s, matches!(verdict, Verdict::KeepsUp | Verdict::Idle));
        }
    }

    /// The result of a search; `None` if the rates were given.
    fn knee(&self, points: &[JudgedPoint]) -> Option<Knee> {
        let Ahead::Search(search) = self else { return None };
        let best = points.iter().map(|judged| judged.point.throughput_per_s).fold(0.0, f64::max);
        Some(Knee {
            keeps_up_to_per_s: search.knee_per_s(),
            is_bounded: search.is_bounded(),
            most_throughput_per_s: best,
        })
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use parking_lot::Mutex;

    use super::super::tally::{Answer, Outcome};
    use super::*;

    /// Draws one frame at a time, 20 ms each. Four requests may wait.
    struct OneAtATime {
        room: tokio::sync::Semaphore,
        turn: tokio::sync::Mutex<()>,
        numbers: Mutex<HashSet<u64>>,
    }

    impl Client for OneAtATime {
        async fn frame(&self, number: u64) -> Outcome {
            assert!(self.numbers.lock().insert(number), "{number} came twice");
            let place = self.room.try_acquire();
            let status = if place.is_ok() { 200 } else { 503 };
            if place.is_ok() {
                let _turn = self.turn.lock().await;
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
            Outcome::Answered(Answer {
                status,
                bytes: 1,
                has_retry_after: true,
                receipt: None,
                complaint: None,
            })
        }
    }

    fn settings(rates: Rates) -> RunSettings {
        RunSettings {
            rates,
            spacing: Spacing::Constant,
            seed: 1,
            warmup_s: 0.1,
            duration_s: 0.6,
            timeout_s: 5.0,
            connections_at_most: 100,
            demands: Demands::new(Duration::from_secs(1)),
            streams: 0,
            poses_per_s: 30.0,
        }
    }

    fn run_it(settings: &RunSettings, stop_after: usize) -> Outcomes {
        let client = Arc::new(OneAtATime {
            room: tokio::sync::Semaphore::new(5),
            turn: tokio::sync::Mutex::new(()),
            numbers: Mutex::new(HashSet::new()),
        });
        let stop = Arc::new(AtomicBool::new(false));
        let (told, mut ended) = (stop.clone(), 0);
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime
            .block_on(run(
                client,
                async |_| None,
                settings,
                stop,
                |event| {
                    ended += usize::from(matches!(event, Event::Ended(_)));
                    told.store(ended >= stop_after, Ordering::Relaxed);
                },
            ))
            .unwrap()
    }

    #[test]
    fn given_rates_are_run_in_order_with_other_numbers_each() {
        let outcomes = run_it(&settings(Rates::Given(vec![20.0, 10.0])), 9);
        let rates: Vec<f64> =
            outcomes.points.iter().map(|judged| judged.point.rate_per_s).collect();
        assert_eq!(rates, [20.0, 10.0]);
        assert!(outcomes.knee.is_none() && !outcomes.interrupted);
    }

    /// A timer that ticks in milliseconds turns 20 ms into 20 to 24 ms.
    #[test]
    fn the_knee_of_a_server_in_real_time_is_found() {
        let search = SearchSettings {
            first_per_s: 10.0,
            least_per_s: 1.0,
            most_per_s: 1000.0,
            factor: 2.0,
            resolution: 0.2,
            steps_at_most: 12,
        };
        let knee = run_it(&settings(Rates::Saturate(search)), 99).knee.unwrap();
        assert!(knee.is_bounded);
        let rate = knee.keeps_up_to_per_s.unwrap();
        assert!((30.0..=56.0).contains(&rate), "{knee:?}");
        assert!(knee.most_throughput_per_s <= 55.0, "{knee:?}");
    }

    #[test]
    fn a_run_that_is_stopped_keeps_what_it_has() {
        let outcomes = run_it(&settings(Rates::Given(vec![10.0, 20.0, 30.0])), 1);
        assert!(outcomes.interrupted);
        assert_eq!(outcomes.points.len(), 1);
    }
}
