//! A cloud of 40 million points in a LAS file: when its first picture is there, after the first start and after a later one, and
//! what reading the same coordinates costs laspy and PDAL.

mod common;

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::Context;
use common::daemon::Daemon;
use common::drawing::Drawing;
use common::report::{Bound, Report, number};
use common::{files, folder, median, pick};
use pointillist::generate::{Kind, Parameters};

/// Python that reads all coordinates in units of the file's reference system.
const LASPY: &str =
    "import laspy, numpy, sys; numpy.ascontiguousarray(laspy.read(sys.argv[1]).xyz)";

/// Longest wait for the cloud to be in the cache.
const PATIENCE: Duration = Duration::from_secs(300);

/// A start with the file and its first picture.
struct Start {
    seconds: f64,
    peak_bytes_a_point: Option<f64>,
}

fn main() -> anyhow::Result<()> {
    let count: u64 = pick(40_000_000, 400_000);
    let parameters = Parameters { seed: 1, points: Some(count), ..Parameters::default() };
    let file = files::generated(&format!("town-{count}.las"), Kind::Town, &parameters)?;
    let adapter = Drawing::open(Path::new("scenes/relief.json"), 16, |_| ())?.engine.adapter();
    let mut report = Report::new("large", &adapter);
    let (mut first, mut second, mut laspy, mut pdal) = (vec![], vec![], vec![], vec![]);
    let mut peaks = Vec::new();
    for _ in 0..pick(3, 1) {
        let cache = tempfile::tempdir()?;
        let begun = start(&file, count, cache.path())?;
        first.push(begun.seconds);
        peaks.extend(begun.peak_bytes_a_point);
        second.push(start(&file, count, cache.path())?.seconds);
        laspy.extend(seconds_of("target/peers/venv/bin/python", &["-c", LASPY], &file)?);
        pdal.extend(seconds_of("pdal", &["info", "--stats", "--dimensions", "X,Y,Z"], &file)?);
    }
    let row = |what: &str, seconds: &[f64]| {
        let shown =
            if seconds.is_empty() { "not installed".to_owned() } else { number(median(seconds)) };
        vec![what.to_owned(), shown]
    };
    let rows = [
        row("first start: read, packed, drawn at 1024 × 768", &first),
        row("second start: taken from the cache, drawn", &second),
        row("laspy: coordinates in memory", &laspy),
        row("pdal info --stats: coordinates read once", &pdal),
    ];
    report.table(&format!("{count} points in a LAS file"), &["what", "seconds"], &rows);
    report.target("first picture", Some(median(&first)), Bound::AtMost(12.0), "s");
    report.target(
        "first picture of a second start",
        Some(median(&second)),
        Bound::AtMost(6.0),
        "s",
    );
    let peak = (!peaks.is_empty()).then(|| median(&peaks));
    report.target("peak memory a point", peak, Bound::AtMost(64.0), "B");
    report.finish()
}

/// Starts a daemon with the file and asks it for a picture, which is drawn with what is there.
fn start(file: &Path, count: u64, kept: &Path) -> anyhow::Result<Start> {
    let name = file.file_name().context("a file has a name")?.to_string_lossy();
    let (began, cache) = (Instant::now(), kept.to_string_lossy());
    let daemon = Daemon::start(&folder(), &[&name], &["--no-cache=false", "--cache", &cache])?;
    let id = file.file_stem().context("a file has a name")?.to_string_lossy();
    let path = format!("/v1/scenes/{id}/frame?w=1024&h=768&format=jpeg");
    let answer = daemon.connect()?.get(&path, "")?;
    anyhow::ensure!(answer.status == 200, "{path}: {}", answer.status);
    let seconds = began.elapsed().as_secs_f64();
    let peak = daemon.memory_mib("VmHWM").map(|mib| mib * 1_048_576.0 / count as f64);
    // It is kept in the background.
    let is_note = |entry: &std::fs::DirEntry| entry.path().extension() == Some("note".as_ref());
    while !std::fs::read_dir(kept)?.flatten().any(|entry| is_note(&entry)) {
        anyhow::ensure!(began.elapsed() < PATIENCE, "the cloud is not kept in {}", kept.display());
        std::thread::sleep(Duration::from_millis(50));
    }
    Ok(Start { seconds, peak_bytes_a_point: peak })
}

/// Seconds that a program takes with the file as its last argument; `None` where it is not installed.
fn seconds_of(program: &str, args: &[&str], file: &Path) -> anyhow::Result<Option<f64>> {
    let began = Instant::now();
    let output = Command::new(program).args(args).arg(file).stdin(Stdio::null()).output();
    let Ok(output) = output else { return Ok(None) };
    let told = String::from_utf8_lossy(&output.stderr);
    if told.contains("No module named") {
        return Ok(None);
    }
    anyhow::ensure!(output.status.success(), "{program}: {told}");
    Ok(Some(began.elapsed().as_secs_f64()))
}
