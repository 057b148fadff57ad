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

#[cfg(test)]
mod tests {
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
