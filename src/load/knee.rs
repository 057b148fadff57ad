//! Searches for the knee: the highest rate of requests at which the server keeps up.
//!
//! ```text
//!   first ──keeps up──► × factor ──keeps up──► … ──does not──► bisect between the last that did and the first that did not
//!     │                                                        until they are within `resolution`
//!     └──does not──► ÷ factor … ──keeps up──► bisect
//! ```
//!
//! The server keeps up with a rate when nearly all requests become frames in time, frames arrive as fast as requests are sent,
//! and streams beside the requests do as well. Rates are compared by their ratio: bisection takes the geometric mean.

use std::time::Duration;

use serde::Serialize;

use super::following::StreamPoint;
use super::tally::Point;

/// When a server counts as keeping up.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Demands {
    /// Share of the requests that must become frames, of the offered rate that throughput must reach, and of the streams' poses
    /// that some frame must follow.
    pub share: f64,
    /// Frames per pose that a stream must get. With fewer it is a slide show, however soon some frame follows each pose.
    pub stream_frames: f64,
    /// Bound on the 99th percentile of latency, counted from when a request or a pose was due.
    pub p99_at_most_ns: u64,
}

impl Demands {
    pub fn new(p99_at_most: Duration) -> Self {
        let p99_at_most_ns = u64::try_from(p99_at_most.as_nanos()).unwrap_or(u64::MAX);
        Self { share: 0.95, stream_frames: 1.0 / 3.0, p99_at_most_ns }
    }
}

/// Whether the server kept up with a rate, and if not, why.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    KeepsUp,
    /// Too few requests became frames.
    Unanswered,
    /// Frames arrive at a lower rate than requests.
    FallsBehind,
    /// The 99th percentile of latency is beyond its bound.
    Slow,
    /// Streams beside the requests were not opened, broke off, or got no frame for too many poses.
    StreamsStarve,
    /// Streams beside the requests got frames for too few of their poses.
    StreamsSkip,
    /// The 99th percentile of latency of streams is beyond its bound.
    StreamsSlow,
    /// There was no request to judge.
    Idle,
}

impl Verdict {
    pub fn words(self) -> &'static str {
        match self {
            Verdict::KeepsUp => "keeps up",
            Verdict::Unanswered => "leaves requests without a frame",
            Verdict::FallsBehind => "falls behind",
            Verdict::Slow => "slow",
            Verdict::StreamsStarve => "leaves streams without frames",
            Verdict::StreamsSkip => "shows streams too few of their poses",
            Verdict::StreamsSlow => "slow for streams",
            Verdict::Idle => "no requests",
        }
    }
}

/// Judges a step by `demands`: its requests, and its streams if it had any.
pub fn judge(point: &Point, demands: &Demands) -> Verdict {
    let of_streams = point.streams.as_ref().and_then(|streams| judge_streams(streams, demands));
    match (judge_requests(point, demands), of_streams) {
        (Verdict::KeepsUp | Verdict::Idle, Some(verdict)) => verdict,
        (verdict, _) => verdict,
    }
}

fn judge_requests(point: &Point, demands: &Demands) -> Verdict {
    let requests = point.requests as f64;
    if point.requests == 0 {
        return Verdict::Idle;
    }
    let frames = (point.counts.frames + point.counts.not_modified) as f64;
    if frames < demands.share * requests {
        return Verdict::Unanswered;
    }
    // The window counts frames that arrive in it, not frames that were due in it: frames in flight at its beginning are extra,
    // those in flight at its end are missing. Their mean number is offered rate × latency (Little 1961), and it varies by its
    // square root.
    let mean_s = point.latency.mean_ns.unwrap_or(0) as f64 * 1e-9;
    let by_chance = 1.0 + 2.0 * (point.offered_per_s * mean_s).sqrt();
    let arrived = point.throughput_per_s / point.offered_per_s * requests;
    if arrived < demands.share * requests - by_chance {
        return Verdict::FallsBehind;
    }
    match point.latency.p99_ns {
        Some(p99_ns) if p99_ns <= demands.p99_at_most_ns => Verdict::KeepsUp,
        _ => Verdict::Slow,
    }
}

/// The streams' verdict, or `None` when they keep up.
fn judge_streams(streams: &StreamPoint, demands: &Demands) -> Option<Verdict> {
    let followed = streams.poses.saturating_sub(streams.lost) as f64;
    if streams.broken > 0 || followed < demands.share * streams.poses as f64 {
        return Some(Verdict::StreamsStarve);
    }
    if (streams.frames as f64) < demands.stream_frames * streams.poses as f64 {
        return Some(Verdict::StreamsSkip);
    }
    let is_slow = streams.latency.p99_ns.is_none_or(|p99_ns| p99_ns > demands.p99_at_most_ns);
    (streams.poses > 0 && is_slow).then_some(Verdict::StreamsSlow)
}

/// Bounds and step sizes of the search.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SearchSettings {
    pub first_per_s: f64,
    pub least_per_s: f64,
    pub most_per_s: f64,
    /// Ratio of one rate to the next while the rate is raised.
    pub factor: f64,
    /// The search ends when the rates on both sides of the knee differ by no more than this share.
    pub resolution: f64,
    pub steps_at_most: u32,
}

/// Decides which rate to try next.
#[derive(Clone, Debug)]
pub struct Search {
    settings: SearchSettings,
    steps: u32,
    /// Highest rate that was kept up with so far, and lowest rate that was not.
    kept: Option<f64>,
    lost: Option<f64>,
}

impl Search {
    pub fn new(settings: SearchSettings) -> Self {
        Self { settings, steps: 0, kept: None, lost: None }
    }

    /// The next rate, or `None` when the knee is known well enough or a limit is reached.
    pub fn next_rate(&self) -> Option<f64> {
        let SearchSettings {
            first_per_s,
            least_per_s,
            most_per_s,
            factor,
            resolution,
            steps_at_most,
        } = self.settings;
        if self.steps >= steps_at_most {
            return None;
        }
        match (self.kept, self.lost) {
            (None, None) => Some(first_per_s.clamp(least_per_s, most_per_s)),
            (Some(kept), None) => (kept < most_per_s).then(|| (kept * factor).min(most_per_s)),
            (None, Some(lost)) => (lost > least_per_s).then(|| (lost / factor).max(least_per_s)),
            (Some(kept), Some(lost)) => {
                (lost / kept > 1.0 + resolution).then(|| (kept * lost).sqrt())
            }
        }
    }

    /// Records the outcome at a rate.
    pub fn tell(&mut self, rate_per_s: f64, kept_up: bool) {
        self.steps += 1;
        let side = if kept_up { &mut self.kept } else { &mut self.lost };
        *side = Some(rate_per_s);
    }

    /// The highest rate that the server kept up with.
    pub fn knee_per_s(&self) -> Option<f64> {
        self.kept
    }

    /// Whether some rate above the knee failed. Otherwise the limits ended the search.
    pub fn is_bounded(&self) -> bool {
        self.lost.is_some()
    }
}

#[cfg(test)]
mod tests {
    use std::collections::VecDeque;

    use super::super::schedule::{Schedule, Spacing};
    use super::super::tally::{Answer, Outcome, Sample, Tally};
    use super::*;

    const SETTINGS: SearchSettings = SearchSettings {
        first_per_s: 1.0,
        least_per_s: 0.1,
        most_per_s: 1e5,
        factor: 2.0,
        resolution: 0.05,
        steps_at_most: 40,
    };

    fn found(
        settings: SearchSettings,
        mut keeps_up: impl FnMut(f64) -> bool,
    ) -> (Option<f64>, u32) {
        let mut search = Search::new(settings);
        while let Some(rate) = search.next_rate() {
            search.tell(rate, keeps_up(rate));
        }
        (search.knee_per_s(), search.steps)
    }

    #[test]
    fn a_sharp_knee_is_found_wherever_it_is() {
        for knee in [0.2, 0.9, 1.0, 3.7, 100.0, 1023.0, 1025.0, 77_777.0] {
            let (rate, steps) = found(SETTINGS, |rate| rate <= knee);
            let rate = rate.unwrap();
            assert!(rate <= knee && rate * 1.05 >= knee, "{knee}: {rate}");
            assert!(steps < 25, "{knee}: {steps}");
        }
    }

    #[test]
    fn limits_end_the_search() {
        assert_eq!(found(SETTINGS, |_| true).0, Some(1e5));
        assert_eq!(found(SETTINGS, |_| false).0, None);
        let few = SearchSettings { steps_at_most: 3, ..SETTINGS };
        assert_eq!(found(few, |_| true), (Some(4.0), 3));
    }

    /// A server that draws one frame at a time in `service` and refuses when `queue` requests are waiting.
    fn simulated(
        rate_per_s: f64,
        service: Duration,
        queue: usize,
        timeout: Duration,
        seed: u64,
    ) -> Point {
        let (warmup, length) = (Duration::from_secs(2), Duration::from_secs(20));
        let mut tally = Tally::new(warmup, length);
        let mut free = Duration::ZERO;
        let mut under_way: VecDeque<Duration> = VecDeque::new();
        for due in Schedule::new(rate_per_s, Spacing::Poisson, seed) {
            if due >= warmup + length {
                break;
            }
            while under_way.front().is_some_and(|done| *done <= due) {
                under_way.pop_front();
            }
            let status = if under_way.len() > queue { 503 } else { 200 };
            let mut done = due;
            if status == 200 {
                free = free.max(due) + service;
                done = free;
                under_way.push_back(done);
            }
            let outcome = if done - due > timeout {
                Outcome::TimedOut
            } else {
                Outcome::Answered(Answer {
                    status,
                    bytes: 1,
                    has_retry_after: true,
                    receipt: None,
                    complaint: None,
                })
            };
            tally.record(Sample { due, begun: due, done, outcome });
        }
        tally.point(rate_per_s)
    }

    /// The capacity is 200/s. With a queue that refuses and with one that grows, the knee lies a little below it, where the queue
    /// of a random arrival process is still short.
    #[test]
    fn the_knee_of_a_simulated_server_is_its_capacity() {
        let service = Duration::from_millis(5);
        for queue in [16, usize::MAX] {
            for seed in 0..5 {
                let demands = Demands::new(Duration::from_millis(250));
                let (mut search, mut seen) = (Search::new(SETTINGS), Vec::new());
                while let Some(rate) = search.next_rate() {
                    let point = simulated(rate, service, queue, Duration::from_secs(10), seed);
                    let verdict = judge(&point, &demands);
                    search.tell(rate, verdict == Verdict::KeepsUp);
                    seen.push((rate, point.throughput_per_s, verdict));
                }
                let knee = search.knee_per_s().unwrap();
                assert!((160.0..=215.0).contains(&knee), "{queue} {seed}: {knee} {seen:?}");
                assert!(seen.iter().all(|(_, throughput, _)| *throughput < 201.0), "{seen:?}");
            }
        }
    }

    #[test]
    fn streams_are_judged_beside_requests() {
        use super::super::following::{Following, StreamTally};
        use super::super::wire::FrameAnswer;
        let demands = Demands::new(Duration::from_millis(250));
        let service = Duration::from_millis(5);
        let mut point = simulated(50.0, service, 16, Duration::from_secs(10), 1);
        assert_eq!(judge(&point, &demands), Verdict::KeepsUp);
        // A stream of 100 poses: every `every`th of the first `followed` gets a frame, `took_ms` after it was due.
        let streams = |followed: u64, every: u64, took_ms: u64, broken: bool| {
            let mut tally = StreamTally::new(1, Duration::ZERO, Duration::from_secs(10));
            let mut following = Following::default();
            for seq in 1..=100 {
                let due = Duration::from_millis(seq * 30);
                following.due(seq, due);
                if seq <= followed && seq % every == 0 {
                    let frame = FrameAnswer::of(seq, "moving");
                    let at = due + Duration::from_millis(took_ms);
                    tally.frame(&mut following, &frame, 1000, at);
                }
            }
            if broken {
                tally.broken("closed".to_owned());
            }
            tally.ended(&following);
            Some(tally.point())
        };
        for (followed, every, took_ms, broken, verdict) in [
            (100, 1, 30, false, Verdict::KeepsUp),
            (100, 2, 30, false, Verdict::KeepsUp),
            (100, 5, 30, false, Verdict::StreamsSkip),
            (100, 1, 30, true, Verdict::StreamsStarve),
            (90, 1, 30, false, Verdict::StreamsStarve),
            (0, 1, 30, false, Verdict::StreamsStarve),
            (100, 1, 300, false, Verdict::StreamsSlow),
        ] {
            point.streams = streams(followed, every, took_ms, broken);
            let what = format!("{followed} {every} {took_ms} {broken}");
            assert_eq!(judge(&point, &demands), verdict, "{what}");
        }
        let mut idle = simulated(1e-9, service, 1, service, 1);
        idle.streams = streams(0, 1, 0, true);
        assert_eq!(judge(&idle, &demands), Verdict::StreamsStarve, "streams alone");
    }

    /// At 2.5 requests per second, a throughput of 87 % still counts as falling behind.
    #[test]
    fn few_requests_are_no_excuse() {
        let demands = Demands::new(Duration::from_secs(1));
        let mut point = simulated(2.5, Duration::from_millis(5), 16, Duration::from_secs(1), 1);
        assert_eq!(judge(&point, &demands), Verdict::KeepsUp);
        point.throughput_per_s *= 0.87;
        assert_eq!(judge(&point, &demands), Verdict::FallsBehind);
    }

    #[test]
    fn overload_shows_as_what_it_is() {
        let demands = Demands::new(Duration::from_secs(1));
        let service = Duration::from_millis(5);
        let refusing = simulated(400.0, service, 8, Duration::from_secs(10), 1);
        assert_eq!(judge(&refusing, &demands), Verdict::Unanswered);
        assert!((refusing.throughput_per_s - 200.0).abs() < 2.0);
        let patient = simulated(400.0, service, usize::MAX, Duration::from_secs(100), 1);
        assert_eq!(patient.counts.frames, patient.requests);
        assert_eq!(judge(&patient, &demands), Verdict::FallsBehind);
        let slow =
            simulated(20.0, Duration::from_millis(45), usize::MAX, Duration::from_secs(10), 1);
        assert_eq!(judge(&slow, &Demands::new(Duration::from_millis(100))), Verdict::Slow);
        let lost = simulated(400.0, service, usize::MAX, Duration::from_millis(300), 1);
        assert_eq!(judge(&lost, &demands), Verdict::Unanswered);
        assert_eq!(lost.latency.p99_ns, None);
        assert_eq!(judge(&simulated(1e-9, service, 1, service, 1), &demands), Verdict::Idle);
    }
}
