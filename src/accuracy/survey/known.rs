//! Measurements that the journal of a survey has already. Pure.

use std::collections::{BTreeMap, HashSet};

use super::NamedPose;
use crate::accuracy::journal::Record;
use crate::accuracy::sweep::{Draw, Row, owners};
use crate::plan::Given;

/// Measurements that the journal has.
#[derive(Debug, Default)]
pub struct Known {
    /// Settings that the rows of a pose were drawn with; `None` for those that were not drawn for themselves.
    drawn: BTreeMap<(String, String), Option<Given>>,
    timed: HashSet<(String, String, u32)>,
}

impl Known {
    pub fn of(records: &[Record]) -> Known {
        let mut known = Known::default();
        records.iter().for_each(|record| known.see(record));
        known
    }

    pub fn see(&mut self, record: &Record) {
        match record {
            // Frames of a path are none of a pose.
            Record::Run { .. } | Record::Frame { .. } | Record::FrameRefused { .. } => {}
            Record::Image { pose, row, drawn, .. } => {
                self.drawn.insert((pose.clone(), row.clone()), Some(**drawn));
            }
            Record::Same { pose, row, .. } | Record::Refused { pose, row, .. } => {
                self.drawn.insert((pose.clone(), row.clone()), None);
            }
            Record::Time { pose, row, repeat, .. } => {
                self.timed.insert((pose.clone(), row.clone(), *repeat));
            }
        }
    }

    pub fn has(&self, pose: &str, row: &str) -> bool {
        self.drawn.contains_key(&(pose.to_owned(), row.to_owned()))
    }

    pub fn is_timed(&self, pose: &NamedPose, row: &Row, draw: &Draw) -> bool {
        self.timed.contains(&(pose.name.clone(), row.label.clone(), draw.repeat))
    }

    /// Numbers of the poses and rows that are drawn for themselves.
    pub fn subjects(&self, poses: &[NamedPose], rows: &[Row]) -> Vec<(usize, usize)> {
        let mut subjects = Vec::new();
        for (number, pose) in poses.iter().enumerate() {
            let drawn = |row: &Row| {
                self.drawn.get(&(pose.name.clone(), row.label.clone())).and_then(Option::as_ref)
            };
            let pairs: Vec<_> = rows.iter().map(|row| (row, drawn(row))).collect();
            let own = owners(&pairs).into_iter().enumerate();
            subjects.extend(
                own.filter(|&(row, owner)| owner == Some(row)).map(|(row, _)| (number, row)),
            );
        }
        subjects
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accuracy::journal::Metrics;
    use crate::math::Camera;

    fn image(row: &str, drawn: Given) -> Record {
        let metrics = Metrics { mse: 1.0, others: None };
        let (pose, row) = ("p".to_owned(), row.to_owned());
        Record::Image {
            pose,
            row,
            metrics: Box::new(metrics),
            drawn: Box::new(drawn),
            notes: vec![],
        }
    }

    #[test]
    fn rows_that_were_drawn_alike_are_timed_once() {
        let splats = Given { prefilter: Some(true), ..Given::default() };
        let same = Record::Same {
            pose: "p".into(),
            row: "c".into(),
            same_as: "a".into(),
            notes: Vec::new(),
        };
        let refused = Record::Refused { pose: "p".into(), row: "d".into(), why: "no".into() };
        let time = Record::Time { pose: "p".into(), row: "a".into(), repeat: 1, gpu_ms: 2.0 };
        let records = [
            image("a", Given::default()),
            image("b", splats),
            same,
            refused,
            image("e", splats),
            time,
        ];
        let known = Known::of(&records);
        let row = |label: &str| Row {
            label: label.to_owned(),
            family: String::new(),
            given: Given::default(),
            scale: 1.0,
        };
        let rows = ["a", "b", "c", "d", "e", "f"].map(row);
        let camera = Camera {
            eye: glam::DVec3::Z,
            target: glam::DVec3::ZERO,
            up: glam::DVec3::Y,
            lens: crate::math::Lens::Perspective { fov_deg: 40.0 },
        };
        let poses = [NamedPose::new(0, "p", camera)];
        assert_eq!(known.subjects(&poses, &rows), [(0, 0), (0, 1)]);
        assert!(known.has("p", "e") && !known.has("p", "f") && !known.has("q", "a"));
        let timed = |repeat| known.is_timed(&poses[0], &rows[0], &Draw { pose: 0, row: 0, repeat });
        assert!(timed(1) && !timed(0));
    }
}
