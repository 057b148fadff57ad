//! The list of what a survey draws, its order, and the statistics of what it finds. Pure: no engine, clock or file.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

use crate::plan::{Extent, Given, Settings, scaled_size, trade_offs};
use crate::scene::random::SplitMix64;

/// A combination of settings that a survey measures.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Name in words, such as `splats spt 1 px`.
    pub label: String,
    /// How samples are drawn; rows of a family have one colour in the plot.
    pub family: String,
    pub given: Given,
    /// Width and height of the drawn frames as a share of those that are shown: 1, or one of [`SCALES`].
    pub scale: f64,
}

/// Scales of frames that are drawn smaller than they are shown, as moving frames of streams are, and their names.
pub const SCALES: [(f64, &str); 2] = [(0.75, "3/4"), (0.5, "1/2")];
/// The scales that a planner chooses from.
const PLANNED_SCALES: [(f64, &str); 3] = [SCALES[0], SCALES[1], (0.25, "1/4")];

impl Row {
    /// Whether the row is what the program draws when nothing is chosen.
    pub fn is_default(&self) -> bool {
        Settings::from(self.given) == Settings::default() && self.is_whole()
    }

    /// Whether frames are drawn as large as they are shown.
    pub fn is_whole(&self) -> bool {
        self.scale >= 1.0
    }

    /// Size in pixels of the drawn frames for a size that is shown.
    pub fn drawn_size(&self, shown: [u32; 2]) -> [u32; 2] {
        scaled_size(shown, self.scale)
    }

    /// Whether the row draws full detail at full size without antialiasing, and nothing else.
    pub fn is_plain_full(&self) -> bool {
        let settings = Settings::from(self.given);
        !settings.draws_trees() && settings.parts() == 1 && self.is_whole()
    }

    /// Name as a part of file names: letters, digits and single hyphens.
    pub fn slug(&self) -> String {
        slug(&self.label)
    }
}

/// The text with each run of other characters than letters and digits replaced by a hyphen.
pub fn slug(text: &str) -> String {
    let words: Vec<&str> =
        text.split(|c: char| !c.is_ascii_alphanumeric()).filter(|word| !word.is_empty()).collect();
    words.join("-")
}

/// All combinations of settings, from their declarations, at full size. In a scene without samples, rows of full detail that differ only in how samples are
/// drawn give the same frame. The first of them is named without a way to draw samples.
pub fn rows(extent: Extent, has_samples: bool) -> Vec<Row> {
    named(combinations(extent), has_samples)
}

/// All rows of a survey: the combinations of settings, and the main ones with default numbers at each of [`SCALES`].
pub fn sized_rows(extent: Extent, has_samples: bool) -> Vec<Row> {
    named(sized(extent), has_samples)
}

/// All rows of a planner: the combinations of settings, and those without antialiasing in smaller sizes.
pub fn planned_rows(has_samples: bool) -> Vec<Row> {
    let mut found = combinations(Extent::Planned);
    found.extend(smaller(&found, &PLANNED_SCALES));
    named(found, has_samples)
}

/// Rows of a survey that are compared along a camera path: the main settings, and the variants and sizes that matter most.
pub fn main_rows(extent: Extent, has_samples: bool) -> Vec<Row> {
    let mut found = sized(Extent::Few);
    if extent == Extent::All {
        let more = combinations(Extent::Planned).into_iter().filter(|row| !found.contains(row));
        found.extend(more.collect::<Vec<_>>());
    }
    named(found, has_samples)
}

fn combinations(extent: Extent) -> Vec<Row> {
    let row = |found: crate::plan::TradeOff| Row {
        label: found.label,
        family: found.family,
        given: found.given,
        scale: 1.0,
    };
    trade_offs(extent).into_iter().map(row).collect()
}

fn sized(extent: Extent) -> Vec<Row> {
    let mut found = combinations(extent);
    found.extend(smaller(&combinations(Extent::Few), &SCALES));
    found
}

/// The rows with the names that they have in a scene with or without samples.
fn named(mut rows: Vec<Row>, has_samples: bool) -> Vec<Row> {
    let mut known: BTreeSet<String> = BTreeSet::new();
    // Point trees of meshes have samples.
    let without = rows.iter_mut().filter(|row| !Settings::from(row.given).draws_trees());
    for row in without.filter(|_| !has_samples) {
        let rest = row.label.strip_prefix(&row.family).unwrap_or(&row.label).trim_start();
        if known.insert(rest.to_owned()) {
            row.label = rest.to_owned();
        }
    }
    rows
}

/// The rows at each of these scales, without those that are `auto` or antialiased.
fn smaller(rows: &[Row], scales: &[(f64, &str)]) -> Vec<Row> {
    let is_plain = |row: &&Row| {
        let settings = Settings::from(row.given);
        !settings.leaves_drawing_open() && settings.parts() == 1
    };
    let at = |row: &Row, (scale, name): (f64, &str)| {
        let label = format!("{} size={name}", row.label);
        Row { label, scale, ..row.clone() }
    };
    let each = |row| scales.iter().map(move |&scale| at(row, scale));
    rows.iter().filter(is_plain).flat_map(each).collect()
}

/// For each row, given with the settings that it is drawn with, the row that stands for all rows that are drawn alike in the same size: the first one
/// that is drawn as it asks, or else the first one. `None` for rows that are not drawn.
pub fn owners(rows: &[(&Row, Option<&Given>)]) -> Vec<Option<usize>> {
    let is_as_asked = |asked: &Given, drawn: &Given| {
        let drawn = drawn.pairs();
        asked.pairs().iter().all(|pair| drawn.contains(pair))
    };
    let owner = |own: &Row, drawn: &Given| {
        let is_alike = |row: &usize| rows[*row].1 == Some(drawn) && rows[*row].0.scale == own.scale;
        let mut alike = (0..rows.len()).filter(is_alike).peekable();
        let first = alike.peek().copied();
        alike.find(|&row| is_as_asked(&rows[row].0.given, drawn)).or(first)
    };
    rows.iter().map(|(own, drawn)| owner(own, (*drawn)?)).collect()
}

/// Steps of a pose whose rows have these [`owners`]: each row is one, and so is each timed frame. Rows that are refused or drawn as others are not timed.
pub fn steps(owners: &[Option<usize>], repeats: u32) -> u64 {
    let own = owners.iter().enumerate().filter(|(row, owner)| **owner == Some(*row));
    owners.len() as u64 + own.count() as u64 * u64::from(repeats)
}

/// A timed frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Draw {
    pub pose: usize,
    pub row: usize,
    pub repeat: u32,
}

/// All timed frames of these poses and rows, in an order that the seed decides: slow drifts of the machine then meet all rows alike.
pub fn order(subjects: &[(usize, usize)], repeats: u32, seed: u64) -> Vec<Draw> {
    let mut draws: Vec<Draw> = subjects
        .iter()
        .flat_map(|&(pose, row)| (0..repeats).map(move |repeat| Draw { pose, row, repeat }))
        .collect();
    let mut random = SplitMix64::new(seed);
    for last in (1..draws.len()).rev() {
        draws.swap(last, random.index(last + 1));
    }
    draws
}

/// Median and quartiles of repeated measurements.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Quartiles {
    pub count: usize,
    pub low: f64,
    pub median: f64,
    pub high: f64,
}

impl Quartiles {
    /// Quartiles by linear interpolation between ranks (type 7 of Hyndman and Fan 1996); `None` for no values.
    pub fn of(values: &[f64]) -> Option<Quartiles> {
        let mut sorted = values.to_vec();
        sorted.sort_unstable_by(f64::total_cmp);
        let at = |share: f64| {
            let place = share * sorted.len().checked_sub(1)? as f64;
            let (low, high) = (sorted.get(place as usize)?, sorted.get(place.ceil() as usize)?);
            Some(low + (high - low) * place.fract())
        };
        Some(Quartiles { count: values.len(), low: at(0.25)?, median: at(0.5)?, high: at(0.75)? })
    }

    /// Means of the medians and quartiles of several poses; `None` for no poses. `count` is the sum.
    pub fn mean(of: &[Quartiles]) -> Option<Quartiles> {
        let mean = |value: fn(&Quartiles) -> f64| {
            of.iter().map(value).sum::<f64>() / of.len().max(1) as f64
        };
        (!of.is_empty()).then(|| Quartiles {
            count: of.iter().map(|one| one.count).sum(),
            low: mean(|one| one.low),
            median: mean(|one| one.median),
            high: mean(|one| one.high),
        })
    }
}

/// Indices of the points that no other point beats in both time and error, from the fastest to the most exact. Less is better in both. Of
/// equal points, the first counts. Points that are not finite in time or are NaN in error are left out.
pub fn pareto(points: &[(f64, f64)]) -> Vec<usize> {
    let mut sorted: Vec<usize> =
        (0..points.len()).filter(|&i| points[i].0.is_finite() && !points[i].1.is_nan()).collect();
    sorted.sort_by(|&a, &b| {
        points[a].0.total_cmp(&points[b].0).then(points[a].1.total_cmp(&points[b].1))
    });
    let mut front: Vec<usize> = Vec::new();
    for point in sorted {
        if front.last().is_none_or(|&last| points[point].1 < points[last].1) {
            front.push(point);
        }
    }
    front
}

/// Indices of the points of a front whose times the noise tells apart, given the times from the fastest to the most exact. A point whose quartiles reach those
/// of the next more exact one is left out: another run might swap the two.
pub fn told_apart(times: &[Quartiles]) -> Vec<usize> {
    let mut kept: Vec<usize> = Vec::new();
    // From the most exact one, so that a row of points that each reach the next is not left out as a whole.
    for index in (0..times.len()).rev() {
        if kept.last().is_none_or(|&next| times[index].high < times[next].low) {
            kept.push(index);
        }
    }
    kept.reverse();
    kept
}

/// Price of accuracy between two points of a front.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, utoipa::ToSchema)]
pub struct Price {
    pub from_db: f64,
    pub to_db: f64,
    /// Time of the second point divided by that of the first.
    pub times: f64,
    /// Factor of time for each decibel, if every decibel costs the same factor; `None` for gains below [`LEAST_GAIN_DB`].
    pub times_per_db: Option<f64>,
}

/// Smallest gain that tells the price of a decibel: below it, the noise of times decides.
pub const LEAST_GAIN_DB: f64 = 1.0;

/// Fewest timed frames of a setting and pose that tell prices: times of fewer scatter as much as those of settings differ.
const LEAST_TIMED: u32 = 5;

/// Says beside a price that it is rough, where each setting was timed too few times at each pose.
pub fn roughness(repeats: u32) -> String {
    if repeats >= LEAST_TIMED {
        return String::new();
    }
    format!(" (rough: each setting was timed fewer than {LEAST_TIMED} times)")
}

/// Price from one point `(time, decibels)` to a more exact one; `None` where the second is not above the first or a value is not finite.
pub fn price(from: (f64, f64), to: (f64, f64)) -> Option<Price> {
    let (times, gain) = (to.0 / from.0, to.1 - from.1);
    let is_known = gain > 0.0 && gain.is_finite() && times.is_finite() && times > 0.0;
    is_known.then(|| Price {
        from_db: from.1,
        to_db: to.1,
        times,
        times_per_db: (gain >= LEAST_GAIN_DB).then(|| times.powf(1.0 / gain)),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn order_has_every_draw_once_and_follows_from_the_seed() {
        let subjects = [(0, 0), (0, 3), (1, 2)];
        let draws = order(&subjects, 4, 7);
        assert_eq!(draws.iter().collect::<BTreeSet<_>>().len(), 12);
        assert!(draws.iter().all(|draw| subjects.contains(&(draw.pose, draw.row))));
        assert_eq!(draws, order(&subjects, 4, 7));
        assert_ne!(draws, order(&subjects, 4, 8));
        assert!(!draws.is_sorted());
        assert!(order(&[], 4, 7).is_empty());
    }

    #[test]
    fn rows_that_are_refused_or_drawn_as_others_are_steps_without_timed_frames() {
        let owners = [Some(1), Some(1), None, Some(3)];
        assert_eq!((steps(&owners, 5), steps(&owners, 0), steps(&[], 5)), (14, 4, 0));
    }

    #[test]
    fn rows_that_are_drawn_alike_belong_to_the_one_that_asked_for_it() {
        let given = |pairs: &[(&str, &str)]| {
            let mut given = Given::default();
            pairs.iter().for_each(|(name, value)| given.set_text(name, value).unwrap());
            given
        };
        let row = |given, scale| Row { label: String::new(), family: String::new(), given, scale };
        let auto = given(&[("reconstruct", "auto")]);
        let splats = given(&[("reconstruct", "splats")]);
        let exact = given(&[("reconstruct", "splats"), ("filter", "exact")]);
        let (drawn, other) = (exact, given(&[("reconstruct", "points")]));
        let [auto, splats, exact] = [auto, splats, exact].map(|given| row(given, 1.0));
        let half = Row { scale: 0.5, ..splats.clone() };
        let rows = [
            (&auto, Some(&drawn)),
            (&splats, Some(&drawn)),
            (&exact, Some(&drawn)),
            (&auto, Some(&other)),
            (&splats, None),
            (&half, Some(&drawn)),
        ];
        assert_eq!(owners(&rows), [Some(1), Some(1), Some(1), Some(3), None, Some(5)]);
    }

    #[test]
    fn quartiles_interpolate_between_ranks() {
        let found = Quartiles::of(&[4.0, 1.0, 3.0, 2.0]).unwrap();
        assert_eq!((found.low, found.median, found.high, found.count), (1.75, 2.5, 3.25, 4));
        let one = Quartiles::of(&[5.0]).unwrap();
        assert_eq!((one.low, one.median, one.high), (5.0, 5.0, 5.0));
        assert_eq!(Quartiles::of(&[]), None);
        let mean = Quartiles::mean(&[found, one]).unwrap();
        assert_eq!((mean.low, mean.median, mean.count), (3.375, 3.75, 5));
        assert_eq!(Quartiles::mean(&[]), None);
    }

    #[test]
    fn a_front_has_no_point_that_another_beats() {
        let points = [(4.0, 1.0), (1.0, 9.0), (2.0, 3.0), (3.0, 3.0), (2.0, 3.0), (5.0, 0.5)];
        assert_eq!(pareto(&points), [1, 2, 0, 5]);
        assert_eq!(pareto(&[(1.0, f64::NAN), (f64::INFINITY, 0.0), (2.0, f64::INFINITY)]), [2]);
        assert!(pareto(&[]).is_empty());
    }

    /// Quartiles reach from 0.9 to 1.2 times the median: those of the second reach those of the third, those of the first reach the second's alone.
    #[test]
    fn points_within_the_noise_of_the_next_are_left_out() {
        let time = |ms: f64| Quartiles { count: 3, low: 0.9 * ms, median: ms, high: 1.2 * ms };
        assert_eq!(told_apart(&[10.0, 12.5, 14.0, 30.0].map(time)), [0, 2, 3]);
        assert!(told_apart(&[]).is_empty());
    }

    #[test]
    fn prices_are_factors_of_time() {
        let found = price((2.0, 30.0), (8.0, 32.0)).unwrap();
        assert_eq!((found.times, found.times_per_db), (4.0, Some(2.0)));
        let small = price((2.0, 30.0), (3.0, 30.05)).unwrap();
        assert_eq!((small.times, small.times_per_db), (1.5, None));
        assert_eq!(price((2.0, 30.0), (8.0, 30.0)), None);
        assert_eq!(price((2.0, 30.0), (8.0, f64::INFINITY)), None);
    }

    #[test]
    fn rows_have_file_names_of_their_own() {
        let rows = sized_rows(Extent::All, true);
        let slugs: BTreeSet<String> = rows.iter().map(Row::slug).collect();
        assert_eq!(slugs.len(), rows.len());
        assert!(slugs.contains("splats-spt-0-25-px"), "{slugs:?}");
        assert!(slugs.contains("fuzzy-full-size-1-2"), "{slugs:?}");
        assert_eq!(rows.iter().filter(|row| row.is_default()).count(), 1);
        assert_eq!(slug("a/../b  c"), "a-b-c");
    }

    #[test]
    fn rows_of_a_scene_without_samples_do_not_say_how_samples_are_drawn() {
        for (with, without) in [
            (planned_rows(true), planned_rows(false)),
            (sized_rows(Extent::All, true), sized_rows(Extent::All, false)),
        ] {
            let labels: BTreeSet<&str> = without.iter().map(|row| row.label.as_str()).collect();
            assert_eq!((labels.len(), without.len()), (without.len(), with.len()));
            for expected in ["full", "full antialias=4x", "full size=1/2", "points spt 1 px"] {
                assert!(labels.contains(expected), "{expected} in {labels:?}");
            }
            // The rows are the same ones in all else.
            for (with, without) in with.iter().zip(&without) {
                let renamed = Row { label: with.label.clone(), ..without.clone() };
                assert_eq!(&renamed, with);
                assert!(with.label.ends_with(&without.label), "{} {}", with.label, without.label);
            }
        }
    }

    #[test]
    fn the_main_settings_are_drawn_smaller_as_well() {
        let sized = sized_rows(Extent::Few, true);
        let smaller: Vec<&Row> = sized.iter().filter(|row| !row.is_whole()).collect();
        for row in &smaller {
            let (plain, _) = row.label.rsplit_once(" size=").unwrap();
            let whole = sized.iter().find(|row| row.label == plain).unwrap();
            assert_eq!((whole.given, whole.family.as_str()), (row.given, row.family.as_str()));
            assert!(!plain.contains('=') && row.family != "auto" && !row.is_default());
        }
        let plain = rows(Extent::Few, true).len();
        assert_eq!((smaller.len() + plain, smaller.len() % 2), (sized.len(), 0));
        assert!(
            rows(Extent::Planned, true).iter().chain(&rows(Extent::All, true)).all(Row::is_whole)
        );
        let half = smaller.iter().find(|row| row.label == "splats full size=1/2").unwrap();
        assert_eq!((half.drawn_size([640, 361]), half.drawn_size([1, 1])), ([320, 181], [1, 1]));
    }

    #[test]
    fn a_planner_chooses_from_every_way_to_draw_samples_in_every_size() {
        let rows = planned_rows(true);
        for way in ["points", "splats", "fuzzy", "painted", "pull_push"] {
            for detail in ["full", "spt 1 px", "spt 8 px"] {
                for size in ["", " size=3/4", " size=1/2", " size=1/4"] {
                    let label = format!("{way} {detail}{size}");
                    assert!(rows.iter().any(|row| row.label == label), "{label}");
                }
            }
        }
    }

    #[test]
    fn rows_of_a_path_are_those_of_the_survey_and_have_one_full_detail_each() {
        for (extent, error) in [(Extent::Few, "splats spt 1 px"), (Extent::All, "splats spt 4 px")]
        {
            let (own, all) = (main_rows(extent, true), sized_rows(extent, true));
            assert!(own.iter().all(|row| all.contains(row)), "{extent:?}");
            assert!(own.iter().any(|row| row.label == error), "{extent:?}");
            assert!(own.iter().any(Row::is_default), "{extent:?}");
            let families: BTreeSet<&str> = own.iter().map(|row| row.family.as_str()).collect();
            for family in families {
                let plain = own.iter().filter(|row| row.family == family && row.is_plain_full());
                assert_eq!(plain.count(), 1, "{family}");
            }
        }
    }
}
