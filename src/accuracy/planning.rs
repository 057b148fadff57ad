//! Measures what the planner predicts from: the frames of many settings at poses in all directions and distances, in three sizes.
//!
//! Frames of moving poses are drawn smaller than they are shown, so that settings are measured in smaller sizes as well, enlarged.
//!
//! A first look at a few poses leaves out settings that others beat in both time and error. The rest is drawn at all poses; the sizes take
//! turns from pose to pose. The engine keeps the measurements beside the point trees; journals serve to go on with a measurement that was interrupted.

use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::SystemTime;

use super::date::date;
use super::journal::Journal;
use super::poses::{of_cameras, spread};
use super::results::{ALL_POSES, Entry, Results, Scope};
use super::survey::{Event, NamedPose, Purpose, Survey, SurveyError};
use super::sweep::{Row, planned_rows, rows};
use crate::engine::{Client, Engine, FrameRequest, Pose, SceneInfo};
use crate::math::Camera;
use crate::plan::planner::{Measured, MeasuredPose, MeasuredRow, Point};
use crate::plan::{Extent, Settings};

/// Poses at which settings are measured.
const POSES: usize = 24;
/// Poses of the first look.
const FIRST_POSES: usize = 3;
/// Sizes of frames, as multiples of the least one.
const SIZES: [u32; 3] = [1, 2, MOST_TIMES];
/// Side of the largest frames over that of the smallest.
pub const MOST_TIMES: u32 = 3;
/// Size of the smallest frames.
pub const LEAST_SIZE: [u32; 2] = [320, 180];
/// Timed frames of each setting and pose.
const REPEATS: u32 = 2;
/// A setting is beaten by one that is more exact and takes at most this share of its time.
const BEATEN: f64 = 0.8;
/// Seed of the order in which frames are timed.
const SEED: u64 = 1;

/// Measures a scene for the planner.
pub struct Planning<'a> {
    pub engine: &'a Engine,
    /// Client whose share of the device the frames take.
    pub client: Client,
    /// Id of the scene in the engine.
    pub scene: &'a str,
    /// Size of the smallest frames in pixels.
    pub least_size: [u32; 2],
    /// Ends the measurement after the frame at hand.
    pub stop: &'a AtomicBool,
    /// Folder of the journals, where there is one.
    pub journals: Option<&'a Path>,
}

impl Planning<'_> {
    /// The survey of some settings at poses of one size.
    pub fn survey(&self, size: [u32; 2], poses: Vec<NamedPose>, rows: Vec<Row>) -> Survey<'_> {
        Survey {
            engine: self.engine,
            client: self.client,
            scene: self.scene,
            poses,
            rows,
            size,
            repeats: REPEATS,
            seed: SEED,
            oracle: None,
            folder: None,
            purpose: Purpose::Planner,
            stop: self.stop,
        }
    }

    /// Frames that need what only a bake makes, to be baked before.
    pub fn requests(&self) -> Vec<FrameRequest> {
        let survey = self.survey(self.least_size, Vec::new(), rows(Extent::Planned, true));
        let all =
            survey.rows.iter().map(|row| Settings::from(row.given)).chain([Settings::exact()]);
        let request = |settings: Settings| FrameRequest {
            settings: settings.complete(),
            ..survey.request_at(Pose::FIT)
        };
        all.map(request).filter(|request| self.engine.must_bake(request)).collect()
    }

    /// Draws and compares all frames.
    ///
    /// # Errors
    /// The engine fails, the adapter has no timestamps, or the measurement is told to stop.
    pub fn measure(
        &self,
        info: &SceneInfo,
        mut tell: impl FnMut(Event<'_>),
    ) -> Result<Measured, SurveyError> {
        let mut poses = self.poses(info)?;
        let stages = 1 + SIZES.len() as u64;
        let mut first =
            self.survey(self.least_size, poses.clone(), planned_rows(info.has_samples()));
        let blank = first.leave_out_blank()?;
        if first.poses.is_empty() {
            return Err(SurveyError::Blank(blank.join(", ")));
        }
        poses.clone_from(&first.poses);
        // Poses from near and far, since they were spread.
        first.poses.truncate(FIRST_POSES);
        let looked = self.run(&first, "first", &mut |event| tell(of_stage(0, stages, event)))?;
        let kept = unbeaten(&looked, &first.rows);
        let mut measured =
            Measured { poses: Vec::new(), rows: kept.iter().map(row_without_points).collect() };
        for (number, times) in SIZES.into_iter().enumerate() {
            let size = self.least_size.map(|side| side * times);
            let own = poses.iter().skip(number).step_by(SIZES.len()).cloned().collect();
            let survey = self.survey(size, own, kept.clone());
            let stage = 1 + number as u64;
            let name = format!("{times}x");
            let results =
                self.run(&survey, &name, &mut |event| tell(of_stage(stage, stages, event)))?;
            add(&mut measured, size, &survey, &results);
        }
        Ok(measured)
    }

    /// Runs the survey of a stage; `name` is that of its journal.
    fn run(
        &self,
        survey: &Survey<'_>,
        name: &str,
        tell: &mut dyn FnMut(Event<'_>),
    ) -> Result<Results, SurveyError> {
        let identity = survey.identity(survey.scene)?;
        let now = date(SystemTime::now());
        let mut journal = Journal::resumed(self.journals, name, &identity, &now);
        if !survey.run(&mut journal, tell)? {
            return Err(SurveyError::Stopped);
        }
        Ok(Results::new(identity, journal.date, &survey.rows, &journal.records))
    }

    /// The cameras of the scene, and views around it.
    fn poses(&self, info: &SceneInfo) -> Result<Vec<NamedPose>, SurveyError> {
        let view = self.survey(self.least_size, Vec::new(), Vec::new()).default_view()?;
        let mut poses = of_cameras(&info.cameras, &[])?;
        let first = poses.len();
        poses.extend(spread(&view, first, POSES - first, &info.cameras));
        Ok(poses)
    }
}

/// Progress of one of several stages that take about equally long, in thousandths.
fn of_stage(stage: u64, stages: u64, event: Event<'_>) -> Event<'_> {
    let done = 1000 * stage / stages + 1000 * event.done / (event.total.max(1) * stages);
    Event { done: done.max(1), total: 1000, what: event.what }
}

fn poses_of(results: &Results) -> impl Iterator<Item = &Scope> {
    results.scopes.iter().filter(|scope| scope.name != ALL_POSES)
}

fn point(entry: &Entry) -> Option<Point> {
    Some(Point { mse: entry.metrics.mse, ms: entry.gpu_ms?.median })
}

/// The rows that are not beaten at every pose, and the plain ones of each way to draw samples, since requests may ask for that way. Rows of full size
/// are compared with rows of full size alone, because still frames have no other; smaller rows with all.
fn unbeaten(looked: &Results, rows: &[Row]) -> Vec<Row> {
    let is_plain = |row: &Row| {
        let settings = Settings::from(row.given);
        let is_plain = settings.accepted_px_of_trees().is_none_or(|px| px == 1.0);
        let is_main_size = row.is_whole() || row.scale == 0.5;
        is_main_size && settings.parts() == 1 && is_plain
    };
    let is_beaten = |scope: &Scope, row: &Row| {
        let point_of = |row: &Row| scope.entry(&row.label).and_then(point);
        point_of(row).is_none_or(|own| {
            let others = rows.iter().filter(|other| other.is_whole() || !row.is_whole());
            let mut others = others.filter_map(point_of);
            others.any(|other| other.mse <= own.mse && other.ms <= BEATEN * own.ms)
        })
    };
    let is_kept = |row: &&Row| is_plain(row) || poses_of(looked).any(|at| !is_beaten(at, row));
    rows.iter().filter(is_kept).cloned().collect()
}

fn row_without_points(row: &Row) -> MeasuredRow {
    let (label, given, scale) = (row.label.clone(), row.given, row.scale);
    MeasuredRow { label, given, scale, points: Vec::new() }
}

/// Adds the frames of a survey.
fn add(measured: &mut Measured, size: [u32; 2], survey: &Survey<'_>, results: &Results) {
    for (pose, scope) in survey.poses.iter().zip(poses_of(results)) {
        let Camera { eye, target, up, lens } = pose.camera;
        measured.poses.push(MeasuredPose {
            eye: eye.into(),
            target: target.into(),
            up: up.into(),
            fov_deg: lens.fov_deg(),
            ortho_height: lens.ortho_height(),
            size,
        });
        for row in &mut measured.rows {
            row.points.push(scope.entry(&row.label).and_then(point));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accuracy::results::tests::results;
    use crate::plan::Given;

    #[test]
    fn progress_goes_on_from_stage_to_stage() {
        let event = |done| Event { done, total: 10, what: "x" };
        let done = [(0, 1), (0, 10), (1, 1), (3, 10)]
            .map(|(stage, done)| of_stage(stage, 4, event(done)).done);
        assert_eq!(done, [25, 250, 275, 1000]);
        assert_eq!(of_stage(0, 4, Event { done: 0, total: 0, what: "" }).done, 1);
    }

    #[test]
    fn beaten_settings_are_left_out() {
        let found = results();
        let rows = rows(Extent::Planned, true);
        let kept = unbeaten(&found, &rows);
        assert!(kept.len() < rows.len());
        // Each way to draw samples stays.
        for family in rows.iter().map(|row| &row.family) {
            assert!(kept.iter().any(|row| row.family == *family), "{family}");
        }
    }

    #[test]
    fn smaller_sizes_beat_no_setting_of_full_size() {
        let looked = results();
        let plain = Given::default();
        let mut antialiased = plain;
        antialiased.set_text("antialias", "4x").unwrap();
        // "fast way" is faster and more exact than "beaten way" at both poses.
        let is_kept = |fast: f64, (given, scale): (Given, f64)| {
            let row = |label: &str, given: Given, scale: f64| Row {
                label: label.to_owned(),
                family: String::new(),
                given,
                scale,
            };
            let rows = [row("fast way", plain, fast), row("beaten way", given, scale)];
            unbeaten(&looked, &rows).iter().any(|row| row.label == "beaten way")
        };
        assert!(!is_kept(1.0, (antialiased, 1.0)), "both are of full size");
        assert!(is_kept(0.25, (antialiased, 1.0)), "still frames cannot be smaller");
        assert!(!is_kept(1.0, (plain, 0.25)), "moving frames may have the full size");
        assert!(!is_kept(0.5, (plain, 0.25)), "both are smaller");
        assert!(is_kept(1.0, (plain, 0.5)), "each way to draw stays in one smaller size");
    }
}
