//! Draws consecutive frames of a camera path with several rows, and compares them with the reference and with the frames before.
//!
//! Two frames of each row and of the reference are held at a time. A run that goes on draws the frame before the first missing one again; repeated
//! frames of one adapter are equal.

use std::collections::{BTreeMap, HashSet};
use std::sync::Arc;

use super::{Event, Survey, SurveyError};
use crate::accuracy::journal::{Journal, PathRecord, Record};
use crate::accuracy::metrics;
use crate::accuracy::sweep::Row;
use crate::accuracy::temporal::Change;
use crate::accuracy::truth::{PARTS, averaged, quads};
use crate::engine::EngineError;
use crate::film::manifest::checksum;
use crate::film::shots::Shots;
use crate::math::Camera;

/// Most frames of a path that are compared.
pub const MOST_FRAMES: u64 = 2000;

/// A camera path along which rows are compared.
pub struct Path<'a> {
    /// Name in the scene, or of the path's file.
    pub name: &'a str,
    /// The wanted frames are compared.
    pub shots: &'a Shots,
    pub rows: Vec<Row>,
}

impl Path<'_> {
    /// The path as the journal has it.
    pub fn record(&self) -> PathRecord {
        let cameras: Vec<Camera> =
            self.shots.wanted().map(|number| self.shots.shot(number).camera).collect();
        PathRecord {
            name: self.name.to_owned(),
            fps: self.shots.fps(),
            from: *self.shots.wanted().start(),
            to: *self.shots.wanted().end(),
            cameras: checksum(format!("{cameras:?}").as_bytes()),
            rows: self.rows.iter().map(|row| row.label.clone()).collect(),
        }
    }
}

/// Opaque pixels of a frame.
type Pixels = Arc<Vec<[u8; 4]>>;

/// One frame of the path, drawn with all rows.
struct Still {
    reference: Vec<[u8; 4]>,
    rows: Vec<Result<Shown, String>>,
}

/// A row's frame.
#[derive(Clone)]
struct Shown {
    /// The row that stands for all that draw the same frame.
    owner: usize,
    pixels: Pixels,
}

impl Survey<'_> {
    /// Draws the frames of the path that the journal lacks, and returns whether all are there.
    ///
    /// # Errors
    /// The engine fails, the journal cannot be written, or two frames of each row do not fit into the host memory.
    pub fn run_along(
        &self,
        path: &Path<'_>,
        journal: &mut Journal,
        tell: impl FnMut(Event<'_>),
    ) -> Result<bool, SurveyError> {
        match self.draw_along(path, journal, tell) {
            Ok(()) => Ok(true),
            Err(SurveyError::Stopped) => Ok(false),
            Err(error) => Err(error),
        }
    }

    fn draw_along(
        &self,
        path: &Path<'_>,
        journal: &mut Journal,
        mut tell: impl FnMut(Event<'_>),
    ) -> Result<(), SurveyError> {
        let known: HashSet<(u64, String)> = journal
            .records
            .iter()
            .filter_map(|record| match record {
                Record::Frame { frame, row, .. } | Record::FrameRefused { frame, row, .. } => {
                    Some((*frame, row.clone()))
                }
                _ => None,
            })
            .collect();
        let admission = self.engine.admission();
        let pixels = self.size.iter().map(|&side| u64::from(side)).product::<u64>();
        // Colours of two frames of each row, and the parts of the reference's pixels.
        let bytes = 4 * pixels * (2 * (path.rows.len() as u64 + 1) + u64::from(PARTS * PARTS));
        admission.grow("the frames of the path", bytes).map_err(EngineError::from)?;
        let first = *path.shots.wanted().start();
        let total = path.shots.wanted().count() as u64;
        let mut before: Option<Still> = None;
        for number in path.shots.wanted() {
            let is_missing = |row: &&Row| !known.contains(&(number, row.label.clone()));
            if !path.rows.iter().any(|row| is_missing(&row)) {
                before = None;
                continue;
            }
            let done = number - first + 1;
            tell(Event { done, total, what: &format!("{}, frame {number}", path.name) });
            let earlier = match before.take() {
                None if number > first => Some(self.still(path, number - 1)?),
                earlier => earlier,
            };
            let now = self.still(path, number)?;
            for (index, row) in path.rows.iter().enumerate().filter(|(_, row)| is_missing(row)) {
                journal.add(self.along_record(
                    path,
                    number,
                    index,
                    earlier.as_ref(),
                    &now,
                    row,
                )?)?;
            }
            before = Some(now);
        }
        Ok(())
    }

    /// Draws the reference of a frame of the path, and the frame with all rows; rows with the same settings are drawn once.
    fn still(&self, path: &Path<'_>, number: u64) -> Result<Still, SurveyError> {
        let camera = path.shots.shot(number).camera;
        let reference = self.reference_color(camera)?;
        let (drawn, owners) = self.owners(camera, &path.rows);
        let mut shown: BTreeMap<usize, Shown> = BTreeMap::new();
        let mut rows = Vec::with_capacity(path.rows.len());
        for (drawn, owner) in drawn.into_iter().zip(owners) {
            rows.push(match (drawn, owner) {
                (Err(why), _) => Err(why),
                (Ok(_), None) => Err("the row is drawn as no other".to_owned()),
                (Ok(_), Some(owner)) => {
                    let found = match shown.get(&owner) {
                        Some(found) => found.clone(),
                        None => {
                            self.check_stop()?;
                            let row = &path.rows[owner];
                            let frame = self.draw(self.row_request(camera, row))?;
                            let pixels = self.pixels(row, &frame);
                            // Settings without effect on a scene draw the same frame.
                            let same = shown.values().find(|other| *other.pixels == pixels);
                            let found = same.cloned().unwrap_or_else(|| {
                                let pixels = Arc::new(pixels);
                                Shown { owner, pixels }
                            });
                            shown.insert(owner, found.clone());
                            found
                        }
                    };
                    Ok(found)
                }
            });
        }
        Ok(Still { reference, rows })
    }

    /// Colours of the reference from a camera.
    fn reference_color(&self, camera: Camera) -> Result<Vec<[u8; 4]>, SurveyError> {
        self.check_stop()?;
        if self.oracle.is_some() {
            return Ok(self.truth(camera)?.color);
        }
        let (finer, own, decided) = self.reference_request(camera)?;
        let request = finer.request(&own, &decided, crate::plan::Output::Color, false);
        let color = quads(&self.draw(request)?.bytes);
        Ok(averaged(self.size, PARTS, &color, &color).0)
    }

    fn along_record(
        &self,
        path: &Path<'_>,
        number: u64,
        index: usize,
        before: Option<&Still>,
        now: &Still,
        row: &Row,
    ) -> Result<Record, SurveyError> {
        let label = row.label.clone();
        let shown = match &now.rows[index] {
            Ok(shown) => shown,
            Err(why) => {
                return Ok(Record::FrameRefused { frame: number, row: label, why: why.clone() });
            }
        };
        let earlier =
            before.and_then(|before| Some((&before.reference, before.rows[index].as_ref().ok()?)));
        let change = earlier
            .map(|(reference, earlier)| {
                let frames: [&[[u8; 4]]; 2] = [&earlier.pixels, &shown.pixels];
                Change::between(frames, [reference, &now.reference], self.size)
            })
            .transpose()?;
        Ok(Record::Frame {
            frame: number,
            row: label,
            same_as: (shown.owner != index).then(|| path.rows[shown.owner].label.clone()),
            mse: metrics::mse(&now.reference, &shown.pixels)?,
            change,
        })
    }
}
