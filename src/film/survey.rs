//! What of a folder is kept and what is drawn. Pure: what was found comes in, what to do comes out.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;

use super::manifest::Record;

/// A frame as it is to be now.
#[derive(Clone, Debug, PartialEq)]
pub struct Slot {
    pub number: u64,
    pub t: f64,
    pub file: String,
    pub tag: String,
}

/// What a run has to do.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Survey {
    /// Frames that are good as they are, also such as were not asked for.
    pub kept: BTreeMap<u64, Record>,
    /// Numbers of those to draw.
    pub draw: Vec<u64>,
    /// Files of earlier runs that are no frames of this path with these settings, and that nothing will replace.
    pub left_over: Vec<String>,
}

/// Records that tell of a frame as it is to be now. Whether their files are as they say is for the caller to find out.
pub fn promising(slots: &BTreeMap<u64, Slot>, records: &BTreeMap<u64, Record>) -> Vec<Record> {
    records
        .iter()
        .filter_map(|(number, record)| {
            let slot = slots.get(number)?;
            let same = record.file == slot.file && record.tag == slot.tag;
            // The same picture may have another time where frames come faster or slower.
            same.then(|| Record { t: slot.t, ..record.clone() })
        })
        .collect()
}

/// What to do, where of the `promising` records those in `intact` have whole files.
pub fn survey(
    wanted: RangeInclusive<u64>,
    slots: &BTreeMap<u64, Slot>,
    records: &BTreeMap<u64, Record>,
    intact: Vec<Record>,
) -> Survey {
    let kept: BTreeMap<u64, Record> =
        intact.into_iter().map(|record| (record.frame, record)).collect();
    let draw: Vec<u64> = wanted.clone().filter(|number| !kept.contains_key(number)).collect();
    let listed = |record: &Record| {
        let slot = slots.get(&record.frame);
        let replaced =
            wanted.contains(&record.frame) && slot.is_some_and(|s| s.file == record.file);
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
    use proptest::prelude::*;

    use super::*;

    fn slot(number: u64, tag: u8) -> Slot {
        let file = format!("frame-{number:05}.png");
        Slot { number, t: number as f64, file, tag: tag.to_string() }
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
        let records = BTreeMap::from([(0, record(0, 1)), (1, jpeg), (2, record(2, 1))]);
        let promising = promising(&slots, &records);
        assert_eq!(promising, [Record { t: 0.0, ..record(0, 1) }]);
        let found = survey(0..=1, &slots, &records, promising);
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
            let records: BTreeMap<u64, Record> = found.iter().map(|(&n, &(tag, _))| (n, record(n, tag))).collect();
            let intact: Vec<Record> = promising(&slots, &records).into_iter().filter(|r| found[&r.frame].1).collect();
            let survey = survey(from..=to, &slots, &records, intact);
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
