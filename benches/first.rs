//! The first frame of a fresh daemon, mode by mode: with no compiled shader on the disk (cold) and after an earlier process
//! (warm), asked for as soon as the daemon is ready and once pipelines have been built ahead; and without building ahead.

mod common;

use std::path::Path;
use std::time::{Duration, Instant};

use common::daemon::Daemon;
use common::report::{Bound, Report, number};
use common::{median, pick};

const SCENE: &str = "plaza.json";
const MODES: [(&str, &str); 4] = [
    ("points", "reconstruct=points"),
    ("splats", "reconstruct=splats"),
    ("spt", "lod=spt"),
    ("normal", "output=normal"),
];
/// The list of used pipelines is written down every two seconds.
const WRITTEN_DOWN: Duration = Duration::from_millis(2500);

/// Milliseconds of the first frame of each kind of daemon, and of the second frame.
struct Times {
    unprimed_cold: Vec<f64>,
    cold: Vec<f64>,
    cold_primed: Vec<f64>,
    warm: Vec<f64>,
    warm_primed: Vec<f64>,
    second: Vec<f64>,
}

fn main() -> anyhow::Result<()> {
    let probe = common::drawing::Drawing::open(Path::new("scenes/plaza.json"), 16, |_| ())?;
    let mut report = Report::new("first", &probe.engine.adapter());
    drop(probe);
    let (mut rows, mut slowest) = (Vec::new(), [0.0f64; 2]);
    for (name, query) in MODES {
        let times = measure(query)?;
        let columns = [
            &times.unprimed_cold,
            &times.cold,
            &times.cold_primed,
            &times.warm,
            &times.warm_primed,
            &times.second,
        ];
        slowest[0] = slowest[0].max(median(&times.cold));
        slowest[1] = slowest[1].max(median(&times.warm));
        let figures = columns.map(|times| number(median(times)));
        rows.push([&[name.to_owned()], &figures[..]].concat());
    }
    let header = [
        "mode",
        "not built ahead, cold, ms",
        "cold, at once",
        "cold, built ahead",
        "warm, at once",
        "warm, built ahead",
        "second frame",
    ];
    report.table(&format!("First frame of {SCENE}, 640 × 480"), &header, &rows);
    report.target("slowest first frame, cold", Some(slowest[0]), Bound::AtMost(1000.0), "ms");
    report.target("slowest first frame, warm", Some(slowest[1]), Bound::AtMost(300.0), "ms");
    report.finish()
}

fn measure(query: &str) -> anyhow::Result<Times> {
    let mut times = Times {
        unprimed_cold: Vec::new(),
        cold: Vec::new(),
        cold_primed: Vec::new(),
        warm: Vec::new(),
        warm_primed: Vec::new(),
        second: Vec::new(),
    };
    let path = format!("/v1/scenes/plaza/frame?camera=overview&w=640&h=480&{query}");
    for _ in 0..pick(5, 1) {
        let folder = tempfile::tempdir()?;
        let fresh = |name: &str| folder.path().join(name);
        times.unprimed_cold.push(frame(&start(&fresh("a"), false)?, &path)?);
        times.cold.push(frame(&start(&fresh("b"), true)?, &path)?);
        let kept = fresh("c");
        let daemon = start(&kept, true)?;
        await_primed(&daemon)?;
        times.cold_primed.push(frame(&daemon, &path)?);
        times.second.push(frame(&daemon, &path)?);
        std::thread::sleep(WRITTEN_DOWN);
        drop(daemon);
        times.warm.push(frame(&start(&kept, true)?, &path)?);
        let daemon = start(&kept, true)?;
        await_primed(&daemon)?;
        times.warm_primed.push(frame(&daemon, &path)?);
    }
    Ok(times)
}

fn start(kept: &Path, is_primed: bool) -> anyhow::Result<Daemon> {
    let cache = kept.to_string_lossy();
    let no_prime = format!("--no-prime={}", !is_primed);
    let args = ["--no-cache=false", "--cache", &cache, &no_prime];
    std::fs::create_dir_all(kept)?;
    Daemon::start_with(
        Path::new("scenes"),
        &[SCENE],
        &args,
        &[("MESA_SHADER_CACHE_DIR", kept.as_os_str())],
    )
}

fn frame(daemon: &Daemon, path: &str) -> anyhow::Result<f64> {
    let mut connection = daemon.connect()?;
    let began = Instant::now();
    let answer = connection.get(path, "")?;
    anyhow::ensure!(answer.status == 200, "{path}: {}", answer.status);
    Ok(began.elapsed().as_secs_f64() * 1e3)
}

/// Waits until no more pipelines are built ahead.
fn await_primed(daemon: &Daemon) -> anyhow::Result<()> {
    let mut before = -1.0;
    loop {
        let now = daemon.metric("pointillist_engine_pipelines_primed_total")?;
        if now == before && now > 0.0 {
            return Ok(());
        }
        before = now;
        std::thread::sleep(Duration::from_secs(1));
    }
}
