//! Does the planner keep its promises? At each random pose and size, one frame is asked for, with a time budget or a least PSNR. It is the first frame of that
//! view, so that the planner has learned nothing from it before. The truth is the reference that the planner measures against; times are GPU times. A promise
//! counts where the receipt gives one.
//!
//! At some poses every setting that the planner chooses from is drawn afterwards: the fastest that keeps the PSNR, and the most exact that keeps the budget, tell what
//! it could have chosen, and whether it could have promised anything. Its own choice is judged by the same measurement. Poses come from another generator than
//! those that the planner has measured.
//!
//! At further poses a budget alone is asked for. These frames need no reference and are cheap, so that many of them are drawn. They have a row and a
//! target of their own, because the planner has learned from the frames before them.
//!
//! `PLANNER_SCENES=a.json,b.ply` takes other scenes, `PLANNER_POSES=n` other numbers of poses a scene, `PLANNER_BUDGETS=n` other numbers of further poses.

mod common;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::Context;
use common::drawing::{Drawing, gpu_ms};
use common::report::{Bound, Report, number};
use common::{files, median, pick, quantile};
use glam::DVec3;
use pointillist::accuracy::metrics;
use pointillist::accuracy::planning::{LEAST_SIZE, Planning};
use pointillist::accuracy::sweep::{Row, rows};
use pointillist::accuracy::truth::{opaque, quads};
use pointillist::bake::cache::BakeCache;
use pointillist::encode::ImageFormat;
use pointillist::engine::{Client, EncodedFrame, Receipt};
use pointillist::generate::{Kind, Parameters};
use pointillist::math::Camera;
use pointillist::plan::{Extent, Given, Settings};
use pointillist::scene::random::SplitMix64;

const SCENES: [&str; 5] = ["town", "relief", "textured", "plaza", "glasshouse"];
const BUDGETS_MS: [f64; 3] = [15.0, 40.0, 120.0];
const GOALS: [Goal; 6] = [
    Goal::BudgetMs(BUDGETS_MS[0]),
    Goal::BudgetMs(BUDGETS_MS[1]),
    Goal::BudgetMs(BUDGETS_MS[2]),
    Goal::LeastDb(28.0),
    Goal::LeastDb(34.0),
    Goal::LeastDb(40.0),
];
/// Every so many poses, all settings are drawn.
const ALL_EVERY: usize = 6;
/// Frames that the time of a setting is the median of, after a first one.
const TIMED: usize = 3;
/// Frames that are drawn again where a budget was exceeded.
const AGAIN: usize = 9;

/// The goal that a request names.
#[derive(Clone, Copy)]
enum Goal {
    BudgetMs(f64),
    LeastDb(f64),
}

/// What was found of all frames with a goal.
#[derive(Default)]
struct Found {
    promised: usize,
    kept: usize,
    frames: usize,
    /// How far broken promises are off: in percent of the budget, or in decibels.
    off: Vec<f64>,
    /// Time over the best setting's, or decibels below it.
    lost: Vec<f64>,
    /// Predicted over actual times.
    predicted: Vec<f64>,
    /// Goals that some setting keeps, of the poses at which all are drawn, and how many of them were promised.
    keepable: usize,
    keepable_promised: usize,
}

fn scenes() -> anyhow::Result<Vec<PathBuf>> {
    if let Ok(given) = std::env::var("PLANNER_SCENES") {
        return Ok(given.split(',').map(PathBuf::from).collect());
    }
    let samples = pick(300_000, 20_000);
    let parameters = Parameters { seed: 1, points: Some(samples), ..Parameters::default() };
    let statue = files::generated(&format!("statue-{samples}.ply"), Kind::Statue, &parameters)?;
    let shipped = SCENES.iter().map(|name| PathBuf::from(format!("scenes/{name}.json")));
    Ok(shipped.take(pick(5, 1)).chain([statue]).collect())
}

/// A pose somewhere around the default view.
fn pose(view: &Camera, random: &mut SplitMix64) -> Camera {
    let offset = view.eye - view.target;
    let reach = offset.length();
    let up = view.up.normalize_or(DVec3::Y);
    let side = up.cross(offset).normalize_or(DVec3::X);
    let mut within = |low: f64, high: f64| low + (high - low) * random.unit();
    let turn = within(0.0, std::f64::consts::TAU);
    let height = within(2.0, 75.0).to_radians();
    let level = side.cross(up);
    let flat = level * turn.cos() + side * turn.sin();
    let distance = reach * within(0.25f64.ln(), 4f64.ln()).exp();
    let target = view.target + reach * (side * within(-0.25, 0.25) + level * within(-0.25, 0.25));
    let eye = target + distance * (flat * height.cos() + up * height.sin());
    Camera { eye, target, up, lens: view.lens }
}

/// A size between the smallest and the largest that the planner measures.
fn size_of(planning: &Planning<'_>, random: &mut SplitMix64) -> [u32; 2] {
    let width = (planning.least_size[0] as f64 * (1.0 + 2.0 * random.unit())).round() as u32;
    [width, width * 9 / 16]
}

impl Goal {
    fn settings(self) -> Settings {
        let (budget_ms, min_psnr_db) = match self {
            Goal::BudgetMs(budget) => (Some(budget), None),
            Goal::LeastDb(least) => (None, Some(least)),
        };
        Settings::from(Given { budget_ms, min_psnr_db, ..Given::default() })
    }

    fn is_kept(self, &(db, ms): &(f64, f64)) -> bool {
        match self {
            Goal::BudgetMs(budget) => ms <= budget,
            Goal::LeastDb(least) => db >= least,
        }
    }

    /// Returns how much worse the chosen setting is than the best that keeps the goal: decibels for a budget, a ratio of times for a PSNR. Returns `None`
    /// where no setting keeps the goal. A chosen setting that does not keep it gives `None` as well, since that promise counts as broken.
    fn lost(self, chosen: &str, all: &BTreeMap<String, (f64, f64)>) -> Option<f64> {
        let chosen = all.get(chosen).filter(|chosen| self.is_kept(chosen))?;
        let keeping = all.values().filter(|one| self.is_kept(one));
        Some(match self {
            Goal::BudgetMs(_) => keeping.map(|(db, _)| *db).reduce(f64::max)? - chosen.0,
            Goal::LeastDb(_) => chosen.1 / keeping.map(|(_, ms)| *ms).reduce(f64::min)?,
        })
    }
}

/// A frame's PSNR against the reference, its GPU time and its receipt.
struct Drawn {
    db: f64,
    ms: f64,
    receipt: Receipt,
}

/// Frames of one pose and size, which are compared with their reference.
struct Shot<'a> {
    drawing: &'a Drawing,
    camera: Camera,
    size: [u32; 2],
    truth: &'a [[u8; 4]],
}

impl Shot<'_> {
    /// Draws a frame as at a new pose, with its shadow maps.
    fn frame(&self, settings: Settings) -> anyhow::Result<Arc<EncodedFrame>> {
        let settings = Settings { draws_maps: true, ..settings.complete() };
        self.drawing.image(self.camera, self.size, settings, ImageFormat::Raw)
    }

    /// Draws such a frame and compares it.
    fn draw(&self, settings: Settings) -> anyhow::Result<Drawn> {
        let frame = self.frame(settings)?;
        let color: Vec<[u8; 4]> = quads(&frame.bytes).into_iter().map(opaque).collect();
        let db = metrics::psnr_db(metrics::mse(self.truth, &color)?).unwrap_or(99.0);
        Ok(Drawn { db, ms: gpu_ms(&frame.receipt)?, receipt: frame.receipt.clone() })
    }

    /// The row of a table for a promised budget that the frame exceeded. The frame is drawn again with its settings, which tells a wrong prediction from a
    /// disturbance of the machine. `None` for a frame that kept its budget, or had no promise.
    fn broken(
        &self,
        scene: &str,
        budget: f64,
        receipt: &Receipt,
    ) -> anyhow::Result<Option<Vec<String>>> {
        let (ms, plan) = (gpu_ms(receipt)?, receipt.planned.as_ref());
        let broken = plan.filter(|plan| plan.keeps == Some(true) && ms > budget);
        let Some(chosen) = broken.and_then(|plan| plan.chosen.as_ref()) else { return Ok(None) };
        let given = receipt.settings.applied;
        let again: anyhow::Result<Vec<f64>> =
            (0..AGAIN).map(|_| gpu_ms(&self.frame(given.into())?.receipt)).collect();
        let [width, height] = self.size;
        let mut cells =
            vec![scene.to_owned(), format!("{width} × {height}"), chosen.setting.clone()];
        cells.extend([budget, chosen.ms, chosen.most_ms, ms, median(&again?)].map(number));
        Ok(Some(cells))
    }

    /// The PSNR and the median time of every measured setting, by its name.
    fn all(&self) -> anyhow::Result<BTreeMap<String, (f64, f64)>> {
        let each = |row: Row| {
            let db = self.draw(row.given.into())?.db;
            let times: anyhow::Result<Vec<f64>> =
                (0..pick(TIMED, 1)).map(|_| Ok(self.draw(row.given.into())?.ms)).collect();
            Ok((row.label, (db, median(&times?))))
        };
        rows(Extent::Planned, self.drawing.info.has_samples()).into_iter().map(each).collect()
    }
}

fn main() -> anyhow::Result<()> {
    let poses = std::env::var("PLANNER_POSES").ok().and_then(|n| n.parse().ok());
    let poses: usize = poses.unwrap_or(pick(84, 1));
    let further = std::env::var("PLANNER_BUDGETS").ok().and_then(|n| n.parse().ok());
    let further: usize = further.unwrap_or(pick(40, 2));
    let mut report: Option<Report> = None;
    let [mut budgets, mut furthers, mut errors] = std::array::from_fn(|_| Found::default());
    let (mut table, mut broken) = (Vec::new(), Vec::new());
    for file in scenes()? {
        let cache = BakeCache::new(common::folder().join("planner-cache"), 4 << 30);
        let drawing = Drawing::open(&file, 0, |config| config.bake_cache = Some(cache))?;
        let report =
            report.get_or_insert_with(|| Report::new("planner", &drawing.engine.adapter()));
        let name = file.file_stem().context("a scene's name")?.to_string_lossy().into_owned();
        let stop = AtomicBool::new(false);
        let planning = Planning {
            engine: &drawing.engine,
            client: Client::Unnamed,
            scene: "scene",
            least_size: pick(LEAST_SIZE, [64, 36]),
            stop: &stop,
            journals: None,
        };
        for request in planning.requests() {
            drawing.engine.bake(&request)?;
        }
        if drawing.engine.planner_size("scene")?.is_none() {
            let found = planning.measure(&drawing.info, |_| ())?;
            drawing.engine.learn("scene", found)?;
        }
        let survey = planning.survey(planning.least_size, Vec::new(), Vec::new());
        let view = survey.default_view()?;
        let mut random = SplitMix64::new(2026);
        let [mut own_budgets, mut own_further, mut own_errors] =
            std::array::from_fn(|_| Found::default());
        for number in 0..poses {
            let camera = pose(&view, &mut random);
            let size = size_of(&planning, &mut random);
            let goal = GOALS[random.index(GOALS.len())];
            let survey = planning.survey(size, Vec::new(), Vec::new());
            let truth = survey.truth(camera)?;
            if truth.covered_pixels() == 0 {
                continue;
            }
            let shot = Shot { drawing: &drawing, camera, size, truth: &truth.color };
            let first = shot.draw(goal.settings())?;
            let plan = first.receipt.planned.clone().context("a frame with a goal has a plan")?;
            let own = match goal {
                Goal::BudgetMs(budget) => {
                    let off = 100.0 * (first.ms / budget - 1.0);
                    own_budgets.see(plan.keeps, first.ms <= budget, off);
                    broken.extend(shot.broken(&name, budget, &first.receipt)?);
                    &mut own_budgets
                }
                Goal::LeastDb(least) => {
                    own_errors.see(plan.keeps, first.db >= least, least - first.db);
                    &mut own_errors
                }
            };
            let Some(chosen) = plan.chosen else { continue };
            own.predicted.push(chosen.ms / first.ms);
            if number % ALL_EVERY == 0 {
                let all = shot.all()?;
                own.lost.extend(goal.lost(&chosen.setting, &all));
                if all.values().any(|one| goal.is_kept(one)) {
                    own.keepable += 1;
                    own.keepable_promised += usize::from(plan.keeps == Some(true));
                }
            }
        }
        for _ in 0..further {
            let camera = pose(&view, &mut random);
            let size = size_of(&planning, &mut random);
            let budget = BUDGETS_MS[random.index(BUDGETS_MS.len())];
            let shot = Shot { drawing: &drawing, camera, size, truth: &[] };
            let frame = shot.frame(Goal::BudgetMs(budget).settings())?;
            if frame.receipt.nothing_visible.is_some() {
                continue;
            }
            let (ms, plan) = (gpu_ms(&frame.receipt)?, frame.receipt.planned.clone());
            let plan = plan.context("a frame with a goal has a plan")?;
            own_further.see(plan.keeps, ms <= budget, 100.0 * (ms / budget - 1.0));
            own_further.predicted.extend(plan.chosen.as_ref().map(|chosen| chosen.ms / ms));
            broken.extend(shot.broken(&name, budget, &frame.receipt)?);
        }
        for (what, own, sum) in [
            ("budget", own_budgets, &mut budgets),
            ("budget, further poses", own_further, &mut furthers),
            ("PSNR", own_errors, &mut errors),
        ] {
            table.push(own.row(&name, what));
            sum.add(own);
        }
        // Printed as they come: a run takes an hour.
        println!("{name}: {:?}", &table[table.len() - 3..]);
        report.value(&format!("{name}, poses"), poses);
        report.value(&format!("{name}, further poses with a budget"), further);
    }
    let mut report = report.context("no scenes")?;
    table.push(budgets.row("all", "budget"));
    table.push(furthers.row("all", "budget, further poses"));
    table.push(errors.row("all", "PSNR"));
    report.table(
        "Goals at random poses: budgets of 15, 40 and 120 ms, and 28, 34 and 40 dB",
        &[
            "scene",
            "goal",
            "frames",
            "promised",
            "kept, %",
            "worst off",
            "lost (dB of a budget, times of a PSNR), median",
            "lost, 90 %",
            "promised, of goals that some setting keeps",
            "predicted/actual, 5–95 %",
        ],
        &table,
    );
    if !broken.is_empty() {
        report.table(
            "Promised budgets that a frame exceeded, and the time of the same frame drawn again",
            &[
                "scene",
                "size",
                "setting",
                "budget, ms",
                "predicted, ms",
                "with its margin, ms",
                "actual, ms",
                "again, ms (median of 9)",
            ],
            &broken,
        );
    }
    report.target(
        &format!("promised budgets kept, of {}", budgets.sample()),
        budgets.share(),
        Bound::AtLeast(95.0),
        "%",
    );
    report.target(
        &format!("promised budgets kept at further poses, of {}", furthers.sample()),
        furthers.share(),
        Bound::AtLeast(95.0),
        "%",
    );
    report.target(
        &format!("promised PSNR kept, of {}", errors.sample()),
        errors.share(),
        Bound::AtLeast(99.9),
        "%",
    );
    let lost = Some(median(&errors.lost)).filter(|lost| lost.is_finite());
    report.target(
        &format!("time over the best setting that keeps the PSNR, median of {}", errors.lost.len()),
        lost,
        Bound::AtMost(1.03),
        "times",
    );
    report.finish()
}

impl Found {
    fn see(&mut self, promised: Option<bool>, is_kept: bool, off: f64) {
        self.frames += 1;
        if promised == Some(true) {
            self.promised += 1;
            self.kept += usize::from(is_kept);
            if !is_kept {
                self.off.push(off);
            }
        }
    }

    fn add(&mut self, other: Found) {
        self.promised += other.promised;
        self.kept += other.kept;
        self.frames += other.frames;
        self.off.extend(other.off);
        self.lost.extend(other.lost);
        self.predicted.extend(other.predicted);
        self.keepable += other.keepable;
        self.keepable_promised += other.keepable_promised;
    }

    fn share(&self) -> Option<f64> {
        (self.promised > 0).then(|| 100.0 * self.kept as f64 / self.promised as f64)
    }

    /// The number of promises, and what share of all promises is kept at least if so many were kept without exception (confidence 95 %).
    fn sample(&self) -> String {
        let sure = 100.0 * 0.05f64.powf(1.0 / self.promised.max(1) as f64);
        let is_whole = self.promised > 0 && self.kept == self.promised;
        let sure =
            if is_whole { format!(" (which is 95 % sure of {sure:.1} %)") } else { String::new() };
        format!("{}{sure}", self.promised)
    }

    fn row(&self, scene: &str, goal: &str) -> Vec<String> {
        let ends = [0.05, 0.95].map(|share| number(quantile(&self.predicted, share)));
        vec![
            scene.to_owned(),
            goal.to_owned(),
            self.frames.to_string(),
            self.promised.to_string(),
            self.share().map_or("—".to_owned(), number),
            number(self.off.iter().copied().fold(0.0, f64::max)),
            number(median(&self.lost)),
            number(quantile(&self.lost, 0.9)),
            format!("{} of {}", self.keepable_promised, self.keepable),
            ends.join("–"),
        ]
    }
}
