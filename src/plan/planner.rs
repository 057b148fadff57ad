//! Choice of settings for a goal: a time that the frame may take, an error that it may have, or both. Pure.
//!
//! Frames of a scene were measured at several poses and sizes, with settings that trade accuracy for time ([`Measured`]). A [`Planner`] fits a
//! [model] to the frames of each setting. For a new pose it predicts time and error of all settings that the request leaves open, and
//! chooses with margins that the measured frames keep.
//!
//! Frames of a moving pose may be drawn smaller than they are shown. For them, settings were measured in smaller sizes as well ([`Moving`]).

mod ground;
mod measured;
mod model;

use std::sync::Arc;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

pub use ground::Ground;
pub use measured::{Measured, MeasuredPose, MeasuredRow};
pub use model::{Effort, LEAST_POSES, Point, Prediction};

use self::model::Model;
use super::{Given, Settings};

/// Alternatives that a choice lists.
const MOST_ALTERNATIVES: usize = 6;
/// Alternatives that are slower and not so much more exact are left out.
const SEEN_DB: f64 = 0.1;
/// Frames of other settings that tell as much about a setting's pace as it is believed without any of its own.
const COMMON: f64 = 2.0;
/// Most frames of a setting that count for its pace.
const MOST_FRAMES: f64 = 16.0;
/// Largest change of a pace by one frame: it may have compiled a shader.
const MOST_CHANGE: f64 = 1.25;
/// The setting of the frame before stays while the pose moves, unless another one is more exact by this much: each change is seen.
const HELD_DB: f64 = 1.0;
/// Factor by which its predicted time may exceed the budget.
const HELD_TIMES: f64 = 1.15;
/// Range of a pace.
const PACES: [f64; 2] = [1.0 / 16.0, 16.0];

/// What a frame is asked to keep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Goal {
    /// Longest GPU time, in milliseconds.
    pub most_ms: Option<f64>,
    /// Least peak signal-to-noise ratio against the reference, in decibels.
    pub least_db: Option<f64>,
}

/// What the next frame of a moving pose may be.
#[derive(Clone, Copy, Debug)]
pub struct Moving<'a> {
    /// Least and largest width and height, as shares of those that the frame is shown at.
    pub scales: [f64; 2],
    /// Name of the setting that the frame before was drawn with.
    pub held: Option<&'a str>,
    /// The still frame that follows: a moving one is not finer.
    pub still: &'a Settings,
}

impl Moving<'_> {
    /// Whether settings at a scale have a smaller error or more antialiasing than the still frame.
    fn is_finer(&self, settings: &Settings, scale: f64) -> bool {
        let error = |of: &Settings| of.accepted_px_of_trees().map(f64::from);
        let has_less_error =
            error(self.still).zip(error(settings)).is_some_and(|(still, own)| own / scale < still);
        has_less_error || settings.parts() > self.still.parts()
    }
}

/// What a request may be drawn with: the settings of each measured row that goes with those that it gives.
#[derive(Clone, Debug)]
pub struct Asked {
    rows: Vec<(usize, Settings)>,
    /// Given settings of which the measurements say nothing.
    others: Vec<&'static str>,
}

/// The measured settings of a scene, each with its model.
#[derive(Clone, Debug)]
pub struct Planner {
    rows: Vec<Row>,
    poses: usize,
    /// Names of the settings that some row gives.
    varied: Vec<&'static str>,
}

#[derive(Clone, Debug)]
struct Row {
    label: String,
    given: Given,
    /// Width and height of drawn frames as a share of those that they are shown at.
    scale: f64,
    /// Shared with rows that are drawn alike everywhere.
    model: Arc<Model>,
    /// The first row that is drawn alike: they have one pace.
    alike: usize,
}

/// How long frames take now, over how long they took when they were measured.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Paces {
    /// For each row: mean logarithm of the quotients, and number of frames.
    rows: Vec<(f64, f64)>,
}

/// A setting that was chosen.
#[derive(Clone, Debug, PartialEq)]
pub struct Chosen {
    /// The first of the rows that are drawn alike.
    pub row: usize,
    pub settings: Settings,
    /// Width and height of the frame as a share of those that it is shown at.
    pub scale: f64,
    pub plan: PlanReceipt,
    /// Time in ms that would be predicted if frames took as long as measured ones.
    pub measured_pace_ms: f64,
    /// Whether the frame differs from measured ones in its pose and size alone, so that its time tells something about theirs.
    pub is_as_measured: bool,
}

/// How settings were chosen for a time budget or an error.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct PlanReceipt {
    /// Longest GPU time that was asked for, in milliseconds. For a moving frame of a stream, the time that the server leaves for it.
    pub budget_ms: Option<f64>,
    /// Least peak signal-to-noise ratio that was asked for, in decibels.
    pub min_psnr_db: Option<f64>,
    /// Whether the chosen setting is expected to keep them; `null` where no measurements tell, where the request gives settings that were not varied
    /// when the scene was measured, and where nodes of the scene were changed after the measurement.
    pub keeps: Option<bool>,
    /// Why this setting was chosen.
    pub because: String,
    /// The chosen setting and what was predicted for it; `null` without measurements.
    pub chosen: Option<Alternative>,
    /// GPU time of the frame, in milliseconds.
    pub actual_ms: Option<f64>,
    /// Whether the frame took at most its budget; `null` without a budget and where the time is unknown.
    pub in_budget: Option<bool>,
    /// Other settings between the fastest and the most exact.
    pub alternatives: Vec<Alternative>,
    /// Number of settings that were compared.
    pub compared: usize,
    /// Number of poses at which they were measured.
    pub poses: usize,
}

/// A setting with what is predicted for it at the frame's pose and size.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
#[schema(as = PlanAlternative)]
pub struct Alternative {
    /// Name of the setting, as in the results of a measurement.
    pub setting: String,
    /// GPU time in milliseconds.
    pub ms: f64,
    /// GPU time with its margin, which is compared with the budget. For a moving frame of a stream, `ms` is compared.
    pub most_ms: f64,
    /// Peak signal-to-noise ratio against the reference, in decibels.
    pub psnr_db: f64,
    /// Peak signal-to-noise ratio with its margin, which is compared with the least one.
    pub least_psnr_db: f64,
}

impl Asked {
    /// The answer for a request that differs from the one asked about in what [`Settings::with_some_goal_and_look`] replaces alone.
    #[must_use]
    pub fn looking_like(&self, settings: &Settings) -> Asked {
        let rows = self.rows.iter().map(|(row, own)| (*row, own.looking_like(settings)));
        Asked { rows: rows.collect(), others: self.others.clone() }
    }
}

impl Goal {
    fn keeps(&self, found: &Prediction) -> bool {
        self.keeps_budget(found)
            && self.least_db.is_none_or(|least_db| found.least_psnr_db >= least_db)
    }

    fn keeps_budget(&self, found: &Prediction) -> bool {
        self.most_ms.is_none_or(|most_ms| found.most_ms <= most_ms)
    }

    /// The goal in words.
    fn in_words(&self) -> String {
        let budget = self.most_ms.map(|ms| format!("{ms} ms"));
        let least = self.least_db.map(|db| format!("{db} dB"));
        [budget, least].into_iter().flatten().collect::<Vec<_>>().join(" and ")
    }

    /// The receipt of a frame for which nothing can be chosen.
    pub fn unplanned(&self, because: String) -> PlanReceipt {
        PlanReceipt {
            budget_ms: self.most_ms,
            min_psnr_db: self.least_db,
            keeps: None,
            because,
            chosen: None,
            actual_ms: None,
            in_budget: None,
            alternatives: Vec::new(),
            compared: 0,
            poses: 0,
        }
    }
}

impl PlanReceipt {
    pub fn goal(&self) -> Goal {
        Goal { most_ms: self.budget_ms, least_db: self.min_psnr_db }
    }

    /// Why the goal is not promised, and what is predicted for the chosen setting; `None` where the goal is promised.
    pub fn unpromised(&self) -> Option<String> {
        if self.keeps == Some(true) {
            return None;
        }
        let predicted = self.chosen.as_ref().map_or_else(String::new, |chosen| {
            let Alternative { setting, most_ms, least_psnr_db, .. } = chosen;
            format!("; the prediction for `{setting}` is at most {most_ms} ms and at least {least_psnr_db} dB")
        });
        let goal = self.goal().in_words();
        Some(format!("the goal of {goal} is not promised: {}{predicted}", self.because))
    }

    /// The receipt of the frame that was drawn in `actual_ms`.
    #[must_use]
    pub fn of_drawn(self, actual_ms: Option<f64>) -> PlanReceipt {
        let in_budget = self.budget_ms.zip(actual_ms).map(|(budget, actual)| actual <= budget);
        PlanReceipt { actual_ms, in_budget, ..self }
    }

    /// Warns that the goal is not promised, or that the frame exceeded a promised budget. `None` if the goal was promised and kept.
    pub fn warning(&self) -> Option<String> {
        self.unpromised().or_else(|| {
            let (budget, actual) = self.budget_ms.zip(self.actual_ms)?;
            let is_broken = self.in_budget == Some(false);
            is_broken.then(|| {
                format!("the frame took {actual:.2} ms, longer than the {budget} ms that were promised; ask again if other work has slowed the machine, or for a larger budget_ms")
            })
        })
    }

    /// The receipt of a choice for a scene that was patched after it was measured: nothing is promised.
    #[must_use]
    pub fn of_other_content(self) -> PlanReceipt {
        let because =
            format!("{}; the scene was measured before its nodes were changed", self.because);
        PlanReceipt { keeps: None, because, ..self }
    }
}

impl Planner {
    /// Fits models to measured frames. `grounds` are those of the poses. Settings with fewer than [`LEAST_POSES`] measured poses are left
    /// out.
    pub fn fit(measured: &Measured, grounds: &[Ground]) -> Planner {
        let mut rows: Vec<Row> = Vec::new();
        let mut fitted: Vec<&MeasuredRow> = Vec::new();
        for row in &measured.rows {
            let found = fitted.iter().position(|other| other.points == row.points);
            let (model, alike) = match found {
                Some(alike) => (rows[alike].model.clone(), alike),
                None => {
                    let points: Vec<(Ground, Point)> = grounds
                        .iter()
                        .zip(&row.points)
                        .filter_map(|(ground, point)| Some((ground.clone(), (*point)?)))
                        .collect();
                    let Some(model) = Model::fit(effort(&row.given, row.scale), &points) else {
                        continue;
                    };
                    (Arc::new(model), rows.len())
                }
            };
            fitted.push(row);
            let (label, given, scale) = (row.label.clone(), row.given, row.scale);
            rows.push(Row { label, given, scale, model, alike });
        }
        let mut varied: Vec<&'static str> = rows.iter().flat_map(|row| row.given.names()).collect();
        varied.sort_unstable();
        varied.dedup();
        Planner { rows, poses: grounds.len(), varied }
    }

    /// Number of settings to choose from.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// Finds what a request with a goal may be drawn with. The answer is the same for all goals and views.
    pub fn asked(&self, settings: &Settings) -> Asked {
        let rows = self.rows.iter().enumerate();
        let rows = rows
            .filter_map(|(index, row)| Some((index, settings.planned(&row.given, &self.varied)?)));
        Asked { rows: rows.collect(), others: settings.beyond(&self.varied) }
    }

    /// Chooses settings for frames with this goal, all of which are to keep it. `allows` tells which settings can be drawn. `None` if none can.
    pub fn choose(
        &self,
        goal: &Goal,
        asked: &Asked,
        grounds: &[Ground],
        paces: &Paces,
        allows: impl Fn(&Settings) -> bool,
    ) -> Option<Chosen> {
        let is_whole = |row: &Row, settings: &Settings| row.scale >= 1.0 && allows(settings);
        let found = self.predictions(asked, grounds, paces, is_whole);
        let (best, because) = pick(goal, &found)?;
        let keeps = goal.keeps(&found[best].2);
        Some(self.chosen(goal, asked, paces, &found, (best, keeps, because)))
    }

    /// Chooses settings and size for a frame of a moving pose: the most exact ones that are predicted to keep the time of the goal. Margins do not count,
    /// since a late frame does no harm. `allows` tells which settings can be drawn, at which scale. `None` if none can, or without a time.
    pub fn choose_moving(
        &self,
        goal: &Goal,
        moving: &Moving<'_>,
        asked: &Asked,
        ground: &Ground,
        paces: &Paces,
        allows: impl Fn(&Settings, f64) -> bool,
    ) -> Option<Chosen> {
        let most_ms = goal.most_ms?;
        let [least, most] = moving.scales;
        let scales = asked.rows.iter().map(|(row, _)| self.rows[*row].scale);
        let smallest = scales.filter(|scale| *scale >= least).fold(f64::INFINITY, f64::min);
        // No size that was measured is within both bounds.
        let most = most.max(smallest);
        let fits = |row: &Row, settings: &Settings| {
            (least..=most).contains(&row.scale)
                && !moving.is_finer(settings, row.scale)
                && allows(settings, row.scale)
        };
        let found = self.predictions(asked, std::slice::from_ref(ground), paces, fits);
        let is_in_time = |at: &usize, times: f64| found[*at].2.ms <= times * most_ms;
        let db = |at: usize| found[at].2.psnr_db;
        // Of equal ones the first: plain settings come first.
        let in_time = (0..found.len()).rev().filter(|at| is_in_time(at, 1.0));
        let exact = in_time.max_by(|&a, &b| db(a).total_cmp(&db(b)));
        let held = |best: usize| {
            let is_held = |at: &usize| Some(&*self.rows[found[*at].0].label) == moving.held;
            let held = (0..found.len()).find(is_held);
            held.filter(|at| is_in_time(at, HELD_TIMES) && db(*at) >= db(best) - HELD_DB)
        };
        let (best, because) = match exact.map(|best| (best, held(best))) {
            Some((_, Some(held))) => (
                held,
                "the settings of the frame before stay, because no others in time are more exact by over 1 dB",
            ),
            Some((best, None)) => (best, "the most exact settings and size in time"),
            None => {
                let ms = |at: &usize| found[*at].2.ms;
                let fastest = (0..found.len()).min_by(|a, b| ms(a).total_cmp(&ms(b)))?;
                if self.rows[found[fastest].0].scale >= 1.0 {
                    // It was not measured in smaller sizes, which may be in time.
                    return None;
                }
                (fastest, "the fastest settings and size, because none are known to be in time")
            }
        };
        let because = format!("the pose moves: {because}");
        let keeps = is_in_time(&best, 1.0);
        Some(self.chosen(goal, asked, paces, &found, (best, keeps, because)))
    }

    /// The settings of each row that is wanted, and the worst of its predicted frames.
    fn predictions(
        &self,
        asked: &Asked,
        grounds: &[Ground],
        paces: &Paces,
        is_wanted: impl Fn(&Row, &Settings) -> bool,
    ) -> Vec<(usize, Settings, Prediction)> {
        let rows = asked.rows.iter();
        rows.filter_map(|&(index, settings)| {
            let row = &self.rows[index];
            let pace = paces.of(row.alike);
            let frames = || grounds.iter().map(|ground| row.model.predict(ground, pace));
            let is_wanted = is_wanted(row, &settings);
            Some((index, settings, is_wanted.then(frames)?.reduce(Prediction::worse)?))
        })
        .collect()
    }

    /// The choice of the row `best` among those that were found.
    fn chosen(
        &self,
        goal: &Goal,
        asked: &Asked,
        paces: &Paces,
        found: &[(usize, Settings, Prediction)],
        (best, keeps, because): (usize, bool, String),
    ) -> Chosen {
        let (row, settings, prediction) = found[best];
        let (keeps, because) = match &asked.others[..] {
            [] => (Some(keeps), because),
            // A picture of another look has other errors and times.
            others => {
                let others = others.join("`, `");
                (None, format!("{because}, as far as is known: it was measured without `{others}`"))
            }
        };
        let plan = PlanReceipt {
            keeps,
            chosen: Some(self.alternative(row, &prediction)),
            alternatives: self.front(found, best),
            compared: found.len(),
            poses: self.poses,
            ..goal.unplanned(because)
        };
        let Row { scale, alike: row, .. } = self.rows[row];
        let measured_pace_ms = prediction.ms / paces.of(row);
        let is_as_measured = asked.others.is_empty();
        Chosen { row, settings, scale, plan, measured_pace_ms, is_as_measured }
    }

    fn alternative(&self, row: usize, found: &Prediction) -> Alternative {
        // Two decimals of a millisecond and of a decibel say all that is known. What misses a goal by less must not look as if it kept the goal.
        let up = |number: f64| (number * 100.0).ceil() / 100.0;
        let down = |number: f64| (number * 100.0).floor() / 100.0;
        Alternative {
            setting: self.rows[row].label.clone(),
            ms: up(found.ms),
            most_ms: up(found.most_ms),
            psnr_db: down(found.psnr_db),
            least_psnr_db: down(found.least_psnr_db),
        }
    }

    /// Settings that no other one beats in predicted time and error, but the chosen one: from the fastest to the most exact.
    fn front(&self, found: &[(usize, Settings, Prediction)], but: usize) -> Vec<Alternative> {
        let mut order: Vec<usize> = (0..found.len()).collect();
        order.sort_by(|&a, &b| found[a].2.ms.total_cmp(&found[b].2.ms));
        let mut most_db = f64::NEG_INFINITY;
        order.retain(|&at| {
            let is_better = found[at].2.psnr_db >= most_db + SEEN_DB;
            if is_better {
                most_db = found[at].2.psnr_db;
            }
            is_better && self.rows[found[at].0].alike != self.rows[found[but].0].alike
        });
        // Those whose time is next to the chosen one's.
        let chosen_ms = found[but].2.ms;
        let after = order.partition_point(|&at| found[at].2.ms < chosen_ms);
        let begin = after.saturating_sub(MOST_ALTERNATIVES / 2);
        let begin = begin.min(order.len().saturating_sub(MOST_ALTERNATIVES));
        let shown = order.iter().skip(begin).take(MOST_ALTERNATIVES);
        shown.map(|&at| self.alternative(found[at].0, &found[at].2)).collect()
    }
}

/// The best of the predicted settings, and why.
fn pick(goal: &Goal, found: &[(usize, Settings, Prediction)]) -> Option<(usize, String)> {
    let fastest = |among: &mut dyn Iterator<Item = usize>| {
        among.min_by(|&a, &b| found[a].2.ms.total_cmp(&found[b].2.ms))
    };
    let most_exact = |among: &mut dyn Iterator<Item = usize>| {
        // Of equal ones the first, as for the fastest: plain settings come first.
        among.min_by(|&a, &b| {
            let by_error = found[b].2.least_psnr_db.total_cmp(&found[a].2.least_psnr_db);
            by_error.then(found[a].2.ms.total_cmp(&found[b].2.ms))
        })
    };
    let of = |test: &dyn Fn(&Prediction) -> bool| {
        (0..found.len()).filter(|&at| test(&found[at].2)).collect::<Vec<usize>>().into_iter()
    };
    let all = || of(&|_| true);
    let asked = goal.in_words();
    if goal.least_db.is_some()
        && let Some(best) = fastest(&mut of(&|one| goal.keeps(one)))
    {
        return Some((best, format!("the fastest setting that keeps {asked}")));
    }
    if let Some(best) =
        most_exact(&mut of(&|one| goal.keeps_budget(one)).filter(|_| goal.most_ms.is_some()))
    {
        return Some(match goal.least_db {
            None => (best, format!("the most exact setting that keeps {asked}")),
            Some(_) => (
                best,
                format!(
                    "no setting is known to keep {asked}; this is the most exact one that keeps the time"
                ),
            ),
        });
    }
    let none = format!("no setting is known to keep {asked}");
    match goal.most_ms {
        Some(_) => Some((fastest(&mut all())?, format!("{none}; this is the fastest one"))),
        None => Some((most_exact(&mut all())?, format!("{none}; this is the most exact one"))),
    }
}

/// What a setting means for the work of a frame that is drawn at a scale. Pixels are those of the frame as it is shown.
fn effort(given: &Given, scale: f64) -> Effort {
    let settings = Settings::from(*given);
    Effort {
        error_px: settings.accepted_px_of_trees().map(|px| f64::from(px) / scale),
        parts: (f64::from(settings.parts()) * scale).powi(2),
    }
}

impl Paces {
    /// How many times as long as measured frames those of a row take.
    pub fn of(&self, row: usize) -> f64 {
        let all: f64 = self.rows.iter().map(|(_, frames)| frames).sum();
        let common = self.rows.iter().map(|(log, frames)| log * frames).sum::<f64>() / all.max(1.0);
        let (log, frames) = self.rows.get(row).copied().unwrap_or_default();
        ((log * frames + common * COMMON) / (frames + COMMON)).exp()
    }

    /// Takes a frame of a row into account that took `actual_ms`, and `measured_pace_ms` at the pace of measured ones.
    pub fn see(&mut self, row: usize, measured_pace_ms: f64, actual_ms: f64) {
        let quotient = actual_ms / measured_pace_ms;
        if !(quotient.is_finite() && quotient > 0.0) {
            return;
        }
        if self.rows.len() <= row {
            self.rows.resize(row + 1, (0.0, 0.0));
        }
        let (log, frames) = &mut self.rows[row];
        let most = MOST_CHANGE.ln();
        let [least_pace, most_pace] = PACES.map(f64::ln);
        let off = (quotient.ln() - *log).clamp(-most, most);
        *frames = (*frames + 1.0).min(MOST_FRAMES);
        *log = (*log + off / frames.min(4.0)).clamp(least_pace, most_pace);
    }
}

#[cfg(test)]
mod tests;
