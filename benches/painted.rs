//! Painted splats beside Tables 3 and 4 of the paper, and beside our other ways to draw the same nodes.
//!
//! The paper is L. Coconu, H.-C. Hege, "Hardware-Accelerated Point-Based Rendering of Complex Scenes", Eurographics Workshop on Rendering
//! 2002. Its splat size is the distance in pixels that samples may be apart; ours is the accepted error of `lod=spt`.

mod common;

use anyhow::ensure;
use common::drawing::{Drawing, Orbit, pass_medians};
use common::report::{Bound, Report, number};
use common::shots::{Shot, Taken, take};
use common::{files, median, median_ratio, pick};
use glam::DVec3;
use pointillist::generate::{Form, Kind, Parameters};
use pointillist::plan::{Lod, MaxError, Reconstruct, Settings};
use pointillist::scene::Painting;

/// Sizes of the paper's frames.
const MODELS: [u32; 2] = [640, 480];
const GRIDS: [u32; 2] = [500, 400];
/// Passes that put splats in order.
const ORDER: [&str; 8] = [
    "count_splats",
    "number_splats",
    "count_keys",
    "sum_counts",
    "move_keys",
    "count_tiles",
    "sum_counts_tiles",
    "move_tiles",
];

fn main() -> anyhow::Result<()> {
    let relief = files::copies(1)?;
    let drawing = Drawing::open(&relief, MODELS[0], |_| ())?;
    let mut report = Report::new("painted", &drawing.engine.adapter());
    drop(drawing);
    let parts = std::env::var("BENCH_PAINTED").unwrap_or_else(|_| "models grids".into());
    for part in parts.split_whitespace() {
        match part {
            "models" => models(&mut report)?,
            "grids" => grids(&mut report)?,
            other => anyhow::bail!("BENCH_PAINTED knows models and grids, not {other}"),
        }
    }
    report.finish()
}

fn repeats() -> (u32, u32) {
    pick((2, 7), (1, 2))
}

/// Nodes of point trees at an accepted error, drawn in a given way.
fn nodes(reconstruct: Reconstruct, px: f32) -> Settings {
    let max_error_px = MaxError::new(px).unwrap_or_default();
    Settings { lod: Lod::Spt, max_error_px, ..Settings::drawn_as(reconstruct) }
}

/// Table 3: models at 640 × 480 and splat size 2.
fn models(report: &mut Report) -> anyhow::Result<()> {
    let leaves = pick(100_000, 1_000);
    let tree = Parameters {
        seed: 1,
        count: Some(leaves),
        form: Some(Form::Triangles),
        ..Parameters::default()
    };
    let points = pick(1_000_000, 10_000);
    let statue = Parameters { seed: 1, points: Some(points), ..Parameters::default() };
    let models = [
        ("relief", files::copies(1)?),
        ("tree", files::generated(&format!("tree-{leaves}.ply"), Kind::Tree, &tree)?),
        ("statue", files::generated(&format!("statue-{points}.ply"), Kind::Statue, &statue)?),
    ];
    let painted = nodes(Reconstruct::Painted, 2.0);
    let ways = [
        ("full detail", Settings::default()),
        ("painted", painted),
        ("painted, each splat", Settings { painted_as: Painting::Splats, ..painted }),
        ("splats", nodes(Reconstruct::Splats, 2.0)),
        ("fuzzy", nodes(Reconstruct::Fuzzy, 2.0)),
    ];
    let mut rows = Vec::new();
    let mut shares = Vec::new();
    for (name, file) in models {
        // Point trees are drawn even where they leave little out.
        let drawing = Drawing::open(&file, MODELS[0], |config| config.may_draw_in_full = false)?;
        let orbit = Orbit::fitted(&drawing, MODELS, Settings::default())?;
        let shots =
            ways.map(|(_, settings)| Shot { drawing: &drawing, orbit, size: MODELS, settings });
        let taken = take(&shots, repeats())?;
        let full = taken[0].gpu_ms()?;
        for ((way, settings), taken) in ways.iter().zip(&taken) {
            check(taken, settings)?;
            let times = taken.gpu_ms()?;
            let accepted = taken.accepted();
            let rate = accepted / median(&times) / 1000.0;
            let share = order_percent(taken);
            report.value(&format!("{name}, {way}, GPU ms"), median(&times));
            report.value(&format!("{name}, {way}, M nodes/s"), rate);
            report.value(&format!("{name}, {way}, order %"), share);
            if *way == "painted" {
                shares.push(share);
            }
            rows.push(vec![
                format!("{name}, {way}"),
                number(median(&times)),
                number(median_ratio(&full, &times)),
                number(accepted),
                number(rate),
                number(share),
            ]);
        }
    }
    report.table(
        "Models at 640 × 480, accepted error 2 px (Table 3)",
        &["how", "GPU ms", "× full detail", "nodes", "M nodes/s", "order, %"],
        &rows,
    );
    println!(
        "The paper, Radeon 8500, 2.0 GHz Pentium 4, points over triangles: Harley 0.45 ×, Pisa 0.96 ×, Lobus 2.0 ×, tree 0.88 ×; 5.2 to 9 M \
         splats/s; order 19 to 33 %, and the index over 50 %."
    );
    let most = shares.into_iter().fold(0.0, f64::max);
    report.target("order and index of painted splats", Some(most), Bound::AtMost(15.0), "%");
    Ok(())
}

/// Refuses frames that were drawn in another way.
fn check(taken: &Taken, settings: &Settings) -> anyhow::Result<()> {
    for receipt in &taken.receipts {
        let drawn = receipt.settings.applied.reconstruct;
        let instead = receipt.settings.instead_because;
        ensure!(instead.is_none(), "{:?} as {drawn:?}: {instead:?}", settings.reconstruct);
    }
    Ok(())
}

/// Share of the passes that put splats in order.
fn order_percent(taken: &Taken) -> f64 {
    let passes = pass_medians(&taken.receipts);
    let sum = |of: &dyn Fn(&str) -> bool| -> f64 {
        passes.iter().filter(|(pass, _)| of(pass)).map(|(_, time)| time).sum()
    };
    let order = sum(&|pass| ORDER.contains(&pass)).abs();
    100.0 * order / sum(&|_| true)
}

/// Table 4: grids of copies at 500 × 400 and splat sizes 2, 3 and 4.
fn grids(report: &mut Report) -> anyhow::Result<()> {
    let sides: [u32; 5] = pick([10, 20, 50, 100, 200], [2, 3, 4, 5, 6]);
    let paper =
        [[7.3, 11.6, 30.6], [6.1, 10.8, 15.5], [3.7, 6.4, 9.4], [2.1, 3.6, 4.7], [1.3, 1.8, 2.2]];
    let mut rows = Vec::new();
    let mut last = f64::NAN;
    for (side, paper) in sides.into_iter().zip(paper) {
        let drawing = Drawing::open(&files::copies(side)?, GRIDS[0], |_| ())?;
        let [low, high] = drawing.info.bounds.unwrap_or_default().map(DVec3::from);
        let (target, width) = (0.5 * (low + high), high.x - low.x);
        let eye = target + DVec3::new(0.0, 0.25, 0.75) * width;
        let orbit = Orbit { eye, target, fov_deg: 40.0 };
        let shot = |settings| Shot { drawing: &drawing, orbit, size: GRIDS, settings };
        let shots = [
            shot(nodes(Reconstruct::Painted, 2.0)),
            shot(nodes(Reconstruct::Painted, 3.0)),
            shot(nodes(Reconstruct::Painted, 4.0)),
            shot(nodes(Reconstruct::Splats, 3.0)),
            shot(nodes(Reconstruct::Points, 3.0)),
        ];
        let taken = take(&shots, repeats())?;
        for (shot, taken) in shots.iter().zip(&taken) {
            check(taken, &shot.settings)?;
        }
        let rates: Vec<f64> = taken
            .iter()
            .map(|taken| Ok(1000.0 / median(&taken.gpu_ms()?)))
            .collect::<anyhow::Result<_>>()?;
        let mut row = vec![format!("{side} × {side}")];
        row.extend(rates.iter().map(|&rate| number(rate)));
        row.extend(paper.map(number));
        rows.push(row);
        for (px, rate) in [2, 3, 4].iter().zip(&rates) {
            report.value(&format!("{side} × {side}, painted at {px} px, frames/s"), *rate);
        }
        last = rates[1];
    }
    report.table(
        "Grids of a mesh of 400,000 triangles at 500 × 400, frames/s (Table 4)",
        &[
            "grid",
            "painted, 2 px",
            "3 px",
            "4 px",
            "splats, 3 px",
            "points, 3 px",
            "paper, 2 px",
            "3 px",
            "4 px",
        ],
        &rows,
    );
    let what = "200 × 200 copies of a mesh, painted at 3 px, frames/s on two cores";
    report.target(what, Some(last), Bound::AtLeast(5.0), "");
    Ok(())
}
