//! `/metrics`: the server's own counters, histograms of the stages that the engine reports for every frame, and the engine's
//! counters, read at scrape time.

use std::fmt;
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::http::Method;
use prometheus_client::collector::Collector;
use prometheus_client::encoding::{
    DescriptorEncoder, EncodeLabelSet, EncodeMetric, text as exposition,
};
use prometheus_client::metrics::counter::{ConstCounter, Counter};
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::{ConstGauge, Gauge};
use prometheus_client::metrics::histogram::{Histogram, exponential_buckets};
use prometheus_client::registry::{Metric, Registry, Unit};

use super::limits::Limits;
use super::{Edge, Phase};
use crate::engine::{Class, EncodedFrame, Engine, Observer, Readiness, Receipt};
use crate::jobs::Jobs;
use crate::memory;

/// Content type of the exposition.
pub const OPENMETRICS: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct RequestLabels {
    route: &'static str,
    method: &'static str,
    status: u16,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct ClassLabel {
    class: &'static str,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct PhaseLabel {
    phase: &'static str,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct PassLabel {
    pass: &'static str,
}

/// A family of histograms by label.
type Histograms<L> = Family<L, Histogram, fn() -> Histogram>;

/// A registry that returns each metric as it is registered.
struct Shelf(Registry);

impl Shelf {
    /// Registers a metric and returns it.
    fn put<M: Metric + Clone>(&mut self, name: &str, help: &str, metric: M) -> M {
        self.0.register(name, help, metric.clone());
        metric
    }

    fn bytes(&mut self, name: &str, help: &str) -> Counter {
        let counter = Counter::default();
        self.0.register_with_unit(name, help, Unit::Bytes, counter.clone());
        counter
    }

    fn seconds<M: Metric + Clone>(&mut self, name: &str, help: &str, metric: M) -> M {
        self.0.register_with_unit(name, help, Unit::Seconds, metric.clone());
        metric
    }
}

/// Buckets from 0.1 ms to about 26 s.
fn seconds_histogram() -> Histogram {
    Histogram::new(exponential_buckets(1e-4, 2.0, 19))
}

fn by_label<L: Clone + Eq + std::hash::Hash>() -> Histograms<L> {
    Family::new_with_constructor(seconds_histogram)
}

/// Durations of each stage of a frame, as reported by the engine.
struct Stages {
    limits: Arc<Limits>,
    queue: Histograms<ClassLabel>,
    batch: Histogram,
    passes: Histograms<PassLabel>,
    gpu: Histograms<ClassLabel>,
    device_wait: Histogram,
    readback: Histogram,
    encode: Histogram,
    total: Histograms<ClassLabel>,
}

impl Stages {
    fn new(shelf: &mut Shelf, limits: Arc<Limits>) -> Self {
        let sizes = Histogram::new(exponential_buckets(1.0, 2.0, 7));
        Self {
            limits,
            queue: shelf.seconds("frame_queue", "A frame's wait for the GPU, by class", by_label()),
            batch: shelf.put("batch_frames", "Frames of a submission to the GPU", sizes),
            passes: shelf.seconds(
                "frame_pass",
                "GPU time of a pass per frame; frames drawn together share the time equally",
                by_label(),
            ),
            gpu: shelf.seconds(
                "frame_gpu",
                "GPU time of all passes per frame, by class; frames drawn together share the time equally",
                by_label(),
            ),
            device_wait: shelf.seconds(
                "frame_device_wait",
                "Time from submission until the GPU has finished earlier submissions",
                seconds_histogram(),
            ),
            readback: shelf.seconds(
                "frame_readback",
                "Time from the end of earlier submissions until the frame is in memory, without the GPU time",
                seconds_histogram(),
            ),
            encode: shelf.seconds("frame_encode", "Encoding time of a frame", seconds_histogram()),
            total: shelf.seconds(
                "frame_total",
                "Time from a frame's request to its encoded image, by class",
                by_label(),
            ),
        }
    }
}

impl Observer for Stages {
    fn batch(&self, frames: usize) {
        self.batch.observe(frames as f64);
    }

    fn spent(&self, caller: u64, device: Duration) {
        self.limits.charge(caller, device, Instant::now());
    }

    fn frame(&self, class: Class, receipt: &Receipt) {
        let class = ClassLabel { class: class.name() };
        self.queue.get_or_create(&class).observe(seconds_of(receipt.queue_ns));
        self.total.get_or_create(&class).observe(seconds_of(receipt.total_ns));
        self.device_wait.observe(seconds_of(receipt.device_wait_ns));
        self.readback.observe(seconds_of(receipt.readback_ns));
        self.encode.observe(seconds_of(receipt.encode_ns));
        if let Some(share_ns) = receipt.gpu_share_ns() {
            self.gpu.get_or_create(&class).observe(seconds_of(share_ns));
        }
        for pass in receipt.passes.iter().filter(|pass| pass.ran) {
            let Some(gpu_ns) = pass.gpu_ns else { continue };
            let share_ns = gpu_ns / u64::from(receipt.views.max(1));
            self.passes.get_or_create(&PassLabel { pass: pass.name }).observe(seconds_of(share_ns));
        }
    }
}

/// The server's own counters, with their registry.
pub struct Metrics {
    shelf: Shelf,
    requests: Family<RequestLabels, Counter>,
    phases: Family<PhaseLabel, Gauge>,
    pub not_modified: Counter,
    pub frames_sent: Counter,
    pub streams_open: Gauge,
    pub stream_frames: Counter,
    pub poses_overtaken: Counter,
    image_bytes: Counter,
    upload_bytes: Counter,
}

impl Metrics {
    /// Registers the metrics and observes the engine from now on. `limits` charges keys for their GPU time.
    pub fn new(engine: &Engine, jobs: Option<&Jobs>, limits: Arc<Limits>, edge: &Edge) -> Self {
        let mut shelf = Shelf(Registry::with_prefix("pointillist"));
        let requests = Family::default();
        let requests = shelf.put("http_requests", "Answers by route, method and status", requests);
        let help =
            "1 for the server's phase (loading, serving, leaving or draining), 0 for the others";
        let phases = shelf.put("phase", help, Family::default());
        let mut counter = |name, help| shelf.put(name, help, Counter::default());
        let not_modified = counter("not_modified", "Frames answered 304 without rendering");
        let frames_sent = counter("frames_sent", "Frames sent, coalesced ones included");
        let stream_frames =
            counter("stream_frames", "Frames sent on streams, included in the frames sent");
        let poses_overtaken = counter(
            "stream_poses_overtaken",
            "Poses of streams skipped because a newer pose had arrived",
        );
        let streams_open = shelf.put("streams_open", "Streams open", Gauge::default());
        let image_bytes = shelf.bytes("images", "Encoded images sent");
        let upload_bytes = shelf.bytes("uploads", "Bytes of scenes and assets received");
        engine.observe(Arc::new(Stages::new(&mut shelf, limits)));
        for (name, log) in
            [("access_log_lost", &edge.access_log), ("audit_log_lost", &edge.audit_log)]
        {
            if let Some(log) = log {
                shelf.put(name, "Lines that were not written, because the log stalled", log.lost());
            }
        }
        shelf.0.register_collector(Box::new(EngineCollector(engine.clone())));
        if let Some(jobs) = jobs {
            shelf.0.register_collector(Box::new(JobCollector(jobs.clone())));
        }
        let metrics = Self {
            shelf,
            requests,
            phases,
            not_modified,
            frames_sent,
            streams_open,
            stream_frames,
            poses_overtaken,
            image_bytes,
            upload_bytes,
        };
        metrics.entered(Phase::Starting);
        metrics
    }

    /// Notes the server's phase.
    pub fn entered(&self, now: Phase) {
        for (phase, name) in [
            (Phase::Starting, "loading"),
            (Phase::Serving, "serving"),
            (Phase::Leaving, "leaving"),
            (Phase::Draining, "draining"),
        ] {
            let label = PhaseLabel { phase: name };
            self.phases.get_or_create(&label).set(i64::from(phase == now));
        }
    }

    /// Counts an answer.
    pub fn answered(&self, route: &'static str, method: &Method, status: u16) {
        let method = match method.as_str() {
            "GET" => "GET",
            "HEAD" => "HEAD",
            "POST" => "POST",
            "PATCH" => "PATCH",
            "DELETE" => "DELETE",
            "OPTIONS" => "OPTIONS",
            _ => "other",
        };
        self.requests.get_or_create(&RequestLabels { route, method, status }).inc();
    }

    /// Counts a frame that is sent.
    pub fn frame(&self, frame: &EncodedFrame) {
        self.frames_sent.inc();
        self.image_bytes.inc_by(frame.bytes.len() as u64);
    }

    /// Counts bytes of an upload.
    pub fn uploaded(&self, bytes: u64) {
        self.upload_bytes.inc_by(bytes);
    }

    /// Returns the OpenMetrics text.
    pub fn exposition(&self) -> Result<String, fmt::Error> {
        let mut text = String::new();
        exposition::encode(&mut text, &self.shelf.0)?;
        Ok(text)
    }
}

fn seconds_of(ns: u64) -> f64 {
    ns as f64 * 1e-9
}

/// Reads the engine's statistics at scrape time.
struct EngineCollector(Engine);

impl fmt::Debug for EngineCollector {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("EngineCollector")
    }
}

impl Collector for EngineCollector {
    fn encode(&self, mut encoder: DescriptorEncoder) -> Result<(), fmt::Error> {
        let stats = self.0.stats();
        let limits = self.0.limits();
        let is_ready = self.0.readiness() == Readiness::Ready;
        for (name, help, value) in [
            ("engine_frames", "Frames rendered", stats.frames),
            ("engine_batches", "Submissions to the GPU", stats.batches),
            ("engine_coalesced", "Jobs that shared another's frame", stats.coalesced),
            ("engine_cancelled", "Jobs abandoned before submission", stats.cancelled),
            (
                "engine_given_up",
                "Blurred frames ended between exposures, because their clients had gone",
                stats.given_up,
            ),
            ("engine_overtaken", "Jobs that a newer one replaced", stats.overtaken),
            ("engine_expired", "Jobs dropped for their deadline", stats.expired),
            ("engine_refused", "Jobs refused because the queue was full", stats.refused),
            ("engine_hopeless", "Jobs refused because their deadline was too near", stats.hopeless),
            ("engine_failed", "Jobs that failed", stats.failed),
            ("engine_device_losses", "Times the GPU was lost", stats.device_losses),
            ("engine_evictions", "Scenes evicted from the GPU", stats.evictions),
            ("engine_uploads", "Assets uploaded to the GPU", stats.uploads),
            (
                "engine_instances_written",
                "Instances written to the GPU, by loaded scenes and by edits",
                stats.instances_written,
            ),
            ("engine_pipelines_late", "Pipelines that frames waited for", stats.pipelines_late),
            ("engine_pipelines_primed", "Pipelines built ahead", stats.pipelines_primed),
        ] {
            write(&mut encoder, name, help, None, &ConstCounter::new(value))?;
        }
        for (name, help, ns) in [
            ("engine_gpu", "GPU time of all passes", stats.gpu_ns),
            ("engine_encode", "Encoding time of all frames", stats.encode_ns),
        ] {
            let counter = ConstCounter::new(seconds_of(ns));
            write(&mut encoder, name, help, Some(&Unit::Seconds), &counter)?;
        }
        for (name, help, value) in [
            ("engine_queued", "Jobs waiting", stats.queued),
            ("engine_resident_bytes", "Scene data on the GPU", stats.gpu_bytes_resident),
            (
                "host_memory_bytes",
                "Host memory reserved by scenes and loads",
                limits.host_memory_in_use_bytes,
            ),
            (
                "host_memory_budget_bytes",
                "Host memory that may be reserved",
                limits.host_memory_bytes,
            ),
            (
                "resident_memory_bytes",
                "Bytes of the process in memory",
                memory::resident_bytes().unwrap_or(0),
            ),
            ("engine_ready", "Whether the engine can draw frames now: 1 or 0", u64::from(is_ready)),
        ] {
            let gauge = ConstGauge::new(i64::try_from(value).unwrap_or(i64::MAX));
            write(&mut encoder, name, help, None, &gauge)?;
        }
        Ok(())
    }
}

/// Counts jobs at scrape time.
struct JobCollector(Jobs);

impl fmt::Debug for JobCollector {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("JobCollector")
    }
}

impl Collector for JobCollector {
    fn encode(&self, mut encoder: DescriptorEncoder) -> Result<(), fmt::Error> {
        let counts = self.0.counts();
        let gauge = |value: u64| ConstGauge::new(i64::try_from(value).unwrap_or(i64::MAX));
        let kind = gauge(0).metric_type();
        let mut jobs = encoder.encode_descriptor("jobs", "Jobs by state", None, kind)?;
        for (state, count) in counts.by_state {
            gauge(count).encode(jobs.encode_family(&[("state", state)])?)?;
        }
        let drawn = ConstCounter::new(counts.drawn);
        let help = "Frames drawn by jobs, included in the frames rendered unless workers drew them";
        drawn.encode(encoder.encode_descriptor(
            "job_frames",
            help,
            None,
            drawn.metric_type(),
        )?)?;
        let bytes = gauge(counts.bytes);
        let help = "Disk space of all jobs";
        bytes.encode(encoder.encode_descriptor("jobs_disk", help, Some(&Unit::Bytes), kind)?)?;
        let Some(load) = self.0.remote_load() else { return Ok(()) };
        let help =
            "1 while there is a connection to the NATS server, which hands frames to workers";
        let connected = gauge(load.is_connected.into());
        connected.encode(encoder.encode_descriptor("farm_nats_connected", help, None, kind)?)?;
        let help = "Worker processes that were heard of lately; those of another adapter or version draw no frames of this server";
        let mut workers = encoder.encode_descriptor("workers", help, None, kind)?;
        for (of, count) in [("this", load.workers), ("another", load.other_workers)] {
            gauge(count).encode(workers.encode_family(&[("kind", of)])?)?;
        }
        let help = "Workers that can draw frames of this server and that pause because they failed at several runs in a row";
        let paused = gauge(load.paused_workers);
        paused.encode(encoder.encode_descriptor("workers_paused", help, None, kind)?)?;
        let help = "Runs of frames in the queue: `pending` ones wait for a worker, `drawing` ones have one, `redelivered` ones of those had another before; absent while the NATS server or the store does not answer";
        let mut runs = encoder.encode_descriptor("worker_runs", help, None, kind)?;
        let states = load.queued.map(|queued| {
            [
                ("pending", queued.pending),
                ("drawing", queued.drawing),
                ("redelivered", queued.redelivered),
            ]
        });
        for (state, count) in states.into_iter().flatten() {
            gauge(count).encode(runs.encode_family(&[("state", state)])?)?;
        }
        for (name, help, count) in [
            (
                "frames_set_aside",
                "Frames that were given up because each of several workers ended or failed while drawing them",
                load.set_aside,
            ),
            (
                "frames_retried",
                "Frames that another try draws because a worker failed at their run, or because no worker seemed to have the run",
                load.retried,
            ),
        ] {
            write(&mut encoder, name, help, None, &ConstCounter::new(count))?;
        }
        Ok(())
    }
}

fn write(
    encoder: &mut DescriptorEncoder<'_>,
    name: &str,
    help: &str,
    unit: Option<&Unit>,
    metric: &impl EncodeMetric,
) -> Result<(), fmt::Error> {
    let encoder = encoder.encode_descriptor(name, help, unit, metric.metric_type())?;
    metric.encode(encoder)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::receipt::PassReceipt;

    #[test]
    fn every_stage_is_counted_with_its_label() {
        let mut shelf = Shelf(Registry::with_prefix("p"));
        let stages = Stages::new(&mut shelf, Arc::new(Limits::new()));
        let pass = |name, gpu_ns| PassReceipt { name, ran: true, gpu_ns, why: None };
        let receipt = Receipt {
            views: 4,
            gpu_ns: Some(8_000_000),
            passes: vec![pass("project_samples", Some(4_000_000)), pass("write_output", None)],
            queue_ns: 1_000_000,
            total_ns: 16_000_000,
            ..Receipt::default()
        };
        stages.frame(Class::Interactive, &receipt);
        stages.frame(Class::Job, &receipt);
        stages.batch(4);
        let mut text = String::new();
        exposition::encode(&mut text, &shelf.0).unwrap();
        for line in [
            "p_frame_queue_seconds_sum{class=\"interactive\"} 0.001",
            "p_frame_total_seconds_count{class=\"job\"} 1",
            "p_frame_pass_seconds_sum{pass=\"project_samples\"} 0.002",
            "p_frame_gpu_seconds_sum{class=\"job\"} 0.002",
            "p_frame_device_wait_seconds_count 2",
            "p_frame_readback_seconds_count 2",
            "p_frame_encode_seconds_count 2",
            "p_batch_frames_sum 4.0",
        ] {
            assert!(text.contains(line), "{line}: {text}");
        }
        assert!(!text.contains("pass=\"write_output\""), "what was not measured is not counted");
    }
}
