//! Adds up the poses that were sent to streams, and the frames that came back.
//!
//! On a stream the newest pose wins: the server never draws many of the poses, and skipping them is not lateness. In place of an
//! overtaken pose the user sees the frame of a newer one. A pose's latency therefore runs from when it was *due* to the arrival
//! of the first frame that shows it or a later pose. If the server stalls, every pose that was due meanwhile waits, drawn or not,
//! and none is left out (coordinated omission). A pose that no frame followed before the end counts as endless.
//!
//! ```text
//!  due      1    2    3    4    5
//!  frames        1         4    │          latency of 2 and 3 ends with the frame of 4: they were overtaken
//! ```

use std::collections::VecDeque;
use std::time::Duration;

use serde::Serialize;

use super::histogram::Histogram;
use super::tally::{Percentiles, ns};
use super::wire::FrameAnswer;

/// Results of the streams that ran beside the requests of a step.
#[derive(Clone, Debug, Serialize)]
pub struct StreamPoint {
    pub streams: usize,
    /// Poses that were due, summed over all streams.
    pub poses: u64,
    pub poses_per_s: f64,
    /// Poses that were never drawn because a newer one overtook them.
    pub overtaken: u64,
    /// Poses after which no frame came at all.
    pub lost: u64,
    /// Frames that arrived, including still ones.
    pub frames: u64,
    pub frames_per_s: f64,
    pub still: u64,
    /// Frames of the stream that got the fewest, and of the one that got the most.
    pub least_frames: u64,
    pub most_frames: u64,
    /// Time from when a pose was due to the first frame that shows it or a newer one.
    pub latency: Percentiles,
    /// Latency of the poses that were drawn themselves.
    pub drawn: Percentiles,
    /// How late the generator sent its poses.
    pub sent_late_p99_ns: Option<u64>,
    pub bytes: u64,
    pub bytes_per_s: f64,
    /// Mean width of the frames as a share of the requested width, then medians of GPU time and of the wait in the engine's
    /// queue.
    pub scale_mean: Option<f64>,
    pub gpu_p50_ns: Option<u64>,
    pub queue_p50_ns: Option<u64>,
    /// Streams that could not be opened, or were closed early.
    pub broken: u64,
    /// Problems that the server reported.
    pub problems: u64,
    pub first_failure: Option<String>,
}

/// The poses of one stream that no frame has followed yet.
#[derive(Clone, Debug, Default)]
pub struct Following {
    waiting: VecDeque<(u64, Duration)>,
    frames: u64,
}

impl Following {
    /// Adds a pose that is due. Numbers increase.
    pub fn due(&mut self, seq: u64, due: Duration) {
        self.waiting.push_back((seq, due));
    }

    /// Whether a frame has followed every pose.
    pub fn is_through(&self) -> bool {
        self.waiting.is_empty()
    }
}

/// Adds up the streams of a step.
#[derive(Clone, Debug)]
pub struct StreamTally {
    from: Duration,
    to: Duration,
    streams: usize,
    overtaken: u64,
    lost: u64,
    frames: u64,
    still: u64,
    least_and_most: Option<(u64, u64)>,
    latency: Histogram,
    drawn: Histogram,
    sent_late: Histogram,
    bytes: u64,
    scale_sum: f64,
    gpu: Histogram,
    queue: Histogram,
    broken: u64,
    problems: u64,
    first_failure: Option<String>,
}

impl StreamTally {
    /// Counts what is due from `warmup` on, for a time of `length`.
    pub fn new(streams: usize, warmup: Duration, length: Duration) -> Self {
        Self {
            from: warmup,
            to: warmup + length,
            streams,
            overtaken: 0,
            lost: 0,
            frames: 0,
            still: 0,
            least_and_most: None,
            latency: Histogram::default(),
            drawn: Histogram::default(),
            sent_late: Histogram::default(),
            bytes: 0,
            scale_sum: 0.0,
            gpu: Histogram::default(),
            queue: Histogram::default(),
            broken: 0,
            problems: 0,
            first_failure: None,
        }
    }

    fn counts(&self, time: Duration) -> bool {
        self.from <= time && time < self.to
    }

    /// Records how late a pose was sent.
    pub fn sent(&mut self, due: Duration, sent: Duration) {
        if self.counts(due) {
            self.sent_late.record(ns(sent.saturating_sub(due)));
        }
    }

    /// Records a frame, which ends the wait of its pose and of all earlier ones.
    pub fn frame(&mut self, of: &mut Following, frame: &FrameAnswer, bytes: u64, at: Duration) {
        while let Some((seq, due)) =
            of.waiting.front().copied().filter(|(seq, _)| *seq <= frame.seq)
        {
            of.waiting.pop_front();
            if !self.counts(due) {
                continue;
            }
            let took_ns = ns(at.saturating_sub(due));
            self.latency.record(took_ns);
            if seq == frame.seq {
                self.drawn.record(took_ns);
            } else {
                self.overtaken += 1;
            }
        }
        if !self.counts(at) {
            return;
        }
        of.frames += 1;
        self.frames += 1;
        self.still += u64::from(frame.quality == "still");
        self.bytes += bytes;
        self.scale_sum += frame.scale;
        let receipt = &frame.receipt;
        self.queue.record(receipt.queue_ns);
        if let Some(gpu_ns) = receipt.gpu_ns {
            self.gpu.record(gpu_ns / u64::from(receipt.views.max(1)));
        }
    }

    /// Records a problem that the server reported.
    pub fn problem(&mut self, why: String) {
        self.problems += 1;
        self.first_failure.get_or_insert(why);
    }

    /// Records a stream that could not be opened or was closed early.
    pub fn broken(&mut self, why: String) {
        self.broken += 1;
        self.first_failure.get_or_insert(why);
    }

    /// Ends a stream: poses that still wait are lost.
    pub fn ended(&mut self, of: &Following) {
        let lost = of.waiting.iter().filter(|(_, due)| self.counts(*due)).count();
        self.lost += lost as u64;
        let (least, most) = self.least_and_most.unwrap_or((u64::MAX, 0));
        self.least_and_most = Some((least.min(of.frames), most.max(of.frames)));
    }

    /// The totals of the step.
    pub fn point(&self) -> StreamPoint {
        let seconds = (self.to - self.from).as_secs_f64().max(1e-9);
        let poses = self.latency.count() + self.lost;
        let (least_frames, most_frames) = self.least_and_most.unwrap_or((0, 0));
        StreamPoint {
            streams: self.streams,
            poses,
            poses_per_s: poses as f64 / seconds,
            overtaken: self.overtaken,
            lost: self.lost,
            frames: self.frames,
            frames_per_s: self.frames as f64 / seconds,
            still: self.still,
            least_frames,
            most_frames,
            latency: Percentiles::of(&self.latency, self.lost),
            drawn: Percentiles::of(&self.drawn, 0),
            sent_late_p99_ns: self.sent_late.quantile(0.99),
            bytes: self.bytes,
            bytes_per_s: self.bytes as f64 / seconds,
            scale_mean: (self.frames > 0).then(|| self.scale_sum / self.frames as f64),
            gpu_p50_ns: self.gpu.quantile(0.5),
            queue_p50_ns: self.queue.quantile(0.5),
            broken: self.broken,
            problems: self.problems,
            first_failure: self.first_failure.clone(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    fn frame(seq: u64, quality: &str) -> FrameAnswer {
        FrameAnswer::of(seq, quality)
    }

    fn near(found: Option<u64>, ms: u64) {
        assert!(found.unwrap().abs_diff(ms * 1_000_000) <= ms * 4_000, "{found:?}: {ms} ms");
    }

    #[test]
    fn an_overtaken_pose_waits_for_the_one_that_overtook_it() {
        let mut tally = StreamTally::new(1, Duration::ZERO, MS * 1000);
        let mut stream = Following::default();
        for seq in 1..=5 {
            stream.due(seq, MS * 100 * seq as u32);
        }
        tally.frame(&mut stream, &frame(1, "moving"), 10, MS * 120);
        tally.frame(&mut stream, &frame(4, "moving"), 10, MS * 450);
        // The still frame of the same pose.
        tally.frame(&mut stream, &frame(4, "still"), 10, MS * 470);
        assert!(!stream.is_through());
        tally.ended(&stream);
        let point = tally.point();
        assert_eq!((point.poses, point.overtaken, point.lost), (5, 2, 1));
        assert_eq!((point.frames, point.still, point.bytes), (3, 1, 30));
        assert_eq!((point.latency.answered, point.latency.endless), (4, 1));
        // Latencies of 20, 50, 150 and 250 ms, and one pose without a frame.
        near(point.latency.p50_ns, 150);
        assert_eq!(point.latency.p90_ns, None);
        near(point.drawn.max_ns, 50);
        assert_eq!((point.least_frames, point.most_frames), (3, 3));
        assert_eq!((point.gpu_p50_ns, point.scale_mean), (Some(400), Some(0.5)));
    }

    /// A server stalls for a second and then draws one of the poses: all poses that were due meanwhile have waited.
    #[test]
    fn a_stall_keeps_every_pose_waiting() {
        let mut tally = StreamTally::new(1, Duration::ZERO, MS * 2000);
        let mut stream = Following::default();
        for seq in 0..100 {
            stream.due(seq, MS * 10 * seq as u32);
        }
        tally.frame(&mut stream, &frame(99, "moving"), 1, MS * 1000);
        let point = tally.point();
        assert_eq!((point.overtaken, point.latency.answered), (99, 100));
        near(point.latency.p50_ns, 500);
        near(point.latency.p99_ns, 990);
        near(point.drawn.p50_ns, 10);
    }

    #[test]
    fn the_window_is_that_of_requests() {
        let mut tally = StreamTally::new(2, MS * 100, MS * 100);
        let (mut a, mut b) = (Following::default(), Following::default());
        a.due(1, MS * 50);
        a.due(2, MS * 150);
        a.due(3, MS * 250);
        tally.frame(&mut a, &frame(2, "moving"), 1, MS * 160);
        tally.frame(&mut a, &frame(3, "moving"), 1, MS * 260);
        b.due(1, MS * 199);
        tally.ended(&a);
        tally.ended(&b);
        let point = tally.point();
        assert_eq!((point.poses, point.frames, point.lost, point.overtaken), (2, 1, 1, 0));
        assert_eq!((point.least_frames, point.most_frames), (0, 1));
    }
}
