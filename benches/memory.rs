//! Memory: bytes on the GPU for each sample and triangle, and what loading eight million samples takes at its peak.

mod common;

use std::path::{Path, PathBuf};

use common::daemon::Daemon;
use common::drawing::Drawing;
use common::report::{Bound, Report, number};
use common::{files, folder, pick};
use pointillist::generate::{Kind, Parameters};

fn main() -> anyhow::Result<()> {
    let count = pick(8_000_000, 80_000);
    let random = files::random_points(count)?;
    let made = |points, triangles| Parameters {
        seed: 1,
        points,
        triangles,
        size: None,
        count: None,
        form: None,
    };
    let statue_points = pick(5_000_000, 50_000);
    let statue = files::generated(
        &format!("statue-{statue_points}.ply"),
        Kind::Statue,
        &made(Some(statue_points), None),
    )?;
    let relief_triangles = pick(400_000, 40_000);
    let relief = files::generated(
        &format!("relief-{relief_triangles}.ply"),
        Kind::Relief,
        &made(None, Some(relief_triangles)),
    )?;
    let mut report = Report::new("memory", &Drawing::open(&random, 16, |_| ())?.engine.adapter());
    let worst = on_gpu(&mut report, &random, &statue, &relief)?;
    let loading = while_loading(&mut report, &random, count)?;
    report.target("GPU bytes a sample, all tables included", worst, Bound::AtMost(24.0), "B");
    if let Some(peak) = loading {
        report.value("loading_peak_mib", peak);
    }
    report.finish()
}

/// GPU bytes by the engine's own account; gives the most that a sample takes.
fn on_gpu(
    report: &mut Report,
    random: &Path,
    statue: &Path,
    relief: &Path,
) -> anyhow::Result<Option<f64>> {
    let mut assets = vec![
        ("random points, colours", random.to_path_buf()),
        ("statue, colours and normals", statue.to_path_buf()),
        ("town scan, colours", PathBuf::from("scenes/town-scan.laz")),
        ("relief, normals and colours", relief.to_path_buf()),
        ("amphora, textured", PathBuf::from("scenes/textured-amphora.obj")),
    ];
    assets.extend(files::dragon().map(|file| ("Stanford dragon", file)));
    let (mut rows, mut worst) = (Vec::new(), None);
    for (name, file) in assets {
        let info = Drawing::open(&file, 16, |_| ())?.info;
        let each = info.gpu_bytes as f64 / (info.samples + info.triangles) as f64;
        if info.triangles == 0 {
            worst = Some(each.max(worst.unwrap_or(0.0)));
        }
        report.value(&format!("{name}, GPU bytes each"), each);
        rows.push(vec![
            name.to_owned(),
            info.samples.to_string(),
            info.triangles.to_string(),
            number(info.gpu_bytes as f64 / 1e6),
            number(each),
        ]);
    }
    report.table("On the GPU", &["asset", "samples", "triangles", "MB", "bytes each"], &rows);
    Ok(worst)
}

/// A daemon that loads the file and draws it once; gives the peak in MiB.
fn while_loading(report: &mut Report, file: &Path, count: u64) -> anyhow::Result<Option<f64>> {
    let name = file.file_name().map(|name| name.to_string_lossy()).unwrap_or_default();
    let empty = Daemon::start(Path::new("scenes"), &["relief.json"], &[])?;
    let before = empty.memory_mib("VmRSS");
    drop(empty);
    let daemon = Daemon::start(&folder(), &[&name], &[])?;
    let mut rows = Vec::new();
    let mut row = |when: &str| {
        let (now, peak) = (daemon.memory_mib("VmRSS"), daemon.memory_mib("VmHWM"));
        let shown = |value: Option<f64>| value.map_or("—".to_owned(), number);
        let each = peak.map(|mib| mib * 1_048_576.0 / count as f64);
        rows.push(vec![when.to_owned(), shown(now), shown(peak), shown(each)]);
        peak
    };
    row("loaded");
    let mut connection = daemon.connect()?;
    let scenes: serde_json::Value =
        serde_json::from_slice(&connection.get("/v1/scenes", "")?.body)?;
    let id = scenes["scenes"][0]["id"].as_str().or_else(|| scenes[0]["id"].as_str());
    let id = id.unwrap_or_default().to_owned();
    let answer = connection.get(&format!("/v1/scenes/{id}/frame?w=1024&h=1024&format=jpeg"), "")?;
    anyhow::ensure!(answer.status == 200, "a frame was answered with {}", answer.status);
    let drawn = row("after the first frame");
    rows.push(vec![
        "for comparison: a daemon with a scene of 37 thousand triangles".to_owned(),
        before.map_or("—".to_owned(), number),
        "—".to_owned(),
        "—".to_owned(),
    ]);
    report.value("load_s", daemon.start.as_secs_f64());
    println!("\nloading took {} s", number(daemon.start.as_secs_f64()));
    report.table(
        &format!("The daemon's memory with {count} samples (a software adapter's is in it)"),
        &["when", "resident MiB", "peak MiB", "peak bytes a sample"],
        &rows,
    );
    Ok(drawn)
}
