//! The results of a survey: what each row costs and how far it is from the reference, at each pose and over all of them, and the Pareto
//! fronts. Pure.

use std::collections::BTreeMap;

use serde::Serialize;

use super::journal::{Identity, Metrics, Record};
use super::metrics::{Coverage, Spread, psnr_db};
use super::sweep::{Price, Quartiles, Row, owners, pareto, price};
use crate::plan::Given;

/// Name of the scope that holds all poses.
pub const ALL_POSES: &str = "all poses";

/// Family of frames that show no samples.
pub(super) const NO_SAMPLES: &str = "meshes, lines";

/// Everything that a report shows.
#[derive(Clone, Debug, Serialize, utoipa::ToSchema)]
#[schema(as = SurveyResults)]
pub struct Results {
    pub identity: Identity,
    /// Date of the first run, in UTC.
    pub date: String,
    /// What one more decibel costs, in a sentence.
    pub summary: String,
    /// All poses together, if there are several, then each pose.
    pub scopes: Vec<Scope>,
}

/// Rows at one pose, or over all of them.
#[derive(Clone, Debug, Serialize, utoipa::ToSchema)]
#[schema(as = SurveyScope)]
pub struct Scope {
    pub name: String,
    /// Folder of the pose's frames; `None` for all poses.
    pub folder: Option<String>,
    pub entries: Vec<Entry>,
    /// The entry that stands for what is drawn when nothing is chosen.
    pub default: Option<String>,
    /// Rows that the program refuses, each with the reason.
    #[schema(value_type = Vec<Vec<String>>)]
    pub refused: Vec<(String, String)>,
    /// Labels of the rows on the Pareto front of time and error, from the fastest to the most exact, by the measure of the error.
    #[schema(value_type = BTreeMap<String, Vec<String>>)]
    pub fronts: BTreeMap<&'static str, Vec<String>>,
    /// Prices from each point of the front of `psnr` to the next.
    pub steps: Vec<Price>,
    /// The price from the first point of that front to the last.
    pub price: Option<Price>,
}

/// A row's errors and times.
#[derive(Clone, Debug, Serialize, utoipa::ToSchema)]
#[schema(as = SurveyEntry)]
pub struct Entry {
    pub row: String,
    pub family: String,
    /// File name of its frames.
    pub slug: String,
    /// Settings of the row; others have their defaults.
    pub settings: Given,
    /// The row that draws the same frame.
    pub same_as: Option<String>,
    /// The receipt's reasons for drawing otherwise than requested.
    pub notes: Vec<String>,
    /// Peak signal-to-noise ratio in decibels; `None` where the frame equals the reference.
    pub psnr_db: Option<f64>,
    /// GPU time of a frame in milliseconds; `None` before it is measured.
    pub gpu_ms: Option<Quartiles>,
    #[serde(flatten)]
    pub metrics: Metrics,
}

impl Entry {
    /// Decibels, infinite for equal frames.
    pub fn decibels(&self) -> f64 {
        self.psnr_db.unwrap_or(f64::INFINITY)
    }

    /// Whether the row is on a front of the scope.
    pub fn is_on(&self, scope: &Scope, measure: &str) -> bool {
        scope.fronts.get(measure).is_some_and(|front| front.contains(&self.row))
    }
}

/// An error of an entry: less is better.
pub type ErrorOf = fn(&Entry) -> f64;

/// Measures by which fronts are found.
pub const MEASURES: [(&str, ErrorOf); 3] = [
    ("psnr", |entry| entry.metrics.mse),
    ("flip", |entry| entry.metrics.flip),
    ("ssim", |entry| 1.0 - entry.metrics.ssim),
];

/// Points of a front are at least so much more exact than the one before.
const SEEN_DB: f64 = 0.1;

impl Results {
    /// Results of what a journal has.
    pub fn new(identity: Identity, date: String, rows: &[Row], records: &[Record]) -> Results {
        let mut scopes: Vec<Scope> = identity
            .poses
            .iter()
            .map(|pose| Scope::of_pose(&pose.name, &pose.folder, rows, records))
            .collect();
        if scopes.len() > 1 {
            let all = Scope::of_all(rows, &scopes);
            scopes.insert(0, all);
        }
        let summary = scopes.first().map(summary).unwrap_or_default();
        Results { identity, date, summary, scopes }
    }
}

impl Scope {
    fn new(name: &str, folder: Option<&str>, rows: &[Row], entries: Vec<Entry>) -> Scope {
        let time = |entry: &Entry| entry.gpu_ms.map_or(f64::INFINITY, |time| time.median);
        let own: Vec<&Entry> = plotted(&entries).collect();
        let (mut fronts, mut steps, mut whole) = (BTreeMap::new(), Vec::new(), None);
        for (measure, error) in MEASURES {
            let points: Vec<(f64, f64)> =
                own.iter().map(|entry| (time(entry), error(entry))).collect();
            let mut front: Vec<&Entry> = pareto(&points).into_iter().map(|i| own[i]).collect();
            if measure == "psnr" {
                front = worthwhile(front);
                let points: Vec<(f64, f64)> =
                    front.iter().map(|entry| (time(entry), entry.decibels())).collect();
                steps = points.windows(2).filter_map(|pair| price(pair[0], pair[1])).collect();
                let last = points.iter().rev().find(|point| point.1.is_finite());
                whole = points.first().zip(last).and_then(|(first, last)| price(*first, *last));
            }
            let labels: Vec<String> = front.into_iter().map(|entry| entry.row.clone()).collect();
            fronts.insert(measure, labels);
        }
        Scope {
            name: name.to_owned(),
            folder: folder.map(str::to_owned),
            default: rows.iter().find(|row| row.is_default()).and_then(|row| {
                let entry = entries.iter().find(|entry| entry.row == row.label)?;
                Some(entry.same_as.clone().unwrap_or_else(|| entry.row.clone()))
            }),
            entries,
            refused: Vec::new(),
            fronts,
            steps,
            price: whole,
        }
    }

    /// Entries that are drawn for themselves and timed.
    pub fn plotted(&self) -> impl Iterator<Item = &Entry> {
        plotted(&self.entries)
    }

    /// The entry of a row.
    pub fn entry(&self, row: &str) -> Option<&Entry> {
        self.entries.iter().find(|entry| entry.row == row)
    }

    fn of_pose(name: &str, folder: &str, rows: &[Row], records: &[Record]) -> Scope {
        let mut times: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
        for record in records {
            if let Record::Time { pose, row, gpu_ms, .. } = record
                && pose == name
            {
                times.entry(row).or_default().push(*gpu_ms);
            }
        }
        let of_pose: BTreeMap<&str, &Record> =
            records.iter().filter_map(|record| Some((row_at(record, name)?, record))).collect();
        let drawn: Vec<(&Given, Option<&Given>)> = rows
            .iter()
            .map(|row| match of_pose.get(row.label.as_str()) {
                Some(Record::Image { drawn, .. }) => (&row.given, Some(&**drawn)),
                _ => (&row.given, None),
            })
            .collect();
        let owner: BTreeMap<&str, &str> = rows
            .iter()
            .zip(owners(&drawn))
            .filter_map(|(row, owner)| Some((row.label.as_str(), rows[owner?].label.as_str())))
            .collect();
        let (mut entries, mut refused) = (Vec::new(), Vec::new());
        for row in rows {
            let (drawn_as, own_notes) = match of_pose.get(row.label.as_str()) {
                Some(Record::Image { notes, .. }) => (row.label.as_str(), notes),
                Some(Record::Same { same_as, notes, .. }) => (same_as.as_str(), notes),
                Some(Record::Refused { why, .. }) => {
                    refused.push((row.label.clone(), why.clone()));
                    continue;
                }
                _ => continue,
            };
            let owner = owner.get(drawn_as).copied().unwrap_or(drawn_as);
            // An owner that is not drawn yet has no errors.
            if let Some(Record::Image { metrics, .. }) = of_pose.get(owner) {
                let same_as = (owner != row.label).then(|| owner.to_owned());
                let gpu_ms = times.get(owner).and_then(|times| Quartiles::of(times));
                let family = match of_pose.get(owner) {
                    Some(Record::Image { drawn, .. }) if !drawn.draws_samples() => NO_SAMPLES,
                    _ => &row.family,
                };
                entries.push(Entry {
                    family: family.to_owned(),
                    ..Entry::new(row, same_as, own_notes.clone(), gpu_ms, (**metrics).clone())
                });
            }
        }
        let scope = Scope::new(name, Some(folder), rows, entries);
        Scope { refused, ..scope }
    }

    /// Rows that every pose has: errors pooled over all pixels, times averaged over the poses.
    fn of_all(rows: &[Row], poses: &[Scope]) -> Scope {
        let entry = |row: &Row| {
            let own: Vec<&Entry> =
                poses.iter().map(|pose| pose.entry(&row.label)).collect::<Option<_>>()?;
            let first = own.first()?;
            let is_same = own.iter().all(|entry| entry.same_as == first.same_as);
            let same_as = first.same_as.clone().filter(|_| is_same);
            let mut notes: Vec<String> = Vec::new();
            for note in own.iter().flat_map(|entry| &entry.notes) {
                if !notes.contains(note) {
                    notes.push(note.clone());
                }
            }
            // Reasons with figures differ from pose to pose.
            notes.truncate(1);
            let times: Option<Vec<Quartiles>> = own.iter().map(|entry| entry.gpu_ms).collect();
            let time = times.and_then(|times| Quartiles::mean(&times));
            let metrics: Vec<&Metrics> = own.iter().map(|entry| &entry.metrics).collect();
            let family = first.family.clone();
            Some(Entry { family, ..Entry::new(row, same_as, notes, time, pooled(&metrics)) })
        };
        Scope::new(ALL_POSES, None, rows, rows.iter().filter_map(entry).collect())
    }
}

impl Entry {
    fn new(
        row: &Row,
        same_as: Option<String>,
        notes: Vec<String>,
        gpu_ms: Option<Quartiles>,
        metrics: Metrics,
    ) -> Entry {
        Entry {
            row: row.label.clone(),
            family: row.family.clone(),
            slug: row.slug(),
            settings: row.given,
            same_as,
            notes,
            psnr_db: psnr_db(metrics.mse),
            gpu_ms,
            metrics,
        }
    }
}

/// Metrics over the pixels of several frames of one size. Medians and 99th percentiles are means over the frames.
fn pooled(of: &[&Metrics]) -> Metrics {
    let count = of.len().max(1) as f64;
    let mean = |value: fn(&Metrics) -> f64| of.iter().map(|one| value(one)).sum::<f64>() / count;
    let mut coverage = Coverage::default();
    let mut both = 0;
    for one in of.iter().map(|one| &one.coverage) {
        coverage.covered_reference += one.covered_reference;
        coverage.covered_image += one.covered_image;
        coverage.holes += one.holes;
        coverage.leaks += one.leaks;
        coverage.holes_inside += one.holes_inside;
        coverage.leaks_outside += one.leaks_outside;
        both += one.covered_reference - one.holes;
    }
    let either = both + coverage.holes + coverage.leaks;
    coverage.silhouette_iou = if either == 0 { 1.0 } else { both as f64 / either as f64 };
    let spread = |part: fn(&Metrics) -> Option<Spread>| {
        let all: Vec<Spread> = of.iter().filter_map(|one| part(one)).collect();
        let mean = |value: fn(&Spread) -> f64| {
            all.iter().map(value).sum::<f64>() / all.len().max(1) as f64
        };
        let pixels: u64 = all.iter().map(|one| one.pixels).sum();
        let sum: f64 = all.iter().map(|one| one.mean * one.pixels as f64).sum();
        (!all.is_empty()).then(|| Spread {
            pixels,
            max: all.iter().map(|one| one.max).fold(0.0, f64::max),
            mean: sum / pixels.max(1) as f64,
            median: mean(|one| one.median),
            p99: mean(|one| one.p99),
        })
    };
    Metrics {
        mse: mean(|one| one.mse),
        ssim: mean(|one| one.ssim),
        flip: mean(|one| one.flip),
        max_error: of.iter().map(|one| one.max_error).max().unwrap_or(0),
        coverage,
        depth: spread(|one| one.depth),
        normal_deg: spread(|one| one.normal_deg),
    }
}

/// The points of a front, without those that are hardly more exact than the one before them.
fn worthwhile(front: Vec<&Entry>) -> Vec<&Entry> {
    let mut kept: Vec<&Entry> = Vec::new();
    for entry in front {
        if kept.last().is_none_or(|last| entry.decibels() >= last.decibels() + SEEN_DB) {
            kept.push(entry);
        }
    }
    kept
}

fn plotted(entries: &[Entry]) -> impl Iterator<Item = &Entry> {
    entries.iter().filter(|entry| entry.same_as.is_none() && entry.gpu_ms.is_some())
}

/// The row of a record that says how the row is drawn at this pose.
fn row_at<'a>(record: &'a Record, name: &str) -> Option<&'a str> {
    match record {
        Record::Image { pose, row, .. }
        | Record::Same { pose, row, .. }
        | Record::Refused { pose, row, .. } => (pose == name).then_some(row),
        Record::Run { .. } | Record::Time { .. } => None,
    }
}

/// What one more decibel costs.
fn summary(scope: &Scope) -> String {
    let front = scope.fronts.get("psnr").map(Vec::as_slice).unwrap_or_default();
    let is_exact = |row: &&String| scope.entry(row).is_some_and(|entry| entry.psnr_db.is_none());
    let finite = front.iter().rev().find(|row| !is_exact(row));
    let equal = front.last().filter(is_exact).and_then(|row| scope.entry(row));
    let ends = front.first().zip(finite.or(front.last()));
    let Some((first, last)) = ends.and_then(|(a, b)| scope.entry(a).zip(scope.entry(b))) else {
        return "No setting has been timed yet.".to_owned();
    };
    let ms = |entry: &Entry| entry.gpu_ms.map_or(f64::NAN, |time| time.median);
    let at = |entry: &Entry| match entry.psnr_db {
        Some(db) => format!("{} ({}, {db:.1} dB)", entry.row, milliseconds(ms(entry))),
        None => format!("{} ({}, equal to the reference)", entry.row, milliseconds(ms(entry))),
    };
    let equal = equal.filter(|_| front.len() > 1);
    let equal = equal.map_or_else(String::new, |entry| {
        format!(" {} equals the reference and takes {}.", entry.row, milliseconds(ms(entry)))
    });
    let Some(price) = scope.price else {
        let alone = if equal.is_empty() { " No slower one is more exact." } else { "" };
        return format!("Of the settings compared, the fastest is {}.{alone}{equal}", at(first));
    };
    let each = scope.steps.iter().filter_map(|step| step.times_per_db);
    let (least, most) = each
        .clone()
        .fold((f64::INFINITY, 0.0f64), |(least, most), times| (least.min(times), most.max(times)));
    let spread = if each.count() > 1 {
        format!(
            " Between neighbours on the Pareto front, a decibel costs {} to {} times the time.",
            three_digits(least),
            three_digits(most)
        )
    } else {
        String::new()
    };
    let average = price.times_per_db.map_or_else(String::new, |times| {
        format!(": one more decibel costs {:.0} % more time on average", 100.0 * (times - 1.0))
    });
    format!(
        "From {:.1} dB to {:.1} dB costs {}× the time{average}. The fastest setting is {}, the most exact {}.{spread}{equal}",
        price.from_db,
        price.to_db,
        three_digits(price.times),
        at(first),
        at(last),
    )
}

/// A time with its unit.
pub fn milliseconds(ms: f64) -> String {
    format!("{} ms", three_digits(ms))
}

/// A number with three digits, or all digits before the point.
pub fn three_digits(value: f64) -> String {
    if !value.is_finite() {
        return "–".to_owned();
    }
    let before = value.abs().max(1e-4).log10().floor() as i32 + 1;
    format!("{value:.*}", usize::try_from(3 - before).unwrap_or(0))
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::accuracy::journal::PoseRecord;

    fn metrics(mse: f64) -> Metrics {
        let coverage = Coverage {
            covered_reference: 10,
            covered_image: 9,
            holes: 2,
            leaks: 1,
            silhouette_iou: 0.8,
            ..Coverage::default()
        };
        let spread = |max| Some(Spread { pixels: 8, max, mean: 0.2, median: 0.1, p99: 0.9 });
        Metrics {
            mse,
            ssim: 0.9,
            flip: 0.1,
            max_error: 9,
            coverage,
            depth: spread(mse),
            normal_deg: None,
        }
    }

    fn given(number: u32) -> Box<Given> {
        let mut given = Given::default();
        given.set_text("edl_strength", &number.to_string()).unwrap();
        given.set_text("reconstruct", "splats").unwrap();
        Box::new(given)
    }

    /// Results of two poses and five rows: two on the front, one that is beaten, one that is drawn as another and one that is refused.
    pub(crate) fn results() -> Results {
        let row = |label: &str| Row {
            label: label.into(),
            family: label[..3].into(),
            given: if label == "good way" { Given::default() } else { *given(1) },
        };
        let rows = ["fast way", "good way", "beaten way", "other way", "gone <way>"].map(row);
        let mut records = Vec::new();
        let poses = ["front", "back & side"];
        for (number, pose) in poses.iter().enumerate() {
            let (pose, more) = ((*pose).to_owned(), number as f64);
            for (index, (row, mse, ms)) in [
                ("fast way", 65.025 + more, 1.0),
                ("good way", 6.5025, 4.0),
                ("beaten way", 70.0, 8.0),
            ]
            .into_iter()
            .enumerate()
            {
                let (row, metrics, drawn) =
                    (row.to_owned(), Box::new(metrics(mse)), given(index as u32));
                records.push(Record::Image {
                    pose: pose.clone(),
                    row: row.clone(),
                    metrics,
                    drawn,
                    notes: vec![],
                });
                for repeat in 0..3 {
                    let gpu_ms = ms * (1.0 + 0.1 * f64::from(repeat)) + more;
                    records.push(Record::Time {
                        pose: pose.clone(),
                        row: row.clone(),
                        repeat,
                        gpu_ms,
                    });
                }
            }
            let notes = vec![format!("reason {number}")];
            records.push(Record::Same {
                pose: pose.clone(),
                row: "other way".into(),
                same_as: "good way".into(),
                notes,
            });
            records.push(Record::Refused {
                pose,
                row: "gone <way>".into(),
                why: "too large".into(),
            });
        }
        let pose = |(number, name): (usize, &str)| PoseRecord {
            name: name.into(),
            folder: format!("{}-pose", number + 1),
            eye: [0.0; 3],
            target: [0.0; 3],
            up: [0.0; 3],
            fov_deg: Some(40.0),
            ortho_height: None,
        };
        let identity = Identity {
            version: "1".into(),
            adapter: "A".into(),
            scene: "scene.json".into(),
            tag: "t".into(),
            width: 4,
            height: 3,
            repeats: 3,
            seed: 1,
            reference: "the reference".into(),
            poses: poses.into_iter().enumerate().map(pose).collect(),
            rows: rows.iter().map(|row| row.label.clone()).collect(),
        };
        Results::new(identity, "2026-01-02".into(), &rows, &records)
    }

    #[test]
    fn fronts_and_prices_are_computed_for_each_pose_and_for_all() {
        let results = results();
        let names: Vec<&str> = results.scopes.iter().map(|scope| scope.name.as_str()).collect();
        assert_eq!(names, [ALL_POSES, "front", "back & side"]);
        let front = &results.scopes[1];
        assert_eq!(front.fronts["psnr"], ["fast way", "good way"]);
        assert_eq!(front.default.as_deref(), Some("good way"));
        let price = front.price.unwrap();
        assert!((price.from_db - 30.0).abs() < 1e-9 && (price.to_db - 40.0).abs() < 1e-9);
        assert!(
            (price.times - 4.0).abs() < 1e-9
                && (price.times_per_db.unwrap() - 4f64.powf(0.1)).abs() < 1e-9
        );
        assert_eq!(front.plotted().count(), 3);
        let other = front.entry("other way").unwrap();
        assert_eq!(other.same_as.as_deref(), Some("good way"));
        assert_eq!(other.notes, ["reason 0"]);
        assert_eq!(other.gpu_ms, front.entry("good way").unwrap().gpu_ms);
        assert_eq!(front.refused, [("gone <way>".to_owned(), "too large".to_owned())]);
        let all = &results.scopes[0];
        let fast = all.entry("fast way").unwrap();
        assert!((fast.metrics.mse - 65.525).abs() < 1e-9);
        assert!((fast.gpu_ms.unwrap().median - 1.6).abs() < 1e-9);
        assert_eq!(fast.metrics.coverage.holes, 4);
        assert!((fast.metrics.coverage.silhouette_iou - 16.0 / 22.0).abs() < 1e-12);
        assert!((fast.metrics.depth.unwrap().max - 66.025).abs() < 1e-9);
    }

    #[test]
    fn the_summary_says_what_a_decibel_costs() {
        let results = results();
        assert!(
            results.summary.starts_with("From 30.0 dB to 40.0 dB costs 3.06× the time"),
            "{}",
            results.summary
        );
        assert!(results.summary.contains("fast way (1.60 ms, 30.0 dB)"), "{}", results.summary);
        let one = Scope::new("p", None, &[], vec![results.scopes[1].entries[0].clone()]);
        let text = summary(&one);
        assert!(text.contains("the fastest is fast way") && text.contains("No slower"), "{text}");
        // A frame that equals the reference has no decibels.
        let mut entries = results.scopes[1].entries.clone();
        let exact = entries.iter_mut().find(|entry| entry.row == "good way").unwrap();
        (exact.psnr_db, exact.metrics.mse) = (None, 0.0);
        let text = summary(&Scope::new("p", None, &[], entries));
        assert!(text.contains("good way equals the reference and takes"), "{text}");
        assert!(!text.contains("inf"), "{text}");
        assert!(summary(&Scope::new("p", None, &[], Vec::new())).starts_with("No setting"));
    }

    #[test]
    fn a_drawing_that_turns_out_to_be_another_rows_is_not_plotted() {
        let row =
            |label: &str| Row { label: label.into(), family: "a".into(), given: Given::default() };
        let image = |row: &str| Record::Image {
            pose: "p".into(),
            row: row.into(),
            metrics: Box::new(metrics(1.0)),
            drawn: given(1),
            notes: vec![],
        };
        let scope = Scope::of_pose("p", "1-p", &["a", "b"].map(row), &[image("a"), image("b")]);
        assert_eq!(scope.entries[1].same_as.as_deref(), Some("a"));
        // Both rows give nothing, so the first of them is the default.
        assert_eq!(scope.default.as_deref(), Some("a"));
    }

    #[test]
    fn numbers_have_three_digits() {
        assert_eq!(
            [0.01234, 1.2345, 12.345, 123.45, 1234.5].map(three_digits),
            ["0.0123", "1.23", "12.3", "123", "1234"]
        );
        assert_eq!(three_digits(f64::NAN), "–");
    }
}
