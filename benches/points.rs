//! Eight million random samples at 1024²: what their projection costs, beside VTK drawing the same file at the same poses.

mod common;

use std::path::Path;

use common::drawing::{Drawing, Orbit, pass_medians, pass_ns};
use common::peer::{self, PYVISTA};
use common::report::{Bound, Report, number};
use common::{files, median, median_ratio, ms, pick};
use glam::DVec3;
use pointillist::engine::Receipt;

const SIZE: u32 = 1024;

/// How VTK may be told to draw points: names and arguments. The first is its fastest.
const WAYS: [(&str, &[&str]); 8] = [
    ("1 px, unlit, no multisamples", &[]),
    ("PyVista's defaults: 5 px, lit, 8 multisamples", PYVISTA),
    ("VTK's defaults: 1 px, lit, 8 multisamples", &["--lighting", "--multisamples=8"]),
    ("one colour for all", &["--colors=none"]),
    ("heights through a lookup table", &["--colors=lut"]),
    ("spheres of 5 px", &["--point-size=5", "--lighting", "--spheres"]),
    ("vtkPointGaussianMapper, scale 0", &["--mode=point-gaussian"]),
    ("vtkPointGaussianMapper, discs", &["--mode=splats", "--radius=0.003"]),
];

/// Frames of ours and of VTK's, in turns.
struct Turns {
    receipts: Vec<Receipt>,
    project_ms: Vec<f64>,
    peer_ms: Vec<f64>,
}

fn main() -> anyhow::Result<()> {
    let count = pick(8_000_000, 80_000);
    let file = files::random_points(count)?;
    let orbit = Orbit { eye: DVec3::new(0.0, 0.0, 4.0), target: DVec3::ZERO, fov_deg: 45.0 };
    let ours = Drawing::open(&file, SIZE, |_| ())?;
    let mut report = Report::new("points", &ours.engine.adapter());
    report.value("samples", count);
    report.value("size_px", SIZE);
    for warm in 0..3 {
        ours.receipt(orbit.at(f64::from(warm) - 10.0))?;
    }
    let mut ways = WAYS.iter();
    let (name, args) = ways.next().copied().unwrap_or_default();
    let fast = take_turns(&mut report, &ours, &file, &orbit, name, args, pick(11, 2))?;
    passes(&mut report, count, &fast);

    let gpu: Vec<f64> = fast.receipts.iter().filter_map(|receipt| receipt.gpu_ns.map(ms)).collect();
    let totals: Vec<f64> = fast.receipts.iter().map(|receipt| ms(receipt.total_ns)).collect();
    let mut rows: Vec<Vec<String>> = [
        ("Pointillist, project_samples", &fast.project_ms),
        ("Pointillist, all passes", &gpu),
        ("Pointillist, finished JPEG", &totals),
    ]
    .into_iter()
    .map(|(name, times)| row(name, count, times, median_ratio(times, &fast.project_ms)))
    .collect();
    let mut ratios = Vec::new();
    if !fast.peer_ms.is_empty() {
        let ratio = median_ratio(&fast.peer_ms, &fast.project_ms);
        ratios.push(ratio);
        rows.push(row(&format!("VTK, {name}"), count, &fast.peer_ms, ratio));
        for (name, args) in ways.take(pick(WAYS.len(), 1)) {
            let turns = take_turns(&mut report, &ours, &file, &orbit, name, args, pick(3, 1))?;
            let ratio = median_ratio(&turns.peer_ms, &turns.project_ms);
            ratios.push(ratio);
            rows.push(row(&format!("VTK, {name}"), count, &turns.peer_ms, ratio));
        }
    }
    let header = ["how", "ms a frame", "M samples/s", "times project_samples"];
    report.table("The same points at the same poses", &header, &rows);
    let target = Bound::AtLeast(100.0);
    let what = "projecting 8 M samples at 1024², against VTK at its fastest";
    report.target(what, ratios.first().copied(), target, "×");
    let what = "projecting 8 M samples at 1024², against VTK as PyVista sets it up";
    report.target(what, ratios.get(1).copied(), target, "×");
    report.finish()
}

fn row(name: &str, count: u64, times_ms: &[f64], ratio: f64) -> Vec<String> {
    let time = median(times_ms);
    vec![name.to_owned(), number(time), number(count as f64 / time / 1e3), number(ratio)]
}

/// Frames with both; see [`peer::take_turns`].
fn take_turns(
    report: &mut Report,
    ours: &Drawing,
    file: &Path,
    orbit: &Orbit,
    name: &str,
    args: &[&str],
    frames: u32,
) -> anyhow::Result<Turns> {
    let name = format!("vtk, {name}");
    let peer::Turns { receipts, peer_ms } =
        peer::take_turns(report, ours, file, orbit, SIZE, &name, args, frames)?;
    // Adapters without 64-bit atomics go through the samples twice.
    let both = |receipt| -> anyhow::Result<f64> {
        let second = pass_ns(receipt, "project_samples_id")?;
        Ok(ms(pass_ns(receipt, "project_samples")? + second))
    };
    let project_ms = receipts.iter().map(both).collect::<Result<_, _>>()?;
    Ok(Turns { receipts, project_ms, peer_ms })
}

/// The time of each pass.
fn passes(report: &mut Report, count: u64, turns: &Turns) {
    let mut rows = Vec::new();
    for (name, time) in pass_medians(&turns.receipts) {
        report.value(&format!("{name}_ms"), time);
        rows.push(vec![name.to_owned(), number(time)]);
    }
    report.table("Our passes", &["pass", "median ms"], &rows);
    report.value("samples_per_s", count as f64 / median(&turns.project_ms) * 1e3);
}
