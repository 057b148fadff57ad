//! A statue of five million samples to a finished JPEG, beside VTK: render, read back, JPEG.

mod common;

use common::drawing::{Drawing, Orbit, pass_medians};
use common::peer::{self, PYVISTA, Turns};
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
    let mut turns = |name, args: &[&str], frames| {
        let args = [&["--jpeg=85"], args].concat();
        peer::take_turns(&mut report, &ours, &file, &orbit, SIZE, name, &args, pick(frames, 2))
    };
    let Turns { receipts, peer_ms } = turns("vtk", &[], 15)?;
    let Turns { receipts: slow_receipts, peer_ms: slow_ms } =
        turns("vtk as PyVista sets it up", PYVISTA, 5)?;

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

/// Share of the time from the request to the JPEG that the passes and the steps around them explain; `None` without
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
