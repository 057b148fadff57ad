//! How much frames flicker along a camera path with each row, from the records of a journal. Pure.

use std::collections::BTreeMap;

use serde::Serialize;

use super::three_digits;
use crate::accuracy::journal::{PathRecord, Record};
use crate::accuracy::metrics::psnr_db;
use crate::accuracy::sweep::Row;
use crate::accuracy::temporal::Change;

/// What was found along a camera path.
#[derive(Clone, Debug, PartialEq, Serialize, utoipa::ToSchema)]
#[schema(as = SurveyAlong)]
pub struct Along {
    /// The settings that flicker least and most, in a sentence.
    pub summary: String,
    pub entries: Vec<AlongEntry>,
    /// The entry that stands for what is drawn when nothing is chosen.
    pub default: Option<String>,
    /// Rows of which the program refuses a frame, each with the reason.
    #[schema(value_type = Vec<Vec<String>>)]
    pub refused: Vec<(String, String)>,
}

/// A row along the path.
#[derive(Clone, Debug, PartialEq, Serialize, utoipa::ToSchema)]
#[schema(as = SurveyAlongEntry)]
pub struct AlongEntry {
    pub row: String,
    pub family: String,
    /// The row that draws the same frames.
    pub same_as: Option<String>,
    /// Number of frames that were compared.
    pub frames: u64,
    /// Mean squared error of the bytes of all frames.
    pub mse: f64,
    /// Peak signal-to-noise ratio over all frames in decibels; `None` where all frames equal the reference.
    pub psnr_db: Option<f64>,
    /// Flicker energy: the mean squared difference of the errors of consecutive frames.
    pub flicker: f64,
    /// The flicker energy over that of `against`; `None` where that does not flicker.
    pub flicker_times: Option<f64>,
    /// Full detail of the same way to draw samples, without antialiasing, or the row that draws the same frames.
    pub against: Option<String>,
    /// Pixels of the largest connected area that changes by more than 32 of 255 beyond the change of the reference.
    pub pop_px: u64,
    /// The frame that shows this change first; `None` where there is none.
    pub pop_frame: Option<u64>,
    /// Number of such areas of at least four pixels.
    pub pops: u64,
}

impl Along {
    /// Results of what a journal has of the path.
    pub fn new(path: &PathRecord, rows: &[Row], records: &[Record]) -> Along {
        let (mut frames, mut refused) = (BTreeMap::<&str, Vec<Seen<'_>>>::new(), BTreeMap::new());
        for record in records {
            match record {
                Record::Frame { frame, row, same_as, mse, change } => {
                    let same_as = same_as.as_deref();
                    let seen = Seen { frame: *frame, same_as, mse: *mse, change: *change };
                    frames.entry(row).or_default().push(seen);
                }
                Record::FrameRefused { frame, row, why } => {
                    refused.entry(row.as_str()).or_insert_with(|| format!("frame {frame}: {why}"));
                }
                _ => {}
            }
        }
        let own = || rows.iter().filter(|row| path.rows.contains(&row.label));
        let entry = |row: &Row| {
            let seen = frames.get(row.label.as_str())?;
            (!refused.contains_key(row.label.as_str())).then(|| AlongEntry::new(row, seen))
        };
        let mut entries: Vec<AlongEntry> = own().filter_map(entry).collect();
        compare(&mut entries, own());
        let default = own().find(|row| row.is_default()).map(|row| row.label.clone());
        let default = default.filter(|row| entries.iter().any(|entry| entry.row == *row));
        Along {
            summary: summary(path, &entries),
            entries,
            default,
            refused: own()
                .filter_map(|row| {
                    Some((row.label.clone(), refused.get(row.label.as_str())?.clone()))
                })
                .collect(),
        }
    }
}

/// A frame of a row.
struct Seen<'a> {
    frame: u64,
    same_as: Option<&'a str>,
    mse: f64,
    change: Option<Change>,
}

impl AlongEntry {
    fn new(row: &Row, seen: &[Seen<'_>]) -> AlongEntry {
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
        let mse = mean(&seen.iter().map(|frame| frame.mse).collect::<Vec<_>>());
        let changes = || seen.iter().filter_map(|frame| Some((frame.frame, frame.change?)));
        let energies: Vec<f64> = changes().map(|(_, change)| change.energy).collect();
        let pop_px = changes().map(|(_, change)| change.pop_px).max().unwrap_or(0);
        let worst = changes().filter(|(_, change)| pop_px > 0 && change.pop_px == pop_px);
        let first = seen.first().and_then(|frame| frame.same_as);
        AlongEntry {
            row: row.label.clone(),
            family: row.family.clone(),
            same_as: first
                .filter(|_| seen.iter().all(|frame| frame.same_as == first))
                .map(str::to_owned),
            frames: seen.len() as u64,
            mse,
            psnr_db: psnr_db(mse),
            flicker: mean(&energies),
            flicker_times: None,
            against: None,
            pop_px,
            pop_frame: worst.map(|(frame, _)| frame).min(),
            pops: changes().map(|(_, change)| change.pops).sum(),
        }
    }
}

/// Compares the flicker of each entry with that of the plain full detail of its family.
fn compare<'a>(entries: &mut [AlongEntry], rows: impl Iterator<Item = &'a Row>) {
    let plain: BTreeMap<&str, &str> = rows
        .filter(|row| row.is_plain_full())
        .map(|row| (row.family.as_str(), row.label.as_str()))
        .collect();
    let drawn = |entry: &AlongEntry| {
        let owner = entry.same_as.as_ref().unwrap_or(&entry.row);
        (entry.row.clone(), (owner.clone(), entry.flicker))
    };
    let known: BTreeMap<String, (String, f64)> = entries.iter().map(drawn).collect();
    for entry in entries {
        let Some(&against) = plain.get(entry.family.as_str()) else { continue };
        let Some((against, flicker)) = known.get(against) else { continue };
        entry.against = Some(against.clone());
        entry.flicker_times = (*flicker > 0.0).then(|| entry.flicker / flicker);
    }
}

/// Which rows flicker least and most, and where the largest pop is.
fn summary(path: &PathRecord, entries: &[AlongEntry]) -> String {
    let PathRecord { name, fps, from, to, .. } = path;
    let place = format!("Along {name}, frames {from} to {to} at {fps} frames per second");
    let own = || entries.iter().filter(|entry| entry.same_as.is_none() && entry.frames > 1);
    let order = |a: &&AlongEntry, b: &&AlongEntry| a.flicker.total_cmp(&b.flicker);
    let Some((least, most)) = own().min_by(order).zip(own().rev().max_by(order)) else {
        return format!("{place}: no two frames have been compared yet.");
    };
    let told = |entry: &AlongEntry| {
        let energy = three_digits(entry.flicker);
        match (entry.flicker_times, &entry.against) {
            (Some(times), Some(against)) if *against != entry.row => {
                format!("{energy}, {}× that of {against}", three_digits(times))
            }
            _ => energy,
        }
    };
    let pop = match own().rev().max_by_key(|entry| entry.pop_px) {
        Some(AlongEntry { row, pop_px, pop_frame: Some(frame), .. }) => {
            let pixels = if *pop_px == 1 { "pixel" } else { "pixels" };
            format!(" The largest pop has {pop_px} {pixels}, with {row} in frame {frame}.")
        }
        _ => " There is no pop.".to_owned(),
    };
    if least.row == most.row {
        return format!("{place}: {} has the flicker energy {}.{pop}", most.row, told(most));
    }
    format!(
        "{place}: {} flickers least (flicker energy {}), {} most ({}).{pop}",
        least.row,
        told(least),
        most.row,
        told(most)
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::Given;

    fn row(family: &str, pairs: &[(&str, &str)], label: &str) -> Row {
        let mut given = Given::default();
        pairs.iter().for_each(|(name, value)| given.set_text(name, value).unwrap());
        Row { label: label.into(), family: family.into(), given, scale: 1.0 }
    }

    fn rows() -> Vec<Row> {
        vec![
            row("auto", &[], "auto full"),
            row("points", &[("reconstruct", "points"), ("lod", "full")], "points full"),
            row("points", &[("reconstruct", "points"), ("lod", "spt")], "points spt 1 px"),
            row("splats", &[("reconstruct", "splats"), ("lod", "full")], "splats full"),
            row("points", &[("reconstruct", "points"), ("antialias", "4x")], "not along"),
        ]
    }

    fn frame(frame: u64, row: &str, mse: f64, change: Option<(f64, u64, u64)>) -> Record {
        let change = change.map(|(energy, pop_px, pops)| Change { energy, pop_px, pops });
        let same_as = (row == "auto full").then(|| "points full".to_owned());
        Record::Frame { frame, row: row.into(), same_as, mse, change }
    }

    fn path() -> PathRecord {
        let labels = rows().into_iter().take(4).map(|row| row.label).collect();
        let (name, cameras) = ("fly".into(), "abc".into());
        PathRecord { name, fps: 30.0, from: 5, to: 7, cameras, rows: labels }
    }

    #[test]
    fn flicker_is_a_multiple_of_the_familys_full_detail() {
        let mut records = Vec::new();
        records.push(frame(5, "points spt 1 px", 10.0, None));
        records.push(frame(6, "points spt 1 px", 20.0, Some((6.0, 3, 0))));
        records.push(frame(7, "points spt 1 px", 30.0, Some((2.0, 9, 2))));
        for row in ["auto full", "points full"] {
            for (number, change) in [(5, None), (6, Some((1.0, 0, 0))), (7, Some((3.0, 0, 0)))] {
                records.push(frame(number, row, 0.0, change));
            }
        }
        records.push(frame(5, "splats full", 1.0, None));
        records.push(Record::FrameRefused {
            frame: 6,
            row: "splats full".into(),
            why: "no".into(),
        });
        let along = Along::new(&path(), &rows(), &records);
        let entry = |row: &str| along.entries.iter().find(|entry| entry.row == row).unwrap();
        let points = entry("points spt 1 px");
        assert_eq!((points.flicker, points.flicker_times, points.frames), (4.0, Some(2.0), 3));
        assert_eq!((points.pop_px, points.pop_frame, points.pops), (9, Some(7), 2));
        assert!((points.mse - 20.0).abs() < 1e-12 && points.same_as.is_none());
        let full = entry("points full");
        assert_eq!((full.flicker_times, full.psnr_db, full.pop_frame), (Some(1.0), None, None));
        assert_eq!(along.default.as_deref(), Some("auto full"));
        let auto = entry("auto full");
        assert_eq!(
            (auto.same_as.as_deref(), auto.against.as_deref()),
            (Some("points full"), Some("points full"))
        );
        assert_eq!(along.refused, [("splats full".to_owned(), "frame 6: no".to_owned())]);
        assert_eq!(along.entries.len(), 3);
        assert_eq!(
            along.summary,
            "Along fly, frames 5 to 7 at 30 frames per second: points full flickers least (flicker energy 2.00), points spt 1 px most (4.00, 2.00× that of \
             points full). The largest pop has 9 pixels, with points spt 1 px in frame 7."
        );
    }

    #[test]
    fn nothing_is_said_of_rows_without_frames() {
        let along = Along::new(&path(), &rows(), &[frame(5, "points full", 0.0, None)]);
        assert!(along.summary.contains("no two frames"), "{}", along.summary);
        let [full] = along.entries.as_slice() else { panic!("{:?}", along.entries) };
        assert_eq!((full.flicker, full.flicker_times, full.pops), (0.0, None, 0));
    }
}
