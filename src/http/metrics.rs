//! `/metrics`: what the server counts itself, and the engine's counters read at scrape time.

use std::fmt;

use axum::http::Method;
use prometheus_client::collector::Collector;
use prometheus_client::encoding::{
    DescriptorEncoder, EncodeLabelSet, EncodeMetric, text as exposition,
};
use prometheus_client::metrics::counter::{ConstCounter, Counter};
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::{ConstGauge, Gauge};
use prometheus_client::metrics::histogram::{Histogram, exponential_buckets};
use prometheus_client::registry::{Registry, Unit};

use crate::engine::{EncodedFrame, Engine, Readiness};

/// Content type of the exposition.
pub const OPENMETRICS: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct RequestLabels {
    route: &'static str,
    method: &'static str,
    status: u16,
}

/// The server's own counters, with the registry that knows them.
pub struct Metrics {
    registry: Registry,
    requests: Family<RequestLabels, Counter>,
    pub not_modified: Counter,
    pub frames_sent: Counter,
    pub streams_open: Gauge,
    pub stream_frames: Counter,
    pub poses_overtaken: Counter,
    image_bytes: Counter,
    upload_bytes: Counter,
    total_seconds: Histogram,
    gpu_seconds: Histogram,
    encode_seconds: Histogram,
}

impl Metrics {
    pub fn new(engine: &Engine) -> Self {
        // 0.1 ms to about 26 s.
        let seconds = || Histogram::new(exponential_buckets(1e-4, 2.0, 19));
        let mut metrics = Self {
            registry: Registry::with_prefix("pointillist"),
            requests: Family::default(),
            not_modified: Counter::default(),
            frames_sent: Counter::default(),
            streams_open: Gauge::default(),
            stream_frames: Counter::default(),
            poses_overtaken: Counter::default(),
            image_bytes: Counter::default(),
            upload_bytes: Counter::default(),
            total_seconds: seconds(),
            gpu_seconds: seconds(),
            encode_seconds: seconds(),
        };
        let registry = &mut metrics.registry;
        registry.register(
            "http_requests",
            "Answers by route, method and status",
            metrics.requests.clone(),
        );
        registry.register(
            "not_modified",
            "Frames answered 304 without rendering",
            metrics.not_modified.clone(),
        );
        registry.register(
            "frames_sent",
            "Frames sent, coalesced ones included",
            metrics.frames_sent.clone(),
        );
        registry.register("streams_open", "Streams open", metrics.streams_open.clone());
        registry.register(
            "stream_frames",
            "Frames sent on streams, which are among the frames sent",
            metrics.stream_frames.clone(),
        );
        registry.register(
            "stream_poses_overtaken",
            "Poses of streams that were not drawn because a newer one had come",
            metrics.poses_overtaken.clone(),
        );
        let bytes = |registry: &mut Registry, name: &str, help: &str, counter: &Counter| {
            registry.register_with_unit(name, help, Unit::Bytes, counter.clone());
        };
        bytes(registry, "images", "Encoded images sent", &metrics.image_bytes);
        bytes(registry, "uploads", "Bytes of scenes and assets received", &metrics.upload_bytes);
        let seconds = |registry: &mut Registry, name: &str, help: &str, histogram: &Histogram| {
            registry.register_with_unit(name, help, Unit::Seconds, histogram.clone());
        };
        seconds(
            registry,
            "frame_total",
            "From a frame's request to its encoded image",
            &metrics.total_seconds,
        );
        seconds(
            registry,
            "frame_gpu",
            "GPU time of a frame's passes, its share where several were drawn together",
            &metrics.gpu_seconds,
        );
        seconds(registry, "frame_encode", "Encoding time of a frame", &metrics.encode_seconds);
        registry.register_collector(Box::new(EngineCollector(engine.clone())));
        metrics
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

    /// Counts a frame that is being sent.
    pub fn frame(&self, frame: &EncodedFrame) {
        self.frames_sent.inc();
        self.image_bytes.inc_by(frame.bytes.len() as u64);
        self.total_seconds.observe(seconds_of(frame.receipt.total_ns));
        self.encode_seconds.observe(seconds_of(frame.receipt.encode_ns));
        if let Some(share_ns) = frame.receipt.gpu_share_ns() {
            self.gpu_seconds.observe(seconds_of(share_ns));
        }
    }

    /// Counts bytes of an upload.
    pub fn uploaded(&self, bytes: u64) {
        self.upload_bytes.inc_by(bytes);
    }

    /// The OpenMetrics text.
    pub fn exposition(&self) -> Result<String, fmt::Error> {
        let mut text = String::new();
        exposition::encode(&mut text, &self.registry)?;
        Ok(text)
    }
}

fn seconds_of(ns: u64) -> f64 {
    ns as f64 * 1e-9
}

/// Reads the engine's statistics when scraped.
struct EngineCollector(Engine);

impl fmt::Debug for EngineCollector {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("EngineCollector")
    }
}

impl Collector for EngineCollector {
    fn encode(&self, mut encoder: DescriptorEncoder) -> Result<(), fmt::Error> {
        let stats = self.0.stats();
        let ready = i64::from(self.0.readiness() == Readiness::Ready);
        for (name, help, value) in [
            ("engine_frames", "Frames rendered", stats.frames),
            ("engine_batches", "Submissions to the GPU", stats.batches),
            ("engine_coalesced", "Jobs that shared another's frame", stats.coalesced),
            ("engine_cancelled", "Jobs abandoned before submission", stats.cancelled),
            ("engine_overtaken", "Jobs that a newer one replaced", stats.overtaken),
            ("engine_expired", "Jobs dropped for their deadline", stats.expired),
            ("engine_refused", "Jobs refused because the queue was full", stats.refused),
            ("engine_failed", "Jobs that failed", stats.failed),
            ("engine_device_losses", "Times the GPU was lost", stats.device_losses),
            ("engine_evictions", "Scenes evicted from the GPU", stats.evictions),
            ("engine_uploads", "Scenes uploaded to the GPU", stats.uploads),
        ] {
            let counter = ConstCounter::new(value);
            let metric = encoder.encode_descriptor(name, help, None, counter.metric_type())?;
            counter.encode(metric)?;
        }
        for (name, help, ns) in [
            ("engine_gpu", "GPU time of all passes", stats.gpu_ns),
            ("engine_encode", "Encoding time of all frames", stats.encode_ns),
        ] {
            let counter = ConstCounter::new(seconds_of(ns));
            let unit = Some(&Unit::Seconds);
            let metric = encoder.encode_descriptor(name, help, unit, counter.metric_type())?;
            counter.encode(metric)?;
        }
        for (name, help, value) in [
            ("engine_queued", "Jobs waiting", i64::try_from(stats.queued).unwrap_or(i64::MAX)),
            (
                "engine_resident_bytes",
                "Scene data on the GPU",
                i64::try_from(stats.gpu_bytes_resident).unwrap_or(i64::MAX),
            ),
            ("engine_ready", "Whether frames can be had now", ready),
        ] {
            let gauge = ConstGauge::new(value);
            let metric = encoder.encode_descriptor(name, help, None, gauge.metric_type())?;
            gauge.encode(metric)?;
        }
        Ok(())
    }
}
