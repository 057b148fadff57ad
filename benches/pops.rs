//! How much pictures jump where the level of detail changes: the largest change from frame to frame along a flight that motion does
//! not explain.
//!
//! Frames at a quarter of the accepted error show motion alone. The rest of a change, without theirs, is a jump. Frames are
//! three times as large as meant, with three times the error, and compared by means of blocks: silhouettes that cross pixels flicker
//! in either flight, and what is to be seen would drown in it. Steps are so small that a switch from one level to another falls
//! between two frames.
//!
//! Measured with it and left out: nodes that fade into their children while the accepted error grows by a tenth, or by four. The worst
//! jumps stayed as they were (0.9, 3.1, 3.1 without; 0.8, 3.5, 2.9 and 0.7, 3.6, 2.7 with), frames took up to twice as long. Errors that
//! know colours see to it that what replaces a node looks like it.

mod common;

use std::path::PathBuf;

use common::drawing::{Drawing, Orbit, gpu_ms};
use common::files;
use common::report::{Bound, Report, number};
use common::{median, pick};
use glam::DVec3;
use pointillist::encode::ImageFormat;
use pointillist::generate::{Kind, Parameters};
use pointillist::math::Camera;
use pointillist::plan::{Lod, MaxError, Reconstruct, Settings};

/// Frames are drawn so much larger, and accept as much more.
const SCALE: u32 = 3;
const SIDE: u32 = SCALE * 256;
const BLOCK: usize = SCALE as usize * 8;
/// Accepted by the two flights.
const ERRORS_PX: [f32; 2] = [1.0, 0.25];
/// From frame to frame, of the distance.
const STEP: f64 = 0.0005;
const HOWS: [(&str, Reconstruct); 3] = [
    ("points", Reconstruct::Points),
    ("splats", Reconstruct::Splats),
    ("fuzzy", Reconstruct::Fuzzy),
];

/// `BENCH_POPS` names some of [`HOWS`]; all, where it is not set.
fn wanted(how: &str) -> bool {
    std::env::var("BENCH_POPS").map_or(true, |list| list.split_whitespace().any(|word| word == how))
}

/// Mean colours of blocks, in 255ths.
fn blocks(rgba: &[u8]) -> Vec<[f64; 3]> {
    let side = SIDE as usize;
    let across = side / BLOCK;
    let mut sums = vec![[0.0; 3]; across * across];
    for (pixel, color) in rgba.chunks_exact(4).enumerate() {
        let block = pixel / side / BLOCK * across + pixel % side / BLOCK;
        for (sum, channel) in sums[block].iter_mut().zip(color) {
            *sum += f64::from(*channel) / (BLOCK * BLOCK) as f64;
        }
    }
    sums
}

/// The largest difference of a channel.
fn change(from: &[[f64; 3]], to: &[[f64; 3]]) -> Vec<[f64; 3]> {
    from.iter().zip(to).map(|(a, b)| std::array::from_fn(|c| b[c] - a[c])).collect()
}

fn most(differences: &[[f64; 3]]) -> f64 {
    differences.iter().flatten().fold(0.0, |most, difference| f64::max(most, difference.abs()))
}

/// Towards `orbit`'s eye from `from` times as far away.
fn approach(orbit: &Orbit, from: f64, frames: u32) -> Vec<Camera> {
    (0..frames)
        .map(|frame| {
            let distance = from * (1.0 - STEP).powi(frame as i32);
            let eye = orbit.target + (orbit.eye - orbit.target) * distance;
            Camera::perspective(eye, orbit.target, orbit.fov_deg)
        })
        .collect()
}

struct Flight {
    name: &'static str,
    file: PathBuf,
    /// In units of the distance at which all of it is seen.
    from: f64,
}

fn main() -> anyhow::Result<()> {
    let samples = pick(150_000, 20_000);
    let parameters = Parameters { seed: 1, points: Some(samples), ..Parameters::default() };
    let flights = [
        Flight {
            name: "statue",
            file: files::generated(&format!("statue-{samples}.ply"), Kind::Statue, &parameters)?,
            from: 8.0,
        },
        Flight { name: "field of reliefs", file: files::copies(pick(20, 6))?, from: 1.5 },
        Flight { name: "crowd", file: files::crowd(pick(20, 10))?, from: 1.5 },
    ];
    let frames = pick(40, 4);
    let mut report: Option<Report> = None;
    let mut rows = Vec::new();
    for flight in &flights {
        let drawing = Drawing::open(&flight.file, SIDE, |_| ())?;
        let report = report.get_or_insert_with(|| Report::new("pops", &drawing.engine.adapter()));
        let orbit = Orbit::around(&drawing.info)?;
        // From somewhat above.
        let up = DVec3::Y * 0.3 * (orbit.eye - orbit.target).length();
        let orbit = Orbit { eye: orbit.eye + up, ..orbit };
        for (how, reconstruct) in HOWS.into_iter().filter(|(how, _)| wanted(how)) {
            let settings = |px: f32| Settings {
                lod: Lod::Spt,
                max_error_px: MaxError::new(px * SCALE as f32).unwrap_or_default(),
                reconstruct,
                ..Settings::default()
            };
            drawing.bake(settings(1.0))?;
            let draw =
                |camera, px| drawing.image(camera, [SIDE, SIDE], settings(px), ImageFormat::Raw);
            let mut before: Option<[Vec<[f64; 3]>; 2]> = None;
            let (mut jumps, mut motion, mut times) = (Vec::new(), 0.0, Vec::new());
            for camera in approach(&orbit, flight.from, frames) {
                let [found, finer] = [draw(camera, ERRORS_PX[0])?, draw(camera, ERRORS_PX[1])?];
                times.push(gpu_ms(&found.receipt)?);
                let now = [&found, &finer].map(|frame| blocks(&frame.bytes));
                if let Some(before) = &before {
                    let [found, finer] = [0, 1].map(|i| change(&before[i], &now[i]));
                    motion = f64::max(motion, most(&finer));
                    jumps.push(most(&change(&finer, &found)));
                }
                before = Some(now);
            }
            jumps.sort_by(f64::total_cmp);
            let worst = jumps.last().copied().unwrap_or(0.0);
            report.value(&format!("{}, {how}, worst jump, 255ths", flight.name), worst);
            report.value(
                &format!("{}, {how}, median frame's jump, 255ths", flight.name),
                median(&jumps),
            );
            rows.push(vec![
                flight.name.to_owned(),
                how.to_owned(),
                number(worst),
                number(median(&jumps)),
                number(motion),
                number(median(&times)),
            ]);
            if reconstruct == Reconstruct::Splats {
                report.target(
                    &format!("jump of a block of pixels of the {}, as splats", flight.name),
                    Some(worst),
                    Bound::AtMost(4.0),
                    "255ths",
                );
            }
        }
    }
    let mut report = report.ok_or_else(|| anyhow::anyhow!("no flights"))?;
    report.table(
        &format!("Flights of {frames} frames by steps of 0.05 % at an accepted error of 1 px, 256²: changes of blocks of 8² pixels in 255ths"),
        &["flight", "how", "worst jump", "median frame's", "largest by motion", "GPU ms"],
        &rows,
    );
    report.finish()
}
