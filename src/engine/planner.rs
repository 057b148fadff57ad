//! Measured frames of scenes, by which settings are chosen for a goal, and how long frames take now.
//!
//! Measurements belong to the content of a scene, an adapter, and a build of the shaders. They are kept in memory and as a note beside the point
//! trees, so that another process finds them. Each frame that was drawn for a goal tells how much longer or shorter frames take than measured ones.
//!
//! Patched nodes make another content. A patched scene that was not measured itself uses the measurements of the scene as it was loaded, and
//! promises nothing.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::loaded::Loaded;
use super::state::EngineState;
use super::{Engine, EngineError, FrameRequest, resolve};
use crate::bake::cache::BakeCache;
use crate::bake::pack::GeometryKind;
use crate::math::View;
use crate::plan::planner::{
    Asked, Chosen, Goal, Ground, Measured, Moving, Paces, PlanReceipt, Planner,
};
use crate::plan::{Output, Settings, scaled_size};

/// Version of a note.
const VERSION: u32 = 3;
/// Most scenes whose measurements are kept in memory.
const MOST_SCENES: usize = 64;
/// Most kinds of requests that are remembered for a scene.
const MOST_ASKED: usize = 64;
/// Number of frames after which the note is written with the new pace.
const WRITE_EVERY: u32 = 512;
/// How long a note is not looked for again after there was none. Another process may write one.
const ABSENT: Duration = Duration::from_secs(2);

type Key = [u8; 32];

/// Measurements of all scenes.
pub struct Planners {
    cache: Option<BakeCache>,
    known: Mutex<HashMap<Key, Arc<Known>>>,
    /// Contents without a note, and when it was looked for.
    absent: Mutex<HashMap<Key, Instant>>,
    /// Held while a note is read, written or removed, until `known` says the same as the note.
    notes: Mutex<()>,
}

/// Measurements of a scene.
pub struct Known {
    key: Key,
    measured: Measured,
    /// Grounds of the measured poses in the scene as it was then.
    grounds: Vec<Ground>,
    planner: Planner,
    pace: Mutex<Pace>,
    /// Answers of [`Planner::asked`]: each takes milliseconds to find, and a stream asks for each frame.
    asked: Mutex<HashMap<Settings, Asked>>,
}

#[derive(Default)]
struct Pace {
    paces: Paces,
    unwritten: u32,
}

#[derive(Serialize, Deserialize)]
struct Note {
    version: u32,
    measured: Measured,
    /// Other revisions of the scene show something else at the same poses.
    grounds: Vec<Ground>,
    #[serde(default)]
    paces: Paces,
}

/// Settings that were chosen for a frame.
#[derive(Clone)]
pub struct PlannedFrame {
    pub receipt: PlanReceipt,
    /// Where they were chosen from, the chosen row, and its predicted time in ms at the pace of measured frames; `None` where the frame's time tells
    /// nothing about that of measured ones.
    from: Option<(Arc<Known>, usize, f64)>,
}

impl Known {
    /// Measurements of a scene that was measured as it is loaded.
    fn new(key: Key, loaded: &Loaded, measured: Measured) -> Known {
        let grounds: Vec<Ground> = measured
            .poses
            .iter()
            .filter_map(|pose| {
                let [width, height] = pose.size;
                Some(ground(loaded, &pose.camera()?.view(width, height).ok()?))
            })
            .collect();
        Known::fit(key, measured, grounds, Paces::default())
    }

    fn fit(key: Key, measured: Measured, grounds: Vec<Ground>, paces: Paces) -> Known {
        // A pose without a view would move the others.
        let is_whole = grounds.len() == measured.poses.len();
        let (measured, grounds) = if is_whole { (measured, grounds) } else { Default::default() };
        let planner = Planner::fit(&measured, &grounds);
        let (pace, asked) = (Mutex::new(Pace { paces, unwritten: 0 }), Mutex::default());
        Known { key, measured, grounds, planner, pace, asked }
    }

    /// Settings that a request may be drawn with. Requests that differ in what [`Settings::with_some_goal_and_look`] replaces alone share an answer,
    /// since these change from frame to frame.
    fn asked(&self, settings: &Settings) -> Asked {
        let kind = settings.with_some_goal_and_look();
        if let Some(known) = self.asked.lock().get(&kind) {
            return known.looking_like(settings);
        }
        let found = self.planner.asked(&kind);
        let own = found.looking_like(settings);
        let mut asked = self.asked.lock();
        if asked.len() >= MOST_ASKED {
            asked.clear();
        }
        asked.insert(kind, found);
        own
    }

    fn write(&self, cache: Option<&BakeCache>, paces: Paces) {
        let Some(cache) = cache else { return };
        let (measured, grounds) = (self.measured.clone(), self.grounds.clone());
        let note = Note { version: VERSION, measured, grounds, paces };
        let text = serde_json::to_vec(&note).map_err(std::io::Error::from);
        if let Err(error) = text.and_then(|text| cache.store_note(&self.key, &text)) {
            tracing::warn!(%error, "measurements for the planner cannot be kept");
        }
    }
}

impl Planners {
    pub fn new(cache: Option<BakeCache>) -> Planners {
        Planners {
            cache,
            known: Mutex::default(),
            absent: Mutex::default(),
            notes: Mutex::default(),
        }
    }

    fn keep(&self, known: Known) -> Arc<Known> {
        let known = Arc::new(known);
        let mut all = self.known.lock();
        if all.len() >= MOST_SCENES
            && !all.contains_key(&known.key)
            && let Some(&some) = all.keys().next()
        {
            // With a cache, it is found again in its note.
            all.remove(&some);
        }
        all.insert(known.key, known.clone());
        known
    }

    /// The measurements of a content, from memory or from its note.
    fn find(&self, key: Key) -> Option<Arc<Known>> {
        let in_memory = || self.known.lock().get(&key).cloned();
        if let Some(known) = in_memory() {
            return Some(known);
        }
        let cache = self.cache.as_ref()?;
        if self.absent.lock().get(&key).is_some_and(|at| at.elapsed() < ABSENT) {
            return None;
        }
        let _notes = self.notes.lock();
        if let Some(known) = in_memory() {
            return Some(known);
        }
        let read = || -> Option<Note> {
            let note: Note = serde_json::from_slice(&cache.load_note(&key)?).ok()?;
            (note.version == VERSION).then_some(note)
        };
        let Some(Note { measured, grounds, paces, .. }) = read() else {
            let mut absent = self.absent.lock();
            if absent.len() >= MOST_SCENES {
                absent.clear();
            }
            absent.insert(key, Instant::now());
            return None;
        };
        Some(self.keep(Known::fit(key, measured, grounds, paces)))
    }

    /// The measurements that a scene uses, and whether they are of its present content.
    fn find_for(&self, state: &EngineState, loaded: &Loaded) -> Option<(Arc<Known>, bool)> {
        let own = self.find(key(state, &loaded.digest)).map(|known| (known, true));
        own.or_else(|| {
            let is_patched = loaded.digest != loaded.origin;
            let known = is_patched.then(|| self.find(key(state, &loaded.origin)))??;
            Some((known, false))
        })
    }

    /// Numbers of settings and poses of the measurements that a scene uses.
    pub fn size(&self, state: &EngineState, loaded: &Loaded) -> Option<[usize; 2]> {
        let (known, _) = self.find_for(state, loaded)?;
        Some([known.planner.len(), known.measured.poses.len()])
    }

    /// Takes on measurements of a scene's present content, if they are still wanted once they are fitted. Returns the number of settings that can be
    /// chosen.
    fn learn(
        &self,
        state: &EngineState,
        loaded: &Loaded,
        measured: Measured,
        is_wanted: impl FnOnce() -> bool,
    ) -> Option<usize> {
        let known = Known::new(key(state, &loaded.digest), loaded, measured);
        Some(self.replace(known, is_wanted)?.planner.len())
    }

    /// Takes on measurements, in memory and as a note. Whoever forgets them afterwards finds both.
    fn replace(&self, known: Known, is_wanted: impl FnOnce() -> bool) -> Option<Arc<Known>> {
        let _notes = self.notes.lock();
        if !is_wanted() {
            return None;
        }
        known.write(self.cache.as_ref(), Paces::default());
        Some(self.keep(known))
    }

    /// Forgets the measurements that a scene uses. Returns whether there were any.
    pub fn forget(&self, state: &EngineState, loaded: &Loaded) -> bool {
        let keys = [loaded.digest, loaded.origin].map(|content| key(state, &content));
        keys.map(|key| self.remove(&key)).contains(&true)
    }

    fn remove(&self, key: &Key) -> bool {
        let _notes = self.notes.lock();
        let was_known = self.known.lock().remove(key).is_some();
        let had_note = self.cache.as_ref().is_some_and(|cache| cache.remove_note(key));
        was_known || had_note
    }

    /// Completes the receipt of a drawn frame that took `actual_ms`. Takes the frame into account if it did the work of a measured frame.
    pub fn see(
        &self,
        planned: &PlannedFrame,
        actual_ms: Option<f64>,
        is_as_measured: bool,
    ) -> PlanReceipt {
        let from = planned.from.as_ref().filter(|_| is_as_measured);
        if let (Some((known, row, measured_ms)), Some(actual_ms)) = (from, actual_ms) {
            let mut pace = known.pace.lock();
            pace.paces.see(*row, *measured_ms, actual_ms);
            pace.unwritten += 1;
            let due = (pace.unwritten >= WRITE_EVERY).then(|| {
                pace.unwritten = 0;
                pace.paces.clone()
            });
            drop(pace);
            if let Some(paces) = due {
                self.write_paces(known, paces);
            }
        }
        planned.receipt.clone().of_drawn(actual_ms)
    }

    /// Writes the note of measurements anew, unless they were replaced or removed while a frame was drawn from them.
    fn write_paces(&self, known: &Arc<Known>, paces: Paces) {
        let _notes = self.notes.lock();
        let held = self.known.lock().get(&known.key).cloned();
        if held.is_some_and(|held| Arc::ptr_eq(&held, known)) {
            known.write(self.cache.as_ref(), paces);
        }
    }
}

/// What a view shows of a scene.
fn ground(loaded: &Loaded, view: &View) -> Ground {
    let kinds = [GeometryKind::Samples, GeometryKind::Triangles, GeometryKind::Lines];
    Ground::new(kinds.map(|kind| loaded.patches(kind)), view)
}

/// Stands for the content of a scene, which has this digest, the adapter and the shaders.
fn key(state: &EngineState, content: &[u8; 32]) -> Key {
    let adapter = state.adapter();
    let mut hasher = Sha256::new();
    for part in ["planner", &adapter.renderer, &adapter.name] {
        hasher.update((part.len() as u64).to_le_bytes());
        hasher.update(part);
    }
    hasher.update([u8::from(adapter.atomics_64)]);
    hasher.update(content);
    hasher.finalize().into()
}

/// The request with settings chosen for its goal, and how they were chosen; `None` for a request without a goal. With several views, frames of all of
/// them are to keep the goal, and the choice does not depend on how long frames take now. Outputs other than colours are drawn with the settings that the
/// colours have. `fits` tells which requests are within the limits of frames.
pub fn planned(
    state: &EngineState,
    loaded: &Loaded,
    request: FrameRequest,
    views: &[View],
    fits: impl Fn(&FrameRequest) -> bool,
) -> (FrameRequest, Option<PlannedFrame>) {
    let Some(goal) = request.settings.goal() else { return (request, None) };
    let asked = request.settings;
    let with = |settings| FrameRequest { settings, ..request.clone() };
    let unplanned =
        |because: &str| (with(asked.without_goal()), Some(PlannedFrame::unplanned(&goal, because)));
    let found = state.planners.find_for(state, loaded);
    let Some((known, is_own)) = found.filter(|(known, _)| !known.planner.is_empty()) else {
        return unplanned(
            "the scene was not measured for the planner on this adapter (`accuracy --planner` measures it), so the settings are those without a goal",
        );
    };
    let paces = match views {
        [_] => known.pace.lock().paces.clone(),
        _ => Paces::default(),
    };
    let fits = |settings: &_| fits(&with(*settings));
    let grounds: Vec<Ground> = views.iter().map(|view| ground(loaded, view)).collect();
    let may_be = known.asked(&asked);
    let Some(chosen) = known.planner.choose(&goal, &may_be, &grounds, &paces, fits) else {
        return unplanned("no measured setting goes with those that are given");
    };
    let settings = chosen.settings;
    (with(settings), Some(PlannedFrame::new(known, is_own, chosen, request.output)))
}

/// Settings and size of a frame of a moving pose.
pub struct MovingFrame {
    pub settings: Settings,
    pub size: [u32; 2],
    /// How they were chosen.
    pub planned: PlannedFrame,
}

/// The most exact settings and size that keep the time of the request's goal. `None` where the scene was not measured, or nothing
/// that was measured goes with the request, which has the size of the still frame. `fits` tells which requests can be drawn.
pub fn planned_moving(
    state: &EngineState,
    loaded: &Loaded,
    request: &FrameRequest,
    view: &View,
    moving: &Moving<'_>,
    fits: impl Fn(&FrameRequest) -> bool,
) -> Option<MovingFrame> {
    let goal = request.settings.goal()?;
    let (known, is_own) = state.planners.find_for(state, loaded)?;
    let paces = known.pace.lock().paces.clone();
    let size = |scale| scaled_size([request.width, request.height], scale);
    let fits = |settings: &Settings, scale| {
        let [width, height] = size(scale);
        fits(&FrameRequest { settings: *settings, width, height, ..request.clone() })
    };
    let ground = ground(loaded, view);
    let asked = known.asked(&request.settings);
    let chosen = known.planner.choose_moving(&goal, moving, &asked, &ground, &paces, fits)?;
    let (settings, size) = (chosen.settings, size(chosen.scale));
    let planned = PlannedFrame::new(known, is_own, chosen, request.output);
    Some(MovingFrame { settings, size, planned })
}

impl PlannedFrame {
    /// A frame with a goal for which nothing could be chosen.
    pub fn unplanned(goal: &Goal, because: &str) -> PlannedFrame {
        PlannedFrame { receipt: goal.unplanned(because.to_owned()), from: None }
    }

    fn new(known: Arc<Known>, is_own: bool, chosen: Chosen, output: Output) -> PlannedFrame {
        let is_as_measured = is_own && chosen.is_as_measured && output == Output::Color;
        let from = is_as_measured.then_some((known, chosen.row, chosen.measured_pace_ms));
        let receipt = if is_own { chosen.plan } else { chosen.plan.of_other_content() };
        PlannedFrame { receipt, from }
    }
}

impl Engine {
    /// Takes on measured frames of a scene, from which settings are chosen for requests with a goal. They are kept beside the point trees.
    /// Returns the number of settings that can be chosen.
    ///
    /// # Errors
    /// [`EngineError::UnknownScene`].
    pub fn learn(&self, id: &str, measured: Measured) -> Result<usize, EngineError> {
        Ok(self.learn_if(id, measured, || true)?.unwrap_or(0))
    }

    /// Takes on measured frames like [`Engine::learn`], if they are still wanted once models are fitted to them. Fitting takes a while. `None` where they
    /// are not.
    ///
    /// # Errors
    /// [`EngineError::UnknownScene`].
    pub fn learn_if(
        &self,
        id: &str,
        measured: Measured,
        is_wanted: impl FnOnce() -> bool,
    ) -> Result<Option<usize>, EngineError> {
        let state = self.state();
        Ok(state.planners.learn(state, &*state.loaded(id)?, measured, is_wanted))
    }

    /// Forgets what [`Engine::learn`] took on. Returns whether there was anything.
    ///
    /// # Errors
    /// [`EngineError::UnknownScene`].
    pub fn unlearn(&self, id: &str) -> Result<bool, EngineError> {
        let state = self.state();
        Ok(state.planners.forget(state, &*state.loaded(id)?))
    }

    /// The settings for frames that belong together, as those of a film, and how they were chosen: the goal of the requests is kept by all of them.
    /// `None` for requests without a goal.
    ///
    /// # Errors
    /// Any error of a request.
    pub fn settings_for_all(
        &self,
        requests: &[FrameRequest],
    ) -> Result<Option<(Settings, PlanReceipt)>, EngineError> {
        resolve::settings_for_all(self.state(), requests)
    }

    /// Numbers of settings and poses that were measured of this content of a scene on this adapter; `None` without measurements.
    ///
    /// # Errors
    /// [`EngineError::UnknownScene`].
    pub fn planner_size(&self, id: &str) -> Result<Option<[usize; 2]>, EngineError> {
        let state = self.state();
        Ok(state.planners.size(state, &*state.loaded(id)?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::Given;
    use crate::plan::planner::MeasuredPose;

    fn known(width: u32) -> Known {
        let pose = MeasuredPose {
            eye: [0.0; 3],
            target: [1.0; 3],
            up: [0.0, 1.0, 0.0],
            fov_deg: Some(40.0),
            ortho_height: None,
            size: [width, 1],
        };
        let measured = Measured { poses: vec![pose], rows: Vec::new() };
        let view = pose.camera().unwrap().view(width, 1).unwrap();
        let grounds = vec![Ground::new([&[]; 3], &view)];
        Known::fit([7; 32], measured, grounds, Paces::default())
    }

    #[test]
    fn clip_boxes_and_sliders_that_move_are_asked_for_once() {
        let known = known(1);
        let asked = |pairs: &[(&str, &str)]| {
            let mut given = Given::default();
            for (name, value) in pairs {
                given.set_text(name, value).unwrap();
            }
            known.asked(&given.resolve().unwrap());
            known.asked.lock().len()
        };
        for x in 1..5 {
            let boxes = format!("0,0,0,{x},1,1");
            assert_eq!(asked(&[("budget_ms", "5"), ("clip_boxes", &boxes)]), 1, "{boxes}");
        }
        assert_eq!(asked(&[("budget_ms", "5")]), 2, "nothing is clipped");
        assert_eq!(asked(&[("budget_ms", "7")]), 2);
        for (number, name) in (3..).zip(["exposure", "edl_strength", "edl_radius_px"]) {
            for value in ["1.5", "2.5", "3"] {
                assert_eq!(asked(&[("budget_ms", "5"), (name, value)]), number, "{name}={value}");
            }
        }
        for [least, most] in [["1", "2"], ["-3", "-2"], ["5", "9"]] {
            let bounds = [("color_least", least), ("color_most", most)];
            let pairs = [&[("budget_ms", "5"), ("color_by", "height")][..], &bounds].concat();
            assert_eq!(asked(&pairs), 6, "{bounds:?}");
        }
    }

    #[test]
    fn frames_in_flight_bring_no_old_measurements_back() {
        let folder = tempfile::tempdir().unwrap();
        let cache = BakeCache::new(folder.path().join("cache"), 1 << 20);
        let planners = Planners::new(Some(cache.clone()));
        let noted = || {
            let note: Note = serde_json::from_slice(&cache.load_note(&[7; 32])?).unwrap();
            Some((note.measured.poses[0].size[0], note.paces != Paces::default()))
        };
        let goal = Goal { most_ms: Some(1.0), least_db: None };
        let draw_many = |known: &Arc<Known>| {
            let receipt = goal.unplanned(String::new());
            let planned = PlannedFrame { receipt, from: Some((known.clone(), 0, 1.0)) };
            for _ in 0..WRITE_EVERY {
                planners.see(&planned, Some(2.0), true);
            }
            let receipt = planners.see(&planned, Some(9.0), false);
            assert_eq!(receipt.actual_ms, Some(9.0));
            let pace = known.pace.lock();
            assert_eq!(pace.unwritten, 0, "frames with less work tell nothing");
        };
        let old = planners.replace(known(1), || true).unwrap();
        draw_many(&old);
        assert_eq!(noted(), Some((1, true)));
        let new = planners.replace(known(2), || true).unwrap();
        draw_many(&old);
        assert_eq!(noted(), Some((2, false)), "it was replaced");
        draw_many(&new);
        assert_eq!(noted(), Some((2, true)));
        assert!(planners.remove(&[7; 32]));
        draw_many(&new);
        assert_eq!(noted(), None, "it was removed");
        // Another process finds the note with its grounds.
        assert!(planners.replace(known(4), || false).is_none());
        assert_eq!(noted(), None, "it was no longer wanted");
        planners.replace(known(3), || true).unwrap();
        let found = Planners::new(Some(cache)).find([7; 32]).unwrap();
        assert_eq!(found.grounds, known(3).grounds);
    }
}
