//! Measured frames of scenes, by which settings are chosen for a goal, and how long frames take now.
//!
//! Measurements belong to the content of a scene, an adapter, and a build of the shaders. They are kept in memory and as a note beside the point
//! trees, so that another process finds them. Each frame that was drawn for a goal tells how much longer or shorter frames take than measured ones.

use std::collections::HashMap;
use std::sync::Arc;

use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::FrameRequest;
use super::loaded::Loaded;
use super::state::EngineState;
use crate::bake::cache::BakeCache;
use crate::bake::pack::GeometryKind;
use crate::math::View;
use crate::plan::Output;
use crate::plan::planner::{Ground, Measured, Paces, PlanReceipt, Planner};

/// Version of a note.
const VERSION: u32 = 1;
/// Most scenes whose measurements are kept in memory.
const MOST_SCENES: usize = 64;
/// Number of frames after which the note is written with the new pace.
const WRITE_EVERY: u32 = 64;

type Key = [u8; 32];

/// Measurements of all scenes.
pub struct Planners {
    cache: Option<BakeCache>,
    known: Mutex<HashMap<Key, Arc<Known>>>,
}

/// Measurements of a scene.
pub struct Known {
    key: Key,
    measured: Measured,
    planner: Planner,
    pace: Mutex<Pace>,
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
    fn new(key: Key, loaded: &Loaded, measured: Measured, paces: Paces) -> Known {
        let grounds: Vec<Ground> = measured
            .poses
            .iter()
            .filter_map(|pose| {
                let [width, height] = pose.size;
                Some(ground(loaded, &pose.camera()?.view(width, height).ok()?))
            })
            .collect();
        // A pose without a view would move the others.
        let is_whole = grounds.len() == measured.poses.len();
        let measured = if is_whole { measured } else { Measured::default() };
        let planner = Planner::fit(&measured, &grounds);
        Known { key, measured, planner, pace: Mutex::new(Pace { paces, unwritten: 0 }) }
    }

    fn write(&self, cache: Option<&BakeCache>, paces: Paces) {
        let Some(cache) = cache else { return };
        let note = Note { version: VERSION, measured: self.measured.clone(), paces };
        let text = serde_json::to_vec(&note).map_err(std::io::Error::from);
        if let Err(error) = text.and_then(|text| cache.store_note(&self.key, &text)) {
            tracing::warn!(%error, "measurements for the planner cannot be kept");
        }
    }
}

impl Planners {
    pub fn new(cache: Option<BakeCache>) -> Planners {
        Planners { cache, known: Mutex::default() }
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

    /// The measurements of a scene, from memory or from its note.
    fn find(&self, key: Key, loaded: &Loaded) -> Option<Arc<Known>> {
        if let Some(known) = self.known.lock().get(&key) {
            return Some(known.clone());
        }
        let text = self.cache.as_ref()?.load_note(&key)?;
        let note: Note = serde_json::from_slice(&text).ok()?;
        (note.version == VERSION)
            .then(|| self.keep(Known::new(key, loaded, note.measured, note.paces)))
    }

    /// Numbers of settings and poses of a scene's measurements.
    pub fn size(&self, state: &EngineState, loaded: &Loaded) -> Option<[usize; 2]> {
        let known = self.find(key(state, loaded), loaded)?;
        Some([known.planner.len(), known.measured.poses.len()])
    }

    /// Takes on measurements of a scene. Returns the number of settings that can be chosen.
    pub fn learn(&self, state: &EngineState, loaded: &Loaded, measured: Measured) -> usize {
        let known = Known::new(key(state, loaded), loaded, measured, Paces::default());
        known.write(self.cache.as_ref(), Paces::default());
        self.keep(known).planner.len()
    }

    /// Forgets the measurements of a scene. Returns whether there were any.
    pub fn forget(&self, state: &EngineState, loaded: &Loaded) -> bool {
        let key = key(state, loaded);
        let was_known = self.known.lock().remove(&key).is_some();
        let had_note = self.cache.as_ref().is_some_and(|cache| cache.remove_note(&key));
        was_known || had_note
    }

    /// Takes a drawn frame into account that took `actual_ms`, and completes its receipt.
    pub fn see(&self, planned: &PlannedFrame, actual_ms: Option<f64>) -> PlanReceipt {
        if let (Some((known, row, measured_ms)), Some(actual_ms)) = (&planned.from, actual_ms) {
            let mut pace = known.pace.lock();
            pace.paces.see(*row, *measured_ms, actual_ms);
            pace.unwritten += 1;
            let due = (pace.unwritten >= WRITE_EVERY).then(|| {
                pace.unwritten = 0;
                pace.paces.clone()
            });
            drop(pace);
            if let Some(paces) = due {
                known.write(self.cache.as_ref(), paces);
            }
        }
        PlanReceipt { actual_ms, ..planned.receipt.clone() }
    }
}

/// What a view shows of a scene.
fn ground(loaded: &Loaded, view: &View) -> Ground {
    let kinds = [GeometryKind::Samples, GeometryKind::Triangles, GeometryKind::Lines];
    Ground::new(kinds.map(|kind| loaded.patches(kind)), view)
}

/// Stands for the content of a scene, the adapter and the shaders.
fn key(state: &EngineState, loaded: &Loaded) -> Key {
    let adapter = state.adapter();
    let mut hasher = Sha256::new();
    for part in ["planner", &adapter.renderer, &adapter.name] {
        hasher.update((part.len() as u64).to_le_bytes());
        hasher.update(part);
    }
    hasher.update([u8::from(adapter.atomics_64)]);
    // Moved nodes change the ground, and not what was measured.
    hasher.update(loaded.origin);
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
    let unplanned = |because: &str| {
        let receipt = goal.unplanned(because.to_owned());
        (with(asked.without_goal()), Some(PlannedFrame { receipt, from: None }))
    };
    let known = state.planners.find(key(state, loaded), loaded);
    let Some(known) = known.filter(|known| !known.planner.is_empty()) else {
        return unplanned(
            "the scene was not measured for the planner on this adapter, so the settings are those without a goal",
        );
    };
    let paces = match views {
        [_] => known.pace.lock().paces.clone(),
        _ => Paces::default(),
    };
    let fits = |settings: &_| fits(&with(*settings));
    let grounds: Vec<Ground> = views.iter().map(|view| ground(loaded, view)).collect();
    let Some(chosen) = known.planner.choose(&goal, &asked, &grounds, &paces, fits) else {
        return unplanned("no measured setting goes with those that are given");
    };
    let is_as_measured = chosen.is_as_measured && request.output == Output::Color;
    let from = is_as_measured.then_some((known, chosen.row, chosen.measured_pace_ms));
    (with(chosen.settings), Some(PlannedFrame { receipt: chosen.plan, from }))
}
