//! A statue of five million samples to a finished JPEG, beside VTK: render, read back, JPEG.

mod common;

use std::path::Path;

use common::drawing::{Drawing, Orbit, STEP_DEG, pass_medians};
use common::peer::{PYVISTA, Vtk};
use common::report::{Bound, Report, number};
use common::{files, median, median_ratio, ms, pick};
use pointillist::engine::Receipt;
use pointillist::generate::{Kind, Parameters};

const SIZE: u32 = 1024;

fn main() -> anyhow::Result<()> {
    let points = pick(5_000_000, 50_000);
    let parameters = Parameters { seed: 1, points: Some(points), ..Parameters::default() };
    let file = files::generated(&format!("statue-{points}.ply"), Kind::Statue, &parameters)?;
    let ours = Drawing::open(&file, SIZE, |_| ())?;
    let orbit = Orbit::around(&ours.info)?;
    let mut report = Report::new("statue", &ours.engine.adapter());
    report.value("samples", ours.info.samples);
    report.value("size_px", SIZE);
    for warm in 0..3 {
        ours.receipt(orbit.at(f64::from(warm) - 10.0))?;
    }
    let (receipts, peer_ms) = take_turns(&mut report, &ours, &file, &orbit, "vtk", &[], 15)?;
    let name = "vtk as PyVista sets it up";
    let (slow_receipts, slow_ms) = take_turns(&mut report, &ours, &file, &orbit, name, PYVISTA, 5)?;

    let part = |of: fn(&Receipt) -> u64| {
        median(&receipts.iter().map(|receipt| ms(of(receipt))).collect::<Vec<_>>())
    };
    let mut rows: Vec<Vec<String>> = pass_medians(&receipts)
        .into_iter()
        .map(|(name, time)| vec![format!("pass {name}"), number(time)])
        .collect();
    let total = part(|receipt| receipt.total_ns);
    for (name, time) in [
        ("record", part(|receipt| receipt.record_ns)),
        ("readback", part(|receipt| receipt.readback_ns)),
        ("wait for an encoder", part(|receipt| receipt.encode_wait_ns)),
        ("encode", part(|receipt| receipt.encode_ns)),
        ("finished JPEG, all in all", total),
    ] {
        report.value(&format!("{name} ms"), time);
        rows.push(vec![name.to_owned(), number(time)]);
    }
    for (how, times) in [("at its fastest", &peer_ms), ("as PyVista sets it up", &slow_ms)] {
        if !times.is_empty() {
            let step = format!("VTK {how}: draw, read back, JPEG");
            rows.push(vec![step, number(median(times))]);
        }
    }
    report.table("From pose to JPEG", &["step", "ms"], &rows);
    for (how, times, receipts) in [
        ("at its fastest", &peer_ms, &receipts),
        ("as PyVista sets it up", &slow_ms, &slow_receipts),
    ] {
        let totals: Vec<f64> = receipts.iter().map(|receipt| ms(receipt.total_ns)).collect();
        report.target(
            &format!("5 M-sample statue to finished JPEG, against VTK {how}"),
            (!times.is_empty()).then(|| median_ratio(times, &totals)),
            Bound::AtLeast(50.0),
            "×",
        );
    }
    let explained: Vec<f64> = receipts.iter().filter_map(explained_percent).collect();
    report.target(
        "the receipt's passes and steps explain the frame's time",
        (!explained.is_empty()).then(|| median(&explained)),
        Bound::AtLeast(95.0),
        "%",
    );
    report.finish()
}

/// Frames of ours and of VTK's in turns: receipts, and milliseconds where VTK is installed.
fn take_turns(
    report: &mut Report,
    ours: &Drawing,
    file: &Path,
    orbit: &Orbit,
    name: &str,
    args: &[&str],
    frames: u32,
) -> anyhow::Result<(Vec<Receipt>, Vec<f64>)> {
    let args: Vec<&str> = [&["--jpeg=85"], args].concat();
    let mut vtk = Vtk::start(file, orbit, SIZE, &args)?;
    let (mut receipts, mut peer_ms) = (Vec::new(), Vec::new());
    for frame in 0..pick(frames, 2) {
        let degrees = f64::from(frame) * STEP_DEG + 5.0;
        receipts.push(ours.receipt(orbit.at(degrees))?);
        if let Some(vtk) = &mut vtk {
            peer_ms.push(vtk.frame_ms(degrees)?);
        }
    }
    report.value(name, vtk.map(|vtk| vtk.finish()).transpose()?);
    Ok((receipts, peer_ms))
}

/// What the passes and the steps around them sum up to, of the time from the request to the JPEG; `None` without
/// timestamps.
fn explained_percent(receipt: &Receipt) -> Option<f64> {
    let ran = receipt.passes.iter().filter(|pass| pass.ran);
    let passes: u64 = ran.map(|pass| pass.gpu_ns).sum::<Option<u64>>()?;
    let steps = receipt.queue_ns
        + receipt.record_ns
        + receipt.readback_ns
        + receipt.encode_wait_ns
        + receipt.encode_ns;
    Some(100.0 * (passes + steps) as f64 / receipt.total_ns as f64)
}
