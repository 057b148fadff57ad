//! Measures what the daemon adds to drawing and encoding, how fast it revalidates, what a flood does to it, and what batching gains.
//! Client and daemon share the machine, as they do for its users' tests; the client is as lean as it can be.

mod common;

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, ensure};
use common::client::Connection;
use common::daemon::Daemon;
use common::report::{Bound, Report, number};
use common::{files, median, median_ratio, ms, pick, quantile};
use pointillist::generate::{Kind, Parameters};
use serde_json::Value;

fn main() -> anyhow::Result<()> {
    // A handful of small scenes, by the identifiers that the daemon will give them.
    let folder = scenes()?;
    let names = ["cube.ply", "sphere.ply", "relief.ply", "scan.laz"];
    let daemon = Daemon::start(&folder, &names, &[])?;
    let adapter = adapter(&daemon)?;
    let mut report = Report::new("daemon", &adapter);
    overhead(&mut report, &daemon)?;
    revalidation(&mut report, &daemon)?;
    thumbnails(&mut report, &daemon)?;
    drop(daemon);
    flood(&mut report, &folder)?;
    report.finish()
}

/// A root with scenes from twelve triangles to 165 thousand samples.
fn scenes() -> anyhow::Result<PathBuf> {
    let folder = common::folder().join("small");
    std::fs::create_dir_all(&folder)?;
    let plain = Parameters { seed: 1, ..Parameters::default() };
    for (name, kind) in [("cube.ply", Kind::Cube), ("sphere.ply", Kind::Sphere)] {
        std::fs::copy(files::generated(name, kind, &plain)?, folder.join(name))?;
    }
    std::fs::copy("scenes/relief-asset.ply", folder.join("relief.ply"))?;
    std::fs::copy("scenes/town-scan.laz", folder.join("scan.laz"))?;
    Ok(folder)
}

fn adapter(daemon: &Daemon) -> anyhow::Result<String> {
    let answer = daemon.connect()?.get("/v1/scenes/cube/frame?w=16&h=16&format=png", "")?;
    ensure!(answer.status == 200, "a frame was answered with {}", answer.status);
    Ok(answer.receipt()?["adapter"].as_str().context("no adapter in the receipt")?.to_owned())
}

/// A frame seen from `degrees` around a scene about the origin or, for the scan, around its middle.
fn frame_path(scene: &str, degrees: f64, size: u32, format: &str) -> String {
    let (sin, cos) = degrees.to_radians().sin_cos();
    let (target, eye) = if scene == "scan" {
        let (east, north) = (412_000.0, 5_653_000.0);
        (format!("{east},{north},115"), format!("{},{},160", east + 80.0 * sin, north - 80.0 * cos))
    } else {
        ("0,0.8,0".to_owned(), format!("{},1.2,{}", 4.0 * sin, 4.0 * cos))
    };
    format!(
        "/v1/scenes/{scene}/frame?eye={eye}&target={target}&fov=40&w={size}&h={size}&format={format}"
    )
}

/// Time that a client waits beyond the passes and the encoder, one request at a time on one connection.
fn overhead(report: &mut Report, daemon: &Daemon) -> anyhow::Result<()> {
    let mut connection = daemon.connect()?;
    let mut rows = Vec::new();
    let mut worst: Option<f64> = None;
    for scene in ["cube", "relief", "scan"] {
        let (warm, count) = pick((10, 120), (1, 3));
        let mut parts: [Vec<f64>; 8] = Default::default();
        for number in 0..warm + count {
            let path = frame_path(scene, f64::from(number) * 0.7, 1024, "jpeg");
            let began = Instant::now();
            let answer = connection.get(&path, "")?;
            let latency = began.elapsed().as_secs_f64() * 1e3;
            ensure!(answer.status == 200, "{path} was answered with {}", answer.status);
            if number < warm {
                continue;
            }
            let receipt = answer.receipt()?;
            let of = |name: &str| receipt[name].as_u64().map(ms);
            let gpu = of("gpu_ns").context("this adapter has no timestamps")?;
            let [encode, queue, record, readback, wait, total] =
                ["encode_ns", "queue_ns", "record_ns", "readback_ns", "encode_wait_ns", "total_ns"]
                    .map(|name| of(name).unwrap_or(f64::NAN));
            let added = latency - gpu - encode;
            let values =
                [latency, gpu, encode, added, queue + wait, record, readback, latency - total];
            for (part, value) in parts.iter_mut().zip(values) {
                part.push(value);
            }
        }
        let mut row = vec![scene.to_owned()];
        row.extend(parts.iter().map(|part| number(median(part))));
        row.push(number(quantile(&parts[3], 0.95)));
        rows.push(row);
        report.value(&format!("{scene}, added ms"), median(&parts[3]));
        worst = Some(median(&parts[3]).max(worst.unwrap_or(0.0)));
    }
    report.table(
        "One request at a time, JPEG of 1024², median ms as the client sees it",
        &[
            "scene",
            "latency",
            "GPU",
            "encode",
            "added",
            "waits",
            "record",
            "readback",
            "HTTP",
            "added p95",
        ],
        &rows,
    );
    let what = "what the daemon adds to passes and encoding at 1024², median of the slowest scene";
    report.target(what, worst, Bound::Below(3.0), "ms");
    Ok(())
}

/// 304 answers over a pool of connections, each with one request under way.
fn revalidation(report: &mut Report, daemon: &Daemon) -> anyhow::Result<()> {
    let path = frame_path("relief", 3.0, 1024, "jpeg");
    let tag = daemon.connect()?.get(&path, "")?.header("etag").context("no ETag")?.to_owned();
    let condition = format!("If-None-Match: {tag}\r\n");
    let frames = daemon.metric("pointillist_engine_frames_total")?;
    let mut rows = Vec::new();
    let mut best: Option<f64> = None;
    for connections in [1, 8, 32] {
        let mut rates = Vec::new();
        for _ in 0..pick(5, 1) {
            let pool: Vec<Connection> =
                (0..connections).map(|_| daemon.connect()).collect::<Result<_, _>>()?;
            rates.push(revalidate(pool, &path, &condition, pick(1.0, 0.1))?);
        }
        best = Some(median(&rates).max(best.unwrap_or(0.0)));
        report.value(&format!("not_modified_per_s_{connections}_connections"), median(&rates));
        rows.push(vec![connections.to_string(), number(median(&rates))]);
    }
    let drawn = daemon.metric("pointillist_engine_frames_total")? - frames;
    ensure!(drawn == 0.0, "{drawn} frames were drawn for requests that needed none");
    report.table("Revalidation", &["connections", "304 answers/s"], &rows);
    report.target("304 answers from one connection pool", best, Bound::AtLeast(5000.0), "/s");
    Ok(())
}

/// Answers a second. One thread drives the pool: it sends on every connection, then receives from each.
fn revalidate(
    mut pool: Vec<Connection>,
    path: &str,
    condition: &str,
    seconds: f64,
) -> anyhow::Result<f64> {
    let began = Instant::now();
    let mut count = 0u32;
    while began.elapsed().as_secs_f64() < seconds {
        for connection in &mut pool {
            connection.send(path, condition)?;
        }
        for connection in &mut pool {
            let answer = connection.receive()?;
            ensure!(answer.status == 304, "{} instead of 304", answer.status);
            count += 1;
        }
    }
    Ok(f64::from(count) / began.elapsed().as_secs_f64())
}

/// Frames of 128²: one at a time, and many requests under way that the engine batches; in turns.
fn thumbnails(report: &mut Report, daemon: &Daemon) -> anyhow::Result<()> {
    const IN_FLIGHT: usize = 32;
    let mut rows = Vec::new();
    let mut smallest = None;
    for scene in ["cube", "sphere", "relief", "scan"] {
        let mut alone = vec![daemon.connect()?];
        let mut many: Vec<Connection> =
            (0..IN_FLIGHT).map(|_| daemon.connect()).collect::<Result<_, _>>()?;
        let seed = AtomicU64::new(0);
        let (mut single, mut batched) = (Vec::new(), Vec::new());
        let mut sizes = Vec::new();
        for round in 0..pick(6, 2) {
            let (one, _) = thumbnails_for(&mut alone, scene, &seed, pick(0.8, 0.1))?;
            let (all, batches) = thumbnails_for(&mut many, scene, &seed, pick(0.8, 0.1))?;
            if round > 0 {
                single.push(one);
                batched.push(all);
                sizes.extend(batches);
            }
        }
        let gain = median_ratio(&batched, &single);
        report.value(&format!("{scene}, batched gain"), gain);
        if smallest.is_none() {
            smallest = Some(gain);
        }
        rows.push(vec![
            scene.to_owned(),
            number(median(&single)),
            number(median(&batched)),
            number(median(&sizes)),
            number(gain),
        ]);
    }
    report.table(
        &format!("JPEGs of 128²: one request at a time, {IN_FLIGHT} under way"),
        &["scene", "one at a time /s", "batched /s", "frames a batch", "gain"],
        &rows,
    );
    let what = "thumbnails of a small scene (the cube), batched against one at a time";
    report.target(what, smallest, Bound::AtLeast(3.0), "×");
    Ok(())
}

/// Frames a second and the batch sizes that receipts tell. Each connection sends anew as soon as it is answered.
fn thumbnails_for(
    pool: &mut [Connection],
    scene: &str,
    seed: &AtomicU64,
    seconds: f64,
) -> anyhow::Result<(f64, Vec<f64>)> {
    let next = || {
        let number = seed.fetch_add(1, Ordering::Relaxed);
        frame_path(scene, number as f64 * 0.013, 128, "jpeg")
    };
    let began = Instant::now();
    for connection in pool.iter_mut() {
        connection.send(&next(), "")?;
    }
    let (mut count, mut sizes) = (0u32, Vec::new());
    let mut open = true;
    while open {
        open = began.elapsed().as_secs_f64() < seconds;
        for connection in pool.iter_mut() {
            let answer = connection.receive()?;
            ensure!(answer.status == 200, "a thumbnail was answered with {}", answer.status);
            count += 1;
            sizes.extend(answer.receipt()?["batch_size"].as_f64());
            if open {
                connection.send(&next(), "")?;
            }
        }
    }
    Ok((f64::from(count) / began.elapsed().as_secs_f64(), sizes))
}

#[derive(Default)]
struct Tally {
    frames: AtomicU64,
    refusals: AtomicU64,
    /// Anything but a frame or a 503 that says when to come again.
    errors: AtomicU64,
}

/// A hundred clients without pause: first against the default queue, then against one too short for them.
fn flood(report: &mut Report, folder: &Path) -> anyhow::Result<()> {
    let (mut rows, mut errors, mut worst_growth) = (Vec::new(), 0, None::<f64>);
    for queue in ["256", "16"] {
        let daemon = Daemon::start(folder, &["sphere.ply"], &["--queue", queue])?;
        let clients = pick(100, 10);
        hammer(&daemon, clients, pick(15.0, 0.5))?;
        let before = daemon.memory_mib("VmRSS");
        let tally = hammer(&daemon, clients, pick(10.0, 0.5))?;
        let after = daemon.memory_mib("VmRSS");
        let again = hammer(&daemon, clients, pick(10.0, 0.5))?;
        let last = daemon.memory_mib("VmRSS");
        let sum = |of: fn(&Tally) -> &AtomicU64| {
            of(&tally).load(Ordering::Relaxed) + of(&again).load(Ordering::Relaxed)
        };
        errors += sum(|tally| &tally.errors);
        let growth = after.zip(last).map(|(after, last)| 100.0 * (last / after - 1.0));
        worst_growth = match (worst_growth, growth) {
            (Some(a), Some(b)) => Some(a.max(b)),
            (a, b) => a.or(b),
        };
        let shown = |value: Option<f64>| value.map_or("—".to_owned(), number);
        rows.push(vec![
            queue.to_owned(),
            sum(|tally| &tally.frames).to_string(),
            sum(|tally| &tally.refusals).to_string(),
            sum(|tally| &tally.errors).to_string(),
            shown(before),
            shown(after),
            shown(last),
        ]);
        ensure!(daemon.connect()?.get("/readyz", "")?.status == 200, "not ready after the flood");
    }
    report.table(
        "A hundred clients without pause, 128² each, twice 10 s after a warm-up",
        &["queue", "frames", "503", "errors", "RSS MiB before", "after 10 s", "after 20 s"],
        &rows,
    );
    let what = "100 clients hammering: answers that are neither frames nor honest 503s";
    report.target(what, Some(errors as f64), Bound::AtMost(0.0), "");
    let what = "100 clients hammering: growth of resident memory in the second 10 s";
    report.target(what, worst_growth, Bound::AtMost(1.0), "%");
    Ok(())
}

fn hammer(daemon: &Daemon, clients: u64, seconds: f64) -> anyhow::Result<Tally> {
    let tally = Tally::default();
    let stop = AtomicBool::new(false);
    std::thread::scope(|scope| {
        for client in 0..clients {
            let (tally, stop) = (&tally, &stop);
            scope.spawn(move || {
                let mut connection = daemon.connect();
                let mut number = 0u64;
                while !stop.load(Ordering::Relaxed) {
                    let degrees = (client * 1_000_003 + number) as f64 * 0.0137;
                    number += 1;
                    let path = frame_path("sphere", degrees, 128, "jpeg");
                    let answer = match &mut connection {
                        Ok(open) => open.get(&path, ""),
                        Err(_) => daemon.connect().and_then(|mut open| {
                            let answer = open.get(&path, "");
                            connection = Ok(open);
                            answer
                        }),
                    };
                    match answer {
                        Ok(answer) if answer.status == 200 => &tally.frames,
                        Ok(answer) if is_honest_refusal(&answer) => &tally.refusals,
                        Ok(_) => &tally.errors,
                        Err(error) => {
                            connection = Err(error);
                            &tally.errors
                        }
                    }
                    .fetch_add(1, Ordering::Relaxed);
                }
            });
        }
        std::thread::sleep(Duration::from_secs_f64(seconds));
        stop.store(true, Ordering::Relaxed);
    });
    Ok(tally)
}

/// 503 with a problem and a time to come again.
fn is_honest_refusal(answer: &common::client::Answer) -> bool {
    let problem: Value = serde_json::from_slice(&answer.body).unwrap_or_default();
    answer.status == 503
        && answer.header("retry-after").is_some_and(|text| text.parse::<u64>().is_ok())
        && answer.header("content-type") == Some("application/problem+json")
        && problem["type"] == "urn:pointillist:problem:busy"
}
