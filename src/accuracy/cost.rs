//! What one more decibel costs in several scenes: the Pareto fronts of their reports, compared at equal levels of PSNR. Pure.
//!
//! A frame that has to have at least so many decibels takes the time of the fastest setting that has them. The price of a level is that time
//! over the time of the level below it. The price of a decibel in a scene is the factor of time from the fastest point of its front to the
//! most exact one that differs from the reference, spread evenly over the decibels between them ([`price`]). A second price is that from one fixed
//! level to another, because fronts of different reports begin and end elsewhere.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::results::{decibels_down, three_digits};
use super::sweep::{Price, Quartiles, pareto, price, roughness, told_apart};

/// Decibels between two levels, and the same where there would be more than [`MOST_LEVELS`] of them.
const LEVEL_DB: f64 = 5.0;
const WIDE_LEVEL_DB: f64 = 10.0;
const MOST_LEVELS: f64 = 10.0;
/// Levels between which the price can be compared with that of another report.
const FIXED_DB: [f64; 2] = [30.0, 40.0];

/// Why a report tells no price.
#[derive(Debug, thiserror::Error)]
pub enum CostError {
    #[error(
        "not the accuracy.json of a report: {0}; write one with pointillist accuracy SCENE -o FOLDER"
    )]
    Json(#[from] serde_json::Error),
    #[error("no setting has been timed; run pointillist accuracy SCENE -o FOLDER to its end")]
    Empty,
    #[error("{row}: a time is {value} ms; times are greater than zero")]
    Time { row: String, value: f64 },
}

/// The parts of `accuracy.json` that tell the price of accuracy.
#[derive(Deserialize)]
struct Told {
    identity: ToldIdentity,
    date: String,
    scopes: Vec<ToldScope>,
}

#[derive(Deserialize)]
struct ToldIdentity {
    version: String,
    adapter: String,
    scene: String,
    width: u32,
    height: u32,
    repeats: u32,
    reference: String,
}

#[derive(Deserialize)]
struct ToldScope {
    name: String,
    entries: Vec<ToldEntry>,
    fronts: BTreeMap<String, Vec<String>>,
}

#[derive(Deserialize)]
struct ToldEntry {
    row: String,
    psnr_db: Option<f64>,
    gpu_ms: Option<Quartiles>,
}

/// A setting on the Pareto front of a scene.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Point {
    /// The setting in words.
    pub label: String,
    /// `None` for frames that equal the reference.
    pub psnr_db: Option<f64>,
    pub gpu_ms: Quartiles,
}

impl Point {
    /// Decibels, infinite for frames that equal the reference.
    pub fn decibels(&self) -> f64 {
        self.psnr_db.unwrap_or(f64::INFINITY)
    }
}

/// The Pareto front of a scene, from the fastest setting to the most exact.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Curve {
    pub scene: String,
    pub adapter: String,
    pub version: String,
    pub date: String,
    pub width: u32,
    pub height: u32,
    pub repeats: u32,
    /// Name of the only pose, or that of all poses together.
    pub poses: String,
    pub reference: String,
    pub points: Vec<Point>,
    /// The price from the fastest point to the most exact one that differs from the reference.
    pub price: Option<Price>,
    /// The price from the fastest point with at least 30 dB to the fastest with at least 40 dB.
    pub price_30_to_40_db: Option<Price>,
}

impl Curve {
    /// Reads the front of the first scope of `accuracy.json`: all poses, or the only one.
    ///
    /// # Errors
    /// The text is no such report, a time is not above zero, or nothing has been timed.
    pub fn read(json: &str) -> Result<Curve, CostError> {
        let told: Told = serde_json::from_str(json)?;
        let scope = told.scopes.into_iter().next().ok_or(CostError::Empty)?;
        let on_front = scope.fronts.get("psnr").map(Vec::as_slice).unwrap_or_default();
        let mut points = Vec::new();
        for entry in scope.entries.into_iter().filter(|entry| on_front.contains(&entry.row)) {
            let Some(time) = entry.gpu_ms else { continue };
            let wrong = [time.low, time.median, time.high].into_iter().find(|ms| *ms <= 0.0);
            if let Some(value) = wrong {
                return Err(CostError::Time { row: entry.row, value });
            }
            points.push(Point { label: entry.row, psnr_db: entry.psnr_db, gpu_ms: time });
        }
        let points = front(&points);
        if points.is_empty() {
            return Err(CostError::Empty);
        }
        let identity = told.identity;
        Ok(Curve {
            scene: identity.scene,
            adapter: identity.adapter,
            version: identity.version,
            date: told.date,
            width: identity.width,
            height: identity.height,
            repeats: identity.repeats,
            poses: scope.name,
            reference: identity.reference,
            price: whole_price(&points),
            price_30_to_40_db: fixed_price(&points),
            points,
        })
    }

    /// The scene's name without the ending of its file.
    pub fn name(&self) -> &str {
        self.scene.rsplit_once('.').map_or(&self.scene, |(name, _)| name)
    }

    /// What one more decibel costs in this scene, in words.
    pub fn answer(&self) -> String {
        let Some(price) = self.price else {
            return format!("{}: no slower setting is more exact", self.name());
        };
        let Some(whole) = percent(&price) else {
            return format!(
                "{}: less than a decibel lies between its settings ({} times the time)",
                self.name(),
                three_digits(price.times)
            );
        };
        let [low, high] = FIXED_DB;
        let fixed = self.price_30_to_40_db.as_ref().and_then(percent);
        let fixed =
            fixed.map_or_else(String::new, |each| format!("; {each:.0} % from {low} to {high} dB"));
        format!(
            "{}: {whole:.0} % more time for one more decibel{}, from {} dB to {} dB ({} times the time){fixed}",
            self.name(),
            roughness(self.repeats),
            decibels_down(price.from_db),
            decibels_down(price.to_db),
            three_digits(price.times)
        )
    }
}

/// Percent of time that each decibel of a price adds.
fn percent(price: &Price) -> Option<f64> {
    Some(100.0 * (price.times_per_db? - 1.0))
}

/// The points that no other point beats in time and decibels and whose times the noise [tells apart](told_apart), from the fastest. Points whose decibels are
/// NaN, or whose time is not finite, are left out.
fn front(points: &[Point]) -> Vec<Point> {
    let pairs: Vec<(f64, f64)> =
        points.iter().map(|point| (point.gpu_ms.median, -point.decibels())).collect();
    let front: Vec<&Point> = pareto(&pairs).into_iter().map(|index| &points[index]).collect();
    let times: Vec<Quartiles> = front.iter().map(|point| point.gpu_ms).collect();
    told_apart(&times).into_iter().map(|index| front[index].clone()).collect()
}

/// The fastest point of the front that has at least so many decibels.
fn at_least(points: &[Point], decibels: f64) -> Option<&Point> {
    points.iter().find(|point| point.decibels() >= decibels)
}

fn whole_price(points: &[Point]) -> Option<Price> {
    let last = points.iter().rev().find(|point| point.decibels().is_finite())?;
    let place = |point: &Point| (point.gpu_ms.median, point.decibels());
    price(place(points.first()?), place(last))
}

/// The levels count here, whatever their points have above them.
fn fixed_price(points: &[Point]) -> Option<Price> {
    let [low, high] = FIXED_DB;
    let ms = |level: f64| at_least(points, level).map(|point| point.gpu_ms.median);
    price((ms(low)?, low), (ms(high)?, high))
}

/// What a level costs in a scene.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Reached {
    /// The fastest setting that reaches the level, with its decibels and its median time.
    pub label: String,
    pub psnr_db: Option<f64>,
    pub gpu_ms: f64,
    /// Time over that of the level below; `None` for the lowest level.
    pub times: Option<f64>,
}

/// A level of PSNR and what it costs in each scene; `None` where no setting reaches it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Level {
    pub least_db: f64,
    pub scenes: Vec<Option<Reached>>,
}

/// What one more decibel costs in several scenes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Costs {
    /// The answer in a sentence.
    pub summary: String,
    pub curves: Vec<Curve>,
    pub levels: Vec<Level>,
}

impl Costs {
    /// Compares the fronts of these scenes.
    pub fn new(curves: Vec<Curve>) -> Costs {
        Costs { summary: summary(&curves), levels: levels(&curves), curves }
    }
}

/// Multiples of [`LEVEL_DB`] from what every fastest setting has to what the most exact setting reaches.
fn levels(curves: &[Curve]) -> Vec<Level> {
    let finite = || {
        let all = curves.iter().flat_map(|curve| &curve.points).map(Point::decibels);
        all.filter(|decibels| decibels.is_finite())
    };
    let (low, high) = finite()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), db| (low.min(db), high.max(db)));
    if low > high {
        return Vec::new();
    }
    let is_wide = high - low > LEVEL_DB * MOST_LEVELS;
    let step = if is_wide { WIDE_LEVEL_DB } else { LEVEL_DB };
    let of_level = |least_db: f64, below: Option<f64>| {
        let reached = |curve: &Curve| {
            let point = at_least(&curve.points, least_db)?;
            let below = below.and_then(|below| at_least(&curve.points, below));
            Some(Reached {
                label: point.label.clone(),
                psnr_db: point.psnr_db,
                gpu_ms: point.gpu_ms.median,
                times: below.map(|below| point.gpu_ms.median / below.gpu_ms.median),
            })
        };
        Level { least_db, scenes: curves.iter().map(reached).collect() }
    };
    let (first, last) = ((low / step).floor() as i64, (high / step).floor() as i64);
    let db = |level: i64| level as f64 * step;
    (first..=last)
        .map(|level| of_level(db(level), (level > first).then(|| db(level - 1))))
        .collect()
}

fn summary(curves: &[Curve]) -> String {
    let Some(whole) = percents(curves, |curve| curve.price) else {
        return "No scene has settings of different accuracy.".to_owned();
    };
    let depending = if whole.contains(" to ") { ", depending on the scene" } else { "" };
    let [low, high] = FIXED_DB;
    let fixed = percents(curves, |curve| curve.price_30_to_40_db);
    let fixed = fixed
        .map_or_else(String::new, |each| format!(" From {low} to {high} dB, it costs {each}."));
    let priced = curves.iter().filter(|curve| curve.price.is_some());
    let rough = priced.map(|curve| curve.repeats).max().map_or_else(String::new, roughness);
    format!("One more decibel costs {whole} more time on average{rough}{depending}.{fixed}")
}

/// The percentages that a decibel adds to the time in the scenes that have a price, from the least to the most; `None` where no scene has one.
fn percents(curves: &[Curve], of: fn(&Curve) -> Option<Price>) -> Option<String> {
    let all: Vec<f64> = curves.iter().filter_map(of).filter_map(|price| percent(&price)).collect();
    let least = all.iter().copied().reduce(f64::min)?;
    let most = all.iter().copied().reduce(f64::max)?;
    Some(match all.len() {
        1 => format!("{most:.0} %"),
        _ => format!("{least:.0} to {most:.0} %"),
    })
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::accuracy::results::tests::results;

    fn point(row: &str, psnr_db: Option<f64>, ms: f64) -> Point {
        let gpu_ms = Quartiles { count: 3, low: 0.9 * ms, median: ms, high: 1.2 * ms };
        Point { label: row.into(), psnr_db, gpu_ms }
    }

    fn curve(scene: &str, points: Vec<Point>) -> Curve {
        let points = front(&points);
        Curve {
            scene: scene.into(),
            adapter: "A".into(),
            version: "1".into(),
            date: "2026-01-02".into(),
            width: 4,
            height: 3,
            repeats: 3,
            poses: "all poses".into(),
            reference: "the reference".into(),
            price: whole_price(&points),
            price_30_to_40_db: fixed_price(&points),
            points,
        }
    }

    /// A scene of three settings, one that equals the reference, and one of a single setting.
    pub(in crate::accuracy) fn costs() -> Costs {
        let town = vec![
            point("fast", Some(28.0), 2.0),
            point("good <way>", Some(38.0), 8.0),
            point("beaten", Some(30.0), 9.0),
            point("exact", None, 20.0),
        ];
        let lone = vec![point("only", Some(34.0), 5.0)];
        Costs::new(vec![curve("town.json", town), curve("lone.ply", lone)])
    }

    #[test]
    fn levels_take_the_fastest_setting_that_has_them() {
        let costs = costs();
        let levels: Vec<f64> = costs.levels.iter().map(|level| level.least_db).collect();
        assert_eq!(levels, [25.0, 30.0, 35.0]);
        let town: Vec<(String, f64, Option<f64>)> = costs
            .levels
            .iter()
            .filter_map(|level| level.scenes[0].clone())
            .map(|reached| (reached.label, reached.gpu_ms, reached.times))
            .collect();
        assert_eq!(
            town,
            [
                ("fast".into(), 2.0, None),
                ("good <way>".into(), 8.0, Some(4.0)),
                ("good <way>".into(), 8.0, Some(1.0)),
            ]
        );
        // The other scene reaches 34 dB.
        let lone = |level: usize| costs.levels[level].scenes[1].as_ref().map(|at| at.times);
        assert_eq!([0, 1, 2].map(lone), [Some(None), Some(Some(1.0)), None]);
        // Frames that equal the reference reach every level.
        assert_eq!(at_least(&costs.curves[0].points, 1e9).unwrap().label, "exact");
    }

    #[test]
    fn prices_are_percent_of_time_for_a_decibel() {
        let costs = costs();
        let price = costs.curves[0].price.unwrap();
        assert_eq!((price.from_db, price.to_db, price.times), (28.0, 38.0, 4.0));
        assert_eq!(
            costs.curves[0].answer(),
            "town: 15 % more time for one more decibel (rough: each setting was timed fewer than 5 times), from 28.0 dB to 38.0 dB (4.00 times the time); \
             10 % from 30 to 40 dB"
        );
        assert_eq!(costs.curves[1].answer(), "lone: no slower setting is more exact");
        let rough = "One more decibel costs 15 % more time on average (rough: each setting was timed fewer than 5 times). From 30 to 40 dB, it costs 10 %.";
        assert_eq!(costs.summary, rough);
        let often = Curve { repeats: 5, ..costs.curves[0].clone() };
        assert!(!often.answer().contains("rough"), "{}", often.answer());
        assert_eq!(
            summary(&[often]),
            "One more decibel costs 15 % more time on average. From 30 to 40 dB, it costs 10 %."
        );
        let close = curve("close", vec![point("a", Some(30.0), 2.0), point("b", Some(30.5), 3.0)]);
        assert!(close.answer().contains("less than a decibel"), "{}", close.answer());
        let two = summary(&[costs.curves[0].clone(), costs.curves[0].clone()]);
        assert!(two.starts_with("One more decibel costs 15 to 15 %"), "{two}");
    }

    /// The town takes 8 ms for 30 dB and 20 ms for 40 dB, although its points have 38 dB and no error. The other scene does not reach 40 dB.
    #[test]
    fn prices_between_fixed_levels_do_not_depend_on_where_fronts_end() {
        let costs = costs();
        let fixed = costs.curves[0].price_30_to_40_db.unwrap();
        assert_eq!((fixed.from_db, fixed.to_db, fixed.times), (30.0, 40.0, 2.5));
        assert_eq!(costs.curves[1].price_30_to_40_db, None);
    }

    /// A setting that misses a level by a hair is not said to have it.
    #[test]
    fn decibels_are_rounded_down() {
        let points = vec![point("a", Some(29.993), 2.0), point("b", Some(39.993), 4.0)];
        let answer = curve("scene", points).answer();
        assert!(answer.contains("from 29.9 dB to 39.9 dB (2.00 times"), "{answer}");
    }

    #[test]
    fn fronts_rise_and_have_no_values_that_are_not_numbers() {
        let points = vec![
            point("slow", Some(40.0), 9.0),
            point("nan", Some(f64::NAN), 1.0),
            point("never", Some(60.0), f64::INFINITY),
            point("fast", Some(30.0), 2.0),
            point("beaten", Some(29.0), 3.0),
        ];
        let rows: Vec<String> = front(&points).into_iter().map(|point| point.label).collect();
        assert_eq!(rows, ["fast", "slow"]);
        assert!(levels(&[]).is_empty());
        let equal = curve("equal", vec![point("exact", None, 1.0)]);
        assert_eq!((equal.price, levels(std::slice::from_ref(&equal))), (None, vec![]));
        assert_eq!(summary(&[equal]), "No scene has settings of different accuracy.");
        let wide = curve("wide", vec![point("a", Some(5.0), 1.0), point("b", Some(99.0), 2.0)]);
        let of: Vec<f64> = levels(&[wide]).iter().map(|level| level.least_db).collect();
        assert_eq!((of.len(), of[0], of[9]), (10, 0.0, 90.0));
    }

    #[test]
    fn reports_are_read_and_others_refused() {
        let json = serde_json::to_string(&results()).unwrap();
        let read = Curve::read(&json).unwrap();
        assert_eq!((read.name(), read.poses.as_str()), ("scene", "all poses"));
        let rows: Vec<&str> = read.points.iter().map(|point| point.label.as_str()).collect();
        assert_eq!(rows, ["fast way", "good way"]);
        let message = |text: &str| Curve::read(text).unwrap_err().to_string();
        assert!(
            message("{}").starts_with("not the accuracy.json of a report"),
            "{}",
            message("{}")
        );
        let mut untimed = serde_json::to_value(results()).unwrap();
        for entry in untimed["scopes"][0]["entries"].as_array_mut().unwrap() {
            entry["gpu_ms"] = serde_json::Value::Null;
        }
        assert!(message(&untimed.to_string()).contains("no setting has been timed"));
        untimed["scopes"] = serde_json::json!([]);
        assert!(message(&untimed.to_string()).contains("no setting has been timed"));
        let mut zero = serde_json::to_value(results()).unwrap();
        zero["scopes"][0]["entries"][0]["gpu_ms"]["low"] = 0.0.into();
        assert!(message(&zero.to_string()).contains("fast way: a time is 0 ms"));
    }
}
