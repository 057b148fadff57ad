//! How clients share the device: unlike ones that want all they can get, and one beside a job.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, ensure};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

use super::common::client::Connection;
use super::common::daemon::Daemon;
use super::common::report::{Bound, Report, number};
use super::common::stream::Stream;
use super::common::{self, median, median_ratio, ms, pick, quantile};
use super::{QUALITY, SCENE, frame_path, open, pose, start_job};

const GPU_SECONDS: &str = "pointillist_engine_gpu_seconds_total";

/// Eight streams that move all the time, one of them with frames of four times the pixels, as splats, and one of thumbnails; and
/// somebody who always has eight requests under way. Each has a key: without, all that come from one address are one client.
pub fn clients(report: &mut Report) -> anyhow::Result<()> {
    const CLIENTS: usize = 8;
    // Long enough for the client of the fewest frames to get some fifty.
    let seconds = pick(60.0, 0.5);
    let keys: Vec<String> =
        (0..=CLIENTS).map(|number| format!("key-{number}-of-a-bench")).collect();
    let line = |(number, key): (usize, &String)| {
        let hash: String = Sha256::digest(key).iter().map(|byte| format!("{byte:02x}")).collect();
        format!("client-{number} read {hash}\n")
    };
    let file = common::folder().join("keys.txt");
    std::fs::write(&file, keys.iter().enumerate().map(line).collect::<String>())?;
    let file = file.to_str().context("a folder whose name is no text")?;
    let daemon = &Daemon::start(Path::new("scenes"), &["plaza.json"], &["--api-keys", file])?;
    let keys = &keys;
    let stop = AtomicBool::new(false);
    let ask = |client: usize| match client {
        0 => ("1280×960, splats", "w=1280&h=960&reconstruct=splats&"),
        1 => ("160×120", "w=160&h=120&"),
        _ => ("640×480", "w=640&h=480&"),
    };
    let mut counts: Vec<(String, u64, f64)> = Vec::new();
    let mut share = f64::NAN;
    std::thread::scope(|scope| -> anyhow::Result<()> {
        let mut running = Vec::new();
        let stop = &stop;
        for (client, key) in keys.iter().take(CLIENTS).enumerate() {
            running.push(scope.spawn(move || {
                let (name, size) = ask(client);
                let degrees = 45.0 * client as f64;
                let (frames, device_ms) = watch(daemon, key, size, degrees, stop)?;
                anyhow::Ok((format!("stream, {name}"), frames, device_ms))
            }));
        }
        running.push(scope.spawn(move || {
            let (frames, device_ms) = flood(daemon, &keys[CLIENTS], stop)?;
            anyhow::Ok(("eight requests under way".to_owned(), frames, device_ms))
        }));
        // All are connected and warm.
        std::thread::sleep(Duration::from_secs_f64(0.2 * seconds));
        let gpu_s = || daemon.metric_as(GPU_SECONDS, &bearer(&keys[CLIENTS]));
        let (began, before) = (Instant::now(), gpu_s());
        std::thread::sleep(Duration::from_secs_f64(seconds));
        let after = gpu_s();
        // They are told in any case: who is not would go on for ever.
        stop.store(true, Ordering::Relaxed);
        share = (after? - before?) / began.elapsed().as_secs_f64();
        for client in running {
            counts.push(client.join().map_err(|_| anyhow::anyhow!("a client panicked"))??);
        }
        Ok(())
    })?;
    let device = counts.iter().map(|(.., device_ms)| *device_ms);
    let mean = device.clone().sum::<f64>() / counts.len() as f64;
    let least = device.fold(f64::MAX, f64::min) / mean;
    let rows: Vec<Vec<String>> = counts
        .iter()
        .map(|(name, frames, device_ms)| {
            vec![name.clone(), frames.to_string(), number(*device_ms), number(device_ms / mean)]
        })
        .collect();
    report.table(
        "Unlike clients that want all they can get",
        &["client", "frames", "device ms", "of an equal share"],
        &rows,
    );
    report.target(
        "the device is busy with eight streams",
        Some(100.0 * share),
        Bound::AtLeast(90.0),
        "%",
    );
    report.target(
        "least device time of a client, of an equal share",
        Some(least),
        Bound::AtLeast(0.5),
        "",
    );
    Ok(())
}

/// The line of a request's head that has an API key.
fn bearer(key: &str) -> String {
    format!("Authorization: Bearer {key}\r\n")
}

/// A stream with two poses under way until `stop`: its frames, and what they took of the device in ms.
fn watch(
    daemon: &Daemon,
    key: &str,
    size: &str,
    mut degrees: f64,
    stop: &AtomicBool,
) -> anyhow::Result<(u64, f64)> {
    let rest = format!("format=jpeg&quality={QUALITY}&lod=spt");
    let path = format!("/v1/scenes/{SCENE}/stream?{size}{rest}");
    let mut stream = Stream::open_as(daemon.address, &path, Some(key))?;
    let (mut frames, mut device_ms) = (0u64, 0.0);
    let mut next = |stream: &mut Stream| {
        degrees += 0.4;
        let seq = stream.next_seq();
        // At rest, so that none of them gets smaller frames than the others.
        stream.send(&pose(seq, degrees, false)).map(|()| seq)
    };
    let mut waiting = next(&mut stream)?;
    while !stop.load(Ordering::Relaxed) {
        let then = next(&mut stream)?;
        // The newer one wins where the first has not been begun.
        let frame = stream.frame_from(waiting)?;
        stream.acknowledge(&frame)?;
        waiting = if frame["seq"].as_u64() == Some(then) { next(&mut stream)? } else { then };
        frames += 1;
        device_ms += device_ms_of(&frame["receipt"]);
    }
    Ok((frames, device_ms))
}

/// Counts the frames of requests, eight at a time.
fn flood(daemon: &Daemon, key: &str, stop: &AtomicBool) -> anyhow::Result<(u64, f64)> {
    let key = bearer(key);
    let mut pool = (0..8).map(|_| daemon.connect()).collect::<Result<Vec<_>, _>>()?;
    let (mut frames, mut device_ms, mut degrees) = (0u64, 0.0, 0.0);
    let mut next = || {
        degrees += 0.37;
        frame_path(degrees)
    };
    for connection in &mut pool {
        connection.send(&next(), &key)?;
    }
    while !stop.load(Ordering::Relaxed) {
        for connection in &mut pool {
            let answer = connection.receive()?;
            ensure!(answer.status == 200, "a frame was answered with {}", answer.status);
            frames += 1;
            device_ms += device_ms_of(&answer.receipt()?);
            connection.send(&next(), &key)?;
        }
    }
    Ok((frames, device_ms))
}

/// A frame's part of the device's time, from its receipt.
fn device_ms_of(receipt: &Value) -> f64 {
    let together = receipt["views"].as_u64().unwrap_or(1).max(1);
    ms(receipt["gpu_ns"].as_u64().unwrap_or(0)) / together as f64
}

/// Measures clients that wait for each frame before they ask for the next, alone and beside a job of as dear frames, in turns. They ask
/// at once or, as people and control loops do, `PACE` times a second, which leaves the device idle between frames.
pub fn beside(report: &mut Report, daemon: &Daemon) -> anyhow::Result<()> {
    const PACE: f64 = 10.0;
    let seconds = pick(12.0, 0.5);
    let mut client = daemon.connect()?;
    // Both return the time that each frame took, in milliseconds.
    let mut degrees = 0.0;
    let mut requests = |pace: Option<f64>| -> anyhow::Result<Vec<f64>> {
        let mut connection = daemon.connect()?;
        timed(seconds, pace, || {
            degrees += 0.37;
            let answer = connection.get(&frame_path(degrees), "")?;
            ensure!(answer.status == 200, "a frame was answered with {}", answer.status);
            Ok(())
        })
    };
    let mut poses = |pace: Option<f64>| -> anyhow::Result<Vec<f64>> {
        let mut stream = open(daemon.address)?;
        timed(seconds, pace, || {
            let seq = stream.next_seq();
            // At rest, so that frames are what they are alone.
            stream.send(&pose(seq, 0.4 * seq as f64 + 0.1 * seconds, false))?;
            let frame = stream.frame_of(seq)?;
            stream.acknowledge(&frame)
        })
    };
    let drawn = |client: &mut Connection, place: &str| -> anyhow::Result<f64> {
        let job: Value = serde_json::from_slice(&client.get(place, "")?.body)?;
        job["frames"]["done"].as_f64().with_context(|| format!("no count of frames in {job}"))
    };
    let place = start_job(&mut client, 200.0)?;
    std::thread::sleep(Duration::from_secs_f64(0.2 * seconds));
    let (began, before) = (Instant::now(), drawn(&mut client, &place)?);
    std::thread::sleep(Duration::from_secs_f64(0.5 * seconds));
    let of_job = (drawn(&mut client, &place)? - before) / began.elapsed().as_secs_f64();
    ensure!(client.post(&format!("{place}/cancel"), &json!({}))?.status < 300, "no cancel");
    let mut rows = Vec::new();
    type Ask<'a> = &'a mut dyn FnMut(Option<f64>) -> anyhow::Result<Vec<f64>>;
    let asks: [(&str, Ask<'_>); 2] = [("requests", &mut requests), ("a stream", &mut poses)];
    for (name, ask) in asks {
        for pace in [None, Some(PACE)] {
            let (mut alone, mut together, mut left) = (Vec::new(), Vec::new(), Vec::new());
            for _ in 0..pick(3, 1) {
                alone.push(ask(pace)?);
                let place = start_job(&mut client, 200.0)?;
                // Nothing of the job is drawn yet, and then it is.
                while drawn(&mut client, &place)? < 1.0 {
                    std::thread::sleep(Duration::from_millis(20));
                }
                let (began, before) = (Instant::now(), drawn(&mut client, &place)?);
                together.push(ask(pace)?);
                left.push((drawn(&mut client, &place)? - before) / began.elapsed().as_secs_f64());
                let cancelled = client.post(&format!("{place}/cancel"), &json!({}))?;
                ensure!(cancelled.status < 300, "no cancel");
            }
            let name = match pace {
                None => format!("{name}, one frame after the other"),
                Some(pace) => format!("{name}, {pace} frames a second"),
            };
            let rates = |times: &[Vec<f64>]| -> Vec<f64> {
                times
                    .iter()
                    .map(|times| 1e3 / (times.iter().sum::<f64>() / times.len() as f64))
                    .collect()
            };
            let [kept, share] =
                [median_ratio(&rates(&together), &rates(&alone)), median(&left) / of_job];
            let times = |times: Vec<Vec<f64>>| times.into_iter().flatten().collect::<Vec<f64>>();
            let [alone, together] = [times(alone), times(together)];
            let late = quantile(&together, 0.99) / quantile(&alone, 0.99);
            let ms = |share: f64| [&alone, &together].map(|times| number(quantile(times, share)));
            let ([half, half_beside], [most, most_beside]) = (ms(0.5), ms(0.99));
            rows.push(vec![
                name.clone(),
                half,
                half_beside,
                most,
                most_beside,
                number(late),
                number(kept),
                number(share),
            ]);
            match pace {
                // A job has its share of the device, so some frames wait for one of the job's.
                None => report.target(
                    &format!("{name}: rate beside a job, of the rate alone"),
                    Some(kept),
                    Bound::AtLeast(0.85),
                    "",
                ),
                Some(_) => report.target(
                    &format!("{name}: 99th percentile beside a job, of that alone"),
                    Some(late),
                    Bound::AtMost(1.1),
                    "",
                ),
            }
            report.target(
                &format!("{name}: what the job keeps of its rate"),
                Some(share),
                Bound::AtLeast(0.05),
                "",
            );
        }
    }
    report.table(
        "Clients that wait for each frame, alone and beside a job (median and 99th percentile in ms)",
        &[
            "client",
            "median alone",
            "beside",
            "99 % alone",
            "beside",
            "ratio of 99 %",
            "rate kept",
            "job's rate, of its own alone",
        ],
        &rows,
    );
    Ok(())
}

/// Asks again and again for `seconds`, at most `pace` times a second, and returns the times in milliseconds.
fn timed(
    seconds: f64,
    pace: Option<f64>,
    mut ask: impl FnMut() -> anyhow::Result<()>,
) -> anyhow::Result<Vec<f64>> {
    let (began, mut times) = (Instant::now(), Vec::new());
    while began.elapsed().as_secs_f64() < seconds {
        let asked = Instant::now();
        ask()?;
        times.push(asked.elapsed().as_secs_f64() * 1e3);
        if let Some(pace) = pace {
            std::thread::sleep(Duration::from_secs_f64(1.0 / pace).saturating_sub(asked.elapsed()));
        }
    }
    Ok(times)
}
