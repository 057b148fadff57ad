//! The work of a survey, on a thread of its own.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::SystemTime;

use super::store::Kept;
use super::{Failure, Progress, Shared, State, Wanted, tag};
use crate::accuracy::journal::Journal;
use crate::accuracy::planning::Planning;
use crate::accuracy::results::Results;
use crate::accuracy::survey::{Event, Purpose, Survey, SurveyError};
use crate::accuracy::{date, sweep};
use crate::engine::{Client, EngineError, FrameRequest, Pose, SceneMark};
use crate::plan::Extent;
use crate::plan::planner::Measured;

/// The number of the surveys' lane in the queue; those of jobs begin at 1.
const LANE: u64 = 0;
/// Seed of the order in which frames are timed.
const SEED: u64 = 1;

/// What was measured.
pub(super) enum Outcome {
    Results(Kept),
    /// Frames for the planner, and the content that they show.
    Planner(Measured, Option<SceneMark>),
}

impl Shared {
    /// Surveys a scene.
    ///
    /// # Errors
    /// How the survey ended without results.
    pub(super) fn measure(
        &self,
        scene: &str,
        wanted: &Wanted,
        stop: &AtomicBool,
    ) -> Result<Outcome, State> {
        let engine = &self.engine;
        let mark = engine.scene_mark(scene);
        let has_changed = || engine.scene_mark(scene) != mark;
        let measured = if wanted.is_for_planner {
            self.plan(scene, wanted, stop, &has_changed)
                .map(|measured| Outcome::Planner(measured, mark))
        } else {
            self.survey(scene, wanted, stop, &has_changed).map(Outcome::Results)
        };
        // Frames of a scene that changed show both contents, or failed because of the change.
        if has_changed() {
            return Err(State::Failed(Failure::SceneChanged));
        }
        measured.map_err(|error| match error {
            SurveyError::Stopped | SurveyError::Engine(EngineError::ShuttingDown) => {
                State::Cancelled
            }
            SurveyError::Engine(EngineError::Internal(cause)) => {
                tracing::error!(scene, %cause, "accuracy cannot be measured");
                let told = "a frame could not be drawn; the server's log has the cause";
                State::Failed(Failure::Other(told.to_owned()))
            }
            SurveyError::Journal(cause) => {
                tracing::error!(scene, %cause, "measurements of accuracy cannot be kept");
                let told = "the measurements could not be written; the server's log has the cause";
                State::Failed(Failure::Other(told.to_owned()))
            }
            error => State::Failed(Failure::Other(error.to_string())),
        })
    }

    fn survey(
        &self,
        scene: &str,
        wanted: &Wanted,
        stop: &AtomicBool,
        has_changed: &impl Fn() -> bool,
    ) -> Result<Kept, SurveyError> {
        let engine = &self.engine;
        let info = engine.scene(scene)?;
        let tag = tag(engine, scene)?;
        let extent = if wanted.is_quick { Extent::Few } else { Extent::All };
        let mut survey = Survey {
            engine,
            client: Client::Job(LANE),
            scene,
            poses: Vec::new(),
            rows: sweep::sized_rows(extent, info.has_samples()),
            size: wanted.size,
            repeats: wanted.repeats,
            seed: SEED,
            oracle: None,
            folder: None,
            purpose: Purpose::Report,
            stop,
        };
        if info.cameras.is_empty() && wanted.cameras.is_empty() {
            self.bake(&survey.request_at(Pose::FIT), stop)?;
        }
        survey.find_poses(&info, &wanted.cameras, wanted.is_quick)?;
        for request in survey.requests() {
            self.bake(&request, stop)?;
        }
        let blank = survey.leave_out_blank()?;
        if survey.poses.is_empty() {
            return Err(SurveyError::Blank(blank.join(", ")));
        }
        let identity = survey.identity(&info.name)?;
        let journals = self.unfinished.journals();
        let mut journal = Journal::resumed(journals, "report", &identity, &date(SystemTime::now()));
        let is_complete = survey.run(&mut journal, |event| self.hear(event, stop, has_changed))?;
        if !is_complete {
            return Err(SurveyError::Stopped);
        }
        let results = Results::new(identity, journal.date, &survey.rows, &journal.records);
        let kept = Kept::new(scene, tag, info.revision, &results);
        kept.map_err(|error| EngineError::Internal(error.to_string()).into())
    }

    /// Measures a scene for the planner.
    fn plan(
        &self,
        scene: &str,
        wanted: &Wanted,
        stop: &AtomicBool,
        has_changed: &impl Fn() -> bool,
    ) -> Result<Measured, SurveyError> {
        let engine = &self.engine;
        let least_size = wanted.size;
        let journals = self.unfinished.journals();
        let client = Client::Job(LANE);
        let planning = Planning { engine, client, scene, least_size, stop, journals };
        for request in planning.requests() {
            self.bake(&request, stop)?;
        }
        planning.measure(&engine.scene(scene)?, |event| self.hear(event, stop, has_changed))
    }

    /// Tells the progress, and stops the survey of a scene that has changed.
    fn hear(&self, event: Event<'_>, stop: &AtomicBool, has_changed: &impl Fn() -> bool) {
        let Event { done, total, what } = event;
        self.tell(Progress { done, total, what: what.to_owned() });
        if has_changed() {
            stop.store(true, Ordering::Relaxed);
        }
    }

    /// Bakes what a frame needs. The bake is given up if the survey is told to stop.
    fn bake(&self, request: &FrameRequest, stop: &AtomicBool) -> Result<(), SurveyError> {
        let Some(mut ticket) = self.engine.begin_bake(request)? else { return Ok(()) };
        let mut told = -1.0;
        let baked = ticket.wait_while(|done| {
            if done != told {
                told = done;
                let what = format!("baking, {:.0} %", 100.0 * done);
                self.tell(Progress { what, ..Progress::default() });
            }
            !stop.load(Ordering::Relaxed)
        });
        Ok(baked.ok_or(SurveyError::Stopped)??)
    }
}
