//! Camera paths: keys with times in seconds, and the camera at any time between them.
//!
//! Changes between two keys:
//!
//! | of the camera | between two keys |
//! |---|---|
//! | position | on a centripetal Catmull–Rom curve through all keys ([`spline`]), or on a straight line |
//! | orientation | spherical linear interpolation (K. Shoemake, *Animating Rotation with Quaternion Curves*, SIGGRAPH 1985), the shorter way |
//! | distance to the target, field of view | linear |
//!
//! All of them follow one number, how much of the way between the two keys has been made at a time ([`timing`]). At a key's own
//! time the camera is the key's to the last bit; before the first key it is the first's, after the last the last's.
//!
//! Keys in the same place are a pause, in which the camera may turn: the curve goes through them as through one point.

mod timing;

#[cfg(test)]
mod tests;

use glam::{DMat3, DQuat, DVec3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use self::timing::{Part, Way};
use crate::math::{Camera, CameraError, spline};

/// Keyframes with times in seconds.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraPath {
    /// Frames a second, where nothing else is asked for.
    pub fps: f64,
    pub interpolation: Interpolation,
    pub keys: Vec<PathKey>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathKey {
    pub t: f64,
    pub camera: Camera,
    /// From this key to the next; the last key's counts for nothing.
    pub ease: Ease,
}

/// How positions go from key to key.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, utoipa::ToSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum Interpolation {
    /// On a smooth curve through all keys, without loops and cusps between them.
    #[default]
    CatmullRom,
    /// On straight lines.
    Linear,
}

impl Interpolation {
    /// The ease of a path that names none.
    pub fn default_ease(self) -> Ease {
        match self {
            Interpolation::CatmullRom => Ease::Smooth,
            Interpolation::Linear => Ease::Linear,
        }
    }
}

/// How time passes between a key and the next.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, utoipa::ToSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum Ease {
    /// The speed goes over from one part of the path to the next without a jump.
    #[default]
    Smooth,
    /// Evenly.
    Linear,
    /// From rest.
    In,
    /// To rest.
    Out,
    /// From rest to rest.
    InOut,
    /// Not at all until the next key's time: a cut.
    Hold,
}

impl CameraPath {
    /// Time of the first key, and seconds from there to the last.
    fn span_s(&self) -> (f64, f64) {
        match (self.keys.first(), self.keys.last()) {
            (Some(first), Some(last)) => (first.t, last.t - first.t),
            _ => (0.0, 0.0),
        }
    }

    /// Seconds from the first key to the last.
    pub fn duration_s(&self) -> f64 {
        self.span_s().1
    }

    /// Frames from the first key to the last at `fps` a second. The last key has a frame of its own where it falls on one.
    pub fn frame_count(&self, fps: f64) -> u64 {
        // Nothing may be lost of a number that is whole but for rounding.
        const SLACK: f64 = 1e-6;
        (self.duration_s() * fps + SLACK).floor() as u64 + 1
    }

    /// The time that frame `number` shows at `fps` a second: `number / fps` after the first key.
    pub fn frame_time_s(&self, number: u64, fps: f64) -> f64 {
        self.span_s().0 + number as f64 / fps
    }

    /// Prepares to ask for the camera at many times.
    ///
    /// # Errors
    /// No keys, times that do not grow, or a camera that cannot be drawn; scene and path files with such paths are refused.
    pub fn sampler(&self) -> Result<PathSampler, CameraError> {
        PathSampler::new(self)
    }
}

/// A path ready to be asked for its camera at any time.
#[derive(Clone, Debug)]
pub struct PathSampler {
    keys: Vec<PathKey>,
    /// One less than keys.
    legs: Vec<Leg>,
}

/// The way from a key to the next.
#[derive(Clone, Copy, Debug)]
struct Leg {
    duration_s: f64,
    way: Way,
    /// Derivatives of the position by the part of the way made, at either end.
    slopes: [DVec3; 2],
    /// World from view, at either end.
    turns: [DQuat; 2],
    distances: [f64; 2],
}

impl PathSampler {
    fn new(path: &CameraPath) -> Result<PathSampler, CameraError> {
        let fail = |parameter, reason: &str| CameraError { parameter, reason: reason.to_owned() };
        let keys = &path.keys;
        if keys.is_empty() {
            return Err(fail("keys", "a path needs at least one key"));
        }
        if !keys.iter().all(|key| key.t.is_finite()) || !keys.is_sorted_by(|a, b| a.t < b.t) {
            return Err(fail("t", "the times of a path's keys must grow"));
        }
        let turns =
            keys.iter().map(|key| orientation(&key.camera)).collect::<Result<Vec<_>, _>>()?;
        let slopes = slopes(path);
        let parts: Vec<Part> = (0..keys.len() - 1)
            .map(|i| {
                let [a, b] = [&keys[i], &keys[i + 1]];
                let (from, to) = (a.camera.eye, b.camera.eye);
                let length = match path.interpolation {
                    _ if coincide(from, to) => None,
                    Interpolation::CatmullRom => Some(spline::knot_interval(from, to)),
                    Interpolation::Linear => Some(from.distance(to)),
                };
                let angle = turns[i].angle_between(turns[i + 1]);
                Part { duration_s: b.t - a.t, length, angle, ease: a.ease }
            })
            .collect();
        let legs = (0..parts.len())
            .map(|i| {
                let [a, b] = [&keys[i].camera, &keys[i + 1].camera];
                Leg {
                    duration_s: parts[i].duration_s,
                    way: Way::of(&parts, i),
                    slopes: slopes[i],
                    turns: [turns[i], turns[i + 1]],
                    distances: [a.eye.distance(a.target), b.eye.distance(b.target)],
                }
            })
            .collect();
        Ok(PathSampler { keys: keys.clone(), legs })
    }

    /// The camera at `t` seconds. What is no number counts as before all keys.
    pub fn at(&self, t: f64) -> Camera {
        // The first key is at or before `t` unless `t` is before all of them.
        let index = self.keys.partition_point(|key| key.t <= t).saturating_sub(1);
        let key = &self.keys[index];
        let (Some(leg), Some(next)) = (self.legs.get(index), self.keys.get(index + 1)) else {
            return key.camera;
        };
        if t > key.t { leg.between(&key.camera, &next.camera, t - key.t) } else { key.camera }
    }

    /// The cameras at `count` times while a shutter is open: in the middle of equal parts of the time from `t - 0.5 * open_s` to
    /// `t + 0.5 * open_s`. A cut within that time ends the exposure, so that no frame shows what is before and behind the cut.
    pub fn while_open(&self, t: f64, open_s: f64, count: u32) -> Vec<Camera> {
        let [first, last] = self.shot(t);
        let (opens, closes) = ((t - 0.5 * open_s).max(first), (t + 0.5 * open_s).min(last));
        let share = |number: u32| (f64::from(number) + 0.5) / f64::from(count);
        (0..count).map(|number| self.at(opens + (closes - opens) * share(number))).collect()
    }

    /// The time between two cuts that `t` lies in. A cut is at the end of a wait, and where the projection changes.
    fn shot(&self, t: f64) -> [f64; 2] {
        let cuts = self.keys.windows(2).filter(|pair| {
            let [before, behind] =
                [pair[0].camera.lens, pair[1].camera.lens].map(|lens| lens.projection());
            pair[0].ease == Ease::Hold || before != behind
        });
        cuts.fold([f64::NEG_INFINITY, f64::INFINITY], |[first, last], pair| match pair[1].t {
            cut if cut <= t => [first.max(cut), last],
            cut => [first, last.min(cut)],
        })
    }
}

impl Leg {
    /// The camera `elapsed_s` after `a`, on the way to `b`.
    fn between(&self, a: &Camera, b: &Camera, elapsed_s: f64) -> Camera {
        let made = self.way.made(elapsed_s / self.duration_s);
        if made <= 0.0 {
            return *a;
        }
        if made >= 1.0 {
            return *b;
        }
        let eye = spline::hermite(a.eye, b.eye, self.slopes[0], self.slopes[1], made);
        let turn = self.turns[0].slerp(self.turns[1], made).normalize();
        let [from, to] = self.distances;
        // A target must stay apart from the eye, also where coordinates are too large to tell them apart by a small distance.
        let distance = (from + (to - from) * made).max(eye.length() * 1e-12);
        Camera {
            eye,
            target: eye + turn * DVec3::NEG_Z * distance,
            up: turn * DVec3::Y,
            lens: a.lens.towards(b.lens, made),
        }
    }
}

/// The rotation from view space into the world.
fn orientation(camera: &Camera) -> Result<DQuat, CameraError> {
    let world_from_view: DMat3 = camera.view(1, 1)?.view_from_world.transpose();
    Ok(DQuat::from_mat3(&world_from_view).normalize())
}

/// Whether two places are the same but for rounding.
fn coincide(a: DVec3, b: DVec3) -> bool {
    a.distance(b) <= 4.0 * f64::EPSILON * a.abs().max(b.abs()).max_element()
}

/// For each part of the path, derivatives of the position at both ends, by the part of the way made.
fn slopes(path: &CameraPath) -> Vec<[DVec3; 2]> {
    let eyes: Vec<DVec3> = path.keys.iter().map(|key| key.camera.eye).collect();
    if path.interpolation == Interpolation::Linear {
        return eyes.windows(2).map(|pair| [pair[1] - pair[0]; 2]).collect();
    }
    // Keys in one place are one point of the curve: where each key stands among these.
    let mut points: Vec<DVec3> = Vec::new();
    let mut place = Vec::with_capacity(eyes.len());
    for (i, &eye) in eyes.iter().enumerate() {
        if i == 0 || !coincide(eyes[i - 1], eye) {
            points.push(eye);
        }
        place.push(points.len() - 1);
    }
    let tangents = spline::tangents(&points);
    let of_leg = |i: usize| {
        if place[i] == place[i + 1] {
            return [eyes[i + 1] - eyes[i]; 2];
        }
        let interval = spline::knot_interval(points[place[i]], points[place[i + 1]]);
        [tangents[place[i]] * interval, tangents[place[i + 1]] * interval]
    };
    (0..eyes.len() - 1).map(of_leg).collect()
}
