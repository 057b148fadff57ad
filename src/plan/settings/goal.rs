//! Settings that are chosen for a goal, and those that the request gives itself.

use serde_json::{Map, Value};

use super::{Budget, Given, MinPsnr, Setting, SettingKind, Settings, Trade, declared, kept, words};
use crate::plan::planner::Goal;
use crate::scene::clipping::ClipBoxes;

/// The settings that trade accuracy for time and that a request gives, as bits in the order of their declaration. None without a goal, since nothing is chosen then.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Pinned(u64);

const _: () = assert!(Given::NAMES.len() <= 64);

/// Names of the settings that make a goal.
const BUDGET: &str = "budget_ms";
const LEAST_PSNR: &str = "min_psnr_db";

impl Settings {
    /// What the frame is asked to keep, where settings are to be chosen for it.
    pub fn goal(&self) -> Option<Goal> {
        let goal = Goal { most_ms: self.budget_ms.ms(), least_db: self.min_psnr_db.db() };
        (goal.most_ms.is_some() || goal.least_db.is_some()).then_some(goal)
    }

    /// The settings without a goal.
    #[must_use]
    pub fn without_goal(&self) -> Settings {
        let (budget_ms, min_psnr_db) = (Budget::default(), MinPsnr::default());
        let pinned = Pinned::default();
        Settings { budget_ms, min_psnr_db, pinned, ..self.with_lod_without_goal() }
    }

    /// The settings with one value in place of any other of the goal, the clip boxes, and the numbers of the look that sliders change from frame to
    /// frame. What may be chosen is the same for all of these values.
    #[must_use]
    pub fn with_some_goal_and_look(&self) -> Settings {
        fn some<T: PartialEq + Default + From<f64>>(own: T, other: f64) -> T {
            if own == T::default() { own } else { other.into() }
        }
        Settings {
            budget_ms: 1.0.into(),
            min_psnr_db: MinPsnr::default(),
            clip_boxes: self.clip_boxes.map(|_| ClipBoxes::EVERYTHING),
            color_least: self.color_least.map(|_| 0.0.into()),
            color_most: self.color_most.map(|_| 1.0.into()),
            exposure: some(self.exposure, 1.0),
            edl_strength: some(self.edl_strength, 1.0),
            edl_radius_px: some(self.edl_radius_px, 2.0),
            ..*self
        }
    }

    /// The settings with the clip boxes and the numbers of the look of `other`.
    #[must_use]
    pub fn looking_like(&self, other: &Settings) -> Settings {
        Settings {
            clip_boxes: other.clip_boxes,
            color_least: other.color_least,
            color_most: other.color_most,
            exposure: other.exposure,
            edl_strength: other.edl_strength,
            edl_radius_px: other.edl_radius_px,
            ..*self
        }
    }

    pub(super) fn with_pinned<const N: usize>(self, given: [bool; N]) -> Settings {
        if self.goal().is_none() {
            return self;
        }
        let bits = given.iter().zip(declared()).enumerate();
        let bits = bits.filter(|(_, (is_given, setting))| **is_given && setting.trades.is_some());
        let pinned = Pinned(bits.fold(0, |bits, (index, _)| bits | 1 << index));
        Settings { pinned, ..self }
    }

    /// Names of the settings that are to be chosen: those that trade accuracy for time and are not given, or are `auto`.
    pub(super) fn open(&self) -> Vec<&'static str> {
        if self.goal().is_none() {
            return Vec::new();
        }
        let values = words(self);
        let is_given = |index: usize, name: &str| {
            self.pinned.0 >> index & 1 == 1
                && values.get(name).and_then(Value::as_str) != Some("auto")
        };
        let named = declared().iter().enumerate().filter(|(_, setting)| setting.trades.is_some());
        let open = named.filter(|(index, setting)| !is_given(*index, setting.name));
        open.map(|(_, setting)| setting.name).collect()
    }

    /// Names of given settings that affect the picture or its cost, and of which candidates that vary the settings in `varied` say nothing.
    pub fn beyond(&self, varied: &[&str]) -> Vec<&'static str> {
        let (own, plain) = (words(self), words(&Settings::default()));
        let is_given = |name: &str| own.get(name) != plain.get(name) && !varied.contains(&name);
        // A projection makes another view, which the planner sees. The others are the goal.
        let others = |name: &str| !["projection", BUDGET, LEAST_PSNR].contains(&name);
        declared()
            .iter()
            .map(|one| one.name)
            .filter(|name| is_given(name) && others(name))
            .collect()
    }

    /// The settings with those that are open as in `candidate`, and without a goal. `None` where the candidate contradicts what is given:
    /// another choice of a setting in `varied`, or a larger number than the given one, which is an upper bound.
    pub fn planned(&self, candidate: &Given, varied: &[&str]) -> Option<Settings> {
        let (open, own) = (self.open(), words(self));
        let (plain, values): (_, Map<String, Value>) =
            (words(&Settings::default()), words(candidate));
        let is_own = |setting: &Setting| own.get(setting.name) != plain.get(setting.name);
        let mut given = kept(&words(&self.without_goal()), &open, is_own);
        for setting in declared().iter().filter(|setting| setting.trades.is_some()) {
            let value = values.get(setting.name);
            let chosen = match (&setting.kind, value) {
                _ if open.contains(&setting.name) => value.cloned(),
                (SettingKind::Number { .. }, _) => {
                    let most = own.get(setting.name).and_then(Value::as_f64);
                    if value.and_then(Value::as_f64) > most {
                        return None;
                    }
                    value.cloned()
                }
                (SettingKind::Choice { default, .. }, _) if varied.contains(&setting.name) => {
                    let word = value.and_then(Value::as_str).or(default.as_deref());
                    let asked = own.get(setting.name).and_then(Value::as_str);
                    if word.is_some() && word != asked {
                        return None;
                    }
                    continue;
                }
                _ => continue,
            };
            given.set(setting.name, chosen.unwrap_or(Value::Null)).ok()?;
        }
        let settings = given.resolve().ok()?;
        Some(Settings { decide_for: self.decide_for, wait: self.wait, ..settings })
    }
}

impl Given {
    /// The settings for a frame of a moving pose: a time budget is the goal, and the given error and antialiasing are left out. A given budget stays if it is
    /// smaller.
    #[must_use]
    pub fn moving_within(&self, ms: f64) -> Given {
        let own = self.budget_ms.unwrap_or(f64::INFINITY);
        let given = Given { budget_ms: Some(ms.min(own)), ..*self };
        let is_other = |setting: &Setting| {
            let is_number = matches!(setting.kind, SettingKind::Number { .. });
            let is_open = |trade: Trade| is_number || trade.is_large_variant();
            setting.name != LEAST_PSNR && !setting.trades.is_some_and(is_open)
        };
        kept(&words(&given), &[], is_other)
    }

    /// Names of the settings that are given.
    pub fn names(&self) -> Vec<&'static str> {
        let own = words(self);
        Given::NAMES.iter().copied().filter(|name| own.contains_key(*name)).collect()
    }
}
