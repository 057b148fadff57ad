//! Poses of a survey: cameras of the scene, or views around it. Pure.

use glam::{DQuat, DVec3};

use super::survey::NamedPose;
use crate::engine::NamedCamera;
use crate::math::{Camera, Lens};
use crate::spelling::suggestion;

/// Most cameras of a scene that a survey takes by itself.
pub const MOST_POSES: usize = 5;

/// Distances of the views around a scene, as shares of the default view's, each with its name.
const DISTANCES: [(&str, f64); 3] = [("default view", 1.0), ("near", 0.4), ("far", 3.0)];
/// Turns of the other views about the vertical axis, in degrees.
const TURNS_DEG: [(&str, f64); 2] = [("turned left", -50.0), ("turned right", 50.0)];

/// A camera that the scene does not have.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("the scene has no camera `{name}`{near}; {known}")]
pub struct UnknownCamera {
    pub name: String,
    near: String,
    known: String,
}

/// The poses of these cameras of a scene, or of its first [`MOST_POSES`] if no names are given.
///
/// # Errors
/// A name that is not among the scene's cameras.
pub fn of_cameras(
    cameras: &[NamedCamera],
    names: &[String],
) -> Result<Vec<NamedPose>, UnknownCamera> {
    let mut chosen: Vec<&NamedCamera> = Vec::new();
    for name in names {
        let found = cameras.iter().find(|camera| camera.name == *name).ok_or_else(|| {
            let known: Vec<&str> = cameras.iter().map(|camera| camera.name.as_str()).collect();
            let near = suggestion(name, known.iter().copied());
            let known = match known.as_slice() {
                [] => "it has none; leave the option out for views around the scene".to_owned(),
                known => format!("its cameras are {}", known.join(", ")),
            };
            UnknownCamera { name: name.clone(), near, known }
        })?;
        if !chosen.iter().any(|camera| camera.name == found.name) {
            chosen.push(found);
        }
    }
    if names.is_empty() {
        chosen.extend(cameras.iter().take(MOST_POSES));
    }
    let pose = |(number, found): (usize, &NamedCamera)| {
        let lens = match (found.fov, found.ortho_height) {
            (_, Some(height)) => Lens::Orthographic { height },
            (fov_deg, None) => Lens::Perspective { fov_deg: fov_deg.unwrap_or(40.0) },
        };
        let [eye, target, up] = [found.eye, found.target, found.up].map(DVec3::from);
        NamedPose::new(number, &found.name, Camera { eye, target, up, lens })
    };
    Ok(chosen.into_iter().enumerate().map(pose).collect())
}

/// Five views around a scene: the default view, one nearer, one farther, and two that are turned about the vertical axis.
pub fn around(view: &Camera) -> Vec<NamedPose> {
    let offset = view.eye - view.target;
    let at = |share: f64| {
        let lens = match view.lens {
            Lens::Orthographic { height } => Lens::Orthographic { height: height * share },
            perspective => perspective,
        };
        Camera { eye: view.target + offset * share, lens, ..*view }
    };
    let turned = |degrees: f64| {
        let turn = DQuat::from_axis_angle(view.up.normalize_or(DVec3::Y), degrees.to_radians());
        Camera { eye: view.target + turn * offset, ..*view }
    };
    let distances = DISTANCES.map(|(name, share)| (name, at(share)));
    let turns = TURNS_DEG.map(|(name, degrees)| (name, turned(degrees)));
    let views = distances.into_iter().chain(turns).enumerate();
    views.map(|(number, (name, camera))| NamedPose::new(number, name, camera)).collect()
}

/// Range of the distances of [`spread`] views, as shares of the default view's.
const SPREAD: [f64; 2] = [0.25, 4.0];
/// Range of their heights over the horizon, in degrees.
const HEIGHTS_DEG: [f64; 2] = [5.0, 65.0];
/// Farthest that their targets are moved, as a share of the default view's distance.
const ASIDE: f64 = 0.2;

/// Views in all directions and distances around a scene, the same ones every time: from `first` on, so many of the additive recurrence of
/// Roberts (2018), which fills the space of views evenly. No view has the name of one of the scene's `cameras`.
pub fn spread(
    view: &Camera,
    first: usize,
    count: usize,
    cameras: &[NamedCamera],
) -> Vec<NamedPose> {
    // The real root of x⁶ = x + 1; its powers are the steps.
    let root: f64 = 1.134_724_138_401_519_5;
    let offset = view.eye - view.target;
    let up = view.up.normalize_or(DVec3::Y);
    let level = offset.reject_from_normalized(up).normalize_or(up.any_orthonormal_vector());
    let views = (first..first + count).map(|number| {
        let at = |axis: i32| (0.5 + (number as f64 + 1.0) / root.powi(axis)).fract();
        let within = |[low, high]: [f64; 2], share: f64| low + share * (high - low);
        let turn = DQuat::from_axis_angle(up, at(1) * std::f64::consts::TAU);
        let height = within(HEIGHTS_DEG, at(2)).to_radians();
        let share = within(SPREAD.map(f64::ln), at(3)).exp();
        let towards = turn * (level * height.cos() + up * height.sin());
        let aside = |share: f64| (2.0 * share - 1.0) * ASIDE * offset.length();
        let target = view.target + level * aside(at(4)) + up.cross(level) * aside(at(5));
        let lens = match view.lens {
            Lens::Orthographic { height } => Lens::Orthographic { height: height * share },
            perspective => perspective,
        };
        let camera = Camera { eye: target + towards * share * offset.length(), target, up, lens };
        let mut name = format!("view {}", number + 1);
        while cameras.iter().any(|camera| camera.name == name) {
            name.insert_str(0, "other ");
        }
        NamedPose::new(number, &name, camera)
    });
    views.collect()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    fn camera(name: &str) -> NamedCamera {
        NamedCamera {
            name: name.to_owned(),
            eye: [0.0, 0.0, 4.0],
            target: [0.0; 3],
            up: [0.0, 1.0, 0.0],
            fov: Some(30.0),
            ortho_height: None,
        }
    }

    #[test]
    fn cameras_are_taken_by_name_or_the_first_five() {
        let cameras: Vec<_> = ["a", "b", "c", "d", "e", "front"].map(camera).into();
        let all = of_cameras(&cameras, &[]).unwrap();
        assert_eq!(all.len(), MOST_POSES);
        assert_eq!(all[4].folder, "5-e");
        let two = of_cameras(&cameras, &["front".into(), "b".into(), "front".into()]).unwrap();
        assert_eq!(two.iter().map(|pose| pose.name.as_str()).collect::<Vec<_>>(), ["front", "b"]);
        assert_eq!(two[0].camera.lens, Lens::Perspective { fov_deg: 30.0 });
        let error = of_cameras(&cameras, &["frnt".into()]).unwrap_err().to_string();
        assert!(error.contains("`frnt`") && error.contains("a, b, c, d, e, front"), "{error}");
        let error = of_cameras(&[], &["x".into()]).unwrap_err().to_string();
        assert!(error.contains("has none"), "{error}");
    }

    #[test]
    fn spread_views_differ_and_stay_within_their_ranges() {
        let view = Camera::perspective(DVec3::new(0.0, 3.0, 4.0), DVec3::ZERO, 40.0);
        let poses = spread(&view, 0, 32, &[]);
        let away = |pose: &NamedPose| pose.camera.eye - pose.camera.target;
        for (number, pose) in poses.iter().enumerate() {
            let share = away(pose).length() / 5.0;
            assert!((SPREAD[0]..=SPREAD[1]).contains(&share), "{share}");
            let height_deg = (away(pose).y / away(pose).length()).asin().to_degrees();
            assert!((HEIGHTS_DEG[0]..=HEIGHTS_DEG[1]).contains(&height_deg), "{height_deg}");
            assert!(pose.camera.target.length() < 1.5 && pose.camera.target.y.abs() < 1e-12);
            let others = poses.iter().take(number);
            assert!(others.clone().all(|other| away(other).distance(away(pose)) > 0.1));
        }
        let near = poses.iter().filter(|pose| away(pose).length() < 5.0).count();
        assert!((12..=20).contains(&near), "{near}");
        assert_eq!(spread(&view, 3, 1, &[])[0].camera, poses[3].camera);
    }

    /// Measurements are kept by the names of poses.
    #[test]
    fn spread_views_have_names_that_no_camera_has() {
        let cameras: Vec<_> = ["view 7", "other view 7", "view 40"].map(camera).into();
        let mut poses = of_cameras(&cameras, &[]).unwrap();
        poses.extend(spread(&poses[0].camera, 3, 8, &cameras));
        let names: BTreeSet<&str> = poses.iter().map(|pose| pose.name.as_str()).collect();
        assert_eq!(names.len(), poses.len(), "{names:?}");
        assert!(names.contains("other other view 7") && names.contains("view 8"), "{names:?}");
    }

    #[test]
    fn views_keep_their_target_and_differ_in_distance_or_direction() {
        let lens = Lens::Orthographic { height: 2.0 };
        let view =
            Camera { eye: DVec3::new(0.0, 3.0, 4.0), target: DVec3::ZERO, up: DVec3::Y, lens };
        let poses = around(&view);
        let distances: Vec<f64> = poses.iter().map(|pose| pose.camera.eye.length()).collect();
        for (found, expected) in distances.iter().zip([5.0, 2.0, 15.0, 5.0, 5.0]) {
            assert!((found - expected).abs() < 1e-12, "{distances:?}");
        }
        assert!(poses.iter().all(|pose| pose.camera.target == DVec3::ZERO));
        assert_eq!(poses[1].camera.lens, Lens::Orthographic { height: 0.8 });
        assert!((poses[3].camera.eye.y - 3.0).abs() < 1e-12);
        assert!(poses[3].camera.eye.distance(poses[4].camera.eye) > 1.0);
    }
}
