//! The pose of each request: a point of a closed path. No two requests use the same point.
//!
//! Neighbouring requests have neighbouring poses, as those of a moving client have. Equal poses never occur, because the step
//! along the path is an irrational part of its length. No entity tag, proxy or coalescing of identical requests can therefore
//! answer for the renderer.

use std::f64::consts::TAU;

use glam::DVec3;

use super::wire::SceneAnswer;
use crate::math::{Bounds, Camera, Lens};
use crate::scene::random::SplitMix64;

/// Step along the path from one request to the next: the golden ratio's fraction over 64, about a hundredth of the path.
const STEP: f64 = 0.618_033_988_749_894_9 / 64.0;
/// Step of an orbit's rise, which goes up and down at its own pace.
const RISE_STEP: f64 = STEP * 0.414_213_562_373_095;
const FOV_DEG: f64 = 40.0;
/// Lens of the cameras of an orbit.
pub const LENS: Lens = Lens::Perspective { fov_deg: FOV_DEG };
/// Lowest and highest elevation of the eye above the horizon.
const RISE_DEG: [f64; 2] = [8.0, 42.0];

/// Path that the poses lie on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum PathKind {
    /// An orbit around the scene, which stays in view; the eye rises and sinks
    Orbit,
    /// Straight lines from each camera of the scene to the next
    Cameras,
}

/// A path, and the seeded point at which the run enters it.
#[derive(Clone, Debug)]
pub struct Poses {
    path: Path,
    entry: f64,
}

#[derive(Clone, Debug)]
enum Path {
    Orbit { centre: DVec3, radius: f64, up: DVec3, side: DVec3, ahead: DVec3 },
    Tour { stops: Vec<Camera> },
}

impl Poses {
    /// # Errors
    /// Fails for a scene without extent, and for one without two cameras to go between.
    pub fn new(kind: PathKind, scene: &SceneAnswer, seed: u64) -> anyhow::Result<Self> {
        let path = match kind {
            PathKind::Orbit => {
                let [min, max] = scene.bounds.ok_or_else(|| {
                    anyhow::anyhow!("scene `{}` is empty: there is nothing to look at", scene.id)
                })?;
                orbit(&Bounds { min: min.into(), max: max.into() }, scene.up.into())
            }
            PathKind::Cameras => {
                anyhow::ensure!(
                    scene.cameras.len() >= 2,
                    "scene `{}` names {} camera(s); a path between cameras needs two; use --poses orbit",
                    scene.id,
                    scene.cameras.len()
                );
                Path::Tour { stops: scene.cameras.iter().map(|camera| camera.pose()).collect() }
            }
        };
        Ok(Self { path, entry: SplitMix64::new(seed).unit() })
    }

    /// The pose of request `number`.
    pub fn pose(&self, number: u64) -> Camera {
        let along = |step: f64| (self.entry + number as f64 * step).fract();
        match &self.path {
            Path::Orbit { centre, radius, up, side, ahead } => {
                let (sine, cosine) = (TAU * along(STEP)).sin_cos();
                let [low, high] = RISE_DEG.map(f64::to_radians);
                let rise = low + (high - low) * (0.5 - 0.5 * (TAU * along(RISE_STEP)).cos());
                let level = *ahead * cosine + *side * sine;
                let eye = *centre + (level * rise.cos() + *up * rise.sin()) * *radius;
                Camera { eye, target: *centre, up: *up, lens: LENS }
            }
            Path::Tour { stops } => between_stops(stops, along(STEP)),
        }
    }
}

/// An orbit from which the whole box is in view.
fn orbit(bounds: &Bounds, up: DVec3) -> Path {
    let up = up.try_normalize().unwrap_or(DVec3::Y);
    let side = up.any_orthonormal_vector();
    let around = 0.5 * bounds.extent().length();
    // A single point is looked at from one unit away.
    let around = if around > 0.0 { around } else { 0.3 };
    let radius = around / (0.5 * FOV_DEG).to_radians().sin();
    Path::Orbit { centre: bounds.centre(), radius, up, side, ahead: side.cross(up) }
}

/// The pose at a share of the closed path from stop to stop; all legs are equally long.
fn between_stops(stops: &[Camera], share: f64) -> Camera {
    let at = share * stops.len() as f64;
    let leg = (at as usize).min(stops.len() - 1);
    let (from, to, t) = (stops[leg], stops[(leg + 1) % stops.len()], at - leg as f64);
    let eye = from.eye.lerp(to.eye, t);
    let mut target = from.target.lerp(to.target, t);
    // The path may lead the eye through its own target. The eye then keeps its direction.
    if (target - eye).length() < 1e-6 * (from.target - from.eye).length() {
        target = eye + (from.target - from.eye);
    }
    let up = from.up.lerp(to.up, t);
    let up = if up.length() > 1e-6 { up } else { from.up };
    Camera { eye, target, up, lens: from.lens.towards(to.lens, t) }
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::super::wire::CameraAnswer;
    use super::*;

    fn scene() -> SceneAnswer {
        let camera = |eye, target| CameraAnswer {
            eye,
            target,
            up: [0.0, 0.0, 1.0],
            fov: Some(50.0),
            ortho_height: None,
        };
        SceneAnswer {
            id: "town".into(),
            revision: 1,
            bounds: Some([[4.1e5, 5.65e6, 100.0], [4.1e5 + 80.0, 5.65e6 + 60.0, 120.0]]),
            up: [0.0, 0.0, 1.0],
            cameras: vec![
                camera([0.0, 0.0, 1.0], [9.0, 0.0, 1.0]),
                camera([9.0, 5.0, 1.0], [0.0, 5.0, 1.0]),
                camera([4.0, 2.5, 9.0], [4.0, 2.5, 0.0]),
            ],
        }
    }

    #[test]
    fn no_pose_comes_twice() {
        for kind in [PathKind::Orbit, PathKind::Cameras] {
            let poses = Poses::new(kind, &scene(), 5).unwrap();
            let seen: HashSet<String> =
                (0..100_000).map(|number| format!("{:?}", poses.pose(number))).collect();
            assert_eq!(seen.len(), 100_000, "{kind:?}");
        }
    }

    #[test]
    fn an_orbit_sees_all_of_the_scene_from_all_around() {
        let scene = scene();
        let poses = Poses::new(PathKind::Orbit, &scene, 1).unwrap();
        let [min, max] = scene.bounds.unwrap().map(DVec3::from);
        let mut quarters = HashSet::new();
        for number in 0..1000 {
            let pose = poses.pose(number);
            assert!(pose.view(64, 64).is_ok());
            let forward = (pose.target - pose.eye).try_normalize().unwrap();
            for corner in 0..8 {
                let pick =
                    |axis: usize| if corner >> axis & 1 == 0 { min[axis] } else { max[axis] };
                let to = DVec3::new(pick(0), pick(1), pick(2)) - pose.eye;
                assert!(to.angle_between(forward) <= 20.001f64.to_radians());
            }
            assert!(pose.eye.z > 100.0);
            quarters.insert((pose.eye.x > pose.target.x, pose.eye.y > pose.target.y));
        }
        assert_eq!(quarters.len(), 4);
    }

    #[test]
    fn neighbours_are_near() {
        let poses = Poses::new(PathKind::Orbit, &scene(), 1).unwrap();
        let radius = (poses.pose(0).eye - poses.pose(0).target).length();
        for number in 0..200 {
            let gone = (poses.pose(number + 1).eye - poses.pose(number).eye).length();
            assert!(gone > 0.0 && gone < 0.08 * radius);
        }
    }

    #[test]
    fn tours_lead_through_every_camera_and_never_break() {
        let scene = scene();
        let stops: Vec<Camera> = scene.cameras.iter().map(CameraAnswer::pose).collect();
        assert_eq!(between_stops(&stops, 0.0), stops[0]);
        assert!((between_stops(&stops, 1.0 / 3.0).eye - stops[1].eye).length() < 1e-9);
        let poses = Poses::new(PathKind::Cameras, &scene, 2).unwrap();
        assert!((0..3000).all(|number| poses.pose(number).view(8, 8).is_ok()));
        // Two cameras whose eyes are each other's targets: half way between them, the eye coincides with the target.
        let facing = [stops[0], Camera { eye: stops[0].target, target: stops[0].eye, ..stops[0] }];
        assert!(between_stops(&facing, 0.25).view(8, 8).is_ok());
    }

    #[test]
    fn a_scene_that_has_no_path_is_refused() {
        let mut scene = scene();
        scene.bounds = None;
        scene.cameras.truncate(1);
        assert!(Poses::new(PathKind::Orbit, &scene, 1).unwrap_err().to_string().contains("empty"));
        let refused = Poses::new(PathKind::Cameras, &scene, 1).unwrap_err().to_string();
        assert!(refused.contains("needs two"), "{refused}");
        scene.bounds = Some([[1.0; 3]; 2]);
        assert!(Poses::new(PathKind::Orbit, &scene, 1).unwrap().pose(3).view(8, 8).is_ok());
    }
}
