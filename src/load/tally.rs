//! Adds up how the requests of a step ended.
//!
//! A request's latency runs from when it was *due*, not from when it was sent. A server that stalls delays the requests that were
//! due meanwhile, and a generator that waits for the server would leave out exactly these (coordinated omission). Requests
//! without any answer (timed out, broken off, not sent because too many were in flight) lie above every percentile. Refusals are
//! counted, but they are not frames: their short latency is left out.
//!
//! ```text
//!            │ warm-up │            window              │ drain
//!  due         o   o     x    x   x      x    x      x          o not counted, x counted
//!  done           f   f    f   f      f     f   f  f   | f f    f frames before the bar are throughput
//! ```
//!
//! Throughput counts frames that *arrive* within the window, whenever they were due. What arrives in the drain after it is a
//! backlog; if it were counted, an overloaded server would seem to keep up with any rate.

use std::collections::BTreeMap;
use std::time::Duration;

use serde::Serialize;

use super::following::StreamPoint;
use super::histogram::Histogram;
use super::wire::ReceiptAnswer;

/// An answer that was read to its end.
#[derive(Clone, Debug)]
pub struct Answer {
    pub status: u16,
    /// Length of the body.
    pub bytes: u64,
    /// Whether the answer has a `Retry-After` header.
    pub has_retry_after: bool,
    pub receipt: Option<ReceiptAnswer>,
    /// The message of an answer that is neither a frame nor a refusal.
    pub complaint: Option<String>,
}

/// How a request ended.
#[derive(Clone, Debug)]
pub enum Outcome {
    Answered(Answer),
    /// Given up when the request's timeout was over.
    TimedOut,
    /// No connection could be opened.
    NotConnected(String),
    /// The connection ended before the answer did.
    BrokenOff(String),
    /// Not sent, because the limit of requests in flight was reached.
    NotSent,
}

/// A request, with times since the step began.
#[derive(Clone, Debug)]
pub struct Sample {
    pub due: Duration,
    /// When the generator began with it, at `due` or later.
    pub begun: Duration,
    pub done: Duration,
    pub outcome: Outcome,
}

/// Requests that were due within the window, by outcome.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Counts {
    /// Statuses 200 to 299.
    pub frames: u64,
    /// Status 304. The generator sends no conditional requests, so that there should be none.
    pub not_modified: u64,
    /// Statuses 429 and 503, and how many of these answers have a `Retry-After` header.
    pub refused: u64,
    pub refused_with_retry_after: u64,
    /// Any other status.
    pub failed: u64,
    pub timed_out: u64,
    pub not_connected: u64,
    pub broken_off: u64,
    pub not_sent: u64,
}

impl Counts {
    /// Requests without any answer.
    pub fn lost(&self) -> u64 {
        self.timed_out + self.not_connected + self.broken_off + self.not_sent
    }

    pub fn all(&self) -> u64 {
        self.frames + self.not_modified + self.refused + self.failed + self.lost()
    }
}

/// Percentiles by nearest rank, in nanoseconds. `null` where a percentile falls among requests that were never answered.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Percentiles {
    /// Number of answered requests, and of those that count as endless.
    pub answered: u64,
    pub endless: u64,
    /// Mean of the answered requests.
    pub mean_ns: Option<u64>,
    pub p50_ns: Option<u64>,
    pub p90_ns: Option<u64>,
    pub p95_ns: Option<u64>,
    pub p99_ns: Option<u64>,
    pub p99_9_ns: Option<u64>,
    pub max_ns: Option<u64>,
}

impl Percentiles {
    pub fn of(histogram: &Histogram, endless: u64) -> Self {
        let at = |share| histogram.quantile_with_endless(share, endless);
        Self {
            answered: histogram.count(),
            endless,
            mean_ns: histogram.mean().map(|ns| ns as u64),
            p50_ns: at(0.5),
            p90_ns: at(0.9),
            p95_ns: at(0.95),
            p99_ns: at(0.99),
            p99_9_ns: at(0.999),
            max_ns: if endless == 0 { histogram.max() } else { None },
        }
    }
}

/// Totals of the frames' receipts.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Receipts {
    /// Frames that came with a receipt.
    pub read: u64,
    /// Frames that an identical request had drawn. Not 0 only if another client asks for the same poses.
    pub coalesced: u64,
    /// GPU time per frame: the passes' time divided by the number of frames that they drew. `null` where the adapter cannot
    /// measure it.
    pub gpu_p50_ns: Option<u64>,
    pub gpu_p99_ns: Option<u64>,
    pub queue_p50_ns: Option<u64>,
    pub queue_p99_ns: Option<u64>,
    pub encode_p50_ns: Option<u64>,
    /// Frames per submission, and views per dispatch of passes.
    pub batch_size_mean: Option<f64>,
    pub batch_size_max: Option<u64>,
    pub views_mean: Option<f64>,
    pub views_max: Option<u64>,
}

/// One step as a point of the saturation curve: a rate, and what was measured at it.
#[derive(Clone, Debug, Serialize)]
pub struct Point {
    /// The requested rate. The rate that was offered differs from it by chance.
    pub rate_per_s: f64,
    pub requests: u64,
    pub offered_per_s: f64,
    pub throughput_per_s: f64,
    /// Latency of frames, from when a request was due to the end of its answer.
    pub latency: Percentiles,
    /// Latency counted from when the generator began with a request: what a measurement without the schedule would show.
    pub service: Percentiles,
    /// How late the generator began with its requests.
    pub begun_late_p99_ns: Option<u64>,
    pub begun_late_max_ns: Option<u64>,
    pub counts: Counts,
    /// Number of answers by status.
    pub statuses: BTreeMap<u16, u64>,
    pub bytes: u64,
    pub bytes_per_s: f64,
    pub receipts: Receipts,
    /// Message of the first failure.
    pub first_failure: Option<String>,
    /// Frames of the streams beside the requests; `null` where there are none.
    pub streams: Option<StreamPoint>,
}

/// Adds up the samples of a step.
#[derive(Clone, Debug)]
pub struct Tally {
    from: Duration,
    to: Duration,
    counts: Counts,
    statuses: BTreeMap<u16, u64>,
    latency: Histogram,
    service: Histogram,
    begun_late: Histogram,
    arrived: u64,
    bytes: u64,
    coalesced: u64,
    gpu: Histogram,
    queue: Histogram,
    encode: Histogram,
    batch_size: Histogram,
    views: Histogram,
    first_failure: Option<String>,
    adapter: Option<String>,
    settings: serde_json::Value,
}

pub fn ns(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}

impl Tally {
    /// Counts what is due from `warmup` on, for a time of `length`.
    pub fn new(warmup: Duration, length: Duration) -> Self {
        Self {
            from: warmup,
            to: warmup + length,
            counts: Counts::default(),
            statuses: BTreeMap::new(),
            latency: Histogram::default(),
            service: Histogram::default(),
            begun_late: Histogram::default(),
            arrived: 0,
            bytes: 0,
            coalesced: 0,
            gpu: Histogram::default(),
            queue: Histogram::default(),
            encode: Histogram::default(),
            batch_size: Histogram::default(),
            views: Histogram::default(),
            first_failure: None,
            adapter: None,
            settings: serde_json::Value::Null,
        }
    }

    pub fn record(&mut self, sample: Sample) {
        let within = |time: Duration| self.from <= time && time < self.to;
        let is_frame =
            matches!(&sample.outcome, Outcome::Answered(answer) if is_frame(answer.status));
        if is_frame && within(sample.done) {
            self.arrived += 1;
        }
        if !within(sample.due) {
            return;
        }
        if !matches!(sample.outcome, Outcome::NotSent) {
            self.begun_late.record(ns(sample.begun.saturating_sub(sample.due)));
        }
        match sample.outcome {
            Outcome::Answered(answer) => {
                if is_frame {
                    self.latency.record(ns(sample.done.saturating_sub(sample.due)));
                    self.service.record(ns(sample.done.saturating_sub(sample.begun)));
                }
                self.answered(answer);
            }
            Outcome::TimedOut => self.counts.timed_out += 1,
            Outcome::NotSent => self.counts.not_sent += 1,
            Outcome::NotConnected(why) => {
                self.counts.not_connected += 1;
                self.first_failure.get_or_insert(why);
            }
            Outcome::BrokenOff(why) => {
                self.counts.broken_off += 1;
                self.first_failure.get_or_insert(why);
            }
        }
    }

    fn answered(&mut self, answer: Answer) {
        let Answer { status, bytes, has_retry_after, receipt, complaint } = answer;
        *self.statuses.entry(status).or_default() += 1;
        self.bytes += bytes;
        match status {
            200..=299 => self.counts.frames += 1,
            304 => self.counts.not_modified += 1,
            429 | 503 => {
                self.counts.refused += 1;
                self.counts.refused_with_retry_after += u64::from(has_retry_after);
            }
            _ => {
                self.counts.failed += 1;
                if let Some(complaint) = complaint {
                    self.first_failure.get_or_insert(complaint);
                }
            }
        }
        let Some(receipt) = receipt else { return };
        self.coalesced += u64::from(receipt.coalesced);
        if let Some(gpu_ns) = receipt.gpu_ns {
            self.gpu.record(gpu_ns / u64::from(receipt.views.max(1)));
        }
        self.queue.record(receipt.queue_ns);
        self.encode.record(receipt.encode_ns);
        self.batch_size.record(receipt.batch_size.into());
        self.views.record(receipt.views.into());
        if self.adapter.is_none() {
            self.adapter = Some(receipt.adapter);
            self.settings = receipt.settings;
        }
    }

    /// The adapter and the settings in the first receipt.
    pub fn first_receipt(&self) -> (Option<String>, serde_json::Value) {
        (self.adapter.clone(), self.settings.clone())
    }

    /// The step as a point of the curve.
    pub fn point(&self, rate_per_s: f64) -> Point {
        let seconds = (self.to - self.from).as_secs_f64().max(1e-9);
        let requests = self.counts.all();
        let lost = self.counts.lost();
        Point {
            rate_per_s,
            requests,
            offered_per_s: requests as f64 / seconds,
            throughput_per_s: self.arrived as f64 / seconds,
            latency: Percentiles::of(&self.latency, lost),
            service: Percentiles::of(&self.service, lost),
            begun_late_p99_ns: self.begun_late.quantile(0.99),
            begun_late_max_ns: self.begun_late.max(),
            counts: self.counts.clone(),
            statuses: self.statuses.clone(),
            bytes: self.bytes,
            bytes_per_s: self.bytes as f64 / seconds,
            receipts: Receipts {
                read: self.queue.count(),
                coalesced: self.coalesced,
                gpu_p50_ns: self.gpu.quantile(0.5),
                gpu_p99_ns: self.gpu.quantile(0.99),
                queue_p50_ns: self.queue.quantile(0.5),
                queue_p99_ns: self.queue.quantile(0.99),
                encode_p50_ns: self.encode.quantile(0.5),
                batch_size_mean: self.batch_size.mean(),
                batch_size_max: self.batch_size.max(),
                views_mean: self.views.mean(),
                views_max: self.views.max(),
            },
            first_failure: self.first_failure.clone(),
            streams: None,
        }
    }
}

fn is_frame(status: u16) -> bool {
    (200..300).contains(&status) || status == 304
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    fn answer(status: u16) -> Outcome {
        Outcome::Answered(Answer {
            status,
            bytes: 100,
            has_retry_after: status == 503,
            receipt: None,
            complaint: Some(format!("{status}: no")),
        })
    }

    fn sample(due_ms: u32, begun_ms: u32, done_ms: u32, outcome: Outcome) -> Sample {
        Sample { due: MS * due_ms, begun: MS * begun_ms, done: MS * done_ms, outcome }
    }

    #[test]
    fn latency_counts_from_when_a_request_was_due() {
        let mut tally = Tally::new(Duration::ZERO, MS * 1000);
        tally.record(sample(100, 400, 410, answer(200)));
        let point = tally.point(1.0);
        let near = |found: Option<u64>, ms: u64| {
            assert!(found.unwrap().abs_diff(ms * 1_000_000) <= ms * 4_000, "{found:?} {ms} ms");
        };
        near(point.latency.max_ns, 310);
        near(point.service.max_ns, 10);
        near(point.begun_late_max_ns, 300);
    }

    #[test]
    fn the_window_leaves_out_warm_up_and_backlog() {
        let mut tally = Tally::new(MS * 100, MS * 1000);
        tally.record(sample(50, 50, 150, answer(200))); // due before the window, arrives within it
        tally.record(sample(60, 60, 90, answer(200))); // entirely before the window
        tally.record(sample(200, 200, 210, answer(200)));
        tally.record(sample(1000, 1000, 1500, answer(200))); // due within the window, arrives after it
        tally.record(sample(1100, 1100, 1110, answer(200))); // due after the window
        let point = tally.point(2.0);
        assert_eq!((point.requests, point.counts.frames), (2, 2));
        assert_eq!((point.throughput_per_s, point.offered_per_s), (2.0, 2.0));
        assert_eq!(point.latency.answered, 2);
        assert_eq!(point.bytes, 200);
    }

    #[test]
    fn every_ending_is_counted_as_what_it_is() {
        let mut tally = Tally::new(Duration::ZERO, MS * 1000);
        for status in [200, 204, 304, 429, 503, 503, 404, 500] {
            tally.record(sample(1, 1, 9, answer(status)));
        }
        for outcome in [
            Outcome::TimedOut,
            Outcome::NotConnected("refused".into()),
            Outcome::BrokenOff("reset".into()),
            Outcome::NotSent,
        ] {
            tally.record(sample(1, 1, 9, outcome));
        }
        let point = tally.point(12.0);
        let expected = Counts {
            frames: 2,
            not_modified: 1,
            refused: 3,
            refused_with_retry_after: 2,
            failed: 2,
            timed_out: 1,
            not_connected: 1,
            broken_off: 1,
            not_sent: 1,
        };
        assert_eq!((&point.counts, point.requests), (&expected, 12));
        assert_eq!(point.statuses[&503], 2);
        assert_eq!(point.first_failure.as_deref(), Some("404: no"));
        assert_eq!(point.throughput_per_s, 3.0);
        // With three answers and four requests without an answer there is no median.
        assert_eq!((point.latency.answered, point.latency.endless), (3, 4));
        assert_eq!((point.latency.p50_ns, point.latency.max_ns), (None, None));
        assert!(point.latency.mean_ns.is_some());
    }

    #[test]
    fn receipts_share_the_time_of_their_passes() {
        let mut tally = Tally::new(Duration::ZERO, MS * 1000);
        for views in [1, 4] {
            let receipt = ReceiptAnswer {
                adapter: "a".into(),
                gpu_ns: Some(200),
                queue_ns: 7,
                encode_ns: 5,
                batch_size: views,
                views,
                coalesced: views == 4,
                settings: serde_json::Value::Null,
            };
            let Outcome::Answered(mut answer) = answer(200) else { unreachable!() };
            answer.receipt = Some(receipt);
            tally.record(sample(1, 1, 2, Outcome::Answered(answer)));
        }
        let receipts = tally.point(1.0).receipts;
        assert_eq!((receipts.gpu_p50_ns, receipts.gpu_p99_ns), (Some(50), Some(200)));
        assert_eq!((receipts.read, receipts.coalesced, receipts.views_max), (2, 1, Some(4)));
        assert_eq!(receipts.batch_size_mean, Some(2.5));
    }
}
