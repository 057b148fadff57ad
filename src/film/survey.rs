//! Decides which frames of a folder are kept and which are drawn. Pure: it gets what was found, and returns what to do.

use std::ops::RangeInclusive;
use std::sync::Arc;

use super::manifest::{Record, Records};

/// A frame as it should be now.
#[derive(Clone, Debug, PartialEq)]
pub struct Slot {
    pub number: u64,
    pub t: f64,
    pub file: String,
    pub tag: String,
}

/// The work of a run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Survey {
    /// Frames that are intact, including ones that are not wanted.
    pub kept: Records,
    /// Numbers of the frames to draw.
    pub draw: Vec<u64>,
    /// Files of earlier runs that are not frames of this path with these settings, and that no frame will replace.
    pub left_over: Vec<String>,
}

/// The record, updated, if it describes the frame of `slot`. The caller must check the file.
pub fn promising(slot: &Slot, record: &Arc<Record>) -> Option<Arc<Record>> {
    let is_same = record.file == slot.file && record.tag == slot.tag;
    // At another frame rate the same picture may have another time.
    let has_moved = record.t != slot.t;
    is_same.then(|| {
        let moved = || Arc::new(Record { t: slot.t, ..Record::clone(record) });
        if has_moved { moved() } else { record.clone() }
    })
}

/// Decides the work, where the records in `intact` are [`promising`] and their files are complete. `file_of` names the file of a
/// frame.
pub fn survey(
    wanted: RangeInclusive<u64>,
    file_of: impl Fn(u64) -> String,
    records: &Records,
    intact: Vec<Arc<Record>>,
) -> Survey {
    let kept: Records = intact.into_iter().map(|record| (record.frame, record)).collect();
    let draw: Vec<u64> = wanted.clone().filter(|number| !kept.contains_key(number)).collect();
    let listed = |record: &Record| {
        let replaced = wanted.contains(&record.frame) && file_of(record.frame) == record.file;
        replaced || kept.get(&record.frame).is_some_and(|kept| kept.file == record.file)
    };
    let left_over = records
        .values()
        .filter(|record| !listed(record))
        .map(|record| record.file.clone())
        .collect();
    Survey { kept, draw, left_over }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use proptest::prelude::*;

    use super::*;

    fn slot(number: u64, tag: u8) -> Slot {
        Slot { number, t: number as f64, file: file_of(number), tag: tag.to_string() }
    }

    fn file_of(number: u64) -> String {
        format!("frame-{number:05}.png")
    }

    /// The records that match `slots`.
    fn promising_of(slots: &BTreeMap<u64, Slot>, records: &Records) -> Vec<Arc<Record>> {
        let slot = |record: &Arc<Record>| promising(slots.get(&record.frame)?, record);
        records.values().filter_map(slot).collect()
    }

    fn record(number: u64, tag: u8) -> Record {
        let Slot { number: frame, t, file, tag } = slot(number, tag);
        Record { frame, t: t + 0.5, file, bytes: 1, sha256: String::new(), tag }
    }

    #[test]
    fn formats_and_lengths_that_change() {
        let slots: BTreeMap<u64, Slot> = (0..2).map(|n| (n, slot(n, 1))).collect();
        let mut jpeg = record(1, 1);
        jpeg.file = "frame-00001.jpg".to_owned();
        let records = [record(0, 1), jpeg, record(2, 1)];
        let records: Records = records.into_iter().map(|r| (r.frame, Arc::new(r))).collect();
        let promising = promising_of(&slots, &records);
        assert_eq!(promising, [Arc::new(Record { t: 0.0, ..record(0, 1) })]);
        let found = survey(0..=1, file_of, &records, promising);
        assert_eq!(found.draw, [1]);
        assert_eq!(found.left_over, ["frame-00001.jpg", "frame-00002.png"]);
    }

    proptest! {
        #[test]
        fn every_wanted_frame_is_kept_or_drawn_once(
            tags in prop::collection::vec(0u8..3, 1..20),
            found in prop::collection::btree_map(0u64..24, (0u8..3, any::<bool>()), 0..20),
            range in (0usize..20, 0usize..20),
        ) {
            let count = tags.len();
            let (from, to) = ((range.0 % count) as u64, (range.1 % count) as u64);
            let (from, to) = (from.min(to), from.max(to));
            let slots: BTreeMap<u64, Slot> = (0..).zip(&tags).map(|(n, &tag)| (n, slot(n, tag))).collect();
            let records: Records = found.iter().map(|(&n, &(tag, _))| (n, record(n, tag).into())).collect();
            let intact: Vec<Arc<Record>> = promising_of(&slots, &records).into_iter().filter(|r| found[&r.frame].1).collect();
            let survey = survey(from..=to, file_of, &records, intact);
            for number in from..=to {
                prop_assert!(survey.kept.contains_key(&number) != survey.draw.contains(&number));
            }
            prop_assert!(survey.draw.iter().all(|number| (from..=to).contains(number)));
            prop_assert!(survey.draw.is_sorted_by(|a, b| a < b));
            for (number, record) in &survey.kept {
                let slot = &slots[number];
                prop_assert_eq!((&record.tag, record.t), (&slot.tag, slot.t));
                prop_assert!(found[number].1);
            }
            for (number, record) in &records {
                let accounted = survey.kept.contains_key(number) || survey.draw.contains(number);
                prop_assert!(accounted != survey.left_over.contains(&record.file));
            }
        }
    }
}
