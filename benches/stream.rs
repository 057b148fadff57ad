//! Measures a live view: how long a pose waits for its pixels, how eight clients share the device, what a job leaves of a client's rate,
//! how fast a camera path is filmed,
//! what many requests at a time gain, and frames a second beside a remote view of trame.
//!
//! `BENCH_STREAM=moving` compares moving frames that the planner chooses with those that are paced by time alone. It measures its scenes first, which takes
//! some ten minutes, and does not run by default.
//!
//! Client and daemon share the machine. The client of a stream does no more than read: it neither decodes nor draws.

mod common;
#[path = "stream/moving.rs"]
mod moving;
#[path = "stream/sharing.rs"]
mod sharing;

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, bail, ensure};
use common::client::Connection;
use common::daemon::Daemon;
use common::drawing::Orbit;
use common::peer::Peer;
use common::report::{Bound, Report, number};
use common::stream::Stream;
use common::{median, median_ratio, ms, pick, quantile};
use glam::DVec3;
use pointillist::bake::assemble::Assembler;
use pointillist::bake::prepare;
use pointillist::film::shots::Shots;
use pointillist::scene::SceneLimits;
use serde_json::{Value, json};

/// An instanced square of 17 600 copies.
const SCENE: &str = "plaza";
/// The camera path that jobs draw.
const PATH: &str = "approach";
const SIZE: [u32; 2] = [640, 480];
const QUALITY: u32 = 85;
const FOV_DEG: f64 = 50.0;

fn main() -> anyhow::Result<()> {
    let scenes = Path::new("scenes");
    let state = common::folder().join("state");
    let _ = std::fs::remove_dir_all(&state);
    let state = state.to_str().context("a folder whose name is no text")?;
    let args = ["--max-streams", "32", "--state", state];
    let daemon = Daemon::start(scenes, &["plaza.json"], &args)?;
    let mut probe = daemon.connect()?;
    // Trees are built before anything is timed.
    let answer = probe.get(&frame_path(0.0), "")?;
    ensure!(answer.status == 200, "the first frame was answered with {}", answer.status);
    let adapter = answer.receipt()?["adapter"].as_str().context("no adapter")?.to_owned();
    let mut report = Report::new("stream", &adapter);
    let parts = std::env::var("BENCH_STREAM")
        .unwrap_or_else(|_| "latency clients beside saturation film remote".into());
    for part in parts.split_whitespace() {
        match part {
            "latency" => latency(&mut report, &daemon)?,
            "clients" => sharing::clients(&mut report)?,
            "beside" => sharing::beside(&mut report, &daemon)?,
            "saturation" => saturation(&mut report, &daemon)?,
            "film" => film(&mut report, &daemon, &adapter)?,
            "moving" => moving::compare(&mut report)?,
            "remote" => remote(&mut report, &daemon)?,
            other => bail!(
                "BENCH_STREAM knows latency, clients, beside, saturation, film, remote and moving, not {other}"
            ),
        }
    }
    drop(daemon);
    report.finish()
}

/// On a circle above the square.
fn orbit() -> Orbit {
    Orbit { eye: DVec3::new(40.0, 12.0, 60.0), target: DVec3::new(0.0, 1.0, 0.0), fov_deg: FOV_DEG }
}

/// Among its trees, as the scene's camera `walk`.
fn walk() -> Orbit {
    Orbit { eye: DVec3::new(0.0, 1.7, 56.0), target: DVec3::new(0.4, 1.6, -32.0), fov_deg: FOV_DEG }
}

fn eye_and_target(orbit: &Orbit, degrees: f64) -> [[f64; 3]; 2] {
    let camera = orbit.at(degrees);
    [camera.eye.to_array(), camera.target.to_array()]
}

fn settings_query() -> String {
    format!("w={}&h={}&format=jpeg&quality={QUALITY}&lod=spt", SIZE[0], SIZE[1])
}

fn frame_path(degrees: f64) -> String {
    let [eye, target] =
        eye_and_target(&orbit(), degrees).map(|v| v.map(|number| number.to_string()).join(","));
    format!("/v1/scenes/{SCENE}/frame?eye={eye}&target={target}&fov={FOV_DEG}&{}", settings_query())
}

fn open(address: SocketAddr) -> anyhow::Result<Stream> {
    Stream::open(address, &format!("/v1/scenes/{SCENE}/stream?{}", settings_query()))
}

fn pose(seq: u64, degrees: f64, moving: bool) -> Value {
    pose_on(&orbit(), seq, degrees, moving)
}

fn pose_on(orbit: &Orbit, seq: u64, degrees: f64, moving: bool) -> Value {
    let [eye, target] = eye_and_target(orbit, degrees);
    json!({ "seq": seq, "eye": eye, "target": target, "fov": FOV_DEG, "moving": moving })
}

/// One client: the time from sending a pose to having its frame, as parts of what passes and encoder took for it.
fn latency(report: &mut Report, daemon: &Daemon) -> anyhow::Result<()> {
    let mut stream = open(daemon.address)?;
    let (warm, count) = pick((10, 100), (2, 4));
    let mut rows = Vec::new();
    for (name, moving) in [("at rest, as asked for", false), ("moving", true)] {
        let (mut waits, mut works, mut ratios) = (Vec::new(), Vec::new(), Vec::new());
        for number in 0..warm + count {
            let seq = stream.next_seq();
            let began = Instant::now();
            stream.send(&pose(seq, f64::from(number) * 0.4, moving))?;
            let frame = stream.frame_of(seq)?;
            let waited = began.elapsed().as_secs_f64() * 1e3;
            stream.acknowledge(&frame)?;
            if number < warm {
                continue;
            }
            let of = |name: &str| frame["receipt"][name].as_u64().map(ms);
            let gpu = of("gpu_ns").context("this adapter has no timestamps")?;
            let work = gpu + of("encode_ns").context("no encode_ns")?;
            waits.push(waited);
            works.push(work);
            ratios.push(waited / work);
        }
        let ratio = median(&ratios);
        report.value(
            &format!("pose_to_pixels_over_work_{}", if moving { "moving" } else { "still" }),
            ratio,
        );
        rows.push(vec![
            name.to_owned(),
            number(median(&waits)),
            number(quantile(&waits, 0.95)),
            number(median(&works)),
            number(ratio),
        ]);
        if !moving {
            let what = "pose to pixels at 640×480, median over what passes and encoder took";
            report.target(what, Some(ratio), Bound::AtMost(1.5), "×");
        }
    }
    report.table(
        "One stream, one pose at a time, ms",
        &["frames", "pose to pixels", "p95", "GPU + encode", "×"],
        &rows,
    );
    Ok(())
}

/// Requests one at a time, and sixteen under way, in turns.
fn saturation(report: &mut Report, daemon: &Daemon) -> anyhow::Result<()> {
    let seconds = pick(2.0, 0.2);
    let mut degrees = 0.0;
    let mut rate = |connections: usize| -> anyhow::Result<f64> {
        let mut pool = (0..connections).map(|_| daemon.connect()).collect::<Result<Vec<_>, _>>()?;
        let mut next = || {
            degrees += 0.37;
            frame_path(degrees)
        };
        let began = Instant::now();
        for connection in &mut pool {
            connection.send(&next(), "")?;
        }
        let (mut count, mut open) = (0u32, true);
        while open {
            open = began.elapsed().as_secs_f64() < seconds;
            for connection in &mut pool {
                let answer = connection.receive()?;
                ensure!(answer.status == 200, "a frame was answered with {}", answer.status);
                count += 1;
                if open {
                    connection.send(&next(), "")?;
                }
            }
        }
        Ok(f64::from(count) / began.elapsed().as_secs_f64())
    };
    let (mut alone, mut many) = (Vec::new(), Vec::new());
    for _ in 0..pick(5, 1) {
        alone.push(rate(1)?);
        many.push(rate(16)?);
    }
    let gain = median_ratio(&many, &alone);
    report.value("frames_per_s_one_at_a_time", median(&alone));
    report.value("frames_per_s_sixteen_under_way", median(&many));
    report.target(
        "sixteen requests under way against one, frames/s",
        Some(gain),
        Bound::AtLeast(1.5),
        "×",
    );
    Ok(())
}

/// Asks for a job of the square's path, JPEGs at so many frames a second, and gives its address.
fn start_job(client: &mut Connection, fps: f64) -> anyhow::Result<String> {
    let job = client.post(
        "/v1/jobs",
        &json!({ "scene": SCENE, "path": PATH, "w": SIZE[0], "h": SIZE[1], "fps": fps, "format": "jpeg",
            "quality": QUALITY, "lod": "spt", "want": ["frames"] }),
    )?;
    ensure!(job.status == 201, "{}", String::from_utf8_lossy(&job.body));
    let job: Value = serde_json::from_slice(&job.body)?;
    Ok(format!("/v1/jobs/{}", job["id"].as_str().context("a job without a name")?))
}

/// A job of 300 frames, and what its frames take when nothing else goes on: every tenth of them, one at a time, before and after.
fn film(report: &mut Report, daemon: &Daemon, adapter: &str) -> anyhow::Result<()> {
    let frames = pick(300u32, 12);
    let probes = pick(30u32, 3);
    let scene = prepare::describe(
        Path::new("scenes/plaza.json"),
        Path::new("scenes"),
        &SceneLimits::default(),
    )?;
    let path = scene.paths.iter().find(|(name, _)| name == PATH).context("no such path")?;
    let fps = f64::from(frames - 1) / path.1.duration_s();
    let shots = Shots::new(&path.1, Some(fps), None, None)?;
    let frames = shots.count();
    let work = || -> anyhow::Result<[f64; 2]> {
        // Its own: one that rests while the job is drawn is closed.
        let mut connection = daemon.connect()?;
        let (mut device_ms, mut encode_ms) = (0.0, 0.0);
        for number in 0..probes {
            let pose = shots.shot(u64::from(number) * (frames - 1) / u64::from(probes - 1)).camera;
            let v = |v: DVec3| v.to_array().map(|number| number.to_string()).join(",");
            let (eye, target, up) = (v(pose.eye), v(pose.target), v(pose.up));
            let place =
                format!("eye={eye}&target={target}&up={up}&fov={}", pose.lens.parameter().1);
            let size = format!("w={}&h={}&format=jpeg&quality={QUALITY}", SIZE[0], SIZE[1]);
            let frame = format!("/v1/scenes/{SCENE}/frame?{place}&{size}&lod=spt");
            let receipt = connection.get(&frame, "")?.receipt()?;
            device_ms += ms(receipt["gpu_ns"].as_u64().context("no timestamps")?);
            encode_ms += ms(receipt["encode_ns"].as_u64().context("no encode_ns")?);
        }
        Ok([device_ms, encode_ms].map(|ms| ms * 1e-3 * frames as f64 / f64::from(probes)))
    };
    work()?;
    let before = work()?;
    let mut client = daemon.connect()?;
    let began = Instant::now();
    let place = start_job(&mut client, fps)?;
    let (done, elapsed) = loop {
        let job: Value = serde_json::from_slice(&client.get(&place, "")?.body)?;
        match job["state"].as_str() {
            Some("done") => {
                break (job["frames"]["done"].as_u64().unwrap_or(0), began.elapsed().as_secs_f64());
            }
            // Asking costs time, too.
            Some("queued" | "running") => std::thread::sleep(Duration::from_millis(50)),
            _ => bail!("{job}"),
        }
    };
    ensure!(done == frames, "{done} of {frames} frames");
    let after = work()?;
    let [device_s, encode_s] = [0, 1].map(|at| 0.5 * (before[at] + after[at]));
    let cores = std::thread::available_parallelism().map_or(1, usize::from) as f64;
    // On a CPU adapter passes and encoder share the cores, on a GPU each has its own.
    let is_cpu = adapter.contains("llvmpipe");
    let allowed_s = match is_cpu {
        true => device_s + encode_s / cores,
        false => device_s.max(encode_s / cores),
    };
    report.table(
        "A job: a camera path as JPEGs, beside the same frames one at a time",
        &["frames", "seconds", "frames/s", "GPU s alone", "encode s alone", "of what these allow"],
        &[vec![
            done.to_string(),
            number(elapsed),
            number(done as f64 / elapsed),
            number(device_s),
            number(encode_s),
            number(allowed_s / elapsed),
        ]],
    );
    let what = "rate of a job of 300 frames, of what its passes and encoding allow";
    report.target(what, Some(allowed_s / elapsed), Bound::AtLeast(0.9), "");
    Ok(())
}

/// Draws that square in a remote view of trame, by VTK with a glyph mapper for each kind of mesh; and what VTK needs of that on the
/// server's side alone, without trame and network. In turns.
fn remote(report: &mut Report, daemon: &Daemon) -> anyhow::Result<()> {
    let file = copies()?;
    let mut rows = Vec::new();
    for (name, orbit) in [("from above", orbit()), ("at eye height", walk())] {
        let Beside { ours, trame, vtk } = beside_peers(report, daemon, &file, name, &orbit)?;
        let ratio = (!trame.is_empty()).then(|| median_ratio(&trame, &ours));
        let what = format!("frames/s of a stream against a remote view of trame, {name}");
        report.target(&what, ratio, Bound::AtLeast(8.0), "×");
        for (who, times) in [
            ("a stream, whole way", &ours),
            ("trame, whole way", &trame),
            ("VTK, server's side alone", &vtk),
        ] {
            if times.is_empty() {
                continue;
            }
            let ms = median(times);
            rows.push(vec![
                format!("{name}: {who}"),
                number(ms),
                number(1e3 / ms),
                number(median_ratio(times, &ours)),
            ]);
        }
    }
    report.table(
        "The same square at 640×480, one frame at a time",
        &["view", "ms a frame", "frames/s", "× the stream's"],
        &rows,
    );
    Ok(())
}

/// Milliseconds of frames in turns; empty where the peer is not installed.
struct Beside {
    ours: Vec<f64>,
    trame: Vec<f64>,
    vtk: Vec<f64>,
}

fn beside_peers(
    report: &mut Report,
    daemon: &Daemon,
    file: &Path,
    name: &str,
    orbit: &Orbit,
) -> anyhow::Result<Beside> {
    let (width, height) = (SIZE[0], SIZE[1]);
    let size = format!("--size={width}x{height}");
    let (quality, remote) = (format!("--quality={QUALITY}"), format!("--remote={QUALITY}"));
    let mut trame = Peer::trame(file, orbit, width, &[&size, &quality])?;
    let mut vtk = Peer::vtk(file, orbit, width, &[&size, &remote])?;
    let mut stream = open(daemon.address)?;
    let mut beside = Beside { ours: Vec::new(), trame: Vec::new(), vtk: Vec::new() };
    let mut bytes = Vec::new();
    let (warm, count) = pick((3, 20), (1, 2));
    for number in 0..warm + count {
        let degrees = f64::from(number) * 0.5;
        for (peer, times) in [(&mut trame, &mut beside.trame), (&mut vtk, &mut beside.vtk)] {
            let Some(peer) = peer else { continue };
            let ms = peer.frame_ms(degrees)?;
            if number >= warm {
                times.push(ms);
            }
        }
        let seq = stream.next_seq();
        let began = Instant::now();
        stream.send(&pose_on(orbit, seq, degrees, false))?;
        let frame = stream.frame_of(seq)?;
        let waited = began.elapsed().as_secs_f64() * 1e3;
        stream.acknowledge(&frame)?;
        if number >= warm {
            beside.ours.push(waited);
            bytes.push(frame["bytes"].as_f64().unwrap_or(f64::NAN));
        }
    }
    let name = name.replace(' ', "_");
    for (peer, what) in [(trame, "trame"), (vtk, "vtk")] {
        if let Some(peer) = peer {
            report.value(&format!("remote_view_{what}_{name}"), peer.finish()?);
        }
    }
    report.value(&format!("stream_jpeg_bytes_{name}"), median(&bytes));
    Ok(beside)
}

/// The square's copies for VTK: each file with its matrices.
fn copies() -> anyhow::Result<PathBuf> {
    let (path, root) = (Path::new("scenes/plaza.json"), Path::new("scenes"));
    let limits = SceneLimits::default();
    let scene = prepare::describe(path, root, &limits)?;
    let mut assembler = Assembler::new(path, &scene, &Default::default());
    let mut placements = Vec::new();
    let mut files = Vec::new();
    for (index, reference) in scene.assets.iter().enumerate() {
        placements.push(assembler.asset(index)?.asset.placements);
        files.push(root.join(format!("plaza-{}.ply", reference.name)));
    }
    let mut matrices: Vec<Vec<[f64; 16]>> = vec![Vec::new(); files.len()];
    for placed in prepare::placed(&scene, &placements) {
        matrices[placed.asset].push(glam::DMat4::from(placed.world_from_geometry).to_cols_array());
    }
    let parts: Vec<Value> = files
        .iter()
        .zip(matrices)
        .map(|(file, matrices)| json!({ "file": file, "matrices": matrices }))
        .collect();
    let out = common::folder().join("plaza-copies.json");
    std::fs::create_dir_all(common::folder())?;
    std::fs::write(&out, serde_json::to_vec(&parts)?)?;
    Ok(out)
}
