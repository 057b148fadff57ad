//! Pull-push by the number of samples, beside Table 1 of the paper, and beside projecting eight million samples.
//!
//! The paper is R. Marroquim, M. Kraus, P. R. Cavalcanti, "Efficient image reconstruction for point-based and line-based rendering",
//! Computers & Graphics 2008. Its columns are frames without the buffer of colours, which are drawn here as normals, and with it.

mod common;

use anyhow::Context;
use common::drawing::{Drawing, Orbit, STEP_DEG, gpu_ms, pass_medians, pass_ns};
use common::report::{Bound, Report, number};
use common::{files, median, median_ratio, ms, pick};
use pointillist::engine::Receipt;
use pointillist::generate::{Kind, Parameters};
use pointillist::plan::{Output, Reconstruct, Settings};

const SIZE: u32 = 1024;
/// The models of Table 1; the paper's time of a frame, of projection and of pull-push, without colours and with them.
const PAPER: [(u64, [f64; 3], [f64; 3]); 4] = [
    (173_000, [11.0, 1.2, 8.5], [22.0, 1.5, 18.0]),
    (437_000, [13.0, 2.2, 8.9], [23.0, 2.9, 18.0]),
    (3_610_000, [28.0, 18.0, 8.3], [45.0, 25.0, 17.0]),
    (5_000_000, [35.0, 25.0, 8.2], [55.0, 34.0, 18.0]),
];
const SAMPLES: [u64; 5] = [173_000, 437_000, 871_000, 2_000_000, 5_000_000];
const OUTPUTS: [(&str, Output); 2] = [("normals", Output::Normal), ("lit colours", Output::Color)];
/// Pull-push, and all of it with the pixels of its result.
const PYRAMID: [&str; 2] = ["pull", "push"];
const WHOLE: [&str; 4] = ["record_samples", "pull", "push", "resolve_pulled"];

fn main() -> anyhow::Result<()> {
    let side = pick(SIZE, 256);
    let mut scenes: Vec<(u64, Drawing, Orbit)> = Vec::new();
    for samples in SAMPLES {
        let count = pick(samples, samples / 100);
        let parameters = Parameters { seed: 1, points: Some(count), ..Parameters::default() };
        let file = files::generated(&format!("statue-{count}.ply"), Kind::Statue, &parameters)?;
        let drawing = match scenes.first() {
            Some((_, first, _)) => first.beside(&file)?,
            None => Drawing::open(&file, side, |_| ())?,
        };
        let orbit = Orbit::around(&drawing.info)?;
        scenes.push((samples, drawing, orbit));
    }
    let first = &scenes.first().context("no scenes")?.1;
    let mut report = Report::new("pull_push", &first.engine.adapter());
    let many = first.beside(&files::random_points(pick(8_000_000, 80_000))?)?;
    let (receipts, projections) = draw(&scenes, &many, side)?;
    let mut rows = Vec::new();
    for (output, (name, _)) in OUTPUTS.iter().enumerate() {
        let mut wholes = Vec::new();
        let mut pyramids = Vec::new();
        for (scene, (samples, drawing, _)) in scenes.iter().enumerate() {
            let of = &receipts[output][scene];
            let median_of = |passes: &[&str]| Ok::<f64, anyhow::Error>(median(&sums(of, passes)?));
            let frame = of.iter().map(gpu_ms).collect::<Result<Vec<f64>, _>>()?;
            let [project, pyramid, whole] =
                [median_of(&["project_samples"])?, median_of(&PYRAMID)?, median_of(&WHOLE)?];
            pyramids.push(pyramid);
            wholes.push(whole);
            let paper = PAPER.iter().find(|(count, _, _)| count == samples);
            let paper = paper.map(|row| if output == 0 { row.1 } else { row.2 });
            let filled: Vec<f64> =
                of.iter().map(|receipt| receipt.holes_filled.unwrap_or(0) as f64).collect();
            let mut row = vec![(*name).to_owned(), drawing.info.samples.to_string()];
            row.extend([median(&frame), project, pyramid, whole, median(&filled)].map(number));
            row.push(paper.map_or("—".to_owned(), |of| of.map(number).join(", ")));
            rows.push(row);
            report.value(&format!("{name}, {samples} samples, frame ms"), median(&frame));
            report.value(&format!("{name}, {samples} samples, projection ms"), project);
            report.value(&format!("{name}, {samples} samples, pull and push ms"), pyramid);
            report.value(&format!("{name}, {samples} samples, all of pull-push ms"), whole);
        }
        for (what, times) in
            [("pull and push", &pyramids), ("recording, pull, push and resolving", &wholes)]
        {
            let mean = times.iter().sum::<f64>() / times.len() as f64;
            let off =
                times.iter().map(|time| 100.0 * (time / mean - 1.0).abs()).fold(0.0, f64::max);
            let what =
                format!("{what} over five sizes, {name}: largest difference from their mean");
            report.target(&what, Some(off), Bound::AtMost(20.0), "%");
        }
    }
    report.table(
        &format!(
            "Statues at {side}² by pull-push, ms; the paper's frame, projection and pull-push on a GeForce 8800 GTS, other models of as many \
             points"
        ),
        &[
            "output",
            "samples",
            "frame",
            "projection",
            "pull and push",
            "with recording and resolving",
            "pixels filled",
            "paper",
        ],
        &rows,
    );
    let colored = &receipts[1];
    let largest = colored.last().context("no receipts")?;
    let rows: Vec<Vec<String>> = pass_medians(largest)
        .into_iter()
        .zip(pass_medians(colored.first().context("no receipts")?))
        .map(|((name, most), (_, least))| vec![name.to_owned(), number(least), number(most)])
        .collect();
    report.table(
        &format!("Passes of a frame with lit colours at {side}², ms"),
        &["pass", "fewest samples", "most samples"],
        &rows,
    );
    let projecting = projections
        .iter()
        .map(|receipt| pass_ns(receipt, "project_samples").map(ms))
        .collect::<anyhow::Result<Vec<f64>>>()?;
    report.value("projecting 8 M samples, ms", median(&projecting));
    for (output, (name, _)) in OUTPUTS.iter().enumerate() {
        let slowest = receipts[output]
            .iter()
            .map(|of| Ok(median_ratio(&sums(of, &PYRAMID)?, &projecting)))
            .collect::<anyhow::Result<Vec<f64>>>()?;
        let slowest = slowest.into_iter().fold(0.0, f64::max);
        let what = format!("pull and push, {name}, over projecting 8 M samples at {side}²");
        report.target(&what, Some(slowest), Bound::AtMost(1.0), "×");
    }
    report.finish()
}

/// Milliseconds of some passes together, by receipt.
fn sums(of: &[Receipt], passes: &[&str]) -> anyhow::Result<Vec<f64>> {
    of.iter()
        .map(|receipt| {
            let times = passes.iter().map(|name| pass_ns(receipt, name));
            Ok(ms(times.sum::<anyhow::Result<u64>>()?))
        })
        .collect()
}

/// Receipts by output, scene and frame, and those of the many samples, drawn in turns.
type Drawn = (Vec<Vec<Vec<Receipt>>>, Vec<Receipt>);

fn draw(scenes: &[(u64, Drawing, Orbit)], many: &Drawing, side: u32) -> anyhow::Result<Drawn> {
    let settings = Settings::drawn_as(Reconstruct::PullPush);
    for (_, drawing, _) in scenes {
        drawing.bake(settings)?;
    }
    let orbit = Orbit::around(&many.info)?;
    let mut receipts = vec![vec![Vec::new(); scenes.len()]; OUTPUTS.len()];
    let mut projections = Vec::new();
    let (warm, frames) = pick((2, 15), (1, 2));
    for frame in 0..warm + frames {
        let degrees = f64::from(frame) * STEP_DEG;
        let receipt =
            many.draw(orbit.at(degrees), [side; 2], Settings::drawn_as(Reconstruct::Points))?;
        if frame >= warm {
            projections.push(receipt);
        }
        for (output, (_, of)) in OUTPUTS.iter().enumerate() {
            for (scene, (_, drawing, orbit)) in scenes.iter().enumerate() {
                let drawn = drawing.raw(orbit.at(degrees), [side; 2], settings, *of)?;
                if frame >= warm {
                    receipts[output][scene].push(drawn.receipt.clone());
                }
            }
        }
    }
    Ok((receipts, projections))
}
