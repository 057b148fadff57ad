//! What was measured on a real machine, and recorded costs of frames.

use anyhow::Context;
use pointillist::capacity::costs::{BrokerCosts, DaemonCosts, StoreCosts};
use serde::Deserialize;

use crate::common::median;

const FILE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/capacity/measured.json");

/// A frame of a film on a GPU, in milliseconds: 200 × 200 copies of a mesh as splats, slowest pose, 110 frames/s
/// (benches/results/nvidia-h200-2026-11-27.md).
pub const GPU_FRAME_MS: f64 = 9.1;
/// A frame of a film on two CPU cores: a statue of 5 M samples to a finished JPEG, 1024² (docs/speed.md).
pub const CPU_FRAME_MS: f64 = 46.0;
/// GPU time of frames of 640 × 480 on an H200 (docs/speed.md, "A GPU"): statue as points, as splats, painted, relief, plaza.
pub const GPU_MS: [f64; 5] = [0.44, 0.86, 5.0, 0.72, 1.40];
/// Recording a frame, which keeps the render thread busy (benches/results/nvidia-h200-2026-11-27.md, "record ms").
pub const RECORD_MS: f64 = 1.25;
/// A JPEG of 640 × 480: 11 ms for 1024² (docs/speed.md, "A GPU").
pub const JPEG_MS: f64 = 3.2;
/// What the daemon adds to a frame (docs/speed.md).
pub const OVERHEAD_MS: f64 = 1.8;

#[derive(Debug, Deserialize)]
pub struct Measured {
    pub date: String,
    pub build: String,
    pub cores: usize,
    pub cpu: String,
    pub film_size: String,
    pub client_size: String,
    pub broker: Broker,
    pub store: Store,
    pub idle_connection_kib: f64,
    pub films: Vec<FilmPoint>,
    pub clients: Vec<ClientPoint>,
}

/// CPU time of messages.
#[derive(Debug, Deserialize)]
pub struct Broker {
    pub publish_small_us: f64,
    pub publish_10_kb_us: f64,
    pub pull_and_ack_small_us: f64,
    pub pull_and_ack_10_kb_us: f64,
    pub progress_us: f64,
    pub note_us: f64,
    pub publish_round_trip_us: f64,
}

/// Times of operations of a folder.
#[derive(Debug, Deserialize)]
pub struct Store {
    pub image_bytes: u64,
    pub put_us: f64,
    pub get_us: f64,
    pub head_us: f64,
    pub put_2_mb_us: f64,
}

/// A film that some workers drew.
#[derive(Clone, Debug, Deserialize)]
pub struct FilmPoint {
    pub workers: usize,
    pub frames: u64,
    pub seconds: f64,
    pub others_cores: f64,
    pub worker_cpu_s: f64,
    pub daemon_cpu_s: f64,
    pub broker_cpu_s: f64,
}

/// Requests on some connections.
#[derive(Clone, Debug, Deserialize)]
pub struct ClientPoint {
    pub clients: usize,
    pub throughput_per_s: f64,
    pub service: Service,
    pub receipts: Receipts,
}

#[derive(Clone, Debug, Deserialize)]
pub struct Service {
    pub mean_ns: f64,
}

#[derive(Clone, Debug, Deserialize)]
pub struct Receipts {
    pub gpu_p50_ns: f64,
    pub encode_p50_ns: f64,
}

impl FilmPoint {
    /// CPU time of workers and broker for a frame, in milliseconds.
    pub fn cpu_ms(&self) -> f64 {
        1e3 * (self.worker_cpu_s + self.broker_cpu_s) / self.frames as f64
    }
}

impl Measured {
    pub fn read() -> anyhow::Result<Measured> {
        let text = std::fs::read(FILE).context(FILE)?;
        serde_json::from_slice(&text).context(FILE)
    }

    pub fn machine(&self) -> String {
        let Measured { cores, cpu, build, date, .. } = self;
        format!("{cores} cores of an {cpu}, {build} build, {date}")
    }

    pub fn broker_costs(&self) -> BrokerCosts {
        let us = |us: f64| (1e3 * us) as u64;
        let Broker { publish_small_us, publish_10_kb_us, pull_and_ack_small_us, .. } = self.broker;
        // Publishing and delivering have the same bytes.
        let larger = publish_10_kb_us - publish_small_us + self.broker.pull_and_ack_10_kb_us
            - pull_and_ack_small_us;
        BrokerCosts {
            publish_ns: us(publish_small_us),
            pull_and_ack_ns: us(pull_and_ack_small_us),
            kib_ns: us(larger / 2.0 / (9_800.0 / 1024.0)),
            progress_ns: us(self.broker.progress_us),
            note_ns: us(self.broker.note_us),
            trip_ns: us((self.broker.publish_round_trip_us - publish_small_us).max(0.0)),
        }
    }

    /// The folder that was measured. Its disk takes one operation of each core at a time.
    pub fn folder(&self) -> StoreCosts {
        let Store { image_bytes, put_us, get_us, head_us, put_2_mb_us } = self.store;
        let seconds = (put_2_mb_us - put_us).max(1.0) * 1e-6;
        StoreCosts {
            servers: self.cores,
            put_ns: (1e3 * put_us) as u64,
            get_ns: (1e3 * get_us) as u64,
            head_ns: (1e3 * head_us) as u64,
            trip_ns: 0,
            bytes_per_s: (2e6 - image_bytes as f64) / seconds,
        }
    }

    /// Median CPU time of the daemon for one frame of the films that one worker drew, in milliseconds.
    pub fn daemon_ms(&self) -> f64 {
        let single = self.films.iter().filter(|point| point.workers == 1);
        let times = single.map(|point| 1e3 * point.daemon_cpu_s / point.frames as f64);
        median(&times.collect::<Vec<_>>())
    }

    pub fn daemon_costs(&self, cores: usize) -> DaemonCosts {
        let daemon_ms = self.daemon_ms();
        // A beat is a line of JSON and an entry of a table of all workers.
        DaemonCosts { cores, frame_ns: (1e6 * daemon_ms) as u64, beat_ns: 20_000 }
    }

    /// Bytes of a film's frame of 1280 × 720, by those that were measured.
    pub fn image_bytes(&self) -> u64 {
        let pixels: f64 =
            self.film_size.split('x').filter_map(|side| side.parse::<f64>().ok()).product();
        (self.store.image_bytes as f64 / pixels * 1280.0 * 720.0) as u64
    }
}

/// A bucket that takes 3,500 writes or 5,500 reads per second, which Amazon S3 documents for each prefix, over a link of 25 Gbit/s. Its
/// operations take 20 to 30 ms.
pub fn bucket() -> StoreCosts {
    let servers = 100;
    let rate = |per_s: f64| (1e9 * servers as f64 / per_s) as u64;
    StoreCosts {
        servers,
        put_ns: rate(3500.0),
        get_ns: rate(5500.0),
        head_ns: rate(5500.0),
        trip_ns: 0,
        bytes_per_s: 25e9 / 8.0,
    }
}
