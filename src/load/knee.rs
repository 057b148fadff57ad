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
mod tests;
