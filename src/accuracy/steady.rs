//! Whether frames stay steady: random views of scenes with every setting, each drawn twice, the second time from a pose a thousandth of a pixel aside:
//! `pointillist accuracy --stability --scenes`.
//!
//! Depths must be numbers, and normals unit vectors. A small step must leave the colours of nearly all pixels as they are: only where an edge crosses the
//! centre of a pixel may it show something else (`pair`).

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use glam::{DQuat, DVec3};
use serde::Serialize;

use super::sweep::Row;
use crate::encode::ImageFormat;
use crate::engine::{
    EncodedFrame, Engine, EngineError, FrameRequest, FrameTicket, Pose, SceneInfo,
};
use crate::math::{Bounds, Camera, Lens, View};
use crate::plan::{Output, Settings};
use crate::scene::random::SplitMix64;

mod pair;

use pair::{Judgement, Pair};

/// Size of the frames in pixels.
pub const SIZE: [u32; 2] = [96, 72];
/// The step between a pose and its neighbour, in pixels.
const STEP_PX: f64 = 1e-3;
/// Rounding of a view-space coordinate: one unit in the last place of an `f32`.
const ROUNDING: f64 = f32::EPSILON as f64;
/// Poses with the same settings that are drawn together.
pub const AT_ONCE: u32 = 16;
/// Broken views of a scene that are listed.
const LISTED: usize = 32;
/// Distances from the scene's middle, in halves of its diagonal; fields of view in degrees. Both are distributed evenly over their logarithms.
const DISTANCES: [f64; 2] = [0.02, 200.0];
const FIELDS_DEG: [f64; 2] = [0.02, 170.0];

/// What the frames of a scene showed.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Steadiness {
    pub scene: String,
    /// Pairs of frames that were compared.
    pub views: u64,
    /// Ways to draw that were tried.
    pub settings: usize,
    /// Views that the engine refused, by the reason.
    pub refused: BTreeMap<String, u64>,
    /// Frames with a depth that is NaN, negative or −∞, or with a normal that is not of unit length.
    pub not_finite: u64,
    /// The view in which the largest share of the pixels that may change did.
    pub worst: Changed,
    /// Views in which more pixels changed than may, or a pixel away from every edge.
    pub unsteady: u64,
    /// Settings whose views broke a bound, and how many did.
    pub broken_with: BTreeMap<String, u64>,
    /// The first views that broke a bound, as they can be asked for.
    pub broken: Vec<Broken>,
    pub holds: bool,
}

/// Pixels that differ visibly between a frame and the one beside it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Changed {
    pub changed: usize,
    /// Number of them that the edges of the frame explain.
    pub allowed: usize,
}

/// A view whose frame broke a bound, and the view beside it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Broken {
    pub settings: String,
    #[serde(flatten)]
    pub pixels: Changed,
    /// Changed pixels that have no edge beside them.
    pub away: usize,
    /// Depths that are NaN, negative or −∞.
    pub odd_depths: usize,
    /// Normals that are not of unit length.
    pub odd_normals: usize,
    pub eye: [f64; 3],
    pub target: [f64; 3],
    pub up: [f64; 3],
    /// Degrees, or `None` for a view whose rays are parallel.
    pub fov: Option<f64>,
    pub ortho_height: Option<f64>,
    pub eye_beside: [f64; 3],
    pub target_beside: [f64; 3],
}

/// Random views of a scene with all rows in turn.
pub struct Sweep<'a> {
    pub engine: &'a Engine,
    pub rows: &'a [Row],
    /// The row that the first views are drawn with.
    pub first: usize,
    /// Pairs of frames.
    pub views: u64,
    pub seed: u64,
    /// Ends the sweep early.
    pub stop: &'a AtomicBool,
}

impl Sweep<'_> {
    /// Draws a loaded scene and compares its frames; `told` hears of the views that are done.
    ///
    /// # Errors
    /// The engine fails. A view that it refuses is counted instead.
    pub fn of(
        &self,
        scene: &SceneInfo,
        mut told: impl FnMut(u64),
    ) -> Result<Steadiness, EngineError> {
        let mut random = SplitMix64::stream(self.seed, 0);
        // Rows in turn, each scene from another one on.
        let first = self.first;
        let groups = self.views.div_ceil(u64::from(AT_ONCE)) as usize;
        let mut found = Steadiness {
            scene: scene.name.clone(),
            settings: groups.min(self.rows.len()),
            ..Steadiness::default()
        };
        let mut group = first;
        let mut left = self.views;
        while left > 0 && !self.stop.load(Ordering::Relaxed) {
            let count = left.min(u64::from(AT_ONCE));
            let row = &self.rows[group % self.rows.len()];
            let cameras: Vec<Camera> = (0..count).map(|_| camera(scene, &mut random)).collect();
            self.compare(scene, row, &cameras, &mut random, &mut found)?;
            left -= count;
            group += 1;
            told(self.views - left);
        }
        found.holds = found.not_finite == 0 && found.unsteady == 0;
        Ok(found)
    }

    fn compare(
        &self,
        scene: &SceneInfo,
        row: &Row,
        cameras: &[Camera],
        random: &mut SplitMix64,
        found: &mut Steadiness,
    ) -> Result<(), EngineError> {
        let settings = Settings::from(row.given).complete();
        let request = |camera: Camera, output| FrameRequest {
            scene: scene.id.clone(),
            pose: Pose::Camera(camera),
            width: SIZE[0],
            height: SIZE[1],
            settings,
            output,
            format: ImageFormat::Raw,
            quality: 100,
            deadline: None,
        };
        let submit = |camera: &Camera, output| self.engine.submit(request(*camera, output));
        let tickets: Vec<_> = cameras
            .iter()
            .map(|camera| {
                [Output::Depth, Output::Color, Output::Normal].map(|output| submit(camera, output))
            })
            .collect();
        let mut firsts = Vec::with_capacity(cameras.len());
        for (camera, tickets) in cameras.iter().zip(tickets) {
            let Some([depth, first, normal]) = found.drawn(tickets)? else { continue };
            let moved = beside(camera, nearest(depth.bytes.as_chunks().0), random);
            firsts.push((camera, moved, [depth, first, normal], submit(&moved, Output::Color)));
        }
        for (camera, moved, [depth, first, normal], second) in firsts {
            let Some([second]) = found.drawn([second])? else { continue };
            let [first, second, depth, normal] =
                [&first, &second, &depth, &normal].map(|frame| frame.bytes.as_chunks().0);
            let views = [camera, &moved].map(|camera| camera.view(SIZE[0], SIZE[1]));
            let [Ok(view), Ok(beside)] = &views else {
                return Err(EngineError::Internal("a pose that was drawn has no view".to_owned()));
            };
            let pair = Pair {
                colors: [first, second],
                depths: depth,
                normals: normal,
                views: [view, beside],
                parts: settings.parts(),
                rounding_px: view.focal_px * (ROUNDING * reach(scene, view)),
                error_px: settings.accepted_px_of_trees().map_or(0, |error| error.ceil() as usize),
            };
            found.add(&row.label, [camera, &moved], pair.judge());
        }
        Ok(())
    }
}

impl Steadiness {
    /// Waits for frames of a view. `None` if the engine refuses one of them, which is counted.
    fn drawn<const N: usize>(
        &mut self,
        tickets: [Result<FrameTicket, EngineError>; N],
    ) -> Result<Option<[Arc<EncodedFrame>; N]>, EngineError> {
        let mut frames = Vec::with_capacity(N);
        let mut refused = None;
        for ticket in tickets {
            match ticket.and_then(FrameTicket::wait) {
                Ok(frame) => frames.push(frame),
                Err(error @ (EngineError::BadParameter { .. } | EngineError::OverLimit { .. })) => {
                    refused = Some(error)
                }
                Err(error) => return Err(error),
            }
        }
        if let Some(error) = refused {
            *self.refused.entry(error.to_string()).or_default() += 1;
        }
        Ok(frames.try_into().ok())
    }

    /// Counts a view and the one beside it.
    fn add(&mut self, settings: &str, views: [&Camera; 2], judgement: Judgement) {
        let Judgement { changed, allowed, away, odd_depths, odd_normals } = judgement;
        let pixels = Changed { changed, allowed };
        self.views += 1;
        self.not_finite += u64::from(!judgement.is_finite());
        self.unsteady += u64::from(!judgement.is_steady());
        if pixels.share() > self.worst.share() {
            self.worst = pixels;
        }
        if judgement.is_finite() && judgement.is_steady() {
            return;
        }
        *self.broken_with.entry(settings.to_owned()).or_default() += 1;
        if self.broken.len() < LISTED {
            let [camera, beside] = views;
            self.broken.push(Broken {
                settings: settings.to_owned(),
                pixels,
                away,
                odd_depths,
                odd_normals,
                eye: camera.eye.into(),
                target: camera.target.into(),
                up: camera.up.into(),
                fov: camera.lens.fov_deg(),
                ortho_height: camera.lens.ortho_height(),
                eye_beside: beside.eye.into(),
                target_beside: beside.target.into(),
            });
        }
    }
}

impl Changed {
    /// Changed pixels over those that may change.
    fn share(&self) -> f64 {
        self.changed as f64 / self.allowed.max(1) as f64
    }
}

fn direction(random: &mut SplitMix64) -> DVec3 {
    let z = random.range(-1.0, 1.0);
    let (sine, cosine) = random.range(0.0, std::f64::consts::TAU).sin_cos();
    let level = (1.0 - z * z).max(0.0).sqrt();
    DVec3::new(level * cosine, level * sine, z)
}

/// Evenly over the logarithms of a range.
fn scaled(random: &mut SplitMix64, [low, high]: [f64; 2]) -> f64 {
    random.range(f64::ln(low), f64::ln(high)).exp()
}

/// A view from anywhere, in any direction that may show something: from within the scene and from far away, rolled, of any field of view.
fn camera(scene: &SceneInfo, random: &mut SplitMix64) -> Camera {
    let [low, high] = scene.bounds.unwrap_or_default().map(DVec3::from);
    let radius = (0.5 * (high - low).length()).max(1e-6);
    let within = |random: &mut SplitMix64| {
        DVec3::from_array(std::array::from_fn(|axis| random.range(low[axis], high[axis])))
    };
    let target = within(random);
    let distance = radius * scaled(random, DISTANCES);
    let eye = target + direction(random) * distance;
    let lens = if random.chance(0.15) {
        Lens::Orthographic { height: radius * scaled(random, DISTANCES) }
    } else {
        Lens::Perspective { fov_deg: scaled(random, FIELDS_DEG) }
    };
    Camera { eye, target, up: direction(random), lens }
}

/// The least positive depth of a frame.
fn nearest(depths: &[[u8; 4]]) -> Option<f64> {
    let depths = depths.iter().map(|bytes| f64::from(f32::from_le_bytes(*bytes)));
    depths.filter(|depth| *depth > 0.0 && depth.is_finite()).reduce(f64::min)
}

/// The largest coordinate, beside the optical axis, that decides where something is seen. In perspective, coordinates count in units of the depth.
fn reach(scene: &SceneInfo, view: &View) -> f64 {
    if !view.is_orthographic() {
        return 1.0;
    }
    let [min, max] = scene.bounds.unwrap_or_default().map(DVec3::from);
    let aside = |corner: DVec3| view.to_view(corner).truncate().abs().max_element();
    Bounds { min, max }.corners().map(aside).into_iter().fold(0.0, f64::max)
}

/// The view moved to some side by [`STEP_PX`] at the `nearest` depth, or turned by as much. Where its rays are parallel, all depths move alike.
fn beside(camera: &Camera, nearest: Option<f64>, random: &mut SplitMix64) -> Camera {
    let way = camera.target - camera.eye;
    let aside = direction(random).reject_from(way).normalize_or(DVec3::X);
    let height = f64::from(SIZE[1]);
    match camera.lens {
        Lens::Orthographic { height: own } => {
            let step = aside * (own / height * STEP_PX);
            Camera { eye: camera.eye + step, target: camera.target + step, ..*camera }
        }
        Lens::Perspective { fov_deg } => {
            let pixel = 2.0 * (0.5 * fov_deg.to_radians()).tan() / height;
            if let Some(depth) = nearest.filter(|_| random.chance(0.5)) {
                let step = aside * (depth * pixel * STEP_PX);
                return Camera { eye: camera.eye + step, target: camera.target + step, ..*camera };
            }
            let turn = DQuat::from_axis_angle(aside, pixel * STEP_PX);
            Camera { target: camera.eye + turn * way, ..*camera }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A view counts as unsteady and as not finite each by itself, and is listed once; the worst view is the one farthest beyond what is allowed.
    #[test]
    fn frames_that_break_a_bound_are_found() {
        let camera = Camera::perspective(DVec3::Z, DVec3::ZERO, 40.0);
        let mut found = Steadiness::default();
        let judged = |changed, away, odd_depths, odd_normals| Judgement {
            changed,
            allowed: 10,
            away,
            odd_depths,
            odd_normals,
        };
        for judgement in [
            judged(10, 0, 0, 0),
            judged(11, 0, 0, 0),
            judged(1, 1, 0, 0),
            judged(0, 0, 1, 0),
            judged(0, 0, 0, 1),
            judged(30, 0, 1, 0),
        ] {
            found.add("splats", [&camera, &camera], judgement);
        }
        assert_eq!((found.views, found.unsteady, found.not_finite), (6, 3, 3));
        assert_eq!((found.worst.changed, found.worst.allowed), (30, 10));
        assert_eq!((found.broken.len(), found.broken_with["splats"]), (5, 5));
    }

    /// The step moves the middle of the image by a thousandth of a pixel, whatever the lens.
    #[test]
    fn neighbours_are_a_small_step_aside() {
        let (mut random, mut moves) = (SplitMix64::new(7), 0);
        for lens in [
            Lens::Perspective { fov_deg: 0.05 },
            Lens::Perspective { fov_deg: 150.0 },
            Lens::Orthographic { height: 3.0 },
        ] {
            let camera =
                Camera { eye: DVec3::new(3.0, 1.0, 5.0), target: DVec3::ONE, up: DVec3::Y, lens };
            let distance = camera.eye.distance(camera.target);
            for _ in 0..10 {
                let moved = beside(&camera, Some(distance), &mut random);
                let view = moved.view(SIZE[0], SIZE[1]).unwrap();
                let seen = view.project(view.to_view(camera.target)).unwrap();
                let step = (seen - view.principal_px).length();
                assert!((step / STEP_PX - 1.0).abs() < 0.01, "{lens:?}: {step}");
                moves += usize::from(moved.eye != camera.eye);
            }
        }
        assert!((12..30).contains(&moves), "of 20 in perspective some turn: {moves}");
    }
}
