//! The results of a survey: what each row costs and how far it is from the reference, at each pose and over all of them, and the Pareto
//! fronts. Pure.

mod along;

use std::collections::BTreeMap;

use serde::Serialize;

use super::journal::{Identity, Metrics, OtherMetrics, Record};
use super::metrics::{Coverage, Spread, psnr_db};
use super::sweep::{Price, Quartiles, Row, owners, pareto, price, roughness, told_apart};
use crate::plan::Given;

pub use along::{Along, AlongEntry};

/// Name of the scope that holds all poses.
pub const ALL_POSES: &str = "all poses";

/// Family of frames that show no samples.
const NO_SAMPLES: &str = "meshes, lines";

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
    /// How much the frames of a camera path flicker, where one was given.
    pub along: Option<Along>,
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
    /// Prices from each point of the front of `psnr` to the next. A point whose quartiles of time reach those of the next more exact one is left out.
    pub steps: Vec<Price>,
    /// The price from the first of these points to the last.
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
    /// Width and height of the drawn frame as a share of those that it is shown at; less than 1 for frames that are enlarged, bilinearly.
    pub scale: f64,
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
    ("flip", |entry| entry.metrics.others.as_ref().map_or(f64::NAN, |others| others.flip)),
    ("ssim", |entry| entry.metrics.others.as_ref().map_or(f64::NAN, |others| 1.0 - others.ssim)),
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
        let summary =
            scopes.first().map(|scope| summary(scope, identity.repeats)).unwrap_or_default();
        let along = identity.path.as_ref().map(|path| Along::new(path, rows, records));
        Results { identity, date, summary, scopes, along }
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
                let times: Vec<Quartiles> = front.iter().filter_map(|entry| entry.gpu_ms).collect();
                let place = |index: usize| (times[index].median, front[index].decibels());
                let points: Vec<(f64, f64)> = told_apart(&times).into_iter().map(place).collect();
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
        let drawn: Vec<(&Row, Option<&Given>)> = rows
            .iter()
            .map(|row| match of_pose.get(row.label.as_str()) {
                Some(Record::Image { drawn, .. }) => (row, Some(&**drawn)),
                _ => (row, None),
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
            scale: row.scale,
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
    let mse = of.iter().map(|one| one.mse).sum::<f64>() / of.len().max(1) as f64;
    let others: Option<Vec<&OtherMetrics>> = of.iter().map(|one| one.others.as_ref()).collect();
    Metrics { mse, others: others.map(|others| pooled_others(&others)) }
}

fn pooled_others(of: &[&OtherMetrics]) -> OtherMetrics {
    let count = of.len().max(1) as f64;
    let mean =
        |value: fn(&OtherMetrics) -> f64| of.iter().map(|one| value(one)).sum::<f64>() / count;
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
    let spread = |part: fn(&OtherMetrics) -> Option<Spread>| {
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
    OtherMetrics {
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
        Record::Run { .. }
        | Record::Time { .. }
        | Record::Frame { .. }
        | Record::FrameRefused { .. } => None,
    }
}

/// Says what one more decibel costs, where each setting was timed so many times at each pose.
fn summary(scope: &Scope, repeats: u32) -> String {
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
        Some(db) => {
            format!("{} ({}, {} dB)", entry.row, milliseconds(ms(entry)), decibels_down(db))
        }
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
    let rough = roughness(repeats);
    let spread = if each.count() > 1 && rough.is_empty() {
        format!(
            " Between neighbours on the Pareto front, a decibel costs {} to {} times the time.",
            three_digits(least),
            three_digits(most)
        )
    } else {
        String::new()
    };
    let average = price.times_per_db.map_or_else(String::new, |times| {
        let percent = 100.0 * (times - 1.0);
        format!(": one more decibel costs {percent:.0} % more time on average{rough}")
    });
    format!(
        "From {} dB to {} dB costs {}× the time{average}. The fastest setting is {}, the most exact {}.{spread}{equal}",
        decibels_down(price.from_db),
        decibels_down(price.to_db),
        three_digits(price.times),
        at(first),
        at(last),
    )
}

/// A time with its unit.
pub fn milliseconds(ms: f64) -> String {
    format!("{} ms", three_digits(ms))
}

/// Decibels with one digit, rounded down: what is told as 30.0 dB keeps a goal of 30 dB.
pub fn decibels_down(decibels: f64) -> String {
    // A hair more, because the logarithm of a whole tenth may lie just below it.
    format!("{:.1}", (10.0 * (decibels + 1e-9)).floor() / 10.0)
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
pub(crate) mod tests;
